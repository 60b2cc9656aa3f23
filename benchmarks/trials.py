"""What many trials side by side cost, in CPU time of one core, of which an evaluation uses one a process.

How much of it is the physics itself, and against what people write: a process a core that loops `mj_step` over one
trial after another. Trials of the mug to the end of the lift, each with the mug a little elsewhere.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import mujoco
import numpy as np

from allegro_twin.grasping.batch.batched_trials import run_trials
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner
from allegro_twin.grasping.scenario import TrialProtocol, load_protocol, load_scenario
from allegro_twin.grasping.trial import Trial
from allegro_twin.grasping.uncertainty import Uncertainty, sample_perturbations
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.loop import run, until
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.separate_models import SeparateModelBatch
from allegro_twin.sim.model.wrist import WRIST_JOINTS
from allegro_twin.types import Array

Figure = tuple[str, float, float, str]
SCENARIO, COUNT, TURNS = "mug", 32, 3
_CALLS: list[tuple[Rows, Array, Array, int]] = []


def figures() -> Iterator[Figure]:
    """Ratios of trials a CPU second; the middle of three turns."""
    bench = TrialRunner(load_spec(), threads=1)
    seconds = np.array([[*_together(bench), _seconds(_looped, bench), _seconds(_stepped, bench)] for _ in range(TURNS)])
    whole, physics, looped, stepped = seconds.T
    yield "trials side by side: share of their time that is physics", float(np.median(physics / whole)), 0.9, ""
    yield "trials side by side / this project's loop, trial after trial", float(np.median(looped / whole)), 2.5, "x"
    yield "trials side by side / mj_step alone, nothing decided or seen", float(np.median(stepped / whole)), 2.5, "x"


def lifting() -> TrialProtocol:
    """`table_pick` to the end of the lift."""
    protocol = load_protocol("table_pick")
    phases = [phase.model_copy(update={"check": phase.name == "lift"}) for phase in protocol.phases]
    return protocol.model_copy(update={"phases": tuple(phases[: 1 + [p.name for p in phases].index("lift")])})


def _cases(bench: TrialRunner) -> list[TrialCase]:
    scenario, path = load_scenario(SCENARIO)
    grasp = load_grasp(scenario.grasp, bench.spec)
    drawn = sample_perturbations(Uncertainty(torque=0.0), COUNT)
    return [TrialCase(scenario, grasp, draw, lifting(), path.parent) for draw in drawn]


def _seconds(work: Callable[[list[Trial], TrialRunner], None], bench: TrialRunner) -> float:
    trials = [bench.trial(case) for case in _cases(bench)]
    began = time.process_time()
    work(trials, bench)
    return time.process_time() - began


def _together(bench: TrialRunner) -> tuple[float, float]:
    """All of it, and the physics in it, s."""
    _CALLS.clear()
    advance, physics = SeparateModelBatch.advance, 0.0

    def kept(sims: SeparateModelBatch, rows: Rows, torque: Array, drive: Array, steps: int) -> None:
        nonlocal physics
        _CALLS.append((rows, torque, drive, steps))
        began = time.process_time()
        advance(sims, rows, torque, drive, steps)
        physics += time.process_time() - began

    def work(trials: list[Trial], bench: TrialRunner) -> None:
        run_trials(trials, [bench.controller(trial) for trial in trials], bench.limits, threads=1)

    SeparateModelBatch.advance = kept  # type: ignore[assignment, method-assign]
    whole = _seconds(work, bench)
    SeparateModelBatch.advance = advance  # type: ignore[method-assign]
    return whole, physics


def _looped(trials: list[Trial], bench: TrialRunner) -> None:
    """Each with its controller, and judged, as `allegro-twin run` performs it but for the guard."""
    for trial in trials:
        for _ in trial.watched(until(trial.seconds, run(trial.backend, bench.controller(trial)))):
            pass
        trial.report()


def _stepped(trials: list[Trial], bench: TrialRunner) -> None:
    """The least that such a loop could do: the steps that went before, from Python, with nothing decided or seen."""
    for row, trial in enumerate(trials):
        model, data = trial.backend.model, trial.backend.data
        trial.backend.reset()
        motors = [model.actuator(name).id for name in bench.spec.joints]
        slides = [model.actuator(name).id for name in WRIST_JOINTS]
        for rows, torque, drive, _ in _CALLS:
            if row in rows:
                place = int(np.searchsorted(rows, row))
                data.ctrl[motors] = torque[place]
                for pose in drive[place]:
                    data.ctrl[slides] = pose
                    mujoco.mj_step(model, data)


if __name__ == "__main__":
    from benchmarks.figures import show

    show(figures())
