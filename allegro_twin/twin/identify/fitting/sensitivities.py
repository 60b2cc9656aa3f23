"""How residuals answer to nudges of joints: each finger's joints one after the other, and from then on all at once.

A joint answers mostly to what is its own; what it takes from its finger's other joints, through the links, hardly
changes on a descent. So the second time all joints are nudged together, and of each one's answer what the others had
of it the first time is taken away: one play of the model in the place of four.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from allegro_twin.types import Array


class Answers:
    """Derivatives by kinds of nudges, as they were found last."""

    def __init__(self, fingers: list[list[int]]) -> None:
        longest = max(map(len, fingers))
        self._places = [[finger[place] for finger in fingers if place < len(finger)] for place in range(longest)]
        self._known: dict[str, list[Array]] = {}

    def of(self, name: str, nudged: Callable[[list[int]], Array]) -> Iterator[Array]:
        """Derivatives (w, rows, n) by what is called `name` of the first joint of each finger, the second, …; `nudged`
        gives the one by that of some joints together."""
        known = self._known.get(name)
        if known is None:
            self._known[name] = [nudged(joints) for joints in self._places]
        else:
            together = nudged([joint for joints in self._places for joint in joints])
            self._known[name] = [self._renewed(known, place, together) for place in range(len(known))]
        yield from self._known[name]

    def _renewed(self, known: list[Array], place: int, together: Array) -> Array:
        """By one place: its own joints' answer anew, the others' as it was."""
        own = self._places[place]
        others = sum((known[other][:, :, own] for other in range(len(known)) if other != place), np.float64(0.0))
        found = known[place].copy()
        found[:, :, own] = together[:, :, own] - others
        return found
