"""Both futures of a recording, whichever hand it is of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

from allegro_twin.errors import ConfigError
from allegro_twin.replay.recording import Recording, load
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample, Vector

if TYPE_CHECKING:
    from allegro_twin.build.branching.changes import Changes
    from allegro_twin.evaluate.held import Report

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


def branch(
    path: Path,
    at: float,
    changes: Changes,
    through: Through = lambda samples, beside: samples,
    wanted: Wanted = Wanted(),  # noqa: B008  # Frozen.
) -> Branched:
    """Go on otherwise from `at`, s; `through`: stages for its samples. Raises ConfigError for a recording that cannot
    be gone on from, or an odd change."""
    recording = load(path)
    last = float(recording.columns["t"][-1])
    if not 0.0 <= at <= last:
        raise ConfigError(f"--at {at:g} s: {path} goes from 0 to {last:g} s")
    if by_model(recording, wanted):
        from allegro_twin.build.branching.estimated import estimated

        return estimated(recording, at, changes, through, wanted)
    if wanted != Wanted():
        raise ConfigError(
            f"{path} is of a simulation, which is repeated with what pushed it, its gravity and its controller: leave "
            "out --disturbance, --open-loop and --gravity, or give --hand to go on from what a mirror knows"
        )
    from allegro_twin.build.branching.repeated import repeated

    return repeated(recording, at, changes, through)


def by_model(recording: Recording, wanted: Wanted) -> bool:
    """Whether a model goes on in the place of a hand; otherwise a simulation is repeated. Raises ConfigError where only
    the latter can be."""
    backend = (recording.meta.get("config") or {}).get("backend", {})
    if wanted.hand and backend.get("kind") == "sim":
        raise ConfigError(f"{recording.path} is of a simulation, which is repeated as it was: leave out --hand")
    return "engine" not in recording.meta or bool(wanted.hand)


def rows_before(samples: Iterable[Sample], row: int) -> Iterator[Sample]:
    """The first of some samples."""
    for number, sample in enumerate(samples):
        if number == row:
            return
        yield sample
