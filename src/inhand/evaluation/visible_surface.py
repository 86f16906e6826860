"""VSD, the visible surface discrepancy: how two poses differ where the camera can tell.

Hodan et al., "BOP Challenge 2020 on 6D object localization", section 2.2, and the BOP toolkit's
handling of missing readings.
"""

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera

VISIBLE_BEHIND = 0.015
"""A rendered surface up to this far behind the observed one counts as visible [m]."""
TOLERANCES = np.arange(1, 11) * 0.05
"""BOP's tolerances of the distance between the surfaces, in diameters of the object."""
THRESHOLDS = np.arange(1, 11) * 0.05
"""BOP's thresholds of VSD."""

Image = NDArray[np.floating]


def vsd(
    observed: Image, truth: Image, estimate: Image, camera: Camera, diameter: float
) -> NDArray[np.float64]:
    """VSD for each of `TOLERANCES`, 0 to 1, shape (10,); 1 where neither pose is visible.

    Args:
        observed: the depth image [m], shape (H, W), 0 where there is no reading.
        truth: depth of the object alone at the true pose [m], shape (H, W), 0 beside it.
        estimate: the same at the estimated pose.
        camera: the camera of the images.
        diameter: of the object [m].
    """
    per_depth = _distance_per_depth(camera)
    at_truth, at_estimate = truth * per_depth, estimate * per_depth
    nearest_visible = np.where(observed > 0, observed * per_depth + VISIBLE_BEHIND, np.inf)
    truth_visible = (truth > 0) & (at_truth <= nearest_visible)
    estimate_visible = (estimate > 0) & ((at_estimate <= nearest_visible) | truth_visible)
    both = truth_visible & estimate_visible
    either = int((truth_visible | estimate_visible).sum())
    if either == 0:
        return np.ones(len(TOLERANCES))
    apart = np.abs(at_truth[both] - at_estimate[both]) / diameter
    agreeing = (apart < TOLERANCES[:, None]).sum(axis=1)
    return np.asarray(1 - agreeing / either)


def _distance_per_depth(camera: Camera) -> NDArray[np.float64]:
    """Distance from the camera's centre for a depth of 1, by pixel, shape (H, W)."""
    u = (np.arange(camera.width) - camera.cx) / camera.fx
    v = (np.arange(camera.height) - camera.cy) / camera.fy
    return np.sqrt(1 + u[None] ** 2 + v[:, None] ** 2)
