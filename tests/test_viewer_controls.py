"""The slider through the poses of a stage, when a browser speaks of another stage still."""

from collections.abc import Iterator
from typing import Any

import pytest
from viewed_scenes import demo_analysis

from inhand.viewer.controls import StageControls
from inhand.viewer.server import serving
from inhand.viewer.stages import POSE_STAGES, STAGES

pytest.importorskip("viser")


@pytest.fixture
def gui() -> Iterator[Any]:
    with serving("test", port=0) as server:
        yield server.gui


def browser_sets(gui: Any, label: str, value: int) -> None:
    """As the message of a browser does: whatever the slider's range is by now."""
    for handle in gui._gui_input_handle_from_uuid.values():
        if handle.label == label:
            handle._impl.value = value


@pytest.mark.parametrize("stage", STAGES)
def test_the_rank_is_that_of_a_pose(gui: Any, stage: str) -> None:
    controls, analysis = StageControls(gui, lambda: None), demo_analysis()
    browser_sets(gui, "Stage", 1 + STAGES.index(stage))
    controls.show(analysis)
    assert controls.rank == 0
    browser_sets(gui, "Pose", 5000)
    poses = len(controls.stage.poses)
    assert poses > 1 or stage not in POSE_STAGES
    assert controls.rank == max(poses - 1, 0)
    controls.show(analysis)
    assert controls.rank == 0
