"""The newest minute of a hand can be looked at again, and only of the hand that is open."""

from __future__ import annotations

import numpy as np

from allegro_twin.surfaces.panel.page.page_state import SECONDS, FrameHistory
from allegro_twin.surfaces.panel.stream import StreamFrame


def frame(t: float, session: int = 1) -> StreamFrame:
    row = np.full(3, t)
    return StreamFrame(session, t, row, row, row, row, {}, "pd", False, 0, (), -1.0, False)


def filled(seconds: float, rate: float = 10.0) -> FrameHistory:
    history = FrameHistory()
    for k in range(round(seconds * rate) + 1):
        history.add(frame(k / rate))
    return history


def test_a_moment_so_long_ago_is_found_or_the_oldest() -> None:
    history = filled(10.0)
    found, oldest = history.at(2.5), history.at(99.0)
    assert found is not None
    assert oldest is not None
    assert (found.t, oldest.t) == (7.5, 0.0)
    assert FrameHistory().at(1.0) is None


def test_what_is_older_than_a_minute_is_forgotten() -> None:
    history = filled(SECONDS + 30.0)
    assert history.span == SECONDS
    assert abs(history.rate - 10.0) < 1e-9


def test_another_opening_of_the_hand_and_a_clock_that_begins_anew_forget_what_was() -> None:
    for later in (frame(11.0, session=2), frame(0.0)):
        history = filled(10.0)
        history.add(later)
        assert history.span == 0.0
        assert history.rate == 0.0


def test_curves_have_no_more_rows_than_asked_for_in_the_newest_seconds() -> None:
    t, position, target, torque = filled(30.0).rows(10.0, 50)
    assert len(t) <= 51
    assert t[0] == 20.0
    assert position.shape == target.shape == torque.shape == (len(t), 3)
    np.testing.assert_array_equal(position[:, 0], t)
