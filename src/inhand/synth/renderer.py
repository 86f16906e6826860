"""Ray-cast images of a hand, the object it holds and what stands behind them."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.geometry import se3
from inhand.geometry.mesh import TriangleMesh, box, cylinder, sphere
from inhand.hand import Hand
from inhand.kernels.depth import bounding_sphere, pinhole
from inhand.kernels.launch import launch
from inhand.object_model import ObjectModel
from inhand.synth.kernels import Bodies, Layers, render_layers

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

NO_BODY, BACKGROUND_BODY, OBJECT_BODY = 0, 254, 255
"""Values of a segmentation image; i + 1 is the hand's link i."""

CLUTTER_SHAPES = 24
"""Different solids that may stand behind the hand."""
CLUTTER_SIZE = (0.03, 0.15)
"""Range of their edges and diameters [m]."""
WALL_SIZE = (4.0, 4.0, 0.01)
"""Edges of the wall behind the hand [m]; its frame's z axis is its normal."""


@dataclass(frozen=True, eq=False)
class Images:
    """What a perfect camera sees."""

    depth: NDArray[np.float32]
    """Depth z [m], shape (H, W), 0 where there is nothing."""
    segmentation: NDArray[np.uint8]
    """Body that each pixel shows, shape (H, W): NO_BODY, 1 + index of a link, BACKGROUND_BODY or
    OBJECT_BODY."""
    object_depth: NDArray[np.float32]
    """Depth of the object as if there were nothing else [m], shape (H, W)."""
    rgb: NDArray[np.uint8]
    """Shaded colours, shape (H, W, 3), black where there is nothing."""

    @property
    def object_pixels(self) -> int:
        """Pixels that show the object."""
        return int(np.count_nonzero(self.segmentation == OBJECT_BODY))


class Props(NamedTuple):
    """What stands behind the hand."""

    shape: NDArray[np.int64]
    """Index into `SceneRenderer.props`, shape (k,)."""
    T_camera_prop: Array
    """Poses, shape (k, 4, 4)."""
    colour: Array
    """Red, green, blue, 0 to 1, shape (k, 3)."""


NO_PROPS = Props(np.zeros(0, dtype=np.int64), np.zeros((0, 4, 4)), np.zeros((0, 3)))
"""Nothing behind the hand."""


