"""Makes the pictures of the viewer and of the labelling page, for docs/viewing.md and labelling.md.

    python benchmarks/page_pictures.py [FOLDER]     default: docs/figures

Needs a Chromium, and what the tests need (`make lint` installs it); the pages are driven as the
tests drive them. The scenes are fixed and the estimator repeatable, so the pictures only change
when the method or a page does.
"""

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from browser import PROGRAMS, ViserPage, chromium
from labelling_data import workbench
from viewed_scenes import SceneSource, analyst, demo

from inhand.annotation.page import LabellingPage
from inhand.annotation.session import Status
from inhand.synth.demo import regression_scenes
from inhand.viewer.browsing import Browsing
from inhand.viewer.page import Page
from inhand.viewer.server import address, serving
from inhand.viewer.session import Session

SIZE = (1500, 900)
"""Of the pictures [pixel]."""
IMAGES = (0, 1, 2, 4, 3, 5, 6, 7)
"""Scenes in the order in which the labelling page has them; the fifth is looked at."""
MARKS: tuple[Status, ...] = ("labelled", "skipped", "labelled", "labelled")
"""What the images before it are marked as."""
SHIFT, TURN = np.array([0.003, -0.002, -0.0035]), np.array([0.03, 0.05, 0.02])
"""Where the object is off the estimator's answer there: translation [m], rotation vector [rad]."""


def picture_viewer(browser: Any, path: Path) -> None:
    """The built-in scene at the last stage."""
    source = SceneSource({"built-in scene": demo()})
    with serving("inhand", port=0) as server:
        shown = Page(server, source.hand)
        Browsing(shown, Session(source, analyst())).start()
        tab = ViserPage(browser, address(server), SIZE)
        tab.wait_for_text("8 of 8: choice")
        tab.wait_until_still()
        tab.screenshot(str(path))
        tab.close()
        shown.stop()


def picture_labelling(browser: Any, path: Path) -> None:
    """An image amid others, with the object a little off."""
    with TemporaryDirectory() as folder, serving("inhand annotate", port=0) as server:
        scenes = regression_scenes()
        bench = workbench(Path(folder), [scenes[i] for i in IMAGES])
        for mark in MARKS:
            bench.mark(mark)
        bench.take_object("industrial_part")
        bench.propose()
        bench.nudge_object(TURN, SHIFT, "object moved")
        page = LabellingPage(server, bench)
        tab = ViserPage(browser, address(server), SIZE)
        tab.wait_for_text("its best answer is")
        tab.wait_until_still()
        tab.screenshot(str(path))
        tab.close()
        page.stop()


def main(folder: Path) -> int:
    """Make all pictures into `folder`; the exit code."""
    if not any(map(shutil.which, PROGRAMS)):
        print(f"there is no Chromium: looked for {', '.join(PROGRAMS)}", file=sys.stderr)
        return 2
    folder.mkdir(parents=True, exist_ok=True)
    with chromium() as browser:
        picture_viewer(browser, folder / "viewer.png")
        picture_labelling(browser, folder / "annotate.png")
    return 0


if __name__ == "__main__":
    default = Path(__file__).parents[1] / "docs" / "figures"
    raise SystemExit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else default))
