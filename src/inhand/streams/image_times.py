"""Times of images that lie in a folder."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from inhand.checks import finite_number
from inhand.errors import InputError
from inhand.streams.pose_track import NS


def image_times(told: Sequence[Any], frame_rate: float, where: str) -> list[int]:
    """When each image was taken [ns], in order: as told, or at `frame_rate` from 0 on.

    Args:
        told: times [s] of all images, or None for all.
        frame_rate: images a second, positive.
        where: what tells the times, for messages.

    Raises:
        InputError: some times are missing, or they do not grow.
    """
    if all(time is None for time in told):
        return [round(number * NS / frame_rate) for number in range(len(told))]
    if any(time is None for time in told):
        raise InputError(f"{where} tells the times of some images, but not of all")
    times = [round(finite_number(time, f"a time in {where}") * NS) for time in told]
    if any(later <= earlier for earlier, later in pairwise(times)):
        raise InputError(f"the times in {where} do not grow from image to image")
    return times
