"""The viewer's page in a real browser, headless: it loads, and what is moved changes the view."""

from collections.abc import Iterator
from typing import Any

import pytest
from browser import ViserPage, changed, chromium
from viewed_scenes import SceneSource, analyst, demo, demo_analysis, three_scenes, viewed

from inhand.viewer.browsing import Browsing
from inhand.viewer.live import LiveView
from inhand.viewer.page import Page
from inhand.viewer.server import address, serving
from inhand.viewer.session import Session

pytest.importorskip("viser")

STEP = 2
"""Every so-many-th pixel of the scenes is taken: WebGL on the CPU is slow with many points."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def server() -> Iterator[Any]:
    """The server of a page that shows three scenes."""
    with serving("inhand", port=0) as server:
        source = SceneSource(three_scenes(), STEP)
        page = Page(server, source.hand)
        Browsing(page, Session(source, analyst())).start()
        page.worker.wait()
        yield server
        page.stop()


@pytest.fixture
def page(browser: Any, server: Any) -> Iterator[ViserPage]:
    page = ViserPage(browser, address(server))
    yield page
    page.close()
    assert page.errors == []


def test_the_page_shows_the_answer_and_follows_its_controls(page: ViserPage) -> None:
    page.wait_for_text("8 of 8: choice")
    assert "found, confidence" in page.text()
    choice, pictures = page.wait_until_still(), page.pictures()
    page.slide("Stage", 3 / 7)
    page.wait_for_text("4 of 8: hand removed")
    page.wait_until(lambda: page.pictures() != pictures, "another picture")
    removed = page.wait_for_change(choice, pixels=3000)

    page.tick("Cloud")
    hidden = page.wait_for_change(removed, pixels=3000)
    page.tick("Cloud")
    page.wait_for_change(hidden, pixels=3000)
    page.slide("Stage", 1)
    page.wait_for_text("8 of 8: choice")
    page.wait_until(lambda: changed(choice, page.scene()) < 500, "the 3D view of the start")


def test_sliders_recompute_the_residual(page: ViserPage) -> None:
    page.wait_for_text("of 8: choice")
    page.tab.get_by_text("Try by hand").click()
    before, pictures, scene = page.text(), page.pictures(), page.wait_until_still()
    page.enter("x [mm]", 12)
    page.wait_until(lambda: page.pictures() != pictures, "another picture")
    page.wait_for_text("by the final score")
    assert numbers_of(page.text(), "object") != numbers_of(before, "object")
    page.wait_for_change(scene)
    page.click("Put back")
    page.wait_until(
        lambda: numbers_of(page.text(), "object") == numbers_of(before, "object"), "the old numbers"
    )


def numbers_of(text: str, body: str) -> str:
    """What the page says of the residual of a body."""
    return next(line for line in text.splitlines() if line.startswith(f"{body}:"))


def test_frames_filters_and_frames_that_cannot_be_read(page: ViserPage) -> None:
    page.wait_for_text("3 of 3 frames; 2 not estimated yet")
    page.click("next")
    page.wait_for_text("broken cannot be shown: the file is cut short")
    assert "of 8" not in page.text()
    empty = page.wait_until_still()
    middle = empty[len(empty) // 3 : 2 * len(empty) // 3]  # below the note that tells it
    assert middle.max() < 60
    page.click("next")
    page.wait_for_text("cylinder (cylinder)")
    page.wait_for_change(empty, pixels=3000)
    page.wait_for_text("3 of 3 frames")
    page.choose("Only", "not found")
    page.wait_for_text("1 of 3 frames")
    page.choose("Only", "failed")
    page.wait_for_text("1 of 3 frames")
    page.choose("Object", "industrial_part")
    page.wait_for_text("No frame is like that")
    page.choose("Only", "all")
    page.wait_for_text("1 of 3 frames")
    page.wait_for_text("part (industrial_part)")
    page.choose("Object", "all")
    page.wait_for_text("3 of 3 frames")


def test_a_browser_that_comes_back_finds_what_it_left(browser: Any, server: Any) -> None:
    page = ViserPage(browser, address(server))
    start = page.wait_until_still()
    page.slide("Stage", 2 / 7)
    page.wait_for_text("3 of 8: hand fit")
    page.tab.mouse.move(500, 350)
    page.tab.mouse.down()
    page.tab.mouse.move(620, 300, steps=4)
    page.tab.mouse.up()
    left = page.wait_for_change(start, pixels=20_000)
    page.close()
    again = ViserPage(browser, address(server))
    again.wait_for_text("3 of 8: hand fit")
    again.wait_until(lambda: changed(left, again.scene()) < 500, "the view that was left")
    again.slide("Stage", 1)
    again.wait_for_text("8 of 8: choice")
    again.close()


def test_a_live_view_shows_what_comes(browser: Any) -> None:
    scene = demo()
    estimate = demo_analysis().estimate
    with LiveView(scene.hand, scene.obj, port=0) as live:
        page = ViserPage(browser, live.address)
        for number in range(20):
            live.show(viewed(scene, f"frame {number}", STEP), estimate)
        page.wait_for_text("frame 19")
        assert "Stage" not in page.text().split("Stages")[1][:10]
        pictures = page.pictures()
        live.show(
            viewed(scene, "empty", STEP), type(estimate)(False, "it is dark", None, {}, None, 0.0)
        )
        page.wait_for_text("no answer: it is dark")
        page.wait_until(lambda: page.pictures() != pictures, "another picture")
        page.close()


def test_an_image_of_a_live_view_is_held_and_looked_into(browser: Any) -> None:
    """While others come, one image stays with all its controls."""
    scene, analysis = demo(), demo_analysis()
    with LiveView(scene.hand, scene.obj, port=0) as live:
        page = ViserPage(browser, live.address)
        live.show(viewed(scene, "first", STEP), analysis.estimate, analysis.results)
        page.wait_for_text("first (industrial_part)")
        page.tick("Hold this image")
        live.show(lambda: viewed(scene, "second", STEP), analysis.estimate, analysis.results)
        page.slide("Stage", 4 / 7)
        page.wait_for_text("5 of 8: hypotheses")
        page.tab.get_by_text("Try by hand").click()
        page.enter("x [mm]", 12)
        page.wait_for_text("by the final score")
        assert "first (industrial_part)" in page.text()
        live.say("**The run has ended**: 2 processed")
        page.wait_for_text("The run has ended: 2 processed")
        page.tick("Hold this image")
        page.wait_for_text("second (industrial_part)")
        assert "5 of 8: hypotheses" in page.text()
        page.close()
    assert page.errors == []
