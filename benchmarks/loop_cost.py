"""What a control period costs, as a multiple of three bare `mj_step` in a Python loop on the same scene."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import mujoco
import numpy as np

from allegro_twin.app import Rig, assemble
from allegro_twin.app.config import load_config
from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Hold
from allegro_twin.grasping.trial import make_trial
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_posture
from allegro_twin.loop import run
from allegro_twin.recording.recorder import record
from allegro_twin.safety import Guard, Limits
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.types import Sample, frozen

PERIODS, ROUNDS = 1500, 9
Figure = tuple[str, float, float, str]


def figures() -> Iterator[Figure]:
    rig = assemble(load_config("sim_right"))
    assert rig.sim is not None
    home = load_posture("home", rig.spec)
    yield (
        "period, hand only, PD + guard + recording",
        ratio(rig.sim, PD(Hold(home), load_gains("default", rig.spec))),
        2.5,
        "x",
    )
    yield "  the same with PID and gravity feed-forward", _ratio_of(rig), 2.5, "x"
    gripping, controller = _gripping()
    yield "period, gripping an object, PD + guard + recording", ratio(gripping, controller, resume=True), 1.5, "x"


def ratio(sim: SimBackend, controller: PD, *, resume: bool = False) -> float:
    """Our period over the bare one: the median over rounds in which both run, one after the other."""
    spec = sim.spec
    limits = Limits(spec.actuation.torque_limit, frozen(np.full(spec.n_joints, 50.0)), spec.lower, spec.upper)
    backend = Guard(Resumed(sim) if resume else sim, limits)
    samples = run(backend, controller)
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        samples = record(samples, Path(folder) / "bench.arrow", spec, sim.period)
        list(islice(samples, 300))
        for _ in range(ROUNDS):
            ours = _timed(samples)
            ratios.append(ours / _bare(sim))
        samples.close()  # type: ignore[attr-defined]  # A generator, though typed as an iterator.
    return statistics.median(ratios)


class Resumed:
    """A simulation that a reset leaves where it is: in the middle of a grasp."""

    def __init__(self, sim: SimBackend) -> None:
        self._sim, self.spec, self.period = sim, sim.spec, sim.period
        self.write, self.read, self.close = sim.write, sim.read, sim.close
        self.reset = sim.read


def _ratio_of(rig: Rig) -> float:
    assert rig.sim is not None
    return ratio(rig.sim, rig.controller)  # type: ignore[arg-type]  # Any controller will do.


def _gripping() -> tuple[SimBackend, PD]:
    """A tomato soup can lifted and held, and the controller that goes on holding it."""
    spec = load_spec()
    trial = make_trial("tomato_soup_can", spec)
    lifted = next(window.end for window in trial.windows if window.name == "hold")
    grip = PD(trial.reference, load_gains("default", spec))
    for sample in run(trial.backend, grip):
        if sample.state.t >= lifted:
            break
    held = SimBackend(spec, trial.backend.model, posture=trial.grasp.preshape)
    size = mujoco.mj_stateSize(held.model, mujoco.mjtState.mjSTATE_INTEGRATION)
    state = np.empty(size)
    mujoco.mj_getState(held.model, trial.backend.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_setState(held.model, held.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    return held, PD(Hold(trial.grasp.squeeze), load_gains("default", spec))


def _timed(samples: Iterator[Sample]) -> float:
    start = time.perf_counter()
    for _ in islice(samples, PERIODS):
        pass
    return time.perf_counter() - start


def _bare(sim: SimBackend) -> float:
    """The same model from the same state, with the torques that it holds, and nothing around `mj_step`."""
    model, data = sim.model, mujoco.MjData(sim.model)
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)
    state = np.empty(size)
    mujoco.mj_getState(model, sim.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    torque = sim.data.ctrl.copy()
    start = time.perf_counter()
    for _ in range(PERIODS):
        data.ctrl[:] = torque
        for _ in range(3):
            mujoco.mj_step(model, data)
    return time.perf_counter() - start
