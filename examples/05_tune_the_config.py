"""Tune the configuration: change what you must, and measure what it does.

Every parameter is documented in `inhand.config`. Here the wrist is known worse than the default
expects: it is given 30 mm and 12 degrees off.
"""

from dataclasses import replace
from time import process_time

import numpy as np

import inhand
from inhand.config import WristConfig
from inhand.evaluation.metrics import ObjectMetric
from inhand.geometry import se3
from inhand.synth.demo import regression_scenes

# How far the given wrist may be off, and how far around it and how often to look for it.
rough_wrist = WristConfig(
    prior_sd_translation=0.010,  # [m]
    prior_sd_rotation=0.06,  # [rad]
    search_sd_translation=0.012,
    search_sd_rotation=0.08,
    samples=512,
    starts=9,
)
default = inhand.EstimatorConfig()
configurations = {"default": default, "rough wrist": replace(default, wrist=rough_wrist)}

turn = se3.exp(np.array([0.0, np.radians(12), 0.0, 0.02, 0.02, 0.01]))
scenes = regression_scenes()
for name, config in configurations.items():
    solved, seconds = 0, 0.0
    for scene in scenes:
        estimator = inhand.PoseEstimator(scene.hand, scene.obj, config)
        start = process_time()
        e = estimator.estimate(scene.depth, scene.camera, scene.T_camera_hand @ turn)
        seconds += process_time() - start
        if e.found:
            adi = ObjectMetric(scene.obj).adi(e.T_camera_object, scene.T_camera_object)
            solved += adi < 0.005  # [m]
    time = 1000 * seconds / len(scenes)
    print(f"{name}: {solved} of {len(scenes)} solved, {time:.0f} ms of CPU time an image")

# A value that makes no sense is refused where it is given.
try:
    WristConfig(prior_sd_translation=-1)
except inhand.InputError as error:
    print("InputError:", error)
