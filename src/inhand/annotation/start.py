"""Where the labelling of an image starts."""

from collections.abc import Callable

import numpy as np

from inhand.annotation.images import RawImage
from inhand.annotation.session import Array, Label, Session
from inhand.geometry.se3 import inverse, transform
from inhand.hand import Hand
from inhand.object_model import ObjectModel

FREE = 6.0
"""A joint with a wider range turns freely [rad]."""


def start_label(
    before: Label | None,
    raw: RawImage,
    hand: Hand,
    object_name: str,
    model: Callable[[str], ObjectModel],
) -> Label:
    """The label that the user starts from.

    Images often follow each other: the object is held, and the fingers stand, as in the last image
    before that is labelled. Without one, the fingers stand in the middle of their ranges; the
    object, if it is another, is between their tips.

    Args:
        before: the label of that image, if there is one.
        raw: the image.
        hand: the hand.
        object_name: name of the object.
        model: gives the object's model by name.
    """
    T_camera_hand, joints = raw.T_camera_hand, _half_closed(hand)
    if before is not None:
        joints = dict(before.joint_positions)
        T_camera_hand = before.T_camera_hand if T_camera_hand is None else T_camera_hand
        if before.object_name == object_name:
            T_hand_object = inverse(before.T_camera_hand) @ before.T_camera_object
            return Label(object_name, T_camera_hand @ T_hand_object, T_camera_hand, joints)
    if T_camera_hand is None:
        T_camera_hand = _in_the_middle(raw, hand)
    between = _between_the_tips(hand, hand.joint_vector(joints))
    T = np.eye(4)
    T[:3, 3] = transform(T_camera_hand, between[None])[0] - model(object_name).centre
    return Label(object_name, T, T_camera_hand, joints)


def last_labelled(session: Session) -> Label | None:
    """The label of the last image, before the one that is looked at, that is labelled."""
    for image in reversed(session.images[: session.position]):
        if session.status(image) == "labelled":
            return session.labels[image]
    return None


def _half_closed(hand: Hand) -> dict[str, float]:
    """Joint positions in the middle of their ranges; joints that turn freely are at rest."""
    free = hand.upper - hand.lower > FREE
    q = np.where(free, hand.rest, (hand.lower + hand.upper) / 2)
    return dict(zip(hand.joint_names, q.tolist(), strict=True))


def _between_the_tips(hand: Hand, q: Array) -> Array:
    """The middle of the fingers' last links [m], hand frame, shape (3,)."""
    links = hand.forward_kinematics(q)
    tips = [finger.links[-1] for finger in hand.fingers]
    middles = [transform(links[i], hand.links[i].mesh.bounds.mean(axis=0)[None])[0] for i in tips]
    return np.asarray(np.mean(middles, axis=0))


def _in_the_middle(raw: RawImage, hand: Hand) -> Array:
    """A wrist pose, (4, 4), that puts the hand into the image, at the depth of what is nearest."""
    centre, radius = hand.reach
    readings = raw.depth[raw.depth > 0]
    near = float(np.percentile(readings, 10)) if len(readings) else 0.0
    T = np.eye(4)
    T[:3, 3] = np.array([0.0, 0.0, max(near, 1.5 * radius)]) - centre
    return T
