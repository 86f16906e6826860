"""Draws what every stage of the pipeline makes of the demo scene, for docs/how-it-works.md.

    python benchmarks/stage_pictures.py [FOLDER]     default: docs/stages

The scene is fixed and the estimator repeatable, so the pictures only change when the method does.
"""

import sys
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import inhand
from inhand.config import FirstLookConfig
from inhand.estimate import PoseEstimate
from inhand.estimator import StageResults
from inhand.evaluation.hand_errors import angle_errors, wrist_error
from inhand.evaluation.metrics import ObjectMetric
from inhand.kernels.depth import DepthRenderer
from inhand.overlay import (
    HAND_COLOUR,
    OBJECT_COLOUR,
    Pixels,
    Window,
    grey_depth,
    outline,
    residual_colours,
)
from inhand.stages.results import PoseSet
from inhand.synth.demo import demo_scene
from inhand.synth.scene import HAND, OBJECT, Scene

Colour = tuple[int, int, int]
Mask = NDArray[np.bool_]

SIZE = 420
"""Edge of a panel [pixel]."""
CAPTION = 22
"""Height of the line below it [pixel]."""
GAP = 8
"""Between two panels [pixel]."""
PAPER, INK = (18, 18, 22), (240, 240, 240)
TRUE_COLOUR, GIVEN_COLOUR, UNSURE_COLOUR = (80, 255, 80), (255, 70, 70), (255, 225, 80)


class Panel(NamedTuple):
    """One part of a picture."""

    pixels: Pixels
    caption: str


