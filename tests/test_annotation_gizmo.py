"""The handle in the 3D view, without a browser: what drags tell, and who lets go of it."""

import asyncio
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from inhand.annotation.gizmo import Gizmo
from inhand.geometry.se3 import exp
from inhand.viewer.drawing import View, move
from inhand.viewer.server import serving

pytest.importorskip("viser")

HERE, THERE, HAND = (
    exp(np.array(pose))
    for pose in ([0.1, 0, 0, 0, 0, 0.5], [0, 0.2, 0, 0.1, 0, 0.5], [0, 0, 0, 0, 0.1, 0.4])
)


class Page:
    """A server with a handle, and what its drags and browsers that leave set off."""

    def __init__(self, server: Any) -> None:
        self.begins: list[bool] = []
        self.leave: Callable[[Any], None]
        server.on_client_disconnect = self._on_disconnect
        View(server)
        self.gizmo = Gizmo(server, self.begins.append)
        self.node = server.scene.get_handle_by_name("/camera/gizmo")

    def drag(self, phase: str, pose: np.ndarray) -> None:
        move(self.node, pose)
        asyncio.run(self.gizmo._on_drag(SimpleNamespace(phase=phase)))

    def _on_disconnect(self, react: Callable[[Any], None]) -> None:
        self.leave = react


@pytest.fixture
def page() -> Iterator[Page]:
    with serving("test", port=0) as server:
        yield Page(server)


def test_the_handle_follows_the_object_but_not_while_it_is_dragged(page: Page) -> None:
    page.gizmo.show(HERE, HAND)
    np.testing.assert_allclose(page.gizmo.pose, HERE, atol=1e-9)
    assert not page.gizmo.has_moved
    page.drag("start", THERE)
    page.gizmo.show(HERE, HAND)  # the label lags behind the pointer
    np.testing.assert_allclose(page.gizmo.pose, THERE, atol=1e-9)
    page.drag("end", THERE)
    assert page.begins == [True, False]
    page.gizmo.show(HERE, HAND)
    np.testing.assert_allclose(page.gizmo.pose, HERE, atol=1e-9)


def test_a_browser_that_leaves_in_a_drag_lets_go_of_it(page: Page) -> None:
    page.gizmo.show(HERE, HAND)
    page.drag("start", THERE)
    page.gizmo.show(THERE, HAND)
    page.leave(None)
    page.gizmo.show(HERE, HAND)
    np.testing.assert_allclose(page.gizmo.pose, HERE, atol=1e-9)
