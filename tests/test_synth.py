"""Data sets from `inhand synth`: right images, resumed and repeated to the byte."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inhand.camera import Camera
from inhand.cli import main
from inhand.datasets import bop, bop_frames
from inhand.datasets.bop import BopImage, Instance
from inhand.datasets.bop_images import read_image
from inhand.datasets.bop_results import read_results
from inhand.datasets.bop_scene import read_scene
from inhand.datasets.frames import find_frames, find_hand, find_objects, load_object, read_frame
from inhand.errors import InputError
from inhand.geometry.mesh import box
from inhand.geometry.se3 import inverse, rotation_angle
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer
from inhand.synth import demo
from inhand.synth.dataset import Workshop
from inhand.synth.plan import Plan
from inhand.synth.renderer import BACKGROUND_BODY, OBJECT_BODY
from inhand.synth.scene import NOISY, SceneMaker
from inhand.synth.viewpoints import viewpoints

CAMERA = {"fx": 150, "fy": 150, "cx": 79.5, "cy": 59.5, "width": 160, "height": 120}
NUMBER = 3
OPTIONS: tuple[str, ...] = (
    "--objects",
    "cuboid",
    "can",
    "--number",
    str(NUMBER),
    "--seed",
    "4",
    "--device",
    "cpu",
)
OPTIONS += ("--visible", "0.05", "0.6", "1")
SCENES = range(1, 5)


@pytest.fixture(scope="module")
def camera(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("camera") / "camera.json"
    path.write_text(json.dumps(CAMERA))
    return path


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory, camera: Path) -> Path:
    """Two objects in hands of two colours, three images each."""
    folder = tmp_path_factory.mktemp("made") / "tiny"
    assert synth(folder, camera, "--workers", "1") == 0
    return folder


def synth(folder: Path, camera: Path, *more: str) -> int:
    return main(["synth", str(folder), *OPTIONS, "--camera", str(camera), *more])


def content(folder: Path) -> dict[str, bytes]:
    """All files of a data set; its plan and the hand's files are not its images."""
    files = [f for f in sorted(folder.rglob("*")) if f.is_file()]
    return {f.relative_to(folder).as_posix(): f.read_bytes() for f in files}


def scene(dataset: Path, scene_id: int) -> Path:
    return dataset / "test" / f"{scene_id:06d}"


def images(dataset: Path) -> list[tuple[BopImage, Instance]]:
    read = [read_image(scene(dataset, s), i) for s in SCENES for i in range(NUMBER)]
    return [(image, image.instances[0]) for image in read]


def test_every_image_has_every_file(dataset: Path) -> None:
    frames = find_frames([dataset])
    assert len(frames) == len(SCENES) * NUMBER
    assert len(json.loads((dataset / bop.TARGETS).read_text())) == len(frames)
    folders = ("rgb", "depth", "mask", "mask_visib", "segmentation", "object_depth")
    for s in SCENES:
        assert all(len(list((scene(dataset, s) / f).iterdir())) == NUMBER for f in folders)
        assert list(read_scene(scene(dataset, s)).truth) == list(range(NUMBER))
    assert not [name for name in content(dataset) if "unfinished" in name]
    names = {frame.object_name for frame in map(read_frame, frames)}
    assert names == {"cuboid", "can"}


def test_masks_agree_with_depth_and_visible_share(dataset: Path) -> None:
    for image, obj in images(dataset):
        assert image.segmentation is not None
        assert obj.depth is not None
        assert not (obj.mask_visible & ~obj.mask).any()
        np.testing.assert_array_equal(obj.mask, obj.depth > 0)
        np.testing.assert_array_equal(obj.mask_visible, image.segmentation == OBJECT_BODY)
        np.testing.assert_allclose(
            image.depth[obj.mask_visible], obj.depth[obj.mask_visible], atol=1e-6
        )
        hidden = obj.mask & ~obj.mask_visible
        assert (image.depth[hidden] <= obj.depth[hidden] + 1e-4).all()
        assert ((image.depth > 0) == (image.segmentation > 0)).all()
        assert obj.silhouette_pixels >= obj.mask.sum()
        assert obj.visible_share == obj.mask_visible.sum() / obj.silhouette_pixels


