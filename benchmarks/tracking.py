"""Follows the sequences of a data set and measures what a tracker must do.

    inhand synth out/track --sequence --number 120 --sensor structured_light --backdrop 0.05 0.4 \
        --wrist-translation 0.004 --wrist-rotation 0.026 --distance 0.4 0.7 --seed 2
    python benchmarks/tracking.py out/track

Prints a line a sequence, then a table of the targets:

- update: time of the updates that followed the object; the search of a lost tracker is counted
  apart. Wall-clock time is only honest on an idle machine; CPU time adds up all threads.
- undetected loss: images in a row with an answer of a confidence of 0.5 or more whose ADI is above
  5 mm. A sequence's first image has no track; it is left out.
- recovery: images until a right answer (ADI < 5 mm), once a quarter of the object's silhouette has
  readings again after less than a tenth had.
- 95 % ellipsoid: followed answers whose true pose (the nearest of symmetric ones) lies in the
  ellipsoid of their covariance, of the object's centre alone and of all six dimensions, for an
  object that moved in the camera since the last image and for one that did not.
- sd of the centre: what the covariance says of it, per axis.
- within 1.96 sd, by direction: of the centre along and across the line of sight, of the turn about
  and across it. 95 % are expected.
- jitter: where the true pose stays for 12 images or more, the standard deviation of the object's
  centre, along each axis, and of its rotation, about each axis, past the stretch's first five
  images; root mean square over stretches and axes.
"""

import argparse
import itertools
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

import inhand
from inhand.datasets.bop import BopImage
from inhand.datasets.bop_images import read_image
from inhand.datasets.bop_models import load_model, model_name
from inhand.datasets.bop_scene import find_hand, find_scenes, read_scene
from inhand.evaluation.metrics import adi, sample_model
from inhand.evaluation.results import JOINT_PIXELS
from inhand.geometry.se3 import transform
from inhand.tracking.gaussian import about_origin, twist_between

RIGHT = 0.005
"""ADI below which an answer is right [m]."""
SURE = 0.5
"""Confidence from which on a wrong answer is an undetected one."""
SEEN, HIDDEN = 0.25, 0.1
"""Shares of the silhouette with readings from which on, and below which, the object is seen."""
ELLIPSOID = {3: 7.81, 6: 12.59}
"""Chi squared of 95 % by degrees of freedom."""
SPINS = 24
"""Turns about a continuous axis of symmetry that are looked through."""
STILL, SETTLING = 12, 5
"""Images of a stretch without motion, and those at its start that are left out."""


@dataclass(frozen=True, eq=False)
class Update:
    """One image of a sequence and the tracker's answer."""

    image: int
    time: float
    """Time stamp [s]."""
    seen: float
    """Share of the object's silhouette with readings."""
    truth: NDArray[np.float64]
    """True T_camera_object, shape (4, 4)."""
    moved: bool
    """Whether that is another than in the last image."""
    estimate: inhand.PoseEstimate
    error: float
    """ADI [m]; inf without an answer."""
    wrist: float
    """Distance of the wrist's origin from where it is [m]; nan if unknown."""
    apart: dict[int, float]
    """Squared distance from the truth in units of the covariance, by degrees of freedom: of the
    object's centre (3) and of its pose (6); empty without an answer."""
    sds: NDArray[np.float64]
    """What the covariance says of the object's centre [m]: sds along and across the line of sight;
    empty without an answer."""
    squares: NDArray[np.float64]
    """Squared errors over variances: of the centre along the line of sight and twice across it, and
    of the turns about these axes; empty without an answer."""
    joints: list[float]
    """Errors [rad] of the joints whose links show over `JOINT_PIXELS` pixels."""
    cpu: float
    """CPU time [s]."""
    wall: float
    """Wall-clock time [s]."""

    @property
    def right(self) -> bool:
        """Whether the answer is right."""
        return self.error < RIGHT

    @property
    def fooled(self) -> bool:
        """Whether the answer is wrong and says that it is sure."""
        return self.estimate.found and not self.right and self.estimate.confidence >= SURE

    @property
    def followed(self) -> bool:
        """Whether the answer came without a search."""
        return self.estimate.found and "wrist" not in self.estimate.timings


