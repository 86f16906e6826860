"""The 3D view: scene cloud, hand, objects and camera, drawn by a viser server.

Everything is drawn in the depth camera's frame, below the node `CAMERA`. That node is moved so that
what is looked at (`look_at`) stays in the middle of the page: a view that the user has turned to
his liking goes on to the next frame.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.geometry.mesh import TriangleMesh
from inhand.hand import Hand
from inhand.overlay import Colour, Pixels

Array = NDArray[np.float64]

CAMERA = "/camera"
"""Node of the depth camera's frame."""
DISTANCE = 0.26
"""How far from the middle the page's view starts [m], on the depth camera's side."""
POINT_SIZE = 0.0009
"""Edge length of a point [m]."""


class View:
    """The 3D view of a page.

    Args:
        server: the `viser.ViserServer`.
    """

    def __init__(self, server: Any) -> None:
        self.server = server
        server.scene.set_up_direction("-y")
        self._camera = server.scene.add_frame(CAMERA, show_axes=False)
        server.initial_camera.position = (0.35 * DISTANCE, -0.5 * DISTANCE, -0.85 * DISTANCE)
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.initial_camera.near = 0.005
        self._last_camera: Any = None
        server.on_client_connect(self._welcome)

    def look_at(self, point: Array) -> None:
        """Put a point [m], camera frame, shape (3,), into the middle of the page."""
        self._camera.position = tuple(-np.asarray(point, dtype=float))

    def look_from_camera(self) -> None:
        """Show every browser what the depth camera sees."""
        for client in self.server.get_clients().values():
            with client.atomic():
                client.camera.up_direction = (0.0, -1.0, 0.0)
                client.camera.position = tuple(self._camera.position)
                client.camera.look_at = (0.0, 0.0, 0.0)

    def _welcome(self, client: Any) -> None:
        """Give a browser the view that the last one had: most often it is the same, come back."""
        last = self._last_camera
        if last is not None:
            with client.atomic():
                client.camera.up_direction = last.up_direction
                client.camera.position = last.position
                client.camera.look_at = last.look_at
        client.camera.on_update(self._remember)

    def _remember(self, camera: Any) -> None:
        self._last_camera = camera


class CloudDrawing:
    """A cloud of coloured points.

    Args:
        view: the 3D view.
        name: name of the node.
    """

    def __init__(self, view: View, name: str) -> None:
        self._scene, self._name = view.server.scene, f"{CAMERA}/{name}"
        self._node: Any = None

    def draw(self, points: NDArray[Any], colours: Pixels, size: float = POINT_SIZE) -> None:
        """Show these points instead of any others.

        Args:
            points: points [m], camera frame, shape (n, 3).
            colours: red, green, blue, 0 to 255, shape (n, 3).
            size: edge length of a point [m].
        """
        self._node = self._scene.add_point_cloud(
            self._name,
            np.asarray(points, dtype=np.float32),
            np.asarray(colours, dtype=np.uint8),
            point_size=size,
            point_shape="circle",
            point_shading="flat",
            precision="float32",
        )

    def hide(self) -> None:
        """Show nothing."""
        if self._node is not None:
            self._node.visible = False


class HandDrawing:
    """The links of a hand.

    Args:
        view: the 3D view.
        name: name of the node.
        hand: the hand.
        colour: red, green, blue, 0 to 255.
        opacity: 0 to 1, None for solid.
    """

    def __init__(
        self, view: View, name: str, hand: Hand, colour: Colour, opacity: float | None = None
    ) -> None:
        self._server, self._hand = view.server, hand
        self._root = view.server.scene.add_frame(f"{CAMERA}/{name}", show_axes=False, visible=False)
        self._links = [
            _add_mesh(self._server, f"{CAMERA}/{name}/{link.name}", link.mesh, colour, opacity)
            for link in hand.links
        ]

    def draw(
        self, T_camera_hand: Array, joint_vector: Array, shown: NDArray[np.bool_] | None = None
    ) -> None:
        """Show the hand.

        Args:
            T_camera_hand: its wrist pose, shape (4, 4).
            joint_vector: positions of the independent joints [rad, m], shape (n,).
            shown: which links to show, shape (L,); None for all.
        """
        with self._server.atomic():
            move(self._root, T_camera_hand)
            for node, T in zip(
                self._links, self._hand.forward_kinematics(joint_vector), strict=True
            ):
                move(node, T)
            for i, node in enumerate(self._links):
                node.visible = shown is None or bool(shown[i])
            self._root.visible = True

    def hide(self) -> None:
        """Show nothing."""
        self._root.visible = False


