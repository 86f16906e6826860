"""Moving hand and object by sliders, and what is then drawn."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from inhand.geometry.se3 import exp, inverse, transform
from inhand.overlay import Placement
from inhand.synth.demo import builtin_hand
from inhand.viewer.adjusting import AdjustControls, moved
from inhand.viewer.server import serving

pytest.importorskip("viser")

number = st.floats(-2, 2)
triples = st.tuples(number, number, number).map(np.array)


@given(triples, triples, triples, triples, triples)
def test_a_body_turns_about_its_point_and_shifts(
    w: np.ndarray, t: np.ndarray, shift: np.ndarray, turn: np.ndarray, centre: np.ndarray
) -> None:
    T = exp(np.concatenate([w, t]))
    after = moved(T, shift, turn, centre)
    np.testing.assert_allclose(
        transform(after, centre[None]), transform(T, centre[None]) + shift, atol=1e-9
    )
    np.testing.assert_allclose(
        after[:3, :3], Rotation.from_rotvec(turn).as_matrix() @ T[:3, :3], atol=1e-9
    )
    np.testing.assert_allclose(inverse(after) @ after, np.eye(4), atol=1e-9)


class Controls:
    """The controls with their handles by label, moved as a user moves them."""

    def __init__(self, server: Any) -> None:
        self.changes = 0
        before = set(server.gui._gui_input_handle_from_uuid)
        self.adjust = AdjustControls(server.gui, builtin_hand(), self._changed)
        handles = server.gui._gui_input_handle_from_uuid
        self._handles = [h for uuid, h in handles.items() if uuid not in before]

    def _changed(self) -> None:
        self.changes += 1

    def user_sets(self, label: str, value: float, which: int = 0) -> None:
        """As the message of a browser does: the value, then the callbacks with its number."""
        handle = [h for h in self._handles if h.label == label][which]
        handle._impl.value = value
        for callback in handle._impl.update_cb:
            callback(type("Event", (), {"client_id": 1})())


@pytest.fixture
def controls() -> Iterator[Controls]:
    with serving("test", port=0) as server:
        yield Controls(server)


@pytest.fixture
def base() -> Placement:
    hand = builtin_hand()
    T_hand, T_object = exp(np.array([0.1, 0.2, 0.3, 0, 0, 0.5])), exp(np.full(6, 0.3))
    return Placement(T_hand, 0.6 * hand.lower + 0.4 * hand.upper, T_object)


def test_untouched_sliders_change_nothing_at_all(controls: Controls, base: Placement) -> None:
    controls.adjust.start_from(base, np.zeros(3))
    assert controls.adjust.placement() is base
    assert controls.changes == 0


def test_sliders_move_what_they_name(controls: Controls, base: Placement) -> None:
    centre = np.array([0.01, 0.02, 0.03])
    controls.adjust.start_from(base, centre)
    name = builtin_hand().joint_names[1]
    controls.user_sets("x [mm]", 5.0)
    controls.user_sets("turn z [°]", 30.0)
    controls.user_sets(f"{name} [°]", 40.0)
    controls.user_sets("y [mm]", -2.0, which=1)  # the wrist's
    after = controls.adjust.placement()
    assert controls.changes == 4
    assert base.T_camera_object is not None
    assert base.T_camera_hand is not None
    assert after.T_camera_object is not None
    assert after.T_camera_hand is not None
    assert after.joint_vector is not None
    expected = moved(
        base.T_camera_object, np.array([0.005, 0, 0]), np.array([0, 0, np.radians(30)]), centre
    )
    np.testing.assert_allclose(after.T_camera_object, expected, atol=1e-12)
    T_hand = base.T_camera_hand.copy()
    T_hand[1, 3] -= 0.002
    np.testing.assert_allclose(after.T_camera_hand, T_hand, atol=1e-12)
    q = np.array(base.joint_vector)
    q[1] = np.radians(40)
    np.testing.assert_allclose(after.joint_vector, q, atol=1e-9)


def test_starting_anew_forgets_what_was_moved(controls: Controls, base: Placement) -> None:
    controls.adjust.start_from(base, np.zeros(3))
    controls.user_sets("x [mm]", 5.0)
    assert controls.adjust.placement() is not base
    controls.adjust.start_from(base, np.zeros(3))
    assert controls.adjust.placement() is base


def test_what_has_no_place_cannot_be_moved(controls: Controls) -> None:
    nothing = Placement()
    controls.adjust.start_from(nothing, np.zeros(3))
    assert all(h.disabled for h in controls._handles if "[" in h.label)
    controls.user_sets("x [mm]", 5.0)
    after = controls.adjust.placement()
    assert after.T_camera_object is None
    assert after.T_camera_hand is None
