"""Fingers that could hook into each other: whether a command would bring them to it, seen before it is sent."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from allegro_twin.errors import CommandError
from allegro_twin.sim.contact.self_clearance import SelfClearance
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector

STEP = 0.1
"""rad between two postures that are looked at on a straight way: a fingertip goes by 9 mm, and is 16 mm thick."""
_WORSE = 0.0005
"""m. Fingers that are in each other already may go on by so much, or nothing could free them."""


class Interlock:
    """Keeps the pairs of fingers apart that `spec.apart` names, by the shapes of the simulation with nothing between
    them: joints that nobody senses are where they are estimated to be."""

    def __init__(self, spec: HandSpec) -> None:
        self._spec = spec
        self._clear: tuple[Vector, Vector] | None = None
        """The position and the goal of the last way that was clear."""

    def __call__(self, position: Vector, goal: Vector) -> None:
        """Raises CommandError where the straight way from a position to a goal, (n,), rad, leads fingers into each
        other."""
        before, same = self._clear or (position, goal)
        if self._clear is not None and np.array_equal(goal, same) and np.abs(position - before).max() < STEP:
            return
        steps = max(int(np.ceil(np.abs(goal - position).max() / STEP)), 1)
        way = position + np.linspace(0.0, 1.0, steps + 1)[:, None] * (goal - position)
        free = self._clearance(np.clip(way, self._spec.lower, self._spec.upper))
        worst = free[1:].min(axis=0)
        pair = int(np.argmin(worst))
        if worst[pair] < min(0.0, free[0, pair] - _WORSE):
            one, other = self._clearance.pairs[pair]
            raise CommandError(
                f"{one} and {other} of {self._spec.name} would be {-1000 * worst[pair]:.1f} mm inside each other on "
                "the way to this position: they could hook into each other; move one of them away first"
            )
        self._clear = position, goal

    @cached_property
    def _clearance(self) -> SelfClearance:
        return SelfClearance(self._spec, self._spec.apart)
