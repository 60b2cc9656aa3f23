"""Options and result of a branch."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample, Vector

if TYPE_CHECKING:
    from allegro_twin.grasping.verdict import TrialReport

ReferenceColumns: TypeAlias = Callable[[], dict[str, Array]]
"""Columns beside a sample: the recording's joint positions (`target`), and what a trial reports."""
SampleStages: TypeAlias = Callable[[Iterator[Sample], ReferenceColumns], Iterator[Sample]]


class BranchOptions(NamedTuple):
    """Options of a branch of a hand on a wire."""

    hand: str = ""
    """The hand's file; default: the one it was recorded with."""
    disturbance: Literal["forget", "hold"] = "forget"
    """What happens to the external torques of the instant."""
    open_loop: bool = False
    """The recorded commands continue, whatever the controller would have done."""
    gravity: Vector | None = None
    """In the palm frame, (3,), m/s², where neither recording nor hand says it."""


@dataclass(frozen=True, slots=True, eq=False)
class BranchResult:
    """A recording and its branch."""

    t: Vector
    """s, (k,), of the whole recording."""
    recorded: Array
    """Recorded joint positions, (k, n), rad."""
    branched: Array
    """Joint positions of the branch; fewer rows where the guard would have stopped the hand."""
    spec: HandSpec
    report: TrialReport | None = None
    """The verdict on the branch, where the recording is of a scenario."""
    unchanged: Array | None = None
    """The model's joint positions without any change: their distance from the recording is the model's error. None for
    a simulation."""
    notes: tuple[str, ...] = ()
    """Sentences: what is known of the instant, what is estimated and what is assumed."""
    believed_until: float = math.inf
    """s: from here on the recording's hand is touched, or parts of the branch pass through each other, which no model
    here knows."""


def first_samples(samples: Iterable[Sample], row: int) -> Iterator[Sample]:
    """The first `row` samples."""
    for number, sample in enumerate(samples):
        if number == row:
            return
        yield sample