def test_pixel_counts_and_boxes_are_those_of_the_masks(dataset: Path) -> None:
    info = json.loads((scene(dataset, 1) / bop.INFO).read_text())
    for i in range(NUMBER):
        image = read_image(scene(dataset, 1), i)
        mask, visible = image.instances[0].mask, image.instances[0].mask_visible
        (entry,) = info[str(i)]
        assert entry["px_count_visib"] == visible.sum()
        assert entry["px_count_valid"] == (mask & (image.depth > 0)).sum()
        assert entry["px_count_all"] >= mask.sum()
        assert entry["visib_fract"] == entry["px_count_visib"] / entry["px_count_all"]
        u, v, width, height = entry["bbox_visib"]
        assert visible[v : v + height, u : u + width].sum() == visible.sum()
        assert visible[v].any()
        assert visible[:, u + width - 1].any()


def test_images_show_the_models_at_their_true_poses(dataset: Path) -> None:
    urdf, models = find_hand(dataset, ""), find_objects(dataset, "")
    assert urdf is not None
    assert models is not None
    hand = Hand.from_urdf(urdf)
    for path in find_frames([dataset])[::4]:
        scene_folder, (image_id, _) = path.parents[1], bop_frames.frame_ids(path)
        image = read_image(scene_folder, image_id)
        frame, (obj,) = read_frame(path), image.instances
        assert image.hand is not None
        assert image.segmentation is not None
        meshes = [load_object(models, frame.object_name).mesh, *(k.mesh for k in hand.links)]
        poses = [image.hand.T_camera_link[link.name] for link in hand.links]
        renderer = DepthRenderer(meshes)
        _, index = renderer.render(image.camera, np.stack([obj.T_camera_object, *poses]))
        expected = np.where(index < 0, 0, np.where(index == 0, OBJECT_BODY, index))
        assert (expected == image.segmentation).mean() > 0.999
        depth, _ = DepthRenderer(meshes[:1]).render(image.camera, obj.T_camera_object[None])
        assert obj.depth is not None
        assert (np.abs(depth - obj.depth) < 1.1e-4).mean() > 0.999


def test_the_hand_is_where_its_joints_put_it(dataset: Path) -> None:
    urdf = find_hand(dataset, "")
    assert urdf is not None
    hand = Hand.from_urdf(urdf)
    for image, _ in images(dataset):
        truth = image.hand
        assert truth is not None
        for name, T in hand.link_poses(truth.joint_positions).items():
            np.testing.assert_allclose(truth.T_camera_link[name], truth.T_camera_hand @ T)
        error = inverse(truth.T_camera_hand) @ truth.T_camera_hand_given
        assert 0 < np.linalg.norm(error[:3, 3]) < 0.005
        assert 0 < rotation_angle(error[:3, :3], np.eye(3)) < 0.02
        frame_label = read_frame(find_frames([dataset])[0]).truth.label
        assert set(np.unique(frame_label)) <= {0, 1, 2}


def test_visible_shares_take_turns(dataset: Path) -> None:
    shares = [frame.truth.visible_share for frame in map(read_frame, find_frames([dataset]))]
    for i, share in enumerate(shares):
        low, high = ((0.05, 0.6), (0.6, 1.0))[i % NUMBER % 2]
        assert low <= share <= high


def test_hands_have_their_colours(dataset: Path) -> None:
    for s, blue in ((1, True), (2, False)):
        image = read_image(scene(dataset, s), 0)
        assert image.rgb is not None
        assert image.segmentation is not None
        is_hand = (image.segmentation > 0) & (image.segmentation < BACKGROUND_BODY)
        red, _, blueness = image.rgb[is_hand].astype(float).mean(axis=0)
        assert (blueness > 2 * red) == blue
        assert (image.rgb[image.segmentation == 0] == 0).all()


