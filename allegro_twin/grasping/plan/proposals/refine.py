"""Candidates made better in geometry: palms and pre-shapes move to where the motors have to give the least."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from allegro_twin.grasping.plan.candidate import Candidate, ObjectSymmetry, palm_distance
from allegro_twin.grasping.plan.proposals.propose import Proposer

VARIED = 3
"""Variations in a generation, for each candidate that lives on."""
GENERATIONS, PATIENCE, PROGRESS = 32, 9, 0.05
"""In a round at most; and it ends when the share below has not come down by such a fraction in so many."""
FRONT, EASY = 0.4, 0.30
"""Progress is that of the last in this part of the best: of the share of its limit that its worst motor needs. Where
that is no more than the second, physics may decide."""
NICHE = 4
"""Candidates whose palms are within 2 cm and 20° of a better one's, at most: what is found has to differ."""


@dataclass(slots=True)
class Population:
    """The best that evolution by variation and selection has made of candidates so far.

    A generation varies the best (`Proposer.near`), closes the fingers of each variation in geometry and scores it;
    parents and children compete.
    """

    proposer: Proposer
    symmetry: ObjectSymmetry
    kept: int = 32
    """Candidates that live on in a generation."""
    elite: list[Candidate] = field(default_factory=list)
    _closed: set[Candidate] = field(default_factory=set)
    """Those that physics has closed."""

    def evolve(self, fresh: Sequence[Candidate], over: Callable[[], bool] = lambda: False, part: float = 1.0) -> bool:
        """Let a round of generations pass, or a part of one, with some more candidates. `over`: whether time is up,
        asked before each. Whether the round came to its end."""
        self._select([*self.elite, *fresh])
        history = [self._share()]
        for number in range(math.ceil(part * GENERATIONS)):
            if not self.elite or history[-1] <= EASY:
                break
            if over():
                return False
            self._select([*self.elite, *self.proposer.near(self.elite, VARIED * self.kept, _scale(number))])
            history.append(self._share())
            if number >= PATIENCE and history[-1] > (1.0 - PROGRESS) * history[-1 - PATIENCE]:
                break
        return True

    def take(self, count: int) -> list[Candidate]:
        """So many of the best for physics to close, none of them for a second time. Where none is left, the population
        begins anew with what comes next."""
        chosen = [each for each in self.elite if each not in self._closed][:count]
        self._closed.update(chosen)
        if not chosen:
            self.elite = []
        return chosen

    def drop(self, candidates: Sequence[Candidate]) -> None:
        """Forget some, so that others take their places."""
        gone = set(candidates)
        self.elite = [each for each in self.elite if each not in gone]

    def _select(self, candidates: Sequence[Candidate]) -> None:
        """The best, of which no more than `NICHE` are alike."""
        found, leaders, members = list[Candidate](), list[Candidate](), list[int]()
        for candidate in sorted(candidates, key=lambda c: -c.score):
            near = next((k for k, leader in enumerate(leaders) if _alike(candidate, leader, self.symmetry)), None)
            if near is None:
                leaders.append(candidate)
                members.append(0)
                near = len(leaders) - 1
            if members[near] < NICHE:
                members[near] += 1
                found.append(candidate)
            if len(found) == self.kept:
                break
        self.elite = found

    def _share(self) -> float:
        return -self.elite[int(FRONT * (len(self.elite) - 1))].score if self.elite else float("inf")


def _scale(number: int) -> float:
    """Scale of a variation in a generation: wide, half as wide and a quarter, in turn."""
    return (1.0, 0.5, 0.25)[number % 3]


def _alike(first: Candidate, second: Candidate, symmetry: ObjectSymmetry) -> bool:
    far, turned = palm_distance(first, second, symmetry)
    return far < 0.02 and turned < np.radians(20.0)
