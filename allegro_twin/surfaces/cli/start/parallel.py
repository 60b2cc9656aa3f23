"""Several runs: in turn, or, if all are simulated, in parallel processes.

Results come in the order of the jobs, whichever ends first. So errors and notes do not depend on the number of
processes.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from allegro_twin.errors import HandError, HandFault
from allegro_twin.surfaces.cli.start.jobs import RunJob, outputs_in

if TYPE_CHECKING:
    from rich.progress import Progress

    from allegro_twin.app.session import Outputs, RunOutcome
    from allegro_twin.spec import HandSpec
    from allegro_twin.sweep.workers import UnitDone, UnitFailed, WorkerLost

_REPORT_PERIOD = 0.1
"""s of the hand's time between two progress messages of a process."""
_ONE_THREAD = {"LP_NUM_THREADS": "0"}
"""Keeps Mesa's software rendering in the process's own thread; else each process starts a thread for every core."""


class RunResult(NamedTuple):
    """The outcome of one run."""

    spec: HandSpec
    outcome: RunOutcome
    grasp: str
    """Name of the grasp of its trial; empty without a trial."""


@dataclass(frozen=True, slots=True)
class RunOutputs:
    """The files that every run writes."""

    files: Outputs
    folder: Path | None
    """Folder for a recording and a picture of each run."""


Begin = Callable[[str, float | None], None]
"""Called when a run begins, with its side and its duration, s."""
ReportLine = Callable[[str], None]


def run_all(
    jobs: Sequence[RunJob],
    outputs: RunOutputs,
    count: int,
    bar: Progress,
    report: ReportLine,
    ahead: dict[int, RunResult | HandError],
) -> Generator[tuple[RunJob, RunResult], None, None]:
    """Run every job in up to `count` processes; yields each job with its result, in order. `ahead` has what ended
    before its turn, by the number of the job, also after an interruption. Raises HandError."""
    together = count > 1 and len(jobs) > 1 and all(job.config.backend.kind == "sim" for job in jobs)
    whole = bar.add_task(f"0 of {len(jobs)}", total=len(jobs), visible=len(jobs) > 1)
    results = _run_parallel(jobs, outputs, count, bar, ahead) if together else _run_in_turn(jobs, outputs, bar, report)
    for number, (job, ran) in enumerate(zip(jobs, results, strict=True), 1):
        bar.update(whole, description=f"{number} of {len(jobs)}", completed=number)
        yield job, ran


def run_one(
    job: RunJob, outputs: RunOutputs, begin: Begin, advance: Callable[[float], None], report: ReportLine
) -> RunResult:
    """Do one run in this process. A fault of a simulated hand in a trial is a verdict: not held. Raises HandError."""
    from allegro_twin.app import assemble
    from allegro_twin.app.session import RunOutcome, perform
    from allegro_twin.grasping.verdict import faulted

    rig = assemble(job.config)
    try:
        with closing(rig.backend):
            begin(rig.spec.side, rig.seconds)
            files = outputs.files if outputs.folder is None else outputs_in(outputs.folder, job, rig, outputs.files)
            outcome = perform(rig, job.config, files, advance, report)
    except HandFault as error:
        if rig.trial is None or job.config.backend.kind != "sim" or not error.history:
            raise
        why = str(error).removeprefix("stopped: ").removesuffix("; reset to go on")
        outcome = RunOutcome(error.history[-1].state, faulted(f"guard: {why}"), ())
    return RunResult(rig.spec, outcome, "" if rig.trial is None else rig.trial.grasp.name)


def run_in_worker(outputs: RunOutputs, job: RunJob, send: Callable[[object], None]) -> RunResult:
    """`run_one` as the task of a worker process. It sends the side with the duration, s, then times of the hand, s."""
    last = 0.0

    def advance(t: float) -> None:
        nonlocal last
        if t >= last + _REPORT_PERIOD:
            send(t)
            last = t

    return run_one(job, outputs, lambda side, seconds: send((side, seconds)), advance, lambda line: None)


class _Bars:
    """A progress bar for each running job."""

    def __init__(self, jobs: Sequence[RunJob], bar: Progress) -> None:
        self._jobs, self._bar, self._tasks = jobs, bar, dict[int, Any]()

    def begin(self, number: int, side: str, seconds: float | None) -> None:
        self._tasks[number] = self._bar.add_task(f"{self._jobs[number].name} {side}", total=seconds)

    def advance(self, number: int, t: float) -> None:
        self._bar.update(self._tasks[number], completed=t)

    def receive(self, number: int, message: tuple[str, float | None] | float) -> None:
        """Handle a message of `run_in_worker`."""
        if isinstance(message, tuple):
            self.begin(number, *message)
        else:
            self.advance(number, message)

    def end(self, number: int) -> None:
        if number in self._tasks:  # A failed job may end before it begins.
            self._bar.remove_task(self._tasks.pop(number))


def _run_in_turn(jobs: Sequence[RunJob], outputs: RunOutputs, bar: Progress, report: ReportLine) -> Iterator[RunResult]:
    bars = _Bars(jobs, bar)
    for number, job in enumerate(jobs):
        ran = run_one(job, outputs, partial(bars.begin, number), partial(bars.advance, number), report)
        bars.end(number)
        yield ran


def _run_parallel(
    jobs: Sequence[RunJob], outputs: RunOutputs, count: int, bar: Progress, ended: dict[int, RunResult | HandError]
) -> Iterator[RunResult]:
    """Results in order. Raises the error of the earliest job: it stops later jobs and waits for earlier ones."""
    from allegro_twin.sweep.workers import WorkerEvent, Workers

    bars = _Bars(jobs, bar)
    begun, end, number = 0, len(jobs), 0
    with Workers(f"{__name__}:run_in_worker", outputs, min(count, end), _ONE_THREAD) as workers:
        while number < len(jobs):
            while workers.free and begun < end:
                workers.give(begun, jobs[begun])
                begun += 1
            for event in workers.events():
                if isinstance(event, WorkerEvent):
                    bars.receive(event.task, event.message)
                    continue
                bars.end(event.task)
                ended[event.task] = found = _result_of(event, jobs)
                if isinstance(found, HandError):
                    end = min(end, event.task)
            while number in ended:
                ran = ended[number]
                if isinstance(ran, HandError):
                    raise ran
                yield ran
                del ended[number]
                number += 1


def _result_of(event: UnitDone | UnitFailed | WorkerLost, jobs: Sequence[RunJob]) -> RunResult | HandError:
    from allegro_twin.sweep.workers import UnitDone, UnitFailed

    if isinstance(event, UnitDone):
        ran: RunResult = event.result
        return ran
    if isinstance(event, UnitFailed):
        return event.error
    how = f"was killed by signal {-event.code}" if event.code < 0 else f"ended with code {event.code}"
    job = jobs[event.task]
    return HandError(f"{job.name}, {job.config.hand.side} hand: its process {how}; --jobs 1 runs it in this one")