class Pictures:
    """The pictures of one scene.

    Args:
        scene: the scene, with its truth.
        estimate: the answer to it.
        stages: what every stage made of it.
    """

    def __init__(self, scene: Scene, estimate: PoseEstimate, stages: StageResults) -> None:
        self._scene, self._estimate, self._stages = scene, estimate, stages
        self._shown = np.isin(scene.label, (HAND, OBJECT))
        self._window = Window.around(self._shown)
        self._camera = self._window.camera(scene.camera, SIZE)
        self._object = DepthRenderer([scene.obj.mesh])
        self._metric = ObjectMetric(scene.obj)

    def region(self) -> list[Panel]:
        """Where the hand may be in the whole image, and the normals of the surfaces there."""
        seen = self._stages.observation
        cloud = seen.cloud(step=1)
        v, u = self._rows_and_columns(cloud.points)
        whole = grey_depth(self._scene.depth) // 2
        whole[v, u] = grey_depth(self._scene.depth)[v, u]
        normals = np.zeros_like(whole)
        normals[v, u] = 127.5 * (1 - cloud.normals)
        window = Window.around(self._scene.depth >= 0)
        image = Image.fromarray(window.cut(whole, PAPER, SIZE))
        corners = np.array([seen.offset, np.add(seen.offset, seen.depth.shape[::-1]) - 1])
        box = (corners - [window.u0, window.v0]) * SIZE / window.side
        ImageDraw.Draw(image).rectangle(box.ravel().tolist(), outline=OBJECT_COLOUR, width=3)
        points = f"every {seen.step}th pixel makes {len(seen.points)} points"
        return [
            Panel(np.asarray(image), "bright: what hand and object can reach; dark: beyond"),
            Panel(self._window.cut(normals, PAPER, SIZE), f"normals as colours; {points}"),
        ]

    def wrist(self) -> list[Panel]:
        """The palm at the given pose and at the fitted one."""
        scene, palm = self._scene, self._scene.hand.palm_links
        at_palm = scene.hand.forward_kinematics(scene.hand.rest)[list(palm)]
        contour = partial(self._contour, DepthRenderer([scene.hand.links[i].mesh for i in palm]))
        panels = []
        for name, T, colour in (
            ("as given", scene.T_camera_hand_given, GIVEN_COLOUR),
            ("fitted to the image", self._stages.wrist.T_camera_hand, HAND_COLOUR),
        ):
            pixels = self._background()
            pixels[contour(scene.T_camera_hand @ at_palm)] = TRUE_COLOUR
            pixels[contour(T @ at_palm)] = colour
            off = wrist_error(T, scene.T_camera_hand)
            error = f"off by {1000 * off.translation:.1f} mm, {np.degrees(off.rotation):.1f} deg"
            panels.append(Panel(pixels, f"palm {name}: {error} (truth green)"))
        return panels

    def hand(self) -> list[Panel]:
        """The fitted hand, with the links that the image does not support."""
        scene, state = self._scene, self._stages.hand_state
        pixels, residual = self._background(), self._background()
        for link, T, certain in zip(
            scene.hand.links, state.T_camera_link, state.certain, strict=True
        ):
            contour = self._contour(DepthRenderer([link.mesh]), T[None])
            pixels[contour] = HAND_COLOUR if certain else UNSURE_COLOUR
        depth, label = DepthRenderer([link.mesh for link in scene.hand.links]).render(
            self._camera, state.T_camera_link
        )
        observed = self._window.cut(scene.depth, 0, SIZE)
        both = (label >= 0) & (observed > 0)
        residual[both] = residual_colours((observed - depth)[both])
        joints = scene.hand.joint_dict(state.joint_vector)
        off = np.degrees(list(angle_errors(joints, scene.joint_positions).values()))
        errors = ", ".join(f"{error:.1f}" for error in off)
        return [
            Panel(pixels, f"joints off by {errors} deg; yellow: not relied on"),
            Panel(residual, "observed minus fitted depth: blue in front, red behind"),
        ]

    def segment(self) -> list[Panel]:
        """The scene cloud, and what is left of it without the hand."""
        segment, cloud = self._stages.segment, self._stages.observation
        every, left = self._background(), self._background()
        self._draw_points(every, cloud.points, np.full((len(cloud.points), 3), HAND_COLOUR))
        weight = segment.weight[:, None]
        colours = weight * np.array(OBJECT_COLOUR) + (1 - weight) * np.array(UNSURE_COLOUR)
        self._draw_points(left, segment.points, colours)
        return [
            Panel(every, f"scene cloud, {len(cloud.points)} points"),
            Panel(left, f"object segment, {len(segment.points)} points; yellow: less sure"),
        ]

    def poses(self, found: PoseSet, what: str) -> list[Panel]:
        """Contours of object poses as a heat map, and the best of them."""
        count = np.zeros((SIZE, SIZE))
        for T in found.T_camera_object:
            count += self._contour(self._object, T[None], thickness=1)
        heat = np.clip(count / max(np.percentile(count[count > 0], 98), 1), 0, 1)[..., None] ** 0.5
        heated = (1 - heat) * 0.5 * self._background() + heat * np.array(OBJECT_COLOUR)
        error = [self._metric.adi(T, self._scene.T_camera_object) for T in found.T_camera_object]
        best, pixels = int(np.argmin(error)), self._background()
        for T, colour in (
            (self._scene.T_camera_object, TRUE_COLOUR),
            (found.T_camera_object[best], OBJECT_COLOUR),
        ):
            pixels[self._contour(self._object, T[None])] = colour
        rank = f"number {1 + (found.score > found.score[best]).sum()} by score"
        return [
            Panel(heated.astype(np.uint8), f"contours of {len(found)} {what}"),
            Panel(pixels, f"the best, {rank}: {1000 * error[best]:.1f} mm (ADI; truth green)"),
        ]

    def choice(self) -> list[Panel]:
        """The answer beside the first candidate that is another pose."""
        selection, true_pose = self._stages.selection, self._scene.T_camera_object
        off = [self._metric.pose_error(T, true_pose) for T in selection.T_camera_object]
        other = next(i for i, error in enumerate(off) if error.rotation > np.radians(20))
        panels = []
        for name, i in (("the answer", 0), (f"candidate {other + 1}", other)):
            error = f"{1000 * off[i].translation:.1f} mm, {np.degrees(off[i].rotation):.1f} deg"
            caption = f"{name}: score {selection.score[i]:.2f}, off by {error}"
            panels.append(Panel(self._residual(selection.T_camera_object[i]), caption))
        return panels

    def _residual(self, T_camera_object: NDArray[np.float64]) -> Pixels:
        """Observed minus rendered depth of hand and object as colours."""
        scene, q = self._scene, self._stages.selection.joint_vector
        T_camera_link = self._estimate.T_camera_hand @ scene.hand.forward_kinematics(q)
        meshes = [link.mesh for link in scene.hand.links] + [scene.obj.mesh]
        poses = np.concatenate([T_camera_link, T_camera_object[None]])
        depth, label = DepthRenderer(meshes).render(self._camera, poses)
        observed = self._window.cut(scene.depth, 0, SIZE)
        pixels = (0.5 * self._background()).astype(np.uint8)
        both = (label >= 0) & (observed > 0)
        pixels[both] = residual_colours((observed - depth)[both])
        pixels[outline(label == len(meshes) - 1, 2)] = OBJECT_COLOUR
        return pixels

    def _background(self) -> Pixels:
        return self._window.cut(
            grey_depth(self._scene.depth, self._scene.depth[self._shown]), PAPER, SIZE
        )

    def _contour(self, bodies: DepthRenderer, poses: NDArray[Any], thickness: int = 2) -> Mask:
        """Pixels on the edge of the bodies' common silhouette."""
        shown = bodies.render(self._camera, np.asarray(poses, dtype=np.float64))[1]
        return outline(shown >= 0, thickness)

    def _draw_points(self, pixels: Pixels, points: NDArray[Any], colours: NDArray[Any]) -> None:
        """Draw points [m], camera frame, as squares of 3 pixels."""
        u, v = np.rint(self._camera.project(points)).astype(int).T
        inside = (u > 0) & (u < SIZE - 1) & (v > 0) & (v < SIZE - 1)
        for row in (-1, 0, 1):
            for column in (-1, 0, 1):
                pixels[v[inside] + row, u[inside] + column] = colours[inside]

    def _rows_and_columns(self, points: NDArray[Any]) -> tuple[NDArray[np.int_], ...]:
        u, v = np.rint(self._scene.camera.project(points)).astype(int).T
        return v, u


