"""Image sequences of a hand that moves, with an object that moves in it.

A sequence begins as a random scene (`synth.scene`) and goes on with the motions of `synth.motion`.
Its motion is drawn at once and does not depend on the images, so that these may be made one by one
and in any order.
"""

from dataclasses import dataclass, field

import numpy as np

from inhand.geometry import se3
from inhand.synth.grasp import Grasp
from inhand.synth.motion import (
    Array,
    MotionProtocol,
    move_hand,
    move_in_hand,
    time_stamps,
    wrist_errors,
)
from inhand.synth.renderer import CLUTTER_SHAPES, Props
from inhand.synth.scene import NEAREST, Scene, SceneMaker, with_errors
from inhand.synth.surroundings import Surroundings

FIRST_VISIBLE = 0.35
"""Visible share of the object in the first image, or more; less only if the protocol allows no
more."""
OCCLUDER_GAP = 0.01
"""An occluder passes in front of the hand's reach by at least this [m]."""


@dataclass(frozen=True, eq=False)
class Sequence:
    """What moves in a sequence of n images."""

    times: Array
    """Time stamps [s], shape (n,)."""
    T_hand_object: Array = field(repr=False)
    """Poses of the object in the hand, shape (n, 4, 4)."""
    q: Array = field(repr=False)
    """Joints of the hand [rad, m], shape (n, joints)."""
    T_camera_hand: Array = field(repr=False)
    """True wrist poses, shape (n, 4, 4)."""
    T_camera_hand_given: Array = field(repr=False)
    """The wrist poses that an estimator is told, shape (n, 4, 4)."""
    around: Surroundings = field(repr=False)
    """Light, and what stands behind the hand."""
    occluders: "Occluders" = field(repr=False)
    """What passes in front of it."""


@dataclass(frozen=True, eq=False)
class Occluders:
    """k solids that pass in front of the camera, each on a straight line."""

    props: Props
    """The solids, where they are in front of the object."""
    time: Array
    """When they are there [s], shape (k,)."""
    velocity: Array
    """[m/s], camera frame, shape (k, 3)."""

    def at(self, time: float) -> Props:
        """The solids at a time [s]."""
        poses = self.props.T_camera_prop.copy()
        poses[:, :3, 3] += (time - self.time)[:, None] * self.velocity
        return self.props._replace(T_camera_prop=poses)


class SequenceMaker:
    """Makes random sequences of one hand and object.

    Args:
        scenes: makes the first image, and renders all of them; its protocol is the sequence's.
        motion: what motions are drawn from.
    """

    def __init__(self, scenes: SceneMaker, motion: MotionProtocol) -> None:
        self._scenes, self._motion = scenes, motion

    def plan(self, number: int, rng: np.random.Generator) -> Sequence:
        """The motion of a random sequence of so many images.

        Raises:
            InputError: no first image fits the protocol.
        """
        scenes, motion = self._scenes, self._motion
        low, high = scenes.protocol.visible
        first = scenes.make(rng, (min(max(low, FIRST_VISIBLE), high), high))
        grasp = Grasp(
            se3.inverse(first.T_camera_hand) @ first.T_camera_object,
            scenes.hand.joint_vector(first.joint_positions),
        )
        times = time_stamps(number, motion, rng)
        T_hand_object, q = move_in_hand(scenes.grasps, grasp, motion, times, rng)
        T_camera_hand = move_hand(first.T_camera_hand, scenes.hand, motion, times, rng)
        p = scenes.protocol
        errors = wrist_errors(times, p.wrist_translation, p.wrist_rotation, motion, rng)
        given = T_camera_hand.copy()
        given[:, :3, :3] = se3.exp_so3(errors[:, :3]) @ T_camera_hand[:, :3, :3]
        given[:, :3, 3] += errors[:, 3:]
        around = scenes.surroundings(first.T_camera_hand, rng)
        occluders = self._occluders(times, T_camera_hand, T_hand_object, rng)
        return Sequence(times, T_hand_object, q, T_camera_hand, given, around, occluders)

    def render(self, sequence: Sequence, i: int, rng: np.random.Generator) -> Scene:
        """Image `i` of a sequence; the sensor's errors come from `rng`."""
        behind, occluders = sequence.around.props, sequence.occluders.at(float(sequence.times[i]))
        props = Props(
            *(np.concatenate(parts) for parts in zip(behind, occluders, strict=True)),
        )
        scene = self._scenes.render_in(
            sequence.around._replace(props=props),
            Grasp(sequence.T_hand_object[i], sequence.q[i]),
            sequence.T_camera_hand[i],
        )
        return with_errors(
            scene, self._scenes.protocol, rng, T_camera_hand_given=sequence.T_camera_hand_given[i]
        )

    def _occluders(
        self, times: Array, T_camera_hand: Array, T_hand_object: Array, rng: np.random.Generator
    ) -> Occluders:
        """Random solids, each of which is between camera and object at a random time."""
        number = rng.poisson(self._motion.occluders * times[-1])
        shape = rng.integers(CLUTTER_SHAPES, size=number)
        at = rng.integers(len(times), size=number)
        poses, velocity = np.tile(np.eye(4), (number, 1, 1)), np.empty((number, 3))
        for k, (i, solid) in enumerate(zip(at, shape, strict=True)):
            centre = se3.transform(T_camera_hand[i], self._scenes.hand.reach[0][None])[0]
            held = T_camera_hand[i] @ T_hand_object[i]
            target = se3.transform(held, self._scenes.obj.centre[None])[0]
            radius = self._scenes.solid_diameter(int(solid)) / 2
            farthest = centre[2] - self._scenes.hand.reach[1] - radius - OCCLUDER_GAP
            # Where there is no room in front of the hand, what passes may run through a finger.
            z = max(rng.uniform(0.5, 1.0) * farthest, NEAREST + radius)
            poses[k, :3, :3] = se3.random_rotation(rng)
            poses[k, :3, 3] = z / target[2] * target
            heading = rng.uniform(0, 2 * np.pi)
            speed = rng.uniform(*self._motion.occluder_speed)
            velocity[k] = speed * np.array([np.cos(heading), np.sin(heading), 0.0])
        colours = rng.uniform(0.2, 0.9, size=(number, 3))
        return Occluders(Props(shape, poses, colours), times[at], velocity)
