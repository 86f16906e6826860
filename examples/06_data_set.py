"""A data set: render images with ground truth, then measure the estimator on them.

The same as `inhand synth OUT` and `inhand bench OUT`, in code.
"""

from pathlib import Path

from inhand.baselines.registry import find_methods
from inhand.datasets.frames import find_frames, load_object, read_frame
from inhand.evaluation.benchmark import Benchmark
from inhand.evaluation.summary import summarise
from inhand.synth.dataset import finish, missing_images, start
from inhand.synth.plan import Plan, load_hand
from inhand.synth.scene import NOISY
from inhand.synth.workers import make_here

folder = Path("data-set")
plan = Plan(objects=("cuboid", "bottle"), colours=("blue",), number=2, protocol=NOISY)
start(folder, plan)  # models of hand and objects; a folder that holds this plan already goes on
for _ in make_here(folder, plan, missing_images(folder, plan), device="cpu"):
    print(".", end="", flush=True)
finish(folder, plan)

frame = read_frame(find_frames([folder])[0])
print("\nfirst frame:", frame.name, frame.depth.shape, f"{frame.truth.visible_share:.0%} visible")

(method,) = find_methods("inhand")  # or "paper", "fpfh-ransac+hs", ...
benchmark = Benchmark(
    load_hand(folder, plan), lambda name: load_object(folder / "models", name), method
)
results = [benchmark.score(path) for path in find_frames([folder])]
for result in results:
    error = "-" if result.adi is None else f"{1000 * result.adi:.2f} mm"
    print(f"{result.frame}: {result.outcome}, ADI {error}, lost at {result.lost_at or 'no stage'}")
recall = summarise(results)["recall"]["all"]["5 mm"]
print(f"ADI < 5 mm: {recall['share']:.0%} ({recall['low']:.0%} to {recall['high']:.0%})")
