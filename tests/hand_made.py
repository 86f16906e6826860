"""Evidence made by hand: flat images whose every pixel the test decides on."""

from typing import Any

import numpy as np
import warp as wp

from inhand.camera import Camera
from inhand.kernels.depth import pinhole
from inhand.kernels.hand_fit import DepthView, Visibility

TOLERANCE = 0.01
VIOLATION, MISSING, HIDDEN = 2.0, 0.6, 0.3


def visibility() -> Any:
    """Rules whose penalties can be told apart."""
    rule = Visibility()
    rule.tolerance, rule.violation = TOLERANCE, VIOLATION
    rule.missing, rule.hidden = MISSING, HIDDEN
    return rule


def view(
    camera: Camera,
    depth: np.ndarray | float,
    missing: float = 1.0,
    normal: tuple[float, float, float] = (0, 0, -1),
) -> Any:
    """A view with this depth [m], (H, W) or the same everywhere, and one normal everywhere.

    `missing`: share of missing readings around every pixel.
    """
    n = camera.width * camera.height
    flat = np.broadcast_to(depth, (camera.height, camera.width)).reshape(-1)
    made = DepthView()
    made.camera = pinhole(camera)
    made.depth = wp.array(flat, dtype=float, device="cpu")
    made.normals = wp.array(np.tile(normal, (n, 1)), dtype=wp.vec3, device="cpu")
    made.missing = wp.full(n, missing, dtype=float, device="cpu")
    return made
