"""The contract of a controller: a pure function from a hand's state to its next command."""

from __future__ import annotations

from typing import Protocol, TypeVar

from allegro_twin.types import Command, HandState

M = TypeVar("M")


class Controller(Protocol[M]):
    """A pure function from state to command. Its memory is passed in and handed back, so a run can be repeated. The
    parameters may have other names."""

    def start(self, state: HandState, /) -> M:
        """The memory with which to meet the first state."""
        ...

    def __call__(self, state: HandState, memory: M, /) -> tuple[Command, M]:
        """The command for this state, and the memory for the next."""
        ...
