"""The manufacturer's keys for a hand, from a terminal or a pipe."""

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
    """A key: its description and its action."""

    does: str
    act: Callable[[Hand], object]


def _posture(name: str) -> Callable[[Hand], object]:
    return lambda hand: hand.move_to(name, hand.direct.usual_speed(1.0), wait=False)


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


def press(hand: Hand, key: str) -> str | None:
    """Perform the action of a key. Returns the line to print, or None for a key that ends the session.

    A command that the hand refuses gives its message; a fault raises HandError.
    """
    if key in QUIT:
        return None
    if key in HELP:
        return "   ".join(f"{name} {entry.does}" for name, entry in KEYS.items()) + "   q quit"
    if key not in KEYS:
        return f"{key!r} has no meaning; ? lists the keys"
    try:
        KEYS[key].act(hand)
    except ValueError as error:  # A ConfigError or CommandError: the hand refuses and continues.
        return str(error)
    return KEYS[key].does


def play(hand: Hand, source: TextIO, show: Callable[[str], None]) -> None:
    """Read keys from a terminal or a text until `q` or its end. Raises HandError for a fault."""
    # First the terminal's mode: the change drops what was typed before.
    with _raw(source), hand.listening(_print_stalls(hand, show)):
        show(str(press(hand, "?")))
        while key := source.read(1):
            if key.isspace():
                continue
            answer = press(hand, key)
            if answer is None:
                return
            show(f"{hand.state.t:8.2f} s  {answer}")


def _print_stalls(hand: Hand, show: Callable[[str], None]) -> Callable[[Sample], None]:
    """Callback that prints a blocked motion when the hand gives it up."""
    shown: list[MotionStalled] = []

    def look(sample: Sample) -> None:
        if hand.stalled is not None and hand.stalled not in shown:
            shown.append(hand.stalled)
            show(f"{sample.state.t:8.2f} s  {hand.stalled}")

    return look


@contextmanager
def _raw(source: TextIO) -> Iterator[None]:
    """A terminal that delivers every key at once without echo; restored afterwards."""
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
