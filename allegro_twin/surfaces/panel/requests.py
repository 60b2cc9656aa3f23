"""Requests of a person at the page, as plain data, and the queue in which they wait for the session."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class MoveJoints:
    """Head for these positions, (n,), rad; None: that joint stays at the goal that the session has for it."""

    position: tuple[float | None, ...]

    @classmethod
    def of(cls, n: int, positions: Mapping[int, float]) -> MoveJoints:
        """Some of `n` joints, by number."""
        return cls(tuple(positions.get(joint) for joint in range(n)))

    def after(self, earlier: MoveJoints) -> MoveJoints:
        """This request and one before it as one."""
        if len(earlier.position) != len(self.position):
            return self
        pairs = zip(earlier.position, self.position, strict=True)
        return MoveJoints(tuple(old if new is None else new for old, new in pairs))


@dataclass(frozen=True, slots=True)
class MovePalm:
    """Move the palm of a cell to a pose of the world: position, m, and quaternion w x y z, (7,)."""

    pose: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class MoveToPosture:
    """Go to a posture of the library."""

    name: str


@dataclass(frozen=True, slots=True)
class PerformGrasp:
    """Perform a grasp of the library."""

    name: str


@dataclass(frozen=True, slots=True)
class ChooseController:
    """Change the controller, as `Hand.set_controller` does."""

    kind: str


@dataclass(frozen=True, slots=True)
class ChooseGains:
    """Use other gains of the library, from the next request on."""

    name: str


@dataclass(frozen=True, slots=True)
class SetGravity:
    """Set the gravity that controllers compensate, palm frame, (3,), m/s²; None: what the hand reports."""

    vector: tuple[float, float, float] | None


@dataclass(frozen=True, slots=True)
class HoldHere:
    """Stay here."""


@dataclass(frozen=True, slots=True)
class StopMotion:
    """Stop at once: a hand goes limp, a cell stands still."""


@dataclass(frozen=True, slots=True)
class ReleaseStop:
    """Take requests again after a stop."""


@dataclass(frozen=True, slots=True)
class Teach:
    """Begin a demonstration, or end it."""

    on: bool


@dataclass(frozen=True, slots=True)
class PlayTaught:
    """Play the motion of the last demonstration."""


@dataclass(frozen=True, slots=True)
class StoreTaught:
    """Store the last demonstration in the user's library: its motion, or the posture at its end."""

    name: str
    motion: bool
    replace: bool = False
    """Also where the library's file has an entry of that name."""


@dataclass(frozen=True, slots=True)
class Record:
    """Begin to record, or end it."""

    on: bool


@dataclass(frozen=True, slots=True)
class DragObject:
    """Pull an object of the scene with the mouse."""

    number: int
    """0: the one that is grasped."""
    point: tuple[float, float, float]
    """Where it was picked, in its own frame, m."""
    target: tuple[float, float, float]
    """Where the mouse is, in the plane of the picture through the picked point; world, m."""


@dataclass(frozen=True, slots=True)
class DropObject:
    """The mouse lets go of an object."""


@dataclass(frozen=True, slots=True)
class TurnGoal:
    """Bring the object of an episode to this orientation: a unit quaternion w x y z in the world, (4,); None: to the
    task's own goals again."""

    quaternion: tuple[float, ...] | None


@dataclass(frozen=True, slots=True)
class PerformEpisode:
    """Let the config's controller do the episode's task, from where the hand and the object are."""


@dataclass(frozen=True, slots=True)
class OpenScene:
    """Open a simulated hand anew, in a scenario, with an object of the catalogue in place of its own; None: as the
    config has it. `perform`: and do what the scenario, or the config, is for."""

    scenario: str | None
    object_name: str | None
    perform: bool


@dataclass(frozen=True, slots=True)
class Reopen:
    """Open the hand again, limp: after a fault, or at the end of a recording."""


@dataclass(frozen=True, slots=True)
class DriverLeft:
    """Nobody drives any more."""


Request: TypeAlias = (
    MoveJoints
    | MovePalm
    | MoveToPosture
    | PerformGrasp
    | ChooseController
    | ChooseGains
    | SetGravity
    | HoldHere
    | StopMotion
    | ReleaseStop
    | Teach
    | PlayTaught
    | StoreTaught
    | Record
    | DragObject
    | DropObject
    | TurnGoal
    | PerformEpisode
    | OpenScene
    | Reopen
    | DriverLeft
)
IMMEDIATE = (DragObject, DropObject)
"""These wait for no other request: one that is being planned may take a second."""
_CONTINUOUS = (MoveJoints, MovePalm, TurnGoal)
"""A handle that is dragged asks for more of these than a session can do: of several in a row only the newest waits, and
what earlier ones ask of other joints with it."""


class RequestQueue:
    """Requests wait here until the session has time."""

    def __init__(self) -> None:
        self._waiting: deque[Request] = deque()
        self._changed = threading.Condition()

    def put(self, request: Request) -> None:
        with self._changed:
            if isinstance(request, _CONTINUOUS) and self._waiting and type(self._waiting[-1]) is type(request):
                earlier = self._waiting.pop()
                if isinstance(request, MoveJoints) and isinstance(earlier, MoveJoints):
                    request = request.after(earlier)
            self._waiting.append(request)
            self._changed.notify()

    def clear(self) -> None:
        """Drop everything that waits, after a stop."""
        with self._changed:
            self._waiting.clear()

    def get(self, timeout: float) -> Request | None:
        """The oldest, or None if none came for so many seconds."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(timeout)
            return self._waiting.popleft() if self._waiting else None
