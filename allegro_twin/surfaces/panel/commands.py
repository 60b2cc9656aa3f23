"""From a wish to the hand: one call of the facade each."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import assert_never

from allegro_twin.control.demonstration import TaughtMotion
from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.entries import posture_entry, trajectory_entry
from allegro_twin.hands.library.library import Library
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.hand.demonstration import Demonstration
from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.session import OpenHand


class Doing:
    """Does what is wished with one opening of a hand. `recordings` is the folder for them, `library` the user's file
    for what was taught."""

    def __init__(self, opened: OpenHand, recordings: Path, library: Path) -> None:
        self._opened, self._hand = opened, opened.hand
        self._recordings, self._library = recordings, library
        self._teaching, self._shown = ExitStack(), Demonstration(opened.hand.spec)

    @property
    def spec(self) -> HandSpec:
        return self._hand.spec

    def __call__(self, wish: w.Wish) -> str:
        """What to say of it; empty: nothing. Raises HandError, and the hand goes on with what it did."""
        hand = self._hand
        if self._opened.teaching and isinstance(wish, (w.Joints, w.Posture, w.Grasp, w.Repeat, w.Control)):
            self._teach(False)
        match wish:
            case w.Joints(position):
                hand.direct.steer(position)
            case w.Posture(name):
                hand.move_to(name, wait=False)
            case w.Grasp(name):
                hand.grasp(name, wait=False)
            case w.Control(kind):
                hand.set_controller(next((k for k in hand.controllers if k == kind), kind))  # type: ignore[arg-type]  # Checked there.
            case w.Gravity(vector):
                hand.gravity = vector
            case w.UseGains(name):
                hand.direct.use_gains(name)
                return f"gains {name} from the next wish on"
            case w.Hold():
                hand.stop()
            case w.Stop():
                hand.direct.limp()
            case w.Release():
                hand.direct.release()
                return "the stop is released; the hand is limp until the next wish"
            case w.Gone():
                hand.direct.stay()
            case w.Teach(on):
                return self._teach(on)
            case w.Repeat():
                hand.play(self._motion(), wait=False)
            case w.Keep(name, motion):
                return self._keep(name, motion=motion)
            case w.Record(on):
                return self._record(on)
            case w.Scene() | w.Again():
                raise ConfigError("an open hand cannot be opened by itself")
            case _:
                assert_never(wish)
        return ""

    def _teach(self, on: bool) -> str:
        self._opened.teaching = False
        self._teaching.close()
        if not on:
            return "shown: repeat it, or store it"
        self._shown = self._teaching.enter_context(self._hand.teach())
        self._opened.teaching = True
        return "lead the fingers now"

    def _motion(self) -> TaughtMotion:
        if self._opened.teaching:
            self._teach(False)
        return self._shown.motion()

    def _keep(self, name: str, *, motion: bool) -> str:
        library, spec = Library(), self._hand.spec
        if motion:
            shown = self._motion()
            library.add(name, trajectory_entry(shown.times, shown.positions, spec), spec)
        else:
            library.add(name, posture_entry(self._shown.posture(), spec), spec)
        self._library.parent.mkdir(parents=True, exist_ok=True)
        library.store(name, self._library)
        return f"{name} is in {self._library}"

    def _record(self, on: bool) -> str:
        if not on:
            self._opened.record(None)
            return "the recording is whole"
        path = free_name(self._recordings)
        self._opened.record(path)
        return f"recording to {path}"


def free_name(folder: Path) -> Path:
    """A recording's name that is not taken."""
    count = 1
    while (path := folder / f"panel_{count:03d}.arrow").exists():
        count += 1
    return path
