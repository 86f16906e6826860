"""Where the labelling of an image starts."""

from collections.abc import Callable

import numpy as np

from inhand.annotation.images import RawImage
from inhand.annotation.session import Array, Label, Session
from inhand.geometry.se3 import inverse, transform
from inhand.hand import Hand
from inhand.object_model import ObjectModel


def start_label(
    session: Session,
    raw: RawImage,
    hand: Hand,
    object_name: str,
    model: Callable[[str], ObjectModel],
) -> Label:
    """The label that the user starts from.

    Images often follow each other: the object is held, and the fingers stand, as in the last image
    before that is labelled. In the first image, the fingers stand in the middle of their ranges and
    the object is between their tips.

    Args:
        session: the labels so far.
        raw: the image.
        hand: the hand.
        object_name: name of the object, if no image before says it.
        model: gives the object's model by name.
    """
    before = _last_labelled(session)
    given = raw.T_camera_hand
    if before is not None:
        T_camera_hand = before.T_camera_hand if given is None else given
        T_hand_object = inverse(before.T_camera_hand) @ before.T_camera_object
        T = T_camera_hand @ T_hand_object
        return Label(before.object_name, T, T_camera_hand, before.joint_positions)
    T_camera_hand = _in_the_middle(raw, hand) if given is None else given
    q = np.where(hand.upper - hand.lower > 6, hand.rest, (hand.lower + hand.upper) / 2)
    T = np.eye(4)
    between = transform(T_camera_hand, _between_the_tips(hand, q)[None])[0]
    T[:3, 3] = between - model(object_name).centre
    joints = dict(zip(hand.joint_names, q.tolist(), strict=True))
    return Label(object_name, T, T_camera_hand, joints)


def _last_labelled(session: Session) -> Label | None:
    for image in reversed(session.images[: session.position]):
        if session.status(image) == "labelled":
            return session.labels[image]
    return None


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
