"""Labels with the object elsewhere: it is moved by, and turned about, its centre."""

from dataclasses import replace

from inhand.annotation.session import Array, Label
from inhand.annotation.tools import Tools
from inhand.geometry.se3 import exp_so3


def placed(tools: Tools, label: Label, T_camera_centre: Array) -> Label:
    """The label with the object at a pose, (4, 4), whose origin is the object's centre."""
    return replace(label, T_camera_object=tools.from_centred(T_camera_centre))


def centred_at(tools: Tools, label: Label, centre: Array) -> Label:
    """The label with the object's centre at a point [m], camera frame, shape (3,)."""
    T = tools.centred(label.T_camera_object)
    T[:3, 3] = centre
    return placed(tools, label, T)


def turned_to(tools: Tools, label: Label, rotation: Array) -> Label:
    """The label with the object's axes turned against the camera's by a rotation, shape (3, 3)."""
    T = tools.centred(label.T_camera_object)
    T[:3, :3] = rotation
    return placed(tools, label, T)


def nudged(tools: Tools, label: Label, turn: Array, shift: Array) -> Label:
    """The label with the object moved a little.

    Args:
        tools: those of the label's object.
        label: the label.
        turn: rotation vector about axes parallel to the camera's [rad], shape (3,).
        shift: translation along the camera's axes [m], shape (3,).
    """
    T = tools.centred(label.T_camera_object)
    T[:3, :3] = exp_so3(turn) @ T[:3, :3]
    T[:3, 3] += shift
    return placed(tools, label, T)


def exchanged(before: Tools, after: Tools, label: Label, name: str) -> Label:
    """The label with another object, by its name, in the place of the one before."""
    T = before.centred(label.T_camera_object)
    return replace(label, object_name=name, T_camera_object=after.from_centred(T))
