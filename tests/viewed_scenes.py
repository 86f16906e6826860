"""Scenes of the built-in hand as frames for the viewer, and what it makes of them."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

from inhand.config import EstimatorConfig
from inhand.errors import InputError
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.overlay import ModelRenderer, Placement
from inhand.synth.demo import builtin_hand, demo_scene, regression_scenes
from inhand.synth.scene import Scene
from inhand.viewer.analysis import Analysis, Analyst
from inhand.viewer.frames import ViewedFrame
from inhand.viewer.opening import frame_of_scene


@cache
def analyst() -> Analyst:
    return Analyst(builtin_hand(), EstimatorConfig(), "cpu")


@cache
def demo() -> Scene:
    return demo_scene()


@cache
def demo_analysis() -> Analysis:
    return analyst().analyse(viewed(demo(), "demo"), demo().obj)


@cache
def hidden_analysis() -> Analysis:
    """The hand of the demo alone, without noise: there is no answer."""
    scene = demo()
    frame = frame_of_scene(scene, "hidden")
    q = scene.hand.joint_vector(scene.joint_positions)
    models = ModelRenderer(scene.hand, scene.obj)
    depth = models.render(scene.camera, Placement(scene.T_camera_hand, q)).depth
    return analyst().analyse(ViewedFrame.of_dataset(replace(frame, depth=depth)), scene.obj)


def viewed(scene: Scene, name: str, step: int = 1) -> ViewedFrame:
    """A scene as a frame, of every `step`-th pixel along either side."""
    frame = frame_of_scene(scene, name)
    every = slice(None, None, step)
    truth = replace(frame.truth, label=frame.truth.label[every, every])
    camera, depth = frame.camera.subsampled(step), frame.depth[every, every]
    return ViewedFrame.of_dataset(replace(frame, camera=camera, depth=depth, truth=truth))


class SceneSource:
    """Scenes as a source; the one called "broken" cannot be read."""

    def __init__(self, scenes: dict[str, Scene], step: int = 1) -> None:
        self._scenes, self._step = scenes, step
        self.reads: list[str] = []

    @property
    def hand(self) -> Hand:
        return builtin_hand()

    @property
    def names(self) -> Sequence[str]:
        return list(self._scenes)

    @property
    def object_names(self) -> Sequence[str]:
        return [scene.obj.name for scene in self._scenes.values()]

    def read(self, index: int) -> tuple[ViewedFrame, ObjectModel]:
        name = self.names[index]
        self.reads.append(name)
        if name == "broken":
            raise InputError("the file is cut short")
        scene = self._scenes[name]
        return viewed(scene, name, self._step), scene.obj


@cache
def three_scenes() -> dict[str, Scene]:
    """Two that are solved, of different objects, and one that cannot be read between them."""
    cylinder = regression_scenes()[0]
    return {"part": demo(), "broken": cylinder, "cylinder": cylinder}
