"""Data sets in BOP's scene-wise format, with one more file for the hand.

```
DATASET/
  camera.json                  intrinsics of the sensor
  models/                      see `datasets.bop_models`
  test_targets_bop19.json      images and objects to be found
  test/000001/                 one scene
    depth/000003.png           16 bit, in steps of `depth_scale` [mm]
    rgb/000003.png
    mask/000003_000000.png           whole silhouette of the object within the image
    mask_visib/000003_000000.png     visible part of it
    scene_camera.json          intrinsics and depth_scale by image; in a sequence, `time` [s]
    scene_gt.json              object poses [mm] by image
    scene_gt_info.json         boxes, pixel counts and visible share by image
    scene_hand.json            the hand: the file that BOP does not have
    segmentation/000003.png          what every pixel shows, by body
    object_depth/000003_000000.png   depth of the object as if there were nothing else
```

`scene_hand.json` holds, in metres and radians:

- `urdf`: the hand's URDF, relative to the scene's folder; `package_paths`: folders of its packages;
- `segmentation`: what the values of `segmentation/` mean: names of links, "background", "object";
- `images`: by image, `T_camera_hand` (true wrist pose), `T_camera_hand_given` (what an estimator is
  told), `joint_positions` of all movable joints, `T_camera_link` of every link of the URDF.

It, `segmentation/` and `object_depth/` are optional: any BOP data set with depth and ground truth
can be read. Pixel (u, v) is centred at integer coordinates.

What is here is the layout and what an image of it holds. `bop_scene` finds scenes and reads their
JSON files, `bop_images` reads images, `bop_frames` single objects in them; `bop_models` has the
objects' models, `bop_writer` writes all this, and `bop_results` answers for BOP's own tools.

Reading returns what was written: numbers to the last bit of a float64 (poses too: millimetres are
metres with the decimal point moved), depth in the steps of `depth_scale` (we write 0.1 mm).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera

Array = NDArray[np.float64]

DEPTH_UNIT = 1e-4
"""Metres per count of the depth images that are written: BOP's `depth_scale` of 0.1 mm."""
TARGETS = "test_targets_bop19.json"
SPLIT = "test"
"""Folder of the scenes that are written, and that the targets speak of."""

CAMERA = "scene_camera.json"
TRUTH = "scene_gt.json"
INFO = "scene_gt_info.json"
HAND = "scene_hand.json"
UNFINISHED = "unfinished"
"""Folder in a scene's that is still being written: the images' shares of the JSON files."""


@dataclass(frozen=True, eq=False)
class Instance:
    """One object in an image."""

    object_id: int
    """Number of its model."""
    T_camera_object: Array
    """Its pose, shape (4, 4)."""
    mask: NDArray[np.bool_] = field(repr=False)
    """Its silhouette in the image as if there were nothing else, shape (H, W)."""
    mask_visible: NDArray[np.bool_] = field(repr=False)
    """Where it is visible, shape (H, W)."""
    silhouette_pixels: int
    """Pixels of its silhouette, those outside the image included."""
    depth: NDArray[np.float32] | None = field(default=None, repr=False)
    """Its depth as if there were nothing else [m], shape (H, W); None if unknown."""

    @property
    def visible_share(self) -> float:
        """Visible share of the silhouette."""
        return float(np.count_nonzero(self.mask_visible) / max(self.silhouette_pixels, 1))


@dataclass(frozen=True, eq=False)
class HandTruth:
    """The hand in an image."""

    T_camera_hand: Array
    """True wrist pose, shape (4, 4)."""
    T_camera_hand_given: Array
    """The wrist pose that an estimator is given, shape (4, 4)."""
    joint_positions: dict[str, float]
    """True positions [rad, m] of all movable joints by name."""
    T_camera_link: dict[str, Array]
    """True poses, (4, 4), of all links by name."""


@dataclass(frozen=True, eq=False)
class BopImage:
    """One image of a scene and everything known about it."""

    camera: Camera
    """Intrinsics of the depth image; `depth_unit` is the step of its readings."""
    depth: NDArray[np.float32] = field(repr=False)
    """Depth z [m], shape (H, W), 0 where there is no reading."""
    instances: tuple[Instance, ...]
    """The annotated objects."""
    rgb: NDArray[np.uint8] | None = field(default=None, repr=False)
    """Colour image, shape (H, W, 3), if there is one."""
    hand: HandTruth | None = field(default=None, repr=False)
    """The hand, if there is one."""
    segmentation: NDArray[np.uint8] | None = field(default=None, repr=False)
    """What every pixel shows, shape (H, W): values as in `scene_hand.json`."""
    time: float | None = None
    """When it was taken [s], in a sequence."""


@dataclass(frozen=True)
class HandInfo:
    """What `scene_hand.json` says about all images of a scene."""

    urdf: Path
    """The hand's URDF."""
    segmentation: Mapping[int, str]
    """Names of links, "background" and "object" by the value of a segmentation image."""
    package_paths: Mapping[str, Path] = field(default_factory=dict)
    """Folders of the packages that the URDF names."""
