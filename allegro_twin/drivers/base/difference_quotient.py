"""Joint speeds of a hand that says only where it is, when it is asked."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.types import Vector

_SURE = 1.2
"""The longest time that may lie between two positions, over the shortest: beyond it the speed is not known."""


class Exchanged(NamedTuple):
    """A question and its answer, s on the port's clock."""

    sent: float
    """Before the question went out."""
    came: float
    """When its answer was there."""


class DifferenceQuotient:
    """Δq/Δt, where Δt is known; elsewhere the last speed that was.

    A position is of some time between the question and its answer. The shortest exchange that was ever seen is what a
    line takes of itself; whatever an exchange takes beyond it, on a busy computer, with a late adapter or a question
    that got lost, the position may be older or newer by. A position of doubtful age is compared with nothing: the next
    is compared with the one before it.
    """

    def __init__(self, position: Vector, when: Exchanged) -> None:
        self._position, self._when, self._least = position, when, when.came - when.sent
        self._velocity: Vector = np.zeros_like(position)

    def __call__(self, position: Vector, when: Exchanged) -> Vector:
        """Speeds at a new position, both (n,); rad, rad/s."""
        before = self._when
        self._least = least = min(self._least, when.came - when.sent)
        shortest, longest = when.sent - before.came + least, when.came - least - before.sent
        if 0.0 < longest <= _SURE * shortest:
            self._velocity = (position - self._position) / (0.5 * (shortest + longest))
            self._position, self._when = position, when
        elif when.came - when.sent < before.came - before.sent:
            self._position, self._when = position, when
        return self._velocity
