"""Surfaces around the hand that are too large for the object: walls, tables, other hands."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from inhand.config import SegmentationConfig
from inhand.stages.observation import Cloud, Observation

Image = NDArray[np.float32]
CELL = 2
"""Points of the scene cloud along the side of a cell."""
MIN_CELLS = 10
"""Surfaces of fewer cells are not looked at."""


class Background:
    """Connected surfaces that are longer than the object, of what is not the hand.

    The image is looked at in cells of some pixels.

    Args:
        observation: the image.
        is_hand: which points of its scene cloud are the hand's, shape (n,).
        object_diameter: [m].
        config: parameters.
    """

    def __init__(
        self,
        observation: Observation,
        is_hand: NDArray[np.bool_],
        object_diameter: float,
        config: SegmentationConfig,
    ) -> None:
        self._camera, self._step = observation.camera, CELL * observation.step
        self._shape = [-(-size // self._step) for size in observation.depth.shape]
        self._tolerance = config.surface_step
        self._points, self._normals = np.zeros((2, *self._shape, 3), dtype=np.float32)
        points, normals = observation.points[~is_hand], observation.normals[~is_hand]
        cell = self._cells(points)
        self._points[cell], self._normals[cell] = points, normals
        surface = _surfaces(self._points, self._normals, self._tolerance, config.crease)
        self._large = np.zeros(surface.shape, dtype=bool)
        for number in np.flatnonzero(np.bincount(surface.ravel())[1:] > MIN_CELLS) + 1:
            cells = surface == number
            length = np.ptp(self._points[cells], axis=0).max()
            self._large |= cells & bool(length > config.max_length * object_diameter)

    def removed_from(self, cloud: Cloud) -> Cloud:
        """A cloud of the image without the points on background, or on where it would go on.

        Between the fingers, a wall shows in pieces that are not connected.
        """
        if not self._large.any():
            return cloud
        v, u = distance_transform_edt(~self._large, return_distances=False, return_indices=True)
        cell = self._cells(cloud.points)
        near = v[cell], u[cell]
        off = ((cloud.points - self._points[near]) * self._normals[near]).sum(axis=1)
        rest = np.abs(off) > self._tolerance
        return Cloud(cloud.points[rest], cloud.normals[rest])

    def _cells(self, points: Image) -> tuple[NDArray[np.intp], ...]:
        """Row and column of the cells that show points."""
        u, v = np.rint(self._camera.project(points).T).astype(np.intp) // self._step
        return v.clip(0, self._shape[0] - 1), u.clip(0, self._shape[1] - 1)


def _surfaces(points: Image, normals: Image, tolerance: float, crease: float) -> NDArray[np.int32]:
    """Number of the connected surface that every cell belongs to, shape (h, w), 0 for none.

    A surface ends at a step and at a crease: an object ends where it stands on a table.
    """
    known = normals[..., 2] < 0
    # Cells lie at even places, and between two of them stands whether they are connected.
    connected = np.zeros([2 * size - 1 for size in known.shape], dtype=bool)
    connected[::2, ::2] = known
    for between, here, there in (
        (connected[1::2, ::2], np.s_[:-1], np.s_[1:]),
        (connected[::2, 1::2], np.s_[:, :-1], np.s_[:, 1:]),
    ):
        way = points[there] - points[here]
        off_here = np.einsum("ijk,ijk->ij", way, normals[here])
        off_there = np.einsum("ijk,ijk->ij", way, normals[there])
        flat = np.maximum(np.abs(off_here), np.abs(off_there)) < tolerance
        bend = crease * np.sqrt(np.einsum("ijk,ijk->ij", way, way))
        between[...] = known[here] & known[there] & flat & (off_here - off_there < bend)
    return np.asarray(label(connected)[0][::2, ::2])