def save(path: Path, panels: Iterable[Panel]) -> None:
    """Write panels side by side, with their captions below, as a WebP picture."""
    panels = list(panels)
    width = len(panels) * (SIZE + GAP) - GAP
    picture = Image.new("RGB", (width, SIZE + CAPTION), PAPER)
    draw = ImageDraw.Draw(picture)
    for i, panel in enumerate(panels):
        x = i * (SIZE + GAP)
        picture.paste(Image.fromarray(panel.pixels), (x, 0))
        font = ImageFont.load_default(size=14)
        draw.text((x + 4, SIZE + 2), panel.caption, fill=INK, font=font)
    picture.save(path, quality=80, method=6)


def main(folder: Path) -> None:
    """Draw all pictures into `folder`."""
    scene = demo_scene()
    whole_search = replace(inhand.EstimatorConfig(), first_look=FirstLookConfig(enough=1.0))
    estimator = inhand.PoseEstimator(scene.hand, scene.obj, whole_search, device="cpu")
    estimate, stages = estimator.run(scene.depth, scene.camera, scene.T_camera_hand_given)
    draw = Pictures(scene, estimate, stages)
    folder.mkdir(parents=True, exist_ok=True)
    save(folder / "1-region.webp", draw.region())
    save(folder / "2-wrist.webp", draw.wrist())
    save(folder / "3-hand.webp", draw.hand())
    save(folder / "4-segment.webp", draw.segment())
    save(folder / "5-hypotheses.webp", draw.poses(stages.hypotheses, "hypotheses"))
    save(folder / "6-clusters.webp", draw.poses(stages.clustered, "distinct poses"))
    save(folder / "7-survivors.webp", draw.poses(stages.refined, "refined poses"))
    save(folder / "8-choice.webp", draw.choice())


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "docs" / "stages")