def test_a_benchmark_runs_on_them(dataset: Path, tmp_path: Path) -> None:
    command = ["bench", str(dataset), "--out", str(tmp_path), "--limit", "2", "--device", "cpu"]
    assert main([*command, "--methods", "icp-from-truth+mask@0mm"]) == 0
    answers = read_results(tmp_path / "bop" / "icpfromtruth+mask@0mm_tiny-test.csv")
    assert len(answers) == 2
    for answer in answers:
        image = read_image(scene(dataset, answer.scene_id), answer.image_id)
        (truth,) = [i for i in image.instances if i.object_id == answer.object_id]
        away = inverse(truth.T_camera_object) @ answer.T_camera_object
        assert np.linalg.norm(away[:3, 3]) < 0.005


def test_other_processes_make_the_same_bytes(dataset: Path, camera: Path, tmp_path: Path) -> None:
    assert synth(tmp_path / "again", camera, "--workers", "2") == 0
    assert content(tmp_path / "again") == content(dataset)


def test_a_killed_run_goes_on_where_it_stopped(
    dataset: Path, camera: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "killed"
    # The process dies by SIGKILL just before it gives its 33rd file its name.
    code = f"""
import os, signal, sys
from inhand.cli import main
rename, files = os.replace, []
def stop(one, other):
    files.append(other)
    if len(files) == 33:
        os.kill(os.getpid(), signal.SIGKILL)
    rename(one, other)
os.replace = stop
main({["synth", str(folder), *OPTIONS, "--camera", str(camera), "--workers", "1"]!r})
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    pictures = list(folder.rglob("*.png"))
    assert 0 < len(pictures) < 33
    for picture in pictures:
        with Image.open(picture) as image:
            image.load()
    with pytest.raises(InputError, match="unfinished"):
        read_scene(scene(folder, 1))
    with pytest.raises(InputError, match="holds no frames"):
        find_frames([folder])

    made: list[tuple[int, int]] = []
    make = Workshop.make

    def noted(self: Workshop, scene_id: int, image_id: int) -> None:
        made.append((scene_id, image_id))
        if len(made) == 4:
            raise KeyboardInterrupt
        make(self, scene_id, image_id)

    monkeypatch.setattr(Workshop, "make", noted)
    assert synth(folder, camera, "--workers", "1") == 130
    assert synth(folder, camera, "--workers", "1") == 0
    assert len(made) < len(SCENES) * NUMBER + 1
    assert (1, 0) not in made
    # What an earlier run had begun and not named is replaced as its image is made anew.
    assert content(folder) == content(dataset)
    before = len(made)
    assert synth(folder, camera) == 0
    assert len(made) == before, "nothing is left to do"


def test_a_cluster_makes_the_same_bytes(dataset: Path, camera: Path, tmp_path: Path) -> None:
    pytest.importorskip("ray")
    assert "RAY_ADDRESS" not in os.environ
    assert synth(tmp_path / "on_ray", camera, "--ray") == 0
    assert content(tmp_path / "on_ray") == content(dataset)


def test_missing_ray_is_one_line(
    camera: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    assert synth(tmp_path / "on_ray", camera, "--ray") == 2
    assert capsys.readouterr().err == 'inhand: --ray needs Ray: pip install "inhand[ray]"\n'


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--number", "0"], "number"),
        (["--seed", "-1"], "seed"),
        (["--objects", "sock"], 'no object "sock"'),
        (["--objects", "can", "can"], "same name"),
        (["--distance", "0.9", "0.3"], "distance"),
        (["--distance", "0.3", "9"], "distance"),
        (["--visible", "0.5"], "visible"),
        (["--visible", "0.5", "0.2"], "visible"),
        (["--visible", "0", "1.5"], "visible"),
        (["--clutter", "-1"], "clutter"),
        (["--backdrop", "0.4", "0.1"], "backdrop"),
        (["--wrist-translation", "-0.001"], "wrist"),
        (["--wrist-rotation", "nan"], "wrist"),
        (["--hand", "missing.urdf"], "missing.urdf"),
        (["--camera", "missing.json"], "missing.json"),
        (["--workers", "0"], "workers"),
    ],
)
def test_senseless_options_are_named(
    options: list[str],
    words: str,
    camera: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert synth(tmp_path / "none", camera, *options) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.rglob("*.png"))


def test_a_folder_with_something_else_is_left_alone(
    dataset: Path, camera: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert synth(dataset, camera, "--seed", "5") == 2
    assert "another seed" in capsys.readouterr().err
    (tmp_path / "letter.txt").write_text("dear")
    assert synth(tmp_path, camera) == 2
    assert "not empty" in capsys.readouterr().err


def test_own_meshes_and_hand(tmp_path: Path, camera: Path) -> None:
    mesh = box((30, 30, 60))
    lines = ["v {} {} {}".format(*v) for v in mesh.vertices]
    lines += ["f {} {} {}".format(*f) for f in mesh.faces + 1]
    (tmp_path / "brick.obj").write_text("\n".join(lines))
    jaws = "".join(
        f"""<link name="jaw_{side}"><visual><origin xyz="0 0 0.04"/>
          <geometry><box size="0.01 0.02 0.08"/></geometry></visual></link>
        <joint name="slide_{side}" type="prismatic"><parent link="palm"/><child link="jaw_{side}"/>
          <origin xyz="{side * 0.05} 0 0.02"/><axis xyz="{-side} 0 0"/>
          <limit lower="0" upper="0.045" effort="1" velocity="1"/></joint>"""
        for side in (-1, 1)
    )
    urdf = tmp_path / "gripper.urdf"
    urdf.write_text(
        f"""<robot name="gripper"><link name="palm"><visual>
          <geometry><box size="0.14 0.06 0.03"/></geometry></visual></link>{jaws}</robot>"""
    )
    out = tmp_path / "data" / "own"
    command = ["synth", str(out), "--objects", str(tmp_path / "brick.obj"), "--unit", "mm"]
    command += ["--hand", str(urdf), "--number", "1", "--colours", "white", "--device", "cpu"]
    assert main([*command, "--camera", str(camera), "--workers", "1"]) == 0
    (frame,) = map(read_frame, find_frames([out]))
    assert frame.object_name == "brick"
    assert set(frame.truth.joint_positions) == {"slide_-1", "slide_1"}
    assert find_hand(out, "") == urdf
    models = find_objects(out, "")
    assert models is not None
    assert load_object(models, "brick").diameter == pytest.approx(np.sqrt(30**2 * 2 + 60**2) / 1000)


def test_the_plan_is_the_papers() -> None:
    plan = Plan()
    assert len(plan.scene_ids()) * plan.number == 12_000
    radii = np.linalg.norm(viewpoints((0.3, 0.9)), axis=1)
    assert len(radii) == 648
    assert (radii.min(), radii.max()) == pytest.approx((0.3, 0.9))


def test_clutter_stands_behind_the_hand() -> None:
    small = Camera.from_matrix([[150, 0, 79.5], [0, 150, 59.5], [0, 0, 1]], width=160, height=120)
    hand, obj = demo.builtin_hand(), demo.builtin_object("cuboid")
    protocol = replace(NOISY, backdrop=None, clutter=12)
    made = SceneMaker(hand, obj, small, protocol).make(np.random.default_rng(1))
    images = made.images
    behind = images.depth[images.segmentation == BACKGROUND_BODY]
    assert len(behind) > 50
    others = (images.segmentation > 0) & (images.segmentation != BACKGROUND_BODY)
    assert behind.min() > images.depth[others].max()
