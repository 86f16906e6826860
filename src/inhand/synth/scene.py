"""Scenes with ground truth: a hand holds an object in front of a depth camera.

The protocol is the paper's (section "Simulation Dataset and Results"): the object has a random
pose between the fingers, every finger closes along a random path until it touches, and the camera
stands on 648 viewpoints of spheres around the hand. No physics: any pose in the hand may occur.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.geometry import se3
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.synth.grasp import Grasp, GraspSampler
from inhand.synth.renderer import (
    BACKGROUND_BODY,
    NO_BODY,
    OBJECT_BODY,
    Colour,
    Images,
    SceneRenderer,
)
from inhand.synth.sensor import PERFECT, STRUCTURED_LIGHT, SensorModel, observe, perturb_wrist
from inhand.synth.surroundings import Surroundings, SurroundingsMaker
from inhand.synth.viewpoints import look_from, viewpoints

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
        diameters = [float(solid.diameter) for solid in self._renderer.props]
        self._surroundings = SurroundingsMaker(
            hand, camera, diameters, protocol.clutter, protocol.backdrop
        )

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
                T_camera_hand = look_from(viewpoint, self.hand.reach[0], rng)
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
        return self._surroundings.make(T_camera_hand, rng)

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


def _fits(images: Images, silhouette: int, visible: tuple[float, float], min_pixels: float) -> bool:
    """Whether enough of the object, and not too much, is to be seen, and nothing is too close."""
    shown = images.object_pixels
    if shown < min_pixels or not visible[0] <= shown / silhouette <= visible[1]:
        return False
    return float(images.depth[images.depth > 0].min()) >= NEAREST
