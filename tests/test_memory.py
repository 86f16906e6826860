"""Nothing is kept from one frame to the next.

`benchmarks/memory.py` shows the same for the memory of the process, over ten thousand frames.
"""

import gc
import tracemalloc
from collections import Counter

import numpy as np
import pytest
import warp as wp

from inhand import EstimatorConfig, InputError, PoseEstimator
from inhand.synth.scene import Scene


def alive() -> Counter[str]:
    """How many objects there are of every kind of Warp's: what holds memory outside of Python's."""
    gc.collect()
    kinds = (wp.array, wp.Mesh, wp.Volume, wp.HashGrid, wp.Bvh)
    return Counter(type(o).__name__ for o in gc.get_objects() if isinstance(o, kinds))


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_frames_leave_nothing_behind(scenes: list[Scene], preset: str) -> None:
    config = EstimatorConfig.paper() if preset == "paper" else EstimatorConfig()
    scene, step = scenes[0], 5
    estimator = PoseEstimator(scene.hand, scene.obj, config, "cpu")
    camera, depth = scene.camera.subsampled(step), scene.depth[::step, ::step]
    found = 0

    def run(frames: int) -> None:
        nonlocal found
        for n in range(frames):
            noisy = depth + np.random.default_rng(n).normal(scale=0.001, size=depth.shape)
            estimate = estimator.estimate(
                np.maximum(noisy, 0) * (n % 4 > 0), camera, scene.T_camera_hand_given
            )
            found += estimate.found
            with pytest.raises(InputError):
                estimator.estimate(noisy, camera, np.zeros((4, 4)))

    run(24)  # so that every kernel that these frames need is loaded
    tracemalloc.start()
    try:
        run(4)
        before, traced = alive(), tracemalloc.get_traced_memory()[0]
        run(24)
        after, growth = alive(), tracemalloc.get_traced_memory()[0] - traced
    finally:
        tracemalloc.stop()
    assert found == 39
    assert after == before
    # One image kept a frame would be 24 times 48 kB.
    assert growth < depth.astype(np.float32).nbytes
