"""Your own hand: what `inhand` reads from a URDF, and a test of it on a rendered image.

`python 02_your_own_hand.py hand.urdf` reads yours; without it, a parallel gripper is written.
"""

import sys
from pathlib import Path

import inhand
from inhand.builtin.objects import cuboid
from inhand.synth.demo import CAMERA
from inhand.synth.scene import make_scene


def finger(side: str, sign: int, rule: str = "") -> str:
    """A finger that slides along x by up to 40 mm; sizes in metres."""
    return f"""
      <link name="{side}_finger"><visual><origin xyz="0 0 0.045"/>
        <geometry><box size="0.012 0.022 0.09"/></geometry></visual></link>
      <joint name="{side}_joint" type="prismatic">
        <parent link="palm"/><child link="{side}_finger"/>
        <origin xyz="{sign * 0.008} 0 0.06"/><axis xyz="{sign} 0 0"/>
        <limit lower="0" upper="0.04" effort="40" velocity="0.1"/>{rule}</joint>"""


PALM = '<link name="palm"><visual><geometry><box size="0.13 0.06 0.12"/></geometry></visual></link>'
if len(sys.argv) < 2:
    one, other = finger("left", 1), finger("right", -1, '<mimic joint="left_joint"/>')
    Path("gripper.urdf").write_text(f'<robot name="gripper">{PALM}{one}{other}</robot>')
hand = inhand.Hand.from_urdf(sys.argv[1] if len(sys.argv) > 1 else "gripper.urdf")

print("palm:", [hand.links[i].name for i in hand.palm_links])  # rigid with the root link
for found in hand.fingers:
    links = [hand.links[i].name for i in found.links]
    print("finger:", *links, "moved by", *[hand.joint_names[i] for i in found.joints])
for joint, low, high in zip(hand.joint_names, hand.lower, hand.upper, strict=True):
    print(f"{joint}: {low:.3f} to {high:.3f}")  # rad, or m for a joint that slides

# Where the links are, for joint positions of your choice: compare with your own kinematics.
middle = hand.joint_dict((hand.lower + hand.upper) / 2)
print({name: T[:3, 3].round(3).tolist() for name, T in hand.link_poses(middle).items()})

# The hand holds a cuboid in front of a rendered camera: does the estimator see it?
scene = make_scene(hand, inhand.ObjectModel.from_mesh(cuboid()), CAMERA, seed=1)
estimator = inhand.PoseEstimator(hand, scene.obj)
estimate = estimator.estimate(scene.depth, scene.camera, scene.T_camera_hand_given)
print("found:", estimate.found, f"with confidence {estimate.confidence:.2f}")
print("joints:", {name: round(q, 4) for name, q in estimate.joint_positions.items()})
print("truth: ", {name: round(q, 4) for name, q in scene.joint_positions.items()})