def follow(scene: Path, config: inhand.TrackerConfig | None = None) -> Iterator[Update]:
    """Follow one sequence, in the folder of a data set's scene."""
    models = scene.parents[1] / "models"
    images = sorted(read_scene(scene).truth)
    hand = inhand.Hand.from_urdf(find_hand(scene))
    name = model_name(models, read_image(scene, images[0]).instances[0].object_id)
    obj = load_model(models, name)
    tracker = inhand.PoseTracker(hand, obj, config, device="cpu")
    tree, before = KDTree(sample_model(obj.mesh)), None
    for i in images:
        image = read_image(scene, i)
        instance, hand_truth = image.instances[0], image.hand
        wall, cpu = time.perf_counter(), time.process_time()
        given = hand_truth.T_camera_hand_given
        e = tracker.update(image.depth, image.camera, given, time=image.time)
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        readings = np.count_nonzero(instance.mask_visible & (image.depth > 0))
        yield Update(
            image=i,
            time=image.time,
            seen=readings / max(instance.silhouette_pixels, 1),
            truth=instance.T_camera_object,
            moved=before is not None
            and not np.allclose(instance.T_camera_object, before, atol=1e-9),
            estimate=e,
            error=adi(tree, e.T_camera_object, instance.T_camera_object) if e.found else np.inf,
            wrist=wrist_distance(e, image.hand.T_camera_hand),
            **errors(e, instance.T_camera_object, obj),
            joints=joint_errors(e, image, hand) if e.joint_positions else [],
            cpu=cpu,
            wall=wall,
        )
        before = instance.T_camera_object


def errors(
    e: inhand.PoseEstimate, truth: NDArray[np.float64], obj: inhand.ObjectModel
) -> dict[str, Any]:
    """`apart`, `sds` and `squares` of an `Update` with the object's true pose, shape (4, 4)."""
    if not e.found:
        return {"apart": {}, "sds": np.empty(0), "squares": np.empty(0)}
    # From the frame's origin, of which the covariance speaks, to the object's centre.
    covariance = about_origin(e.covariance, e.T_camera_object, -obj.centre)
    equal = truth @ obj.symmetry.representatives(SPINS)
    twists = np.stack([twist_between(e.T_camera_object, T, obj.centre) for T in equal])
    squared = np.einsum("ni,ij,nj->n", twists, np.linalg.inv(covariance), twists)
    twist = twists[squared.argmin()]
    turn, place = covariance[:3, :3], covariance[3:, 3:]
    sight = transform(e.T_camera_object, obj.centre[None])[0]
    axes = np.linalg.svd(sight[None])[2].T  # the first is the line of sight
    variances, turned = (np.diag(axes.T @ block @ axes) for block in (place, turn))
    moved, turns = (axes.T @ twist[3:]) ** 2 / variances, (axes.T @ twist[:3]) ** 2 / turned
    return {
        "apart": {3: float(twist[3:] @ np.linalg.solve(place, twist[3:])), 6: float(squared.min())},
        "sds": np.sqrt([variances[0], variances[1:].mean()]),
        "squares": np.concatenate([moved, turns]),
    }


def wrist_distance(e: inhand.PoseEstimate, T_camera_hand: NDArray[np.float64]) -> float:
    """Distance of the estimated wrist's origin from the true one [m]."""
    if e.T_camera_hand is None:
        return np.nan
    return float(np.linalg.norm(e.T_camera_hand[:3, 3] - T_camera_hand[:3, 3]))


