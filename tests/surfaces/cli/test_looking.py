"""A live hand in Rerun: the address of the page, or a window, and every sample in it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from allegro_twin.app import session
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.surfaces.cli.start.view import show_live


class Viewer:
    def __init__(self) -> None:
        self.did: list[Any] = []

    def serve(self) -> str:
        self.did.append("serve")
        return "http://127.0.0.1:9090/"

    def spawn(self) -> None:
        self.did.append("spawn")

    def draw(self, sample: object, beside: object) -> None:
        self.did.append(sample)


class Listened:
    """In the place of `Hand`."""

    def __init__(self) -> None:
        self.spec, self.listeners = load_spec(), list[Callable[[Any], None]]()

    def listen(self, listener: Callable[[Any], None]) -> None:
        self.listeners.append(listener)


@pytest.mark.parametrize("web", [True, False])
def test_a_live_hand_is_drawn_sample_by_sample(
    web: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    viewer, hand = Viewer(), Listened()
    monkeypatch.setattr(session, "rerun_stage", lambda: (lambda spec, live: viewer, None))
    show_live(hand, web=web)  # type: ignore[arg-type]
    hand.listeners[0]("a sample")
    assert viewer.did == ["serve" if web else "spawn", "a sample"]
    assert ("Open http://127.0.0.1:9090/" in capsys.readouterr().out) == web
