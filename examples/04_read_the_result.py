"""Read the result: confidence, ranked alternatives, times, and why there is no answer."""

import numpy as np

import inhand
from inhand.synth.demo import demo_scene
from inhand.synth.scene import OBJECT

scene = demo_scene()
estimator = inhand.PoseEstimator(scene.hand, scene.obj)


def estimate(depth: np.ndarray, T_camera_hand: np.ndarray) -> inhand.PoseEstimate:
    """The estimate from another depth image [m], or with another wrist pose."""
    return estimator.estimate(depth, scene.camera, T_camera_hand)


# An answer: the first candidate, with the probability that it is right.
e = estimate(scene.depth, scene.T_camera_hand_given)
print(f"confidence {e.confidence:.2f}:", "use it" if e.confidence > 0.9 else "look again")
for rank, candidate in enumerate(e.candidates, start=1):
    apart = np.linalg.norm((candidate.T_camera_object - e.T_camera_object)[:3, 3])
    print(f"{rank}. score {candidate.scores['score']:.2f}, {1000 * apart:.1f} mm from the first")
print({stage: f"{1000 * seconds:.0f} ms" for stage, seconds in e.timings.items()})

# Found is not yet right: without a reading on the object, the best pose left has little to say.
unseen = np.where(scene.label == OBJECT, 0, scene.depth)
e = estimate(unseen, scene.T_camera_hand_given)
print("object without readings: found", e.found, f"with confidence {e.confidence:.2f}")

# No answer is not an error: the reason is a sentence for a person.
elsewhere = scene.T_camera_hand_given.copy()
elsewhere[0, 3] += 0.1
for depth, T_camera_hand in (
    (scene.depth, elsewhere),
    (np.zeros_like(scene.depth), scene.T_camera_hand_given),
):
    e = estimate(depth, T_camera_hand)
    print("found", e.found, "because", e.reason)

# Bad input is an error that says what to do.
try:
    estimate(1000 * scene.depth, scene.T_camera_hand_given)
except inhand.InputError as error:
    print("InputError:", error)
