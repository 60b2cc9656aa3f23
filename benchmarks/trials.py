"""What many trials side by side cost: against their bare physics, and against a process a core that loops over them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from os import cpu_count
from typing import Any

import numpy as np

from allegro_twin.build.trials import Bench, Case
from allegro_twin.description.hands import load_spec
from allegro_twin.evaluate.scenario import load_scenario
from allegro_twin.evaluate.trial import Trial
from allegro_twin.evaluate.uncertainty import Uncertainty, draws
from allegro_twin.library.named import load_grasp
from allegro_twin.loop import run, until
from allegro_twin.sim.many import Rows, Simulations
from allegro_twin.types import Array

Figure = tuple[str, float, float, str]
SCENARIO, COUNT = "mug", 16
_FORKED: list[Any] = []
_CALLS: list[tuple[Rows, Array, Array, int]] = []


def figures() -> Iterator[Figure]:
    """Ratios of trials a second; the middle of three turns."""
    bench = Bench(load_spec())
    turns = [(_seconds(_together, bench), _seconds(_bare, bench), _seconds(_usual, bench)) for _ in range(3)]
    together, bare, usual = (float(np.median(column)) for column in zip(*turns, strict=True))
    yield "trials side by side / their physics alone, in a batch", bare / together, 0.9, "x"
    yield "trials side by side / a process a core, one mj_step loop after the other", usual / together, 2.5, "x"


def _cases(bench: Bench) -> list[Case]:
    scenario, path = load_scenario(SCENARIO)
    grasp = load_grasp(scenario.grasp, bench.spec)
    return [Case(scenario, grasp, draw, None, path.parent) for draw in draws(Uncertainty(torque=0.0), COUNT)]


def _seconds(work: Callable[[list[Trial], Bench], None], bench: Bench) -> float:
    trials = [bench.trial(case) for case in _cases(bench)]
    began = time.perf_counter()
    work(trials, bench)
    return time.perf_counter() - began


def _together(trials: list[Trial], bench: Bench) -> None:
    from allegro_twin.evaluate.together import together

    _CALLS.clear()
    advance = Simulations.advance

    def kept(sims: Simulations, rows: Rows, torque: Array, drive: Array, steps: int) -> None:
        _CALLS.append((rows, torque, drive, steps))
        advance(sims, rows, torque, drive, steps)

    Simulations.advance = kept  # type: ignore[assignment, method-assign]
    together(trials, [bench.controller(trial) for trial in trials], bench.limits)
    Simulations.advance = advance  # type: ignore[method-assign]


def _bare(trials: list[Trial], bench: Bench) -> None:
    """The physics steps of the trials that went before, in the same calls under the same torques, and nothing else."""
    sims = Simulations(bench.spec, [trial.backend.model for trial in trials])
    sims.position[:] = [trial.backend.posture for trial in trials]
    sims.begin(np.array([trial.backend.drive[0] for trial in trials]))
    for rows, torque, drive, steps in _CALLS:
        sims.advance(rows, torque, drive, steps)


def _usual(trials: list[Trial], bench: Bench) -> None:
    """What people write: a process a core, each with a plain Python loop over one trial after another."""
    _FORKED[:] = [trials, bench]
    with ProcessPoolExecutor(cpu_count(), mp_context=get_context("fork")) as pool:
        list(pool.map(_looped, range(len(trials)), chunksize=4))


def _looped(number: int) -> float:
    trials, bench = _FORKED
    trial, controller = trials[number], bench.controller(trials[number])
    for _ in trial.watched(until(trial.seconds, run(trial.backend, controller))):
        pass
    return float(trial.report().margin)


if __name__ == "__main__":
    from benchmarks.__main__ import show

    show(figures())
