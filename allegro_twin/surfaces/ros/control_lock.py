"""Who drives the hand when several programs want to."""

from __future__ import annotations

from typing import NamedTuple
from uuid import UUID

QUIET = 1.0
"""s after a program's last wish, or after its motion, in which no other drives."""


class _Turn(NamedTuple):
    sender: UUID
    until: float
    """s."""


class Drivers:
    """One program at a time: whoever came first, until it has been quiet."""

    def __init__(self) -> None:
        self._turn: _Turn | None = None
        self._stopped: dict[UUID, float] = {}
        self._told: set[UUID] = set()

    def may(self, sender: UUID, now: float) -> bool:
        """Whether a program may drive at a time, s."""
        if now < self._stopped.get(sender, 0.0):
            self._stopped[sender] = now + QUIET
            return False
        if self._turn is not None and self._turn.sender != sender and now < self._turn.until:
            return False
        if self._turn is None or self._turn.sender != sender:
            self._told.clear()
        self._turn = _Turn(sender, now + QUIET)
        return True

    def keep(self, sender: UUID, now: float, seconds: float) -> None:
        """A program's motion lasts so long, s."""
        self._turn = _Turn(sender, now + seconds + QUIET)

    def stop(self, sender: UUID) -> None:
        """A program has switched the hand off: whoever drove may again after it has been quiet, or its stream would
        undo that at once."""
        if self._turn is not None and self._turn.sender != sender:
            self._stopped[self._turn.sender] = self._turn.until
            self._told.discard(self._turn.sender)
        self._turn = None

    def first_refusal(self, sender: UUID) -> bool:
        """Whether this program hears for the first time that another drives."""
        known = sender in self._told
        self._told.add(sender)
        return not known