def joint_errors(e: inhand.PoseEstimate, image: BopImage, hand: inhand.Hand) -> list[float]:
    """Errors [rad] of the joints that carry a link which is well in view."""
    pixels = np.bincount(image.segmentation.ravel(), minlength=256)[1 : 1 + len(hand.links)]
    joints = hand.chain.link_joint[pixels > JOINT_PIXELS]
    names = {hand.joint_names[hand.chain.source[j]] for j in joints if j >= 0}
    return [abs(e.joint_positions[n] - image.hand.joint_positions[n]) for n in sorted(names)]


def longest_fooled(updates: list[Update]) -> list[int]:
    """Lengths of the undetected losses."""
    runs = itertools.groupby(updates[1:], key=lambda u: u.fooled)
    return [len(list(run)) for fooled, run in runs if fooled]


def recoveries(updates: list[Update]) -> list[float]:
    """Images until each recovery; inf for one that did not come while the object was seen."""
    found, waiting, count = [], False, 0
    for u in updates:
        if u.seen < HIDDEN:
            if waiting and count:
                found.append(np.inf)
            waiting, count = True, 0
        elif waiting and (count or u.seen >= SEEN):
            count += 1
            if u.right:
                found.append(float(count))
                waiting, count = False, 0
    return found + ([np.inf] if waiting and count else [])


