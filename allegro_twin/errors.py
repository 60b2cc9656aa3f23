"""One tree of exceptions, split by what the caller can do about them."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any


class HandError(Exception):
    """Anything this package raises on purpose."""

    history: tuple[Any, ...] = ()
    """The `types.Sample`s that led here, oldest first; filled in by the guard. `types` stands on this module, so they
    have no type here."""


class ConfigError(HandError, ValueError):
    """Fix the YAML, or the argument that stands for it: an unknown key, a wrong shape, a period that does not fit."""


class SelfCollision(ConfigError):
    """Ask for another posture, or go there by another: the hand would meet itself. The message names the parts."""


class WrongPose(ConfigError):
    """Lay the hand as the message says, or name the pose that it has: its IMU shows another one."""


class MotionStalled(HandError):
    """Free the fingers, or go another way: a motion met something. The hand holds where it was stopped."""


class MotionInterrupted(HandError):
    """Decide anew: somebody stopped the motion that you wait for, or asked for another. The message says which; the
    hand does what it was asked last."""


class CommandError(HandError, ValueError):
    """Fix the controller: a NaN, a wrong length, a kind of command that this hand does not accept."""


class LinkError(HandError, ConnectionError):
    """Fix the bus: no interface, no permission, cable out."""


class LinkTimeout(LinkError, TimeoutError):
    """The hand fell silent. The message names the fingers."""


class ProtocolError(HandError):
    """Wrong hand version, or line noise. The message carries the frame."""


class HandFault(HandError):
    """The hand or the guard stopped it: too fast, too hot, a status bit. `reset` leads out, and `recover` where the
    backend is `Recoverable`."""


class TooFast(HandFault):
    """A joint moved faster than its limit. Slow the motion down, or give `limits.velocity` more."""


class ArmReflex(HandFault):
    """An arm met something harder than its collision thresholds allow. It holds itself.

    `name`: `joint_reflex` or `cartesian_reflex`, as libfranka calls it; `wrench`: on the flange then, in the axes of
    the base, six numbers, N and N·m.
    """

    def __init__(self, message: str, name: str, wrench: tuple[float, ...]) -> None:
        super().__init__(message)
        self.name, self.wrench = name, wrench

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (*self.args, self.name, self.wrench), self.__dict__


class RecordingError(HandError, OSError):
    """Fix the file or the disk: not a recording, cut short, or no space left."""


class EndOfRecording(HandError):
    """Nothing to fix: the recording has no further row."""


_MANY, _SOME = 40, 8
"""Names up to which all are listed, and of how many where there are more."""


def unknown(kind: str, name: str, known: Iterable[str]) -> str:
    """The message for a name that does not exist: what was asked for, the nearest names, all of them when few, else
    those that are least unlike it."""
    names = sorted(known)
    near = get_close_matches(name, names, n=3, cutoff=0.5)
    if near:
        return f"no {kind} named {name!r}; did you mean {' or '.join(map(repr, near))}?"
    if len(names) > _MANY:
        nearest = get_close_matches(name, names, n=_SOME, cutoff=0.0)
        return f"no {kind} named {name!r}; there are {len(names)}, among them {', '.join(nearest)}"
    return f"no {kind} named {name!r}; there are: {', '.join(names) or 'none'}"
