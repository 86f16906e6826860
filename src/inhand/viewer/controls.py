"""The controls of a page that choose what is shown."""

from collections.abc import Callable
from typing import Any, Literal, get_args

from inhand.viewer.analysis import Analysis
from inhand.viewer.stages import STAGES, StageView

CloudKind = Literal["by stage", "as the camera sees it", "by residual"]
LAYERS = ("Cloud", "Hand", "Object", "All poses", "True object", "True hand", "Camera")
"""What can be shown or hidden."""
OF_TRUTH = ("True object", "True hand")
HIDDEN = ("True hand", "Camera")
"""What is hidden at first."""


def on_user(handle: Any, react: Callable[[], None]) -> None:
    """Call `react` when a user changes a value, but not when the program does."""
    handle.on_update(lambda event: react() if event.client_id is not None else None)


class StageControls:
    """The slider through the stages, and the one through the poses of a stage.

    Args:
        gui: `server.gui` of viser.
        changed: called when the user moved one.
    """

    def __init__(self, gui: Any, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._stages: tuple[StageView, ...] = ()
        with gui.add_folder("Stages"):
            last = len(STAGES)
            self._stage = gui.add_slider("Stage", min=1, max=last, step=1, initial_value=last)
            self._text = gui.add_markdown("")
            self._rank = gui.add_slider("Pose", min=1, max=1, step=1, initial_value=1)
            self._about = gui.add_markdown("")
        on_user(self._stage, self._stage_chosen)
        on_user(self._rank, changed)

    def show(self, analysis: Analysis) -> None:
        """Offer the stages of a frame; the one that was looked at stays chosen."""
        self._stages = analysis.stages
        self._stage.visible = len(self._stages) > 1
        self._offer_poses()

    def clear(self) -> None:
        """Offer nothing: there is no frame."""
        self._stages = ()
        self._text.content = self._about.content = ""
        self._rank.visible = False

    def turn(self, step: int) -> None:
        """Go on by some stages, as far as there are any."""
        if len(self._stages) < 2:
            return
        self._stage.value = min(max(self._stage.value + step, 1), len(STAGES))
        self._stage_chosen()

    @property
    def stage(self) -> StageView:
        """The stage that is chosen."""
        return self._stages[-1] if len(self._stages) == 1 else self._stages[self._stage.value - 1]

    @property
    def rank(self) -> int:
        """Rank of the chosen pose, from 0.

        Never beyond the last pose: a browser may still speak of the stage before.
        """
        return min(int(self._rank.value), max(len(self.stage.poses), 1)) - 1

    def describe_pose(self, text: str) -> None:
        """Say something about the chosen pose, in Markdown."""
        self._about.content = text

    def _stage_chosen(self) -> None:
        if self._stages:  # the first frame is there
            self._offer_poses()
            self._changed()

    def _offer_poses(self) -> None:
        stage = self.stage
        number = f"{STAGES.index(stage.name) + 1} of {len(STAGES)}: "
        title = "" if len(self._stages) == 1 else number
        self._text.content = f"**{title}{stage.name}**\n\n{stage.text}"
        self._rank.value = 1
        self._rank.max = max(len(stage.poses), 1)
        self._rank.visible = len(stage.poses) > 1


class LayerControls:
    """What is drawn, and how the cloud is coloured.

    Args:
        gui: `server.gui` of viser.
        changed: called when the user changed something.
    """

    def __init__(self, gui: Any, changed: Callable[[], None]) -> None:
        with gui.add_folder("Show"):
            kinds = get_args(CloudKind)
            self._cloud = gui.add_dropdown("Colours", kinds, initial_value=kinds[0])
            self._boxes = {name: gui.add_checkbox(name, name not in HIDDEN) for name in LAYERS}
        for handle in (self._cloud, *self._boxes.values()):
            on_user(handle, changed)

    def offer(self, analysis: Analysis) -> None:
        """Offer what there is of a frame: without ground truth, nothing of that."""
        for name in OF_TRUTH:
            self._boxes[name].visible = analysis.truth is not None

    @property
    def cloud(self) -> CloudKind:
        """How the cloud is coloured."""
        kind: CloudKind = self._cloud.value
        return kind

    def shows(self, layer: str) -> bool:
        """Whether one of `LAYERS` is to be seen."""
        return bool(self._boxes[layer].value)


def candidate_table(analysis: Analysis) -> str:
    """The ranked candidates with their scores, as a table in Markdown."""
    stage = analysis.stages[-1]
    if not len(stage.poses):
        return "none"
    truth = analysis.truth is not None
    lines = ["| rank | score |" + (" ADI |" if truth else ""), "|---|---|" + "---|" * truth]
    for rank, (T, score) in enumerate(zip(stage.poses, stage.scores, strict=True), start=1):
        adi = analysis.adi(T)
        off = "" if adi is None else f" {1000 * adi:.1f} mm |"
        lines.append(f"| {rank} | {score:.3f} |{off}")
    return "\n".join(lines)
