"""A stream of images: a folder, a recording or a camera in, an estimate of every image out.

The same as `inhand run stream --hand HAND --object OBJECT`, in code.
"""

import json
from pathlib import Path

import numpy as np

import inhand
from inhand.streams.config import StreamConfig
from inhand.streams.json_lines import JsonLines
from inhand.streams.open_source import open_source
from inhand.streams.runner import run
from inhand.streams.source import Frame
from inhand.synth.demo import demo_scene

# A folder as a robot might have written it: images, camera, and the wrist's pose with the times.
scene = demo_scene()
folder = Path("stream")
folder.mkdir()
camera = {name: getattr(scene.camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
(folder / "camera.json").write_text(json.dumps(camera))
poses: dict[str, dict[str, object]] = {}
for number in range(3):
    np.save(folder / f"image_{number}.npy", scene.depth)
    poses[f"image_{number}"] = {"time": 0.1 * number}
    if number != 1:  # the robot did not know its wrist at the second image
        poses[f"image_{number}"]["T_camera_hand"] = scene.T_camera_hand_given.tolist()
(folder / "hand_poses.json").write_text(json.dumps(poses))

source = open_source("stream", StreamConfig())  # or "recording.bag", "recording.mcap", "realsense"
print("\n".join(source.description))
estimator = inhand.PoseEstimator(scene.hand, scene.obj)


def estimate(frame: Frame) -> inhand.PoseEstimate:
    """The estimate of one image of the stream."""
    return estimator.estimate(frame.depth, frame.camera, frame.T_camera_hand)


summary = run(source, estimate, [JsonLines(Path("results.jsonl"))])  # rate=1.0: in real time
print(summary.counts)
for line in Path("results.jsonl").read_text().splitlines()[:-1]:  # the last is the summary
    result = json.loads(line)
    print(result["frame"], result["time_ns"], result["reason"] or "found")
