"""Estimate: one depth image in, the pose of the object and the angles of the fingers out.

The image is rendered: the built-in hand holds an industrial part in front of a simulated
structured-light camera. With a camera of your own, the three lines below "your input" change.
"""

import numpy as np

import inhand
from inhand.picture import draw_estimate
from inhand.synth.demo import demo_scene

scene = demo_scene()

# Your input: hand and object as in examples 02 and 03, then one image.
hand, obj = scene.hand, scene.obj
depth, camera = scene.depth, scene.camera  # (480, 640), float32 [m]
T_camera_hand = scene.T_camera_hand_given  # from forward kinematics: some millimetres off

estimator = inhand.PoseEstimator(hand, obj)  # once; it takes any number of images
estimate = estimator.estimate(depth, camera, T_camera_hand)

np.set_printoptions(precision=4, suppress=True)
print("found:", estimate.found, f"with confidence {estimate.confidence:.2f}")
print("T_camera_object:\n", estimate.T_camera_object, sep="")
for joint, angle in estimate.joint_positions.items():
    print(f"{joint}: {np.degrees(angle):.1f} deg")

draw_estimate(estimate, hand, obj, depth, camera).save("estimate.png")
