"""Scenes with ground truth: a hand holds an object in front of a depth camera.

The protocol is the paper's (section "Simulation Dataset and Results"): the object has a random
pose between the fingers, every finger closes along a random path until it touches, and the camera
stands on 648 viewpoints of spheres around the hand. No physics: any pose in the hand may occur.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.geometry import se3
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.synth.grasp import Grasp, GraspSampler
from inhand.synth.renderer import (
    BACKGROUND_BODY,
    CLUTTER_SHAPES,
    NO_BODY,
    OBJECT_BODY,
    Colour,
    Images,
    Props,
    SceneRenderer,
)
from inhand.synth.sensor import PERFECT, STRUCTURED_LIGHT, SensorModel, observe, perturb_wrist

Array = NDArray[np.float64]

NOTHING, HAND, OBJECT, BACKGROUND = 0, 1, 2, 3
"""Values of a label image."""
HAND_COLOURS: dict[str, Colour] = {"blue": (0.16, 0.36, 0.78), "white": (0.92, 0.92, 0.90)}
"""The paper's two hands, blue and white; the tones are choices of ours."""
OBJECT_COLOURS: tuple[Colour, ...] = (
    (0.93, 0.91, 0.86),
    (0.85, 0.72, 0.52),
    (0.80, 0.82, 0.80),
    (0.90, 0.80, 0.45),
    (0.78, 0.50, 0.40),
    (0.62, 0.70, 0.55),
)
"""Plain colours of the objects, by their number; choices of ours, none of them blue."""

SPHERES = 4
"""Spheres of viewpoints, evenly between the nearest and the farthest. The paper states 648
viewpoints and radii of 0.3 to 0.9 m; 4 spheres of the 162 vertices of a twice divided icosahedron
make 648, which is a choice of ours."""
AIM = 0.02
"""Sd of how far the camera looks past the centre of the hand's reach, along either axis [m]; a
choice of ours, so that the hand is not always in the middle."""
NEAREST = 0.1
"""No surface may be closer to the camera than this [m]."""
GRASPS, VIEWS = 100, 40
"""Grasps tried before giving up, and views of each."""
FIRST_LOOK = 4
"""Views are judged by every so many pixels before they are rendered whole."""
MIN_PIXELS = 100
"""Pixels of the object that must be visible."""


@dataclass(frozen=True)
class SceneProtocol:
    """What the scenes are drawn from."""

    distance: tuple[float, float] = (0.3, 0.9)
    """Range of the camera's distance from the centre of the hand's reach [m]."""
    visible: tuple[float, float] = (0.05, 1.0)
    """Range of the visible share of the object's silhouette."""
    sensor: SensorModel = PERFECT
    """The depth camera's errors."""
    wrist_translation: float = 0.0005
    """Sd of the error of the given wrist pose along each axis [m]."""
    wrist_rotation: float = 0.0025
    """Sd of the error of the given wrist pose about each axis [rad]."""
    backdrop: tuple[float, float] | None = None
    """Range of the distance of a wall from the hand's reach [m]; None: nothing behind the hand."""
    clutter: int = 0
    """Boxes, cylinders and balls that stand behind the hand."""


CLEAN = SceneProtocol()
"""The paper's simulation: no sensor noise but quantisation; the wrist is known well."""

NOISY = SceneProtocol(
    sensor=STRUCTURED_LIGHT,
    wrist_translation=0.004,
    wrist_rotation=float(np.radians(1.5)),
    backdrop=(0.05, 0.4),
)
"""A structured-light camera, a wall behind the hand, and a wrist from forward kinematics."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One depth image, the errors an estimator has to live with, and the truth behind it."""

    hand: Hand = field(repr=False)
    obj: ObjectModel = field(repr=False)
    camera: Camera
    T_camera_hand: Array
    """True wrist pose, shape (4, 4)."""
    T_camera_hand_given: Array
    """The wrist pose an estimator is told, shape (4, 4)."""
    T_camera_object: Array
    """True object pose, shape (4, 4)."""
    joint_positions: dict[str, float]
    """True positions [rad, m] of all movable joints, by name."""
    depth: NDArray[np.float32] = field(repr=False)
    """What the sensor reads [m], shape (H, W), 0 without reading."""
    images: Images = field(repr=False)
    """What a perfect camera sees."""
    silhouette_pixels: int
    """Pixels of the object's whole silhouette, also behind the hand and outside the image."""

    @property
    def label(self) -> NDArray[np.uint8]:
        """What each pixel truly shows, shape (H, W): NOTHING, HAND, OBJECT or BACKGROUND."""
        meaning = np.full(256, HAND, dtype=np.uint8)
        meaning[[NO_BODY, OBJECT_BODY, BACKGROUND_BODY]] = NOTHING, OBJECT, BACKGROUND
        return meaning[self.images.segmentation]

    @property
    def visible_share(self) -> float:
        """Visible share of the object's silhouette."""
        return self.images.object_pixels / max(self.silhouette_pixels, 1)


