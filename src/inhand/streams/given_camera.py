"""A camera that the user gives instead of the one that the source tells of."""

from math import isclose
from pathlib import Path

from inhand.camera import Camera
from inhand.errors import InputError


def check_fits(given: Camera, own: Camera, told_by: Path | str) -> Camera:
    """The given camera, if the source's images can be its.

    What a count of the depth images is, the source alone knows: another unit in the given camera,
    or none, which would mean millimetres, is a mistake.

    Args:
        given: the camera that the user gives.
        own: the one that the source tells of.
        told_by: what tells of it, for messages.

    Raises:
        InputError: they have another image size or depth unit.
    """
    if (given.width, given.height) != (own.width, own.height):
        raise InputError(
            f"--camera is of images of {given.width} x {given.height} pixels, but they have "
            f"{own.width} x {own.height} by {told_by}"
        )
    if not isclose(given.depth_unit, own.depth_unit, rel_tol=1e-6):
        raise InputError(
            f"--camera says that a count of the depth images is {given.depth_unit:g} m, but it is "
            f'{own.depth_unit:g} m by {told_by}: write "depth_unit_m": {own.depth_unit:g} there'
        )
    return given