def jitters(updates: list[Update], centre: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Variances over each stretch without motion: per axis, position [m^2] and rotation [rad^2]."""
    found = []
    steps = [0.0] + [float(np.abs(b.truth - a.truth).max()) for a, b in itertools.pairwise(updates)]
    number = np.cumsum(np.array(steps) > 1e-9)
    for k in np.unique(number):
        stretch = [u for u, n in zip(updates, number, strict=True) if n == k]
        settled = stretch[SETTLING:]
        if len(stretch) < STILL or not all(u.followed for u in settled):
            continue
        T = np.stack([u.estimate.T_camera_object for u in settled])
        places = np.stack([transform(pose, centre[None])[0] for pose in T])
        turns = Rotation.from_matrix(T[:, :3, :3])
        turns = (turns * turns.mean().inv()).as_rotvec()
        found.append((places.var(axis=0).mean(), turns.var(axis=0).mean()))
    return found


def main() -> int:
    """Follow all sequences and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+", help="data sets of sequences")
    parser.add_argument("--limit", type=int, help="sequences of each data set at most")
    args = parser.parse_args()
    everything, fooled, recovered, still = [], [], [], []
    for scene in [s for f in args.folders for s in find_scenes(f)[: args.limit]]:
        updates = list(follow(scene))
        everything += updates
        fooled += longest_fooled(updates)
        recovered += recoveries(updates)
        models = scene.parents[1] / "models"
        name = model_name(models, read_image(scene, 0).instances[0].object_id)
        still += jitters(updates, load_model(models, name).centre)
        print(f"{scene.parents[1].name}/{scene.name} {name:16s} {summary(updates)}", flush=True)
    print(table(everything, fooled, recovered, still))
    return 0


def summary(updates: list[Update]) -> str:
    """One line about a sequence."""
    seen = [u for u in updates if u.seen >= SEEN]
    found = [u for u in updates if u.estimate.found]
    errors = [1000 * u.error for u in found]
    return (
        f"{len(updates)} images, seen {len(seen)}, of these right {sum(u.right for u in seen)}; "
        f"found {len(found)}, wrong {sum(not u.right for u in found)}, sure and wrong "
        f"{sum(u.fooled for u in found)}; ADI {np.median(errors) if errors else np.nan:.2f} mm; "
        f"searches {sum('wrist' in u.estimate.timings for u in updates)}; "
        f"CPU {1000 * np.median([u.cpu for u in updates]):.1f} ms"
    )


def table(
    updates: list[Update],
    fooled: list[int],
    recovered: list[float],
    still: list[tuple[float, float]],
) -> str:
    """The targets, in Markdown."""
    cpu, wall = (
        np.array([getattr(u, kind) for u in updates if u.followed]) * 1000
        for kind in ("cpu", "wall")
    )
    search = [1000 * u.cpu for u in updates if not u.followed] or [np.nan]
    seen = [u for u in updates if u.seen >= SEEN]
    hidden = [u for u in updates if u.seen < 0.02]
    found = [u for u in updates if u.estimate.found]
    joints = [error for u in found for error in u.joints] or [np.nan]
    followed = [u for u in found if u.followed]
    moving, still_ones = ([u for u in followed if u.moved is moved] for moved in (True, False))
    place, turn = np.sqrt(np.mean(still, axis=0)) if still else (np.nan, np.nan)
    rows = [
        ("sequences, images", f"{sum(u.image == 0 for u in updates)}, {len(updates)}", ""),
        ("update, wall clock: median, 95 %", f"{_two(wall)} ms", "10 ms"),
        ("update, CPU: median, 95 %", f"{_two(cpu)} ms", ""),
        ("search of a lost tracker, CPU: median", f"{np.median(search):.1f} ms", ""),
        ("images with the object seen: right", _share([u.right for u in seen]), ""),
        ("object, ADI: median", f"{1000 * np.median([u.error for u in found]):.2f} mm", ""),
        ("wrist: median", f"{1000 * np.nanmedian([u.wrist for u in found]):.2f} mm", ""),
        ("joints in view: median", f"{np.degrees(np.median(joints)):.2f} degrees", ""),
        ("truth in the 95 % ellipsoid, moving: centre, pose", _ellipsoid(moving), "90 to 98 %"),
        ("still: centre, pose", _ellipsoid(still_ones), "90 to 98 %"),
        ("sd of the centre, median: along, across the line of sight", _sds(followed), ""),
        ("within 1.96 sd, moving: along, across; turn about, across", _within(moving), "95 %"),
        ("images with under 2 % seen: answered, wrongly", _hidden(hidden), ""),
        ("undetected losses: number, longest", f"{len(fooled)}, {max(fooled, default=0)}", "3"),
        ("recoveries within 2 images", _share([n <= 2 for n in recovered]), "all"),
        ("slowest recovery", f"{max(recovered, default=0):g} images", "2"),
        ("jitter, position (sd)", f"{1000 * place:.2f} mm ({len(still)} stretches)", "0.3 mm"),
        ("jitter, rotation (sd)", f"{np.degrees(turn):.2f} degrees", "0.3 degrees"),
    ]
    lines = ["| what | measured | target |", "|---|---|---|"]
    return "\n".join(lines + [f"| {' | '.join(row)} |" for row in rows])


def _two(values: NDArray[np.float64]) -> str:
    return f"{np.median(values):.1f}, {np.percentile(values, 95):.1f}"


def _share(right: list[bool]) -> str:
    return f"{sum(right)} of {len(right)}"


def _ellipsoid(updates: list[Update]) -> str:
    shares = [np.mean([u.apart[n] < ELLIPSOID[n] for u in updates] or [np.nan]) for n in (3, 6)]
    return f"{shares[0]:.1%}, {shares[1]:.1%} of {len(updates)}"


def _sds(updates: list[Update]) -> str:
    along, across = 1000 * np.median([u.sds for u in updates] or np.full((1, 2), np.nan), axis=0)
    return f"{along:.2f}, {across:.2f} mm"


def _within(updates: list[Update]) -> str:
    inside = np.mean([u.squares < 1.96**2 for u in updates] or np.full((1, 6), np.nan), axis=0)
    along, across, about, tilt = inside[0], inside[1:3].mean(), inside[3], inside[4:].mean()
    return f"{along:.1%}, {across:.1%}; {about:.1%}, {tilt:.1%}"


def _hidden(updates: list[Update]) -> str:
    answered = [u for u in updates if u.estimate.found]
    return f"{len(answered)}, {sum(not u.right for u in answered)} of {len(updates)}"


if __name__ == "__main__":
    sys.exit(main())