class Surroundings(NamedTuple):
    """What a hand is seen in."""

    lamp: Array
    """Unit direction to the lamp, camera frame, shape (3,)."""
    props: Props
    """What else stands there."""


class SceneMaker:
    """Makes random scenes of one hand and object.

    Attributes:
        grasps: where its grasps come from.

    Args:
        hand: the hand.
        obj: the object.
        camera: the camera.
        protocol: what the scenes are drawn from.
        hand_colour: red, green, blue, 0 to 1.
        object_colour: red, green, blue, 0 to 1.
        device: Warp device name.
    """

    def __init__(
        self,
        hand: Hand,
        obj: ObjectModel,
        camera: Camera,
        protocol: SceneProtocol = CLEAN,
        *,
        hand_colour: Colour = HAND_COLOURS["blue"],
        object_colour: Colour = OBJECT_COLOURS[0],
        device: str = "cpu",
    ) -> None:
        self.hand, self.obj, self.camera, self.protocol = hand, obj, camera, protocol
        self._colours = {"hand_colour": hand_colour, "object_colour": object_colour}
        self.grasps = GraspSampler(hand, obj, device)
        self._renderer = SceneRenderer(hand, obj, device)
        self._viewpoints = viewpoints(protocol.distance)

    def make(self, rng: np.random.Generator, visible: tuple[float, float] | None = None) -> Scene:
        """A random scene; the same state of `rng` gives the same scene.

        Args:
            rng: source of everything random.
            visible: range of the visible share; default: the protocol's.

        Raises:
            InputError: the hand cannot hold the object, or no view of it fits the protocol.
        """
        visible = visible or self.protocol.visible
        for _ in range(GRASPS):
            grasp = self.grasps.sample(rng)
            for viewpoint in rng.permutation(self._viewpoints)[:VIEWS]:
                T_camera_hand = self._look_from(viewpoint, rng)
                if self._promises(grasp, T_camera_hand, visible):
                    scene = self.render(grasp, T_camera_hand, rng)
                    if _fits(scene.images, scene.silhouette_pixels, visible, MIN_PIXELS):
                        return with_errors(scene, self.protocol, rng)
        raise InputError(
            f"none of {VIEWS} views of {GRASPS} grasps shows a share of the object within "
            f"{visible} and at least {MIN_PIXELS} pixels of it; widen the range or bring the "
            "camera closer"
        )

    def render(self, grasp: Grasp, T_camera_hand: Array, rng: np.random.Generator) -> Scene:
        """The scene of a grasp before any error: perfect depth, the true wrist as the given one.

        What stands behind the hand, and the light, are drawn from `rng`.
        """
        return self.render_in(self.surroundings(T_camera_hand, rng), grasp, T_camera_hand)

    def surroundings(self, T_camera_hand: Array, rng: np.random.Generator) -> Surroundings:
        """Random light, and what stands behind a hand."""
        lamp = se3.random_rotation(rng)[2]
        lamp[2] = -abs(lamp[2])  # on the camera's side
        return Surroundings(lamp, self._behind(T_camera_hand, rng))

    def render_in(self, around: Surroundings, grasp: Grasp, T_camera_hand: Array) -> Scene:
        """As `render`, in given surroundings."""
        T_camera_object = T_camera_hand @ grasp.T_hand_object
        T_camera_link = T_camera_hand @ self.hand.forward_kinematics(grasp.q)
        images = self._renderer.render(
            self.camera,
            T_camera_object,
            T_camera_link,
            around.props,
            lamp=around.lamp,
            **self._colours,
        )
        return Scene(
            hand=self.hand,
            obj=self.obj,
            camera=self.camera,
            T_camera_hand=T_camera_hand,
            T_camera_hand_given=T_camera_hand,
            T_camera_object=T_camera_object,
            joint_positions=self.hand.joint_dict(grasp.q),
            depth=images.depth,
            images=images,
            silhouette_pixels=self._renderer.silhouette_pixels(
                self.camera, T_camera_object, images
            ),
        )

    def solid_diameter(self, shape: int) -> float:
        """Diameter [m] of a solid that may stand around the hand, by its number."""
        return float(self._renderer.props[shape].diameter)

    def _promises(self, grasp: Grasp, T_camera_hand: Array, visible: tuple[float, float]) -> bool:
        """Whether a coarse image of the object's surroundings fits the protocol."""
        T_camera_object = T_camera_hand @ grasp.T_hand_object
        camera = self._around_object(T_camera_object).subsampled(FIRST_LOOK)
        T_camera_link = T_camera_hand @ self.hand.forward_kinematics(grasp.q)
        images = self._renderer.render(camera, T_camera_object, T_camera_link)
        silhouette = self._renderer.silhouette_pixels(camera, T_camera_object, images)
        return _fits(images, silhouette, visible, MIN_PIXELS / FIRST_LOOK**2)

    def _around_object(self, T_camera_object: Array) -> Camera:
        """The camera of the part of the image that may show the object."""
        camera = self.camera
        centre = se3.transform(T_camera_object, self.obj.centre[None])
        radius = self.obj.diameter  # about twice what is needed
        reach = camera.fx * radius / max(float(centre[0, 2]) - radius, NEAREST)
        (u, v) = camera.project(centre)[0]
        u0, u1 = np.clip([u - reach, u + reach], 0, camera.width).astype(int)
        v0, v1 = np.clip([v - reach, v + reach], 0, camera.height).astype(int)
        return camera.crop(int(u0), int(v0), max(int(u1 - u0), 1), max(int(v1 - v0), 1))

    def _look_from(self, viewpoint: Array, rng: np.random.Generator) -> Array:
        """`T_camera_hand`, (4, 4), of a camera that looks about at the centre of the hand's reach.

        Args:
            viewpoint: place of the camera from that centre [m], axes of the hand frame, shape (3,).
            rng: source of the roll and the aim.
        """
        distance = float(np.linalg.norm(viewpoint))
        roll = se3.exp_so3(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)]))
        T = np.eye(4)
        T[:3, :3] = roll @ se3.rotation_between(-viewpoint / distance, np.array([0.0, 0.0, 1.0]))
        aim = np.array([*rng.normal(scale=AIM, size=2), distance])
        T[:3, 3] = aim - T[:3, :3] @ self.hand.reach[0]
        return T

    def _behind(self, T_camera_hand: Array, rng: np.random.Generator) -> Props:
        """The wall and the clutter behind the hand's reach."""
        centre = se3.transform(T_camera_hand, self.hand.reach[0][None])[0]
        shape = rng.integers(CLUTTER_SHAPES, size=self.protocol.clutter)
        poses = [self._clutter_pose(centre, int(i), rng) for i in shape]
        if self.protocol.backdrop is not None:
            shape = np.append(shape, CLUTTER_SHAPES)
            poses.append(self._wall_pose(centre, self.protocol.backdrop, rng))
        colours = rng.uniform(0.2, 0.9, size=(len(poses), 3))
        return Props(shape, np.array(poses).reshape(-1, 4, 4), colours)

    def _clutter_pose(self, centre: Array, shape: int, rng: np.random.Generator) -> Array:
        """Pose, (4, 4), of a solid somewhere in the image, wholly behind the hand's reach."""
        size = self.solid_diameter(shape)
        z = centre[2] + self.hand.reach[1] + size / 2 + rng.uniform(0, 0.4)
        u, v = rng.uniform([0, 0], [self.camera.width, self.camera.height])
        camera = self.camera
        T = np.eye(4)
        T[:3, :3] = se3.random_rotation(rng)
        T[:3, 3] = z * np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
        return T

    def _wall_pose(
        self, centre: Array, distance: tuple[float, float], rng: np.random.Generator
    ) -> Array:
        """Pose, (4, 4), of a wall (normal: its z axis) that stands clear of the hand's reach."""
        tilt = rng.normal(scale=np.radians(12), size=2)
        T = se3.exp(np.array([tilt[0], tilt[1], 0, 0, 0, 0]))
        T[:3, 3] = centre + (self.hand.reach[1] + rng.uniform(*distance)) * T[:3, 2]
        return T


