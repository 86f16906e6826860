"""What can be said of GPUs where there is none: the kernels compile, and rely on no CPU's ways."""

import importlib
import random
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from held_object import held_object
from numpy.typing import NDArray
from test_second_look import finger_as_segment, left_by_the_object, missed_finger
from test_tracker import MOVING, Film

import inhand
from inhand import EstimatorConfig, PoseEstimate, PoseEstimator
from inhand.kernels import launch as seam
from inhand.stages.second_look import hands_in_segment
from inhand.synth.demo import demo_scene
from inhand.synth.scene import Scene

PACKAGE = Path(inhand.__file__).parent
HOPPER = 90
"""Compute capability of an H100."""

KERNEL_MODULES = [
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
    for path in sorted(PACKAGE.rglob("*.py"))
    if re.search("^@wp.kernel", path.read_text(), re.MULTILINE)
]


@pytest.mark.parametrize("name", KERNEL_MODULES)
def test_kernels_compile_for_a_gpu(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if HOPPER not in wp.get_cuda_supported_archs():
        pytest.skip("this build of Warp has no compiler for this GPU")
    module = importlib.import_module(name)
    monkeypatch.setitem(wp.get_module(name).options, "block_dim", seam.GPU_BLOCK)
    wp.compile_aot_module(module, arch=HOPPER, module_dir=tmp_path, use_ptx=True)
    (ptx,) = tmp_path.glob("*.ptx")
    kernels = [value for value in vars(module).values() if isinstance(value, wp.Kernel)]
    entries = re.findall(r"\.entry (\w+)", ptx.read_text())
    own = [kernel for kernel in kernels if kernel.module.name == name]
    assert len(own) > 0
    for kernel in own:
        assert any(entry.startswith(kernel.key) for entry in entries), kernel.key


@pytest.fixture
def as_on_a_gpu(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Work items run in any order and arrays share no memory with NumPy's; the numbers of slices
    that launches are cut into."""
    chance = random.Random(0)
    slices: list[int] = []

    def run(parts: list[seam.Slice], _threads: int, _inputs: Sequence[Any]) -> None:
        slices.append(len(parts))
        for part in chance.sample(parts, len(parts)):
            part()

    create: Callable[..., None] = wp.array.__init__
    read: Callable[[Any], NDArray[Any]] = wp.array.numpy

    def create_apart(array: Any, data: Any = None, *args: Any, **options: Any) -> None:
        create(array, np.array(data) if isinstance(data, np.ndarray) else data, *args, **options)

    monkeypatch.setattr(wp.array, "__init__", create_apart)
    monkeypatch.setattr(wp.array, "numpy", lambda array: read(array).copy())
    monkeypatch.setattr(seam, "_takes_numpy", lambda _device: False)
    monkeypatch.setattr(seam, "_run", run)
    monkeypatch.setattr(seam, "HANDOVER_OPERATIONS", 1)
    monkeypatch.setattr(seam, "cpu_count", lambda: 23)
    return slices


@pytest.fixture
def in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Work items are shared by blocks of threads, which run one after the other until they wait for
    each other."""
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    monkeypatch.setattr(seam, "CPU_BLOCK", 16)
    monkeypatch.setattr(seam, "cpu_count", lambda: 1)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return demo_scene()


def estimate(scene: Scene, config: EstimatorConfig) -> PoseEstimate:
    estimator = PoseEstimator(scene.hand, scene.obj, config, "cpu")
    return estimator.estimate(scene.depth, scene.camera, scene.T_camera_hand_given)


@pytest.fixture(scope="module", params=["default", "paper"])
def config(request: pytest.FixtureRequest) -> EstimatorConfig:
    return EstimatorConfig() if request.param == "default" else EstimatorConfig.paper()


@pytest.fixture(scope="module")
def expected(scene: Scene, config: EstimatorConfig) -> PoseEstimate:
    return estimate(scene, config)


def test_estimates_rely_on_no_order_of_work_items_and_no_shared_memory(
    scene: Scene, config: EstimatorConfig, expected: PoseEstimate, as_on_a_gpu: list[int]
) -> None:
    found = estimate(scene, config)
    assert len(as_on_a_gpu) > 20
    assert max(as_on_a_gpu) == 23 * seam.SLICES_PER_THREAD
    assert found.found
    assert found.confidence == expected.confidence
    assert found.joint_positions == expected.joint_positions
    np.testing.assert_array_equal(found.T_camera_hand, expected.T_camera_hand)
    assert len(found.candidates) == len(expected.candidates)
    for one, other in zip(found.candidates, expected.candidates, strict=True):
        np.testing.assert_array_equal(one.T_camera_object, other.T_camera_object)


def test_threads_of_a_block_share_work_items(
    scene: Scene, config: EstimatorConfig, expected: PoseEstimate, in_blocks: None
) -> None:
    found = estimate(scene, config)
    assert found.found
    assert found.confidence == pytest.approx(expected.confidence, abs=0.001)
    assert found.joint_positions == pytest.approx(expected.joint_positions, abs=1e-4)
    assert found.T_camera_hand == pytest.approx(expected.T_camera_hand, abs=1e-5)
    assert found.T_camera_object == pytest.approx(expected.T_camera_object, abs=1e-4)


def test_threads_of_a_block_share_a_track(request: pytest.FixtureRequest) -> None:
    # With seed 1 a finger has a sample so near the edge of a pixel that rounding decides.
    film = Film("can", MOVING, 3, seed=2)
    alone = film.tracker()
    expected = [film.show(alone, i) for i in range(3)]
    request.getfixturevalue("in_blocks")
    together = film.tracker()
    for i, e in enumerate(expected):
        found = film.show(together, i)
        assert e.found
        assert found.found
        assert found.T_camera_object == pytest.approx(e.T_camera_object, abs=1e-4)
        assert found.joint_positions == pytest.approx(e.joint_positions, abs=1e-4)


def test_threads_of_a_block_share_a_second_look(request: pytest.FixtureRequest) -> None:
    scene = held_object("industrial_part")
    seen = scene.observation, missed_finger(scene), finger_as_segment(scene), scene.hand
    (expected,) = hands_in_segment(*seen, EstimatorConfig())
    missed = left_by_the_object(scene, *seen[1:3])
    assert missed is not None
    request.getfixturevalue("in_blocks")
    (found,) = hands_in_segment(*seen, EstimatorConfig())
    np.testing.assert_allclose(found.joint_vector, expected.joint_vector, atol=1e-4)
    found_again = left_by_the_object(scene, *seen[1:3])
    assert found_again is not None
    np.testing.assert_allclose(found_again.joint_vector, missed.joint_vector, atol=1e-4)
