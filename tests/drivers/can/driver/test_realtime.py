"""Real-time scheduling is asked for, and what happens where the kernel does not allow it."""

from __future__ import annotations

import os

import pytest

from allegro_twin.drivers.can.driver import realtime
from allegro_twin.errors import ConfigError


def refused(*given: object) -> None:
    raise PermissionError(1, "Operation not permitted")


def test_it_is_asked_for_only_when_it_is_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[object, ...]] = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda *given: asked.append(given))
    realtime.ask(False)
    assert asked == []
    realtime.ask("try")
    realtime.ask(True)
    assert [(pid, policy, param.sched_priority) for pid, policy, param in asked] == [(0, os.SCHED_FIFO, 20)] * 2  # type: ignore[attr-defined]


def test_a_short_slice_is_asked_for_and_no_other_way_of_scheduling() -> None:
    before = os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)
    assert realtime.ask_short_slice() in (True, False)  # As old as the kernel is.
    assert (os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)) == before


def test_where_it_is_not_allowed_it_is_an_error_or_when_only_tried_a_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", refused)
    with pytest.raises(ConfigError, match="no real-time scheduling here .*not permitted.*or set `realtime: false`"):
        realtime.ask(True)
    assert not caplog.records
    realtime.ask("try")
    assert "a busy computer will miss periods" in caplog.text
