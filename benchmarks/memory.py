"""Runs many small frames in one process and shows what becomes of its memory.

    python benchmarks/memory.py --frames 10000

The frames are the project's fixed scenes at an eighth of their size, every one with errors of its
own, so that images, segments and numbers of poses differ from frame to frame as they do in use;
every tenth has no answer, and every hundredth is bad input. The configuration draws fewer samples
than the default one, which runs the same code, so that ten thousand frames take minutes.

Prints the memory that the process holds (RSS) a tenth of the way at a time. Fails when it grows by
more than `LIMIT` after the first tenth: a leak of 2 kB a frame would do that.
"""

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from inhand import EstimatorConfig, InputError, PoseEstimator
from inhand.config import (
    ClusteringConfig,
    FirstLookConfig,
    HandStateConfig,
    HypothesesConfig,
    RefinementConfig,
)
from inhand.synth.demo import regression_scenes

LIMIT = 16 * 2**20
"""Growth of the memory that is put down to the allocator [byte]."""
STEP = 8
"""Every so-many-th pixel of the scenes is used."""

SMALL = replace(
    EstimatorConfig(),
    hand_state=HandStateConfig(samples=64, coarse_points=16, fine_points=32, local_samples=8),
    hypotheses=HypothesesConfig(pairs=80, matches=8),
    clustering=ClusteringConfig(keep=10),
    refinement=RefinementConfig(iterations=3, keep=10),
    first_look=FirstLookConfig(pairs=20, clusters=5, refined=5),
)
"""The default method with less of everything."""


def resident_memory() -> int:
    """Memory that this process holds [byte]; Linux only."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def main() -> int:
    """Run the frames; the exit code says whether the memory stayed flat."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=10_000)
    frames = parser.parse_args().frames
    scenes = regression_scenes()
    estimators = [PoseEstimator(s.hand, s.obj, SMALL, "cpu") for s in scenes]
    rng = np.random.default_rng(0)
    found, early, started = 0, 0, time.perf_counter()
    for n in range(frames):
        scene, estimator = scenes[n % len(scenes)], estimators[n % len(scenes)]
        depth = scene.depth[::STEP, ::STEP] + rng.normal(scale=0.001, size=(60, 80))
        depth[rng.random(depth.shape) < rng.uniform(0, 0.3)] = 0
        depth = np.maximum(depth, 0) * (0 if n % 10 == 9 else 1)
        T = scene.T_camera_hand_given * (np.nan if n % 100 == 98 else 1)
        try:
            found += estimator.estimate(depth, scene.camera.subsampled(STEP), T).found
        except InputError:
            assert n % 100 == 98
        if (n + 1) % (frames // 10) == 0:
            memory = resident_memory()
            early = early or memory
            seconds = time.perf_counter() - started
            print(
                f"{n + 1:6d} frames, {found:5d} found, {memory / 2**20:7.1f} MiB, {seconds:5.0f} s"
            )
    growth = resident_memory() - early
    print(f"growth after the first tenth: {growth / 2**20:.1f} MiB")
    return int(growth > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
