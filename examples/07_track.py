"""Follow the object through a sequence of images, part of which does not show it."""

import numpy as np

import inhand
from inhand.synth.demo import CAMERA, builtin_hand, builtin_object
from inhand.synth.motion import MotionProtocol
from inhand.synth.scene import NOISY, SceneMaker
from inhand.synth.sequence import SequenceMaker

# A sequence of the built-in hand and object, with sensor noise: a third of a second.
hand, obj = builtin_hand(), builtin_object("industrial_part")
maker = SequenceMaker(SceneMaker(hand, obj, CAMERA, NOISY), MotionProtocol(occluders=0, dropped=0))
sequence = maker.plan(12, np.random.default_rng(4))

tracker = inhand.PoseTracker(hand, obj)
for i, time in enumerate(sequence.times):
    scene = maker.render(sequence, i, np.random.default_rng(i))
    depth = scene.depth
    if 5 <= i < 8:  # something passes in front
        depth = np.full_like(depth, 0.2)
    e = tracker.update(depth, CAMERA, scene.T_camera_hand_given, time=float(time))
    if e.found:
        way = e.T_camera_object[:3, 3] - scene.T_camera_object[:3, 3]
        sd = np.sqrt(np.trace(e.covariance[3:, 3:]) / 3)
        how = "searched" if "hypotheses" in e.timings else "followed"
        print(
            f"image {i}: {how}, confidence {e.confidence:.2f}, off by "
            f"{1000 * np.linalg.norm(way):.1f} mm (sd per axis: {1000 * sd:.1f} mm)"
        )
    else:
        print(f"image {i}: no pose, {e.reason}")
