"""A hand that cannot be opened is let go of: its bus, its port and its keeper are free for the next try."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

import allegro_twin.app.rig
from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.errors import HandFault
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.hand.live_control import LiveControl
from allegro_twin.surfaces.panel.hand_session import Folders, HandSession

ERRORS = [HandFault("motor 3 is too hot"), ValueError("of a plugin"), KeyboardInterrupt("of a person")]
Open = Callable[[RunConfig], object]


def panel(config: RunConfig) -> HandSession:
    return HandSession(1, config, Folders(), lambda frame: None)


@pytest.fixture
def closed(monkeypatch: pytest.MonkeyPatch) -> list[SimBackend]:
    """The backends that were closed."""
    found: list[SimBackend] = []
    monkeypatch.setattr(SimBackend, "close", lambda sim: found.append(sim))  # A built-in method takes no self.
    return found


def failing(error: BaseException) -> Callable[..., Any]:
    def fails(*_: object, **__: object) -> Any:
        raise error

    return fails


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("open_", [Hand.open, panel])
def test_a_hand_whose_reset_fails_is_closed(
    open_: Open, error: BaseException, closed: list[SimBackend], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SimBackend, "reset", failing(error))
    with pytest.raises(type(error), match=str(error)):
        open_(load_config("sim_right"))
    assert closed


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("part", ["make_controller", "trial_of", "guarded"])
def test_a_hand_whose_config_cannot_be_assembled_is_closed(
    part: str, error: BaseException, closed: list[SimBackend], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(allegro_twin.app.rig, part, failing(error))
    with pytest.raises(type(error), match=str(error)):
        assemble(load_config("sim_right"))
    assert len(closed) == 1


def test_a_hand_without_the_gains_that_its_config_names_is_closed(
    closed: list[SimBackend], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("allegro_twin.surfaces.hand.facade.load_gains", failing(HandFault("no such gains")))
    with pytest.raises(HandFault, match="no such gains"):
        Hand.open(load_config("sim_right"))
    assert closed


def test_a_session_of_the_panel_that_fails_after_its_hand_runs_ends_the_loop(
    closed: list[SimBackend], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LiveControl, "prepare", failing(ValueError("of a plugin")))
    with pytest.raises(ValueError, match="of a plugin"):
        panel(load_config("sim_right"))
    assert closed
    assert not [thread for thread in threading.enumerate() if thread.name == "allegro_twin"]