class ObjectDrawing:
    """A rigid body with its axes.

    Args:
        view: the 3D view.
        name: name of the node.
        mesh: its mesh, in its own frame [m].
        colour: red, green, blue, 0 to 255.
        opacity: 0 to 1, None for solid.
        axes: length of its axes [m], 0 for none.
        centre: where they are drawn [m], in its own frame, shape (3,); its origin may lie outside.
    """

    def __init__(
        self,
        view: View,
        name: str,
        mesh: TriangleMesh,
        colour: Colour,
        opacity: float | None = None,
        *,
        axes: float = 0.0,
        centre: Array | None = None,
    ) -> None:
        self._server = view.server
        self._root = view.server.scene.add_frame(f"{CAMERA}/{name}", show_axes=False, visible=False)
        if axes > 0:
            view.server.scene.add_frame(
                f"{CAMERA}/{name}/axes",
                axes_length=axes,
                axes_radius=axes / 60,
                origin_radius=axes / 60,
                position=np.zeros(3) if centre is None else centre,
            )
        self._mesh = _add_mesh(self._server, f"{CAMERA}/{name}/mesh", mesh, colour, opacity)

    def draw(self, T_camera_object: Array) -> None:
        """Show it at a pose, shape (4, 4)."""
        with self._server.atomic():
            move(self._root, T_camera_object)
            self._root.visible = True

    def hide(self) -> None:
        """Show nothing."""
        self._root.visible = False

    def remove(self) -> None:
        """Take it out of the scene for good."""
        self._root.remove()


class CameraDrawing:
    """The depth camera's pyramid with its image at the end.

    Args:
        view: the 3D view.
        name: name of the node.
        size: height of the pyramid [m].
    """

    def __init__(self, view: View, name: str = "pinhole", size: float = 0.05) -> None:
        self._scene, self._name, self._size = view.server.scene, f"{CAMERA}/{name}", size
        self._node: Any = None

    def draw(self, camera: Camera, image: Pixels) -> None:
        """Show a camera with its image, shape (H, W, 3)."""
        self._node = self._scene.add_camera_frustum(
            self._name,
            fov=2 * float(np.arctan(camera.height / (2 * camera.fy))),
            aspect=camera.width / camera.height,
            scale=self._size,
            thickness=0.02,
            color=(150, 150, 155),
            image=image[::2, ::2],
            jpeg_quality=70,
        )

    def hide(self) -> None:
        """Show nothing."""
        if self._node is not None:
            self._node.visible = False


def move(node: Any, T: Array) -> None:
    """Put a node at a pose, shape (4, 4), in its parent's frame."""
    import viser.transforms as tf

    node.wxyz = tf.SO3.from_matrix(np.asarray(T[:3, :3], dtype=np.float64)).wxyz
    node.position = np.asarray(T[:3, 3], dtype=np.float64)


def pose_of(node: Any) -> Array:
    """Pose, shape (4, 4), of a node in its parent's frame."""
    import viser.transforms as tf

    T = np.eye(4)
    T[:3, :3] = tf.SO3(np.asarray(node.wxyz)).as_matrix()
    T[:3, 3] = node.position
    return T


def _add_mesh(
    server: Any,
    name: str,
    mesh: TriangleMesh,
    colour: Colour,
    opacity: float | None,
) -> Any:
    return server.scene.add_mesh_simple(
        name,
        mesh.vertices.astype(np.float32),
        mesh.faces.astype(np.uint32),
        color=colour,
        opacity=opacity,
        flat_shading=True,
        side="double",
        cast_shadow=False,
        receive_shadow=False,
    )