def make_scene(
    hand: Hand,
    obj: ObjectModel,
    camera: Camera,
    seed: int,
    protocol: SceneProtocol = CLEAN,
    device: str = "cpu",
) -> Scene:
    """A random scene; the same arguments give the same scene.

    Raises:
        InputError: the hand cannot hold the object, or no view of it fits the protocol.
    """
    maker = SceneMaker(hand, obj, camera, protocol, device=device)
    return maker.make(np.random.default_rng(seed))


def with_errors(
    scene: Scene,
    protocol: SceneProtocol,
    rng: np.random.Generator,
    T_camera_hand_given: Array | None = None,
) -> Scene:
    """The scene as the protocol's sensor sees it, its wrist known as well as the protocol says.

    A sequence says itself how its wrist is known: `T_camera_hand_given`, shape (4, 4).
    """
    depth = observe(scene.images.depth, scene.camera, protocol.sensor, rng)
    if T_camera_hand_given is None:
        T_camera_hand_given = perturb_wrist(
            scene.T_camera_hand, protocol.wrist_translation, protocol.wrist_rotation, rng
        )
    return replace(scene, depth=depth, T_camera_hand_given=T_camera_hand_given)


def viewpoints(distance: tuple[float, float]) -> Array:
    """The 648 places of the camera from the centre of the hand's reach [m], shape (648, 3).

    Args:
        distance: radii of the smallest and the largest sphere [m].
    """
    directions = trimesh.creation.icosphere(subdivisions=2, radius=1.0).vertices
    radii = np.linspace(*distance, SPHERES)
    return np.asarray((radii[:, None, None] * directions).reshape(-1, 3))


def _fits(images: Images, silhouette: int, visible: tuple[float, float], min_pixels: float) -> bool:
    """Whether enough of the object, and not too much, is to be seen, and nothing is too close."""
    shown = images.object_pixels
    if shown < min_pixels or not visible[0] <= shown / silhouette <= visible[1]:
        return False
    return float(images.depth[images.depth > 0].min()) >= NEAREST
