"""How good a snap of `inhand annotate` is, from a start that a user might leave it.

    python benchmarks/snap.py FRAMES ...

The wrist is as the frame gives it, every joint off by 8 degrees (sd), the object by 15 mm and 20
degrees in random directions; then hand and object are snapped once.
"""

import argparse
from functools import cache
from pathlib import Path
from time import process_time

import numpy as np

from inhand import EstimatorConfig, Hand
from inhand.annotation.images import RawImage
from inhand.annotation.session import Label
from inhand.annotation.tools import Tools
from inhand.datasets.frame import LABEL_OBJECT, Frame
from inhand.datasets.frames import find_frames, load_object, need_hand, need_objects, read_frame
from inhand.errors import NoAnswer
from inhand.evaluation.hand_errors import angle_errors, wrist_error
from inhand.evaluation.metrics import ObjectMetric
from inhand.geometry.se3 import exp

JOINTS, METRES, RADIANS = np.radians(8), 0.015, np.radians(20)
"""How far the start is off."""
MOST = 0.6
"""Objects of which more than this share is visible are counted apart too."""


def start_of(frame: Frame, hand: Hand, centre: np.ndarray, rng: np.random.Generator) -> Label:
    """A label that a snap begins with; the object turned about its centre [m], shape (3,)."""
    q = hand.joint_vector(frame.truth.joint_positions) + rng.normal(0, JOINTS, len(hand.lower))
    q = np.clip(q, hand.lower, hand.upper)
    way, axis = rng.normal(size=(2, 3))
    turn = exp(np.r_[RADIANS * axis / np.linalg.norm(axis), 0, 0, 0])
    turn[:3, 3] = centre - turn[:3, :3] @ centre
    T = frame.truth.T_camera_object @ turn
    T[:3, 3] += METRES * way / np.linalg.norm(way)
    joints = {name: float(x) for name, x in zip(hand.joint_names, q, strict=True)}
    return Label(frame.object_name, T, frame.T_camera_hand_given, joints)


def main(folders: list[Path]) -> None:
    """Snap every frame, and print errors and CPU time."""
    hand = Hand.from_urdf(need_hand(folders[0]))
    objects = need_objects(folders[0])
    tools = cache(lambda name: Tools(hand, load_object(objects, name), EstimatorConfig(), "cpu"))
    object_errors, wrists, joints, adi, visible, times, refused = [], [], [], [], [], [], []
    for number, path in enumerate(find_frames(folders)):
        frame = read_frame(path)
        snapper = tools(frame.object_name).snapper
        obj = tools(frame.object_name).obj
        label = start_of(frame, hand, obj.centre, np.random.default_rng([10, number]))
        raw = RawImage(frame.depth, frame.camera, None, frame.T_camera_hand_given)
        begin = process_time()
        try:
            label = snapper.snap_object(raw, snapper.snap_hand(raw, label))
        except NoAnswer:
            seen = (frame.truth.label == LABEL_OBJECT) & (frame.depth > 0)
            refused.append(np.count_nonzero(seen))
            continue
        times.append(process_time() - begin)
        visible.append(frame.truth.visible_share)
        metric = ObjectMetric(obj)
        object_errors.append(metric.pose_error(label.T_camera_object, frame.truth.T_camera_object))
        adi.append(metric.adi(label.T_camera_object, frame.truth.T_camera_object))
        wrists.append(wrist_error(label.T_camera_hand, frame.truth.T_camera_hand))
        joints += angle_errors(label.joint_positions, frame.truth.joint_positions).values()
    e, w, a = np.array(object_errors), np.array(wrists), np.array(adi)
    within = (e[:, 0] < 0.001) & (np.degrees(e[:, 1]) < 1)
    print(f"frames: {len(e) + len(refused)}, no answer: {len(refused)}, with {refused} readings")
    print(f"object, median: {1000 * np.median(e[:, 0]):.2f} mm, {median_degrees(e[:, 1]):.2f} deg")
    plain = np.array(visible) > MOST
    for frames, chosen in (("all", np.full(len(a), True)), (f"over {MOST:.0%} visible", plain)):
        print(
            f"{frames}, {chosen.sum()}: within 1 mm and 1 degree {within[chosen].mean():.0%}, ADI "
            f"under 2 mm {(a[chosen] < 0.002).mean():.0%}, 5 mm {(a[chosen] < 0.005).mean():.0%}"
        )
    print(f"wrist, median: {1000 * np.median(w[:, 0]):.2f} mm, {median_degrees(w[:, 1]):.2f} deg")
    print(f"joints, median: {median_degrees(np.array(joints)):.2f} deg")
    print(f"CPU time, median: {np.median(times):.3f} s")


def median_degrees(angles: np.ndarray) -> float:
    """Median of angles [rad] in degrees."""
    return float(np.degrees(np.median(angles)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("frames", type=Path, nargs="+")
    main(parser.parse_args().frames)
