"""The manufacturer's keys, on a live terminal or from a pipe."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TextIO

from allegro_twin.errors import HandError, MotionStalled
from allegro_twin.surfaces.hand import Hand
from allegro_twin.types import Sample


@dataclass(frozen=True, slots=True)
class Key:
    """What a key does."""

    does: str
    act: Callable[[Hand], object]


def _posture(name: str) -> Callable[[Hand], object]:
    return lambda hand: hand.move_to(name, wait=False)


def _grasp(name: str) -> Callable[[Hand], object]:
    return lambda hand: hand.grasp(name, wait=False)


KEYS: dict[str, Key] = {
    "h": Key("home", _posture("home")),
    "r": Key("ready", _posture("ready")),
    "g": Key("grasp with three fingers", _grasp("grasp_3")),
    "k": Key("grasp with four fingers", _grasp("grasp_4")),
    "p": Key("pinch, index and thumb", _grasp("pinch_index")),
    "m": Key("pinch, middle and thumb", _grasp("pinch_middle")),
    "e": Key("envelop", _grasp("envelop")),
    "a": Key("gravity compensation", lambda hand: hand.set_controller("gravity")),
    "o": Key("off", lambda hand: hand.set_controller(hand.controllers[0])),
    "1": Key("rock", _posture("rock")),
    "2": Key("scissors", _posture("scissors")),
    "3": Key("paper", _posture("paper")),
}
QUIT = "q\x03\x04"
HELP = "?/"


def pressed(hand: Hand, key: str) -> str | None:
    """Do what a key says; what to show for it, or None for a key that ends the session.

    What the hand refuses is shown and ends nothing; a fault ends it.
    """
    if key in QUIT:
        return None
    if key in HELP:
        return "   ".join(f"{name} {entry.does}" for name, entry in KEYS.items()) + "   q quit"
    if key not in KEYS:
        return f"{key!r} has no meaning; ? lists the keys"
    try:
        KEYS[key].act(hand)
    except ValueError as error:  # A ConfigError or CommandError: this wish cannot be, the hand goes on.
        return str(error)
    return KEYS[key].does


def play(hand: Hand, source: TextIO, show: Callable[[str], None]) -> None:
    """Keys from a terminal, one at a time, or from any text, until `q` or its end. Raises HandError for a fault."""
    # The terminal's mode first, before the help invites a key: the change drops what was typed.
    with _raw(source), hand.listening(_stalls(hand, show)):
        show(str(pressed(hand, "?")))
        while key := source.read(1):
            if key.isspace():
                continue
            answer = pressed(hand, key)
            if answer is None:
                return
            show(f"{hand.state.t:8.2f} s  {answer}")


def _stalls(hand: Hand, show: Callable[[str], None]) -> Callable[[Sample], None]:
    """Shows a motion that was stopped, at the moment in which it is given up."""
    told: list[MotionStalled] = []

    def look(sample: Sample) -> None:
        if hand.stalled is not None and hand.stalled not in told:
            told.append(hand.stalled)
            show(f"{sample.state.t:8.2f} s  {hand.stalled}")

    return look


@contextmanager
def _raw(source: TextIO) -> Iterator[None]:
    """A terminal that gives every key at once and shows none; it is put back afterwards."""
    if not source.isatty():
        yield
        return
    if sys.platform == "win32":
        raise HandError("the keyboard needs a POSIX terminal; pipe the keys in instead")
    import termios
    import tty

    before = termios.tcgetattr(source)
    try:
        tty.setcbreak(source)
        yield
    finally:
        termios.tcsetattr(source, termios.TCSADRAIN, before)