class SceneRenderer:
    """Renders one hand and object at changing poses.

    Args:
        hand: the hand.
        obj: the object.
        device: Warp device name.
    """

    props: tuple[TriangleMesh, ...]
    """The solids of clutter and, last, the wall."""

    def __init__(self, hand: Hand, obj: ObjectModel, device: str = "cpu") -> None:
        self._device = device
        self.props = (*clutter_shapes(), box(WALL_SIZE))
        self._n_links = len(hand.links)
        meshes = [obj.mesh, *(link.mesh for link in hand.links), *self.props]
        self._meshes = [_on_device(mesh, device) for mesh in meshes]
        self._spheres = np.array([bounding_sphere(mesh) for mesh in meshes])

    def render(
        self,
        camera: Camera,
        T_camera_object: Array,
        T_camera_link: Array,
        props: Props = NO_PROPS,
        *,
        object_colour: Colour = (0.8, 0.8, 0.8),
        hand_colour: Colour = (0.5, 0.5, 0.5),
        lamp: Array | None = None,
    ) -> Images:
        """The images of one scene.

        Args:
            camera: the camera.
            T_camera_object: pose of the object, shape (4, 4).
            T_camera_link: poses of the hand's links, shape (L, 4, 4).
            props: what stands behind them.
            object_colour: red, green, blue, 0 to 1.
            hand_colour: red, green, blue, 0 to 1.
            lamp: unit direction to a far lamp, camera frame, shape (3,); default: from behind.
        """
        n_links = self._n_links
        index = np.concatenate([np.arange(1 + n_links), 1 + n_links + props.shape])
        poses = np.concatenate([T_camera_object[None], T_camera_link, props.T_camera_prop])
        colours = np.concatenate([[object_colour], [hand_colour] * n_links, props.colour])
        layers = self._cast(camera, index, poses, colours, lamp)
        size = (camera.height, camera.width)
        meaning = np.full(len(index) + 1, BACKGROUND_BODY, dtype=np.uint8)
        meaning[0], meaning[-1] = OBJECT_BODY, NO_BODY  # index -1, no hit, is the last
        meaning[1 : 1 + n_links] = 1 + np.arange(n_links)
        return Images(
            depth=layers.depth.numpy().reshape(size),
            segmentation=meaning[layers.body.numpy().reshape(size)],
            object_depth=layers.depth_alone.numpy().reshape(size),
            rgb=layers.rgb.numpy().reshape(*size, 3),
        )

    def silhouette_pixels(self, camera: Camera, T_camera_object: Array, images: Images) -> int:
        """Pixels of the object's silhouette, those outside the image included.

        The image is widened to three times its size where the object reaches its edge.
        """
        alone = images.object_depth > 0
        if alone[[0, -1]].any() or alone[:, [0, -1]].any():
            width, height = camera.width, camera.height
            wide = camera.crop(-width, -height, 3 * width, 3 * height)
            one = np.zeros(1, dtype=np.int64)
            layers = self._cast(wide, one, T_camera_object[None], np.ones((1, 3)), None)
            alone = layers.depth_alone.numpy() > 0
        return int(np.count_nonzero(alone))

    def _cast(
        self,
        camera: Camera,
        index: NDArray[np.int64],
        poses: Array,
        colours: Array,
        lamp: Array | None,
    ) -> Any:
        device, count = self._device, camera.width * camera.height
        T_body_camera = se3.inverse(poses)
        spheres = self._spheres[index].copy()
        spheres[:, :3] = np.einsum("bij,bj->bi", poses[:, :3, :3], spheres[:, :3])
        spheres[:, :3] += poses[:, :3, 3]
        spheres[:, 3] = (spheres[:, :3] ** 2).sum(axis=1) - spheres[:, 3] ** 2
        b = Bodies()
        ids = [self._meshes[i].id for i in index]
        b.mesh = wp.array(ids, dtype=wp.uint64, device=device)
        b.R_body_camera = wp.array(T_body_camera[:, :3, :3], dtype=wp.mat33, device=device)
        b.eye = wp.array(T_body_camera[:, :3, 3], dtype=wp.vec3, device=device)
        b.sphere = wp.array(spheres, dtype=wp.vec4, device=device)
        b.colour = wp.array(colours, dtype=wp.vec3, device=device)
        layers = Layers()
        layers.depth = wp.empty(count, dtype=float, device=device)
        layers.body = wp.empty(count, dtype=int, device=device)
        layers.depth_alone = wp.empty(count, dtype=float, device=device)
        layers.rgb = wp.empty(count, dtype=wp.vec3ub, device=device)
        direction = wp.vec3(*(np.array([0.0, 0.0, -1.0]) if lamp is None else lamp).tolist())
        inputs = [pinhole(camera), b, direction, layers]
        launch(render_layers, count, inputs, device, work_per_item=20)
        return layers


def clutter_shapes() -> list[TriangleMesh]:
    """Boxes, cylinders and balls of many sizes; always the same."""
    rng = np.random.default_rng(0)
    shapes = []
    for i in range(CLUTTER_SHAPES):
        size = rng.uniform(*CLUTTER_SIZE, size=3)
        solids = (box(size), cylinder(size[0] / 2, size[1]), sphere(size[0] / 2))
        shapes.append(solids[i % len(solids)])
    return shapes


def _on_device(mesh: TriangleMesh, device: str) -> wp.Mesh:
    return wp.Mesh(
        points=wp.array(mesh.vertices, dtype=wp.vec3, device=device),
        indices=wp.array(mesh.faces.reshape(-1), dtype=int, device=device),
    )
