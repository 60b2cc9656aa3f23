"""Both futures of a recording, whichever hand it is of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample, Vector

if TYPE_CHECKING:
    from allegro_twin.grasping.verdict import Report

Beside: TypeAlias = Callable[[], dict[str, Array]]
"""What is known beside a sample: where the recording's joints were (`target`), and what a trial sees."""
Through: TypeAlias = Callable[[Iterator[Sample], Beside], Iterator[Sample]]


class Wanted(NamedTuple):
    """How a hand on a wire is to go on."""

    hand: str = ""
    """Its own file; default: the one it was recorded with."""
    disturbance: Literal["forget", "hold"] = "forget"
    """What becomes of what pushes the joints at the instant."""
    open_loop: bool = False
    """The recorded commands go on, whatever its controller would have done."""
    gravity: Vector | None = None
    """In the palm frame, (3,), m/s², where neither recording nor hand says it."""


@dataclass(frozen=True, slots=True, eq=False)
class Branched:
    """Both futures."""

    t: Vector
    """s, (k,), of the whole recording."""
    recorded: Array
    """Joint positions as they were, (k, n), rad."""
    branched: Array
    """As they would have been; fewer rows where the guard would have stopped the hand."""
    spec: HandSpec
    report: Report | None = None
    """The verdict on the branch, where the recording is of a scenario."""
    unchanged: Array | None = None
    """As the model of a hand on a wire has it without any change: off by its own error. None: there is none."""
    said: tuple[str, ...] = ()
    """What is known of the instant, what is estimated and what assumed."""


def rows_before(samples: Iterable[Sample], row: int) -> Iterator[Sample]:
    """The first of some samples."""
    for number, sample in enumerate(samples):
        if number == row:
            return
        yield sample
