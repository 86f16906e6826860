"""A headless Chromium for tests of web pages made with viser; tests skip where there is none."""

import io
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    # WebGL on the CPU
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
SIZE = (1100, 700)
"""Of the page [pixel]; WebGL on the CPU draws larger ones slowly."""
ON_THE_CPU = """
const ask = WebGL2RenderingContext.prototype.getParameter;
WebGL2RenderingContext.prototype.getParameter = function (name) {
  return name === 0x9246 ? "a test" : ask.call(this, name);  // UNMASKED_RENDERER_WEBGL
};
"""
"""viser shows a note that WebGL runs on the CPU, unless it is told another name."""
FREE_COLUMNS = """() => {
  const free = [];
  for (let x = 0; x < innerWidth; x += 2)
    if (document.elementFromPoint(x, innerHeight / 2)?.tagName === "CANVAS") free.push(x);
  return free.length ? [Math.min(...free), Math.max(...free)] : null;
}"""
"""Where no panel hides the 3D view, half-way down; null while the page is being loaded."""
SQUARE = 10
"""Edge of the squares that pictures are compared by [pixel]."""
THREE_FRAMES = """() => new Promise(done => {
  let left = 4;
  const frame = () => --left ? requestAnimationFrame(frame) : done();
  frame();
})"""
PATIENCE = 90.0
"""How long anything may take [s]: with others on two cores, WebGL on the CPU is slow."""

Pixels = NDArray[np.uint8]


@contextmanager
def chromium() -> Iterator[Any]:
    """A headless Chromium, as a Playwright browser."""
    program = next((path for name in PROGRAMS if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip("there is no Chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=program, args=list(ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()


class ViserPage:
    """A page of a viser server in a browser tab of its own.

    Args:
        browser: as from `chromium`.
        address: of the page.
        size: width and height of the tab [pixel].
    """

    def __init__(self, browser: Any, address: str, size: tuple[int, int] = SIZE) -> None:
        self.tab = browser.new_page(viewport={"width": size[0], "height": size[1]})
        self.tab.set_default_timeout(1000 * PATIENCE)
        self.errors: list[str] = []
        """What went wrong in the page's scripts."""
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.add_init_script(ON_THE_CPU)
        self.tab.goto(address)
        self.tab.locator("canvas").first.wait_for()

    def close(self) -> None:
        """Close the tab."""
        self.tab.close()

    def screenshot(self, path: str | None = None) -> Pixels:
        """The page as it is now, shape (H, W, 3)."""
        return _decoded(self.tab.screenshot(path=path))

    def scene(self) -> Pixels:
        """The 3D view as it is now, without the panels beside it, shape (h, w, 3)."""
        left, right = self.tab.wait_for_function(FREE_COLUMNS).json_value()
        height = self.tab.viewport_size["height"]
        clip = {"x": left, "y": 0, "width": right - left, "height": height}
        return _decoded(self.tab.screenshot(clip=clip))

    def pictures(self) -> list[str]:
        """Sources of the images in the panels, from top to bottom: they change with the images."""
        shown = self.tab.locator("img[src^='blob:']").all()
        return [image.get_attribute("src") or "" for image in shown]

    def text(self) -> str:
        """All text in the panels."""
        return str(self.tab.locator("body").inner_text())

    def wait_for_text(self, text: str) -> None:
        """Wait until the page shows a text.

        Raises:
            AssertionError: it does not come.
        """
        self.wait_until(lambda: text in self.text(), f'"{text}" in the page')

    def wait_until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait for a condition.

        Raises:
            AssertionError: it does not come true in time.
        """
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"waited in vain for {what}; the page:\n{self.text()}"
            self.tab.wait_for_timeout(100)

    def wait_until_still(self) -> Pixels:
        """Wait until the 3D view changes no more, and return it, shape (h, w, 3).

        Raises:
            AssertionError: it does not come to rest.
        """
        seen = [self.scene()]

        def at_rest() -> bool:
            self.tab.evaluate(THREE_FRAMES)  # however long they take
            seen.append(self.scene())
            return np.array_equal(seen[-2], seen[-1])

        self.wait_until(at_rest, "the 3D view to come to rest")
        return seen[-1]

    def wait_for_change(self, before: Pixels, pixels: int = 300) -> Pixels:
        """Wait until the 3D view differs from what it was, and return it when it is at rest.

        Args:
            before: as from `scene`, shape (h, w, 3).
            pixels: how many must differ at least.

        Raises:
            AssertionError: it does not change.
        """
        self.wait_until(lambda: changed(before, self.scene()) >= pixels, "another 3D view")
        return self.wait_until_still()

    def slide(self, slider: str, share: float) -> None:
        """Move a slider to a share, 0 to 1, of its way, by its label.

        By mouse: the 3D view turns by the arrow keys, wherever they are pressed.
        """
        track = self._row(slider).locator(".mantine-Slider-trackContainer")
        box = track.bounding_box()
        track.click(position={"x": share * (box["width"] - 1), "y": box["height"] / 2})

    def enter(self, label: str, value: float | str) -> None:
        """Type a value into the field with a label; sliders have one too."""
        field = self._row(label).locator("input:visible").last
        field.fill(str(value))
        field.press("Enter")

    def value(self, label: str) -> str:
        """What the field with a label shows."""
        return str(self._row(label).locator("input:visible").last.input_value())

    def choose(self, dropdown: str, option: str) -> None:
        """Choose an option of a dropdown by its label."""
        self._row(dropdown).locator("input:visible").first.click()
        self.tab.get_by_role("option", name=option, exact=True).click()

    def tick(self, checkbox: str) -> None:
        """Tick a checkbox, or take the tick away, by its label."""
        self._row(checkbox).get_by_role("checkbox").click()

    def click(self, button: str) -> None:
        """Click a button by its text."""
        self.tab.get_by_role("button", name=button, exact=True).click()

    def _row(self, label: str) -> Any:
        """The label's row in a panel: the label and what it belongs to."""
        exact = self.tab.get_by_text(label, exact=True).and_(self.tab.locator("label"))
        return exact.locator("xpath=ancestor::div[contains(@class,'mantine-Flex-root')][1]")


def _decoded(png: bytes) -> Pixels:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def changed(before: Pixels, after: Pixels) -> int:
    """Number of pixels that differ visibly between two pictures of one size.

    Squares of pixels are compared by their mean: where drawing is slow, viser draws more coarsely,
    and no edge stays as it was.
    """
    difference = np.abs(_squares(before) - _squares(after)).max(axis=-1)
    return SQUARE**2 * int(np.count_nonzero(difference > 15))


def _squares(pixels: Pixels) -> NDArray[np.float64]:
    height, width = (size // SQUARE for size in pixels.shape[:2])
    whole = pixels[: height * SQUARE, : width * SQUARE].astype(float)
    return whole.reshape(height, SQUARE, width, SQUARE, 3).mean(axis=(1, 3))
