"""Several runs: one after the other, or, where all are simulated, side by side in processes of their own.

What is heard of them comes in the order in which they were asked for, whichever ends first; so an error or a note is
the same however many processes there are.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from allegro_twin.errors import HandError
from allegro_twin.surfaces.cli.run.runs import Job, outputs_in

if TYPE_CHECKING:
    from rich.progress import Progress

    from allegro_twin.app.session import Outcome, Outputs
    from allegro_twin.spec import HandSpec
    from allegro_twin.sweep.workers import UnitDone, UnitFailed, WorkerLost

_TELLING = 0.1
"""s of the hand's time between two words of a process about how far it is."""
_ONE_THREAD = {"LP_NUM_THREADS": "0"}
"""For Mesa's software rendering: in the process's own thread, or every process would start a thread for each core."""


class Ran(NamedTuple):
    """What came of one run."""

    spec: HandSpec
    outcome: Outcome
    grasp: str
    """Of its trial; empty without one."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What every run leaves behind."""

    outputs: Outputs
    folder: Path | None
    """For a recording and a picture of each."""


Begin = Callable[[str, float | None], None]
"""Told which side a run is of and for how long, s."""
Tell = Callable[[str], None]


def run_all(
    jobs: Sequence[Job], wanted: Wanted, count: int, bar: Progress, tell: Tell
) -> Generator[tuple[Job, Ran], None, None]:
    """Every job with what came of it, in the order of the jobs, in up to `count` processes. Raises HandError."""
    together = count > 1 and len(jobs) > 1 and all(job.config.backend.kind == "sim" for job in jobs)
    whole = bar.add_task(f"0 of {len(jobs)}", total=len(jobs), visible=len(jobs) > 1)
    results = _side_by_side(jobs, wanted, count, bar) if together else _in_turn(jobs, wanted, bar, tell)
    for number, (job, ran) in enumerate(zip(jobs, results, strict=True), 1):
        bar.update(whole, description=f"{number} of {len(jobs)}", completed=number)
        yield job, ran


def run_one(job: Job, wanted: Wanted, begin: Begin, advance: Callable[[float], None], tell: Tell) -> Ran:
    """One run, in this process. Raises HandError."""
    from allegro_twin.app import assemble
    from allegro_twin.app.session import perform

    rig = assemble(job.config)
    begin(rig.spec.side, rig.seconds)
    outputs = wanted.outputs if wanted.folder is None else outputs_in(wanted.folder, job, rig, wanted.outputs)
    outcome = perform(rig, job.config, outputs, advance, tell)
    return Ran(rig.spec, outcome, "" if rig.trial is None else rig.trial.grasp.name)


def run_apart(wanted: Wanted, job: Job, told: Callable[[object], None]) -> Ran:
    """`run_one` as the task of a process: what it tells are a side with a duration, s, and then the hand's times, s."""
    last = 0.0

    def advance(t: float) -> None:
        nonlocal last
        if t >= last + _TELLING:
            told(t)
            last = t

    return run_one(job, wanted, lambda side, seconds: told((side, seconds)), advance, lambda line: None)


class _Bars:
    """A bar for each run that is going on."""

    def __init__(self, jobs: Sequence[Job], bar: Progress) -> None:
        self._jobs, self._bar, self._tasks = jobs, bar, dict[int, Any]()

    def begin(self, number: int, side: str, seconds: float | None) -> None:
        self._tasks[number] = self._bar.add_task(f"{self._jobs[number].name} {side}", total=seconds)

    def advance(self, number: int, t: float) -> None:
        self._bar.update(self._tasks[number], completed=t)

    def told(self, number: int, message: tuple[str, float | None] | float) -> None:
        """As `run_apart` says it."""
        if isinstance(message, tuple):
            self.begin(number, *message)
        else:
            self.advance(number, message)

    def end(self, number: int) -> None:
        if number in self._tasks:  # It may have ended before it began.
            self._bar.remove_task(self._tasks.pop(number))


def _in_turn(jobs: Sequence[Job], wanted: Wanted, bar: Progress, tell: Tell) -> Iterator[Ran]:
    bars = _Bars(jobs, bar)
    for number, job in enumerate(jobs):
        ran = run_one(job, wanted, partial(bars.begin, number), partial(bars.advance, number), tell)
        bars.end(number)
        yield ran


def _side_by_side(jobs: Sequence[Job], wanted: Wanted, count: int, bar: Progress) -> Iterator[Ran]:
    """What came of each, in order. The error that counts is the earliest job's: for it later ones are stopped, and
    earlier ones are waited for."""
    from allegro_twin.sweep.workers import WorkerEvent, Workers

    bars, ended = _Bars(jobs, bar), dict[int, Ran | HandError]()
    begun, end, number = 0, len(jobs), 0
    with Workers(f"{__name__}:run_apart", wanted, min(count, end), _ONE_THREAD) as workers:
        while number < len(jobs):
            while workers.free and begun < end:
                workers.give(begun, jobs[begun])
                begun += 1
            for event in workers.events():
                if isinstance(event, WorkerEvent):
                    bars.told(event.task, event.message)
                    continue
                bars.end(event.task)
                ended[event.task] = found = _ended(event, jobs)
                if isinstance(found, HandError):
                    end = min(end, event.task)
            while number in ended:
                ran = ended.pop(number)
                if isinstance(ran, HandError):
                    raise ran
                yield ran
                number += 1


def _ended(event: UnitDone | UnitFailed | WorkerLost, jobs: Sequence[Job]) -> Ran | HandError:
    from allegro_twin.sweep.workers import UnitDone, UnitFailed

    if isinstance(event, UnitDone):
        ran: Ran = event.result
        return ran
    if isinstance(event, UnitFailed):
        return event.error
    how = f"was killed by signal {-event.code}" if event.code < 0 else f"ended with code {event.code}"
    job = jobs[event.task]
    return HandError(f"{job.name}, {job.config.hand.side} hand: its process {how}; --jobs 1 runs it in this one")
