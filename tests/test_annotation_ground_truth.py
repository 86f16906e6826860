"""Labels become a BOP data set that reads back as the labels say."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from labelling_data import hand_files, objects_of, true_label, write_folder

from inhand.annotation import ground_truth
from inhand.annotation import objects as sources
from inhand.annotation.ground_truth import ImageMaker, LabelledHand, write_ground_truth
from inhand.annotation.images import ImageFile, RawImage, find_images
from inhand.annotation.session import Session
from inhand.annotation.workbench import Workbench
from inhand.cli import main
from inhand.datasets.bop_images import read_image
from inhand.datasets.bop_writer import write_image
from inhand.datasets.frames import find_frames, find_hand, find_objects, load_object, read_frame
from inhand.errors import InputError
from inhand.evaluation.metrics import ObjectMetric
from inhand.hand import Hand
from inhand.synth.demo import builtin_object
from inhand.synth.renderer import OBJECT_BODY
from inhand.synth.scene import Scene

CLEAN = [0, 3, 5]
"""Scenes without sensor noise."""


def labelled(scenes: list[Scene], files: list[ImageFile]) -> Session:
    """All images labelled with the truth."""
    session = Session(tuple(file.name for file in files))
    for i, scene in enumerate(scenes):
        label = replace(true_label(scene), status="labelled")
        session = session.go_to(i).change(label, "labelled")
    return session


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory, scenes: list[Scene]) -> Path:
    """Three scenes, labelled and written twice."""
    folder, chosen = tmp_path_factory.mktemp("labelled"), [scenes[i] for i in CLEAN]
    write_folder(folder / "images", chosen)
    files = find_images(folder / "images")
    objects = {n: (s.number, s.load()) for n, s in objects_of(chosen).items()}
    told: list[tuple[int, int]] = []
    for _ in range(2):
        count = write_ground_truth(
            folder / "out",
            labelled(chosen, files),
            files,
            hand_files(folder / "hand"),
            objects,
            lambda done, total: told.append((done, total)),
        )
        assert count == 3
    assert told == 2 * [(0, 3), (1, 3), (2, 3)]
    return folder / "out"


def test_it_reads_back_as_the_labels_say(dataset: Path, scenes: list[Scene]) -> None:
    frames = [read_frame(path) for path in find_frames([dataset])]
    for frame, scene in zip(frames, [scenes[i] for i in CLEAN], strict=True):
        truth = frame.truth
        assert frame.object_name == scene.obj.name
        np.testing.assert_allclose(frame.depth, scene.depth, atol=5.1e-5)
        np.testing.assert_allclose(frame.T_camera_hand_given, scene.T_camera_hand_given, atol=1e-9)
        np.testing.assert_allclose(truth.T_camera_hand, scene.T_camera_hand, atol=1e-12)
        assert truth.joint_positions == pytest.approx(scene.joint_positions)
        error = ObjectMetric(scene.obj).pose_error(truth.T_camera_object, scene.T_camera_object)
        assert error.translation < 1e-9
        assert error.rotation < 1e-5
        # The labels are the truth, so the masks must be those of the simulation.
        assert np.mean(truth.label == scene.label) > 0.9995
        assert truth.visible_share == pytest.approx(scene.visible_share, abs=0.005)


def test_hand_and_objects_come_with_it(dataset: Path, scenes: list[Scene]) -> None:
    urdf = find_hand(dataset, "hands/none.urdf")
    assert urdf is not None
    hand = Hand.from_urdf(urdf)
    assert hand.joint_names == scenes[0].hand.joint_names
    models = find_objects(dataset, "objects")
    assert models is not None
    name = scenes[3].obj.name
    assert load_object(models, name).diameter == pytest.approx(scenes[3].obj.diameter)
    image = read_image(dataset / "test" / "000001", 1)
    assert image.hand is not None
    q = hand.joint_vector(scenes[3].joint_positions)
    for link, T in zip(hand.links, hand.forward_kinematics(q), strict=True):
        expected = scenes[3].T_camera_hand @ T
        np.testing.assert_allclose(image.hand.T_camera_link[link.name], expected, atol=1e-9)


def test_it_says_where_the_images_came_from(dataset: Path) -> None:
    sources = json.loads((dataset / "test" / "000001" / "sources.json").read_text())
    assert sources == {"0": "a", "1": "b", "2": "c"}
    assert sorted(path.name for path in dataset.iterdir()) == [
        "camera.json",
        "models",
        "test",
        "test_targets_bop19.json",
    ]


def test_it_can_be_labelled_anew(dataset: Path, tmp_path: Path, scenes: list[Scene]) -> None:
    """A BOP data set goes in, with its own hand and models, and its numbers come out."""
    urdf = find_hand(dataset, "none.urdf")
    assert urdf is not None
    hand = LabelledHand(Hand.from_urdf(urdf), urdf)
    bench = Workbench(find_images(dataset), hand, sources.find_objects(dataset), tmp_path / "out")
    for number in CLEAN[:2]:
        assert bench.label.object_name == scenes[number].obj.name
        bench.propose()
        bench.mark("labelled")
    assert bench.write() == 2
    for path in find_frames([tmp_path / "out"]):
        again = read_frame(path)
        first = read_frame(dataset / path.relative_to(tmp_path / "out"))
        assert again.object_name == first.object_name
        np.testing.assert_array_equal(again.depth, first.depth)
        np.testing.assert_array_equal(again.T_camera_hand_given, first.T_camera_hand_given)
        metric = ObjectMetric(builtin_object(again.object_name))
        error = metric.pose_error(again.truth.T_camera_object, first.truth.T_camera_object)
        assert error.translation < 0.001
        assert np.degrees(error.rotation) < 1


def test_inhand_bench_runs_on_it(dataset: Path, tmp_path: Path) -> None:
    assert main(["bench", str(dataset), "--out", str(tmp_path / "bench"), "--device", "cpu"]) == 0
    lines = (tmp_path / "bench" / "results.jsonl").read_text().splitlines()
    results = [json.loads(line) for line in lines]
    frames = [r for r in results if "frame" in json.dumps(r) and "adi" in json.dumps(r)]
    assert len(frames) == 3


def test_symmetric_labels_are_written_as_one(scenes: list[Scene]) -> None:
    scene = scenes[0]
    maker = ImageMaker(scene.hand, 1, scene.obj)
    raw, label = RawImage(scene.depth, scene.camera), true_label(scene)
    first = maker.make(raw, label).instances[0].T_camera_object
    for T in scene.obj.symmetry.representatives(5):
        turned = replace(label, T_camera_object=label.T_camera_object @ T)
        other = maker.make(raw, turned).instances[0].T_camera_object
        np.testing.assert_allclose(other, first, atol=1e-7)


def test_what_stands_in_front_hides_the_object(scenes: list[Scene]) -> None:
    scene = scenes[3]
    maker = ImageMaker(scene.hand, 1, builtin_object(scene.obj.name))
    plain = maker.make(RawImage(scene.depth, scene.camera), true_label(scene))
    depth, half = scene.depth.copy(), plain.instances[0].mask_visible.copy()
    half[:, : int(np.median(np.nonzero(half)[1]))] = False
    depth[half] -= 0.05
    hidden = maker.make(RawImage(depth, scene.camera), true_label(scene))
    assert hidden.segmentation is not None
    assert (hidden.segmentation[half] == 254).all()
    visible = hidden.instances[0].mask_visible
    np.testing.assert_array_equal(visible, plain.instances[0].mask_visible & ~half)
    assert hidden.instances[0].silhouette_pixels == plain.instances[0].silhouette_pixels
    # A missing reading hides nothing.
    depth[half] = 0
    missing = maker.make(RawImage(depth, scene.camera), true_label(scene))
    np.testing.assert_array_equal(
        missing.segmentation == OBJECT_BODY, plain.instances[0].mask_visible
    )


def test_far_readings_and_unknown_wrists(scenes: list[Scene]) -> None:
    scene = scenes[0]
    depth = scene.depth.copy()
    depth[:10] = 9.0
    image = ImageMaker(scene.hand, 1, scene.obj).make(
        RawImage(depth, scene.camera), true_label(scene)
    )
    assert (image.depth[:10] == 0).all()
    assert image.segmentation is not None
    assert (image.segmentation[:10] == 254).all()
    assert image.hand is not None
    np.testing.assert_array_equal(image.hand.T_camera_hand_given, scene.T_camera_hand)


def test_a_full_disk_leaves_the_last_data_set(
    tmp_path: Path, scenes: list[Scene], monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = scenes[:2]
    write_folder(tmp_path / "images", chosen)
    files, hand = find_images(tmp_path / "images"), hand_files(tmp_path / "hand")
    objects = {n: (s.number, s.load()) for n, s in objects_of(chosen).items()}
    session, out = labelled(chosen, files), tmp_path / "out"
    write_ground_truth(out, session, files, hand, objects)
    before = [read_frame(path).depth for path in find_frames([out])]
    written = []

    def fails(scene: Path, *arguments: Any) -> None:
        written.append(arguments)
        if len(written) > 1:
            raise InputError("cannot write: No space left on device")
        write_image(scene, *arguments)

    monkeypatch.setattr(ground_truth, "write_image", fails)
    with pytest.raises(InputError, match="No space left"):
        write_ground_truth(out, session, files, hand, objects)
    after = [read_frame(path).depth for path in find_frames([out])]
    np.testing.assert_array_equal(before, after)
    assert not list(out.rglob("*unfinished*"))  # what was begun takes no room


def test_nothing_labelled_is_nothing_to_write(tmp_path: Path, scenes: list[Scene]) -> None:
    write_folder(tmp_path / "images", scenes[:1])
    files, hand = find_images(tmp_path / "images"), hand_files(tmp_path / "hand")
    with pytest.raises(InputError, match="no image is labelled"):
        write_ground_truth(tmp_path / "out", Session(("a",)), files, hand, {})
