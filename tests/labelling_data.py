"""Images to be labelled, as files: scenes of the built-in hand in the layouts that are read."""

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from inhand.annotation.ground_truth import LabelledHand
from inhand.annotation.images import find_images
from inhand.annotation.objects import ObjectSource
from inhand.annotation.session import Label
from inhand.annotation.workbench import Workbench
from inhand.builtin.hand import write_hand
from inhand.camera import Camera
from inhand.geometry.mesh import TriangleMesh
from inhand.hand import Hand
from inhand.synth.demo import builtin_object
from inhand.synth.scene import Scene


def true_label(scene: Scene) -> Label:
    """The truth behind a scene."""
    names = scene.hand.joint_names
    joints = {name: scene.joint_positions[name] for name in names}
    return Label(scene.obj.name, scene.T_camera_object, scene.T_camera_hand, joints)


def write_camera(path: Path, camera: Camera, depth_unit: float = 1e-4) -> None:
    names = ("fx", "fy", "cx", "cy", "width", "height")
    fields = {name: getattr(camera, name) for name in names}
    path.write_text(json.dumps(fields | {"depth_unit_m": depth_unit}))


def write_folder(folder: Path, scenes: Sequence[Scene], *, rgb: bool = True) -> None:
    """A folder of images with wrist poses, called a, b, ..."""
    for name in ("depth", *(["rgb"] if rgb else [])):
        (folder / name).mkdir(parents=True)
    poses = {}
    write_camera(folder / "camera.json", scenes[0].camera)
    for name, scene in zip("abcdefgh", scenes, strict=False):
        counts = np.rint(scene.depth.astype(float) * 1e4).astype(np.uint16)
        Image.fromarray(counts).save(folder / "depth" / f"{name}.png")
        poses[name] = {"T_camera_hand": scene.T_camera_hand_given.tolist()}
        if rgb:
            Image.fromarray(scene.images.rgb).save(folder / "rgb" / f"{name}.png")
    (folder / "hand_poses.json").write_text(json.dumps(poses))


def write_mesh(path: Path, mesh: TriangleMesh) -> None:
    """A mesh file [m]."""
    import trimesh

    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)


def hand_files(folder: Path) -> LabelledHand:
    """The built-in hand, written to a folder."""
    urdf = Path(write_hand(folder))
    return LabelledHand(Hand.from_urdf(urdf), urdf)


def objects_of(scenes: Sequence[Scene]) -> dict[str, ObjectSource]:
    """The objects in some scenes."""

    def source(number: int, name: str) -> ObjectSource:
        return ObjectSource(number, lambda: builtin_object(name))

    names = list(dict.fromkeys(scene.obj.name for scene in scenes))
    return {name: source(1 + i, name) for i, name in enumerate(names)}


def workbench(
    folder: Path, scenes: Sequence[Scene], clock: Callable[[], float] = time.monotonic
) -> Workbench:
    """A workbench with a folder of scenes; labels go to the folder `out`."""
    images = folder / "images"
    if not images.is_dir():
        write_folder(images, scenes)
    hand = hand_files(folder / "hand")
    files, objects = find_images(images), objects_of(scenes)
    return Workbench(files, hand, objects, folder / "out", clock=clock)
