"""What a sweep adds to the computing itself: on this computer's cores, and through Ray where it is installed.

An item is a short simulation in the scene of a shipped scenario, 200 of them a unit. Starting processes does not
count: the clock runs from the first units that are done to the last. The engines take turns, and a figure is the median
of their ratios, for the computer may be busy with something else.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.trial import make_trial
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sweep import Local, RayCluster, Sweep, run
from allegro_twin.sweep.local import SweepEngine
from allegro_twin.sweep.processors import core_count

STEPS = 40
"""Of physics an item, some 4 ms of a core."""
UNIT, UNITS, TURNS = 200, 10, 3


def stepped(shared: Mapping[str, Any], items: list[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """For each item: noise on the motors for a while, and where the object is then."""
    model, data, thing = scene()
    rows = []
    for item in items:
        mujoco.mj_resetData(model, data)
        data.ctrl[:16] = np.random.default_rng(item["seed"]).uniform(-0.1, 0.1, 16)
        mujoco.mj_step(model, data, shared["steps"])
        rows.append({"seed": item["seed"], "height": float(data.xpos[thing, 2])})
    return rows


@cache
def scene() -> tuple[mujoco.MjModel, mujoco.MjData, int]:
    """A model with a lemon on its table, memory to simulate it in, and which body the lemon is."""
    trial = make_trial("lemon", load_spec())
    return trial.backend.model, trial.backend.data, trial.backend.model.body("lemon").id


def figures() -> Iterator[tuple[str, float, float, str]]:
    sweep = Sweep("benchmarks.sweeping:stepped", [{"seed": n} for n in range(UNIT * UNITS)], {"steps": STEPS}, UNIT)
    alone, local, ray = list[float](), list[float](), list[float]()
    cluster = _cluster()
    for _ in range(TURNS):
        alone.append(_rate(sweep, Local(0), 1))
        local.append(_rate(sweep, Local(), core_count()))
        if cluster is not None:
            ray.append(_rate(sweep, cluster, core_count()))
    efficiency = statistics.median(many / one for many, one in zip(local, alone, strict=True)) / core_count()
    yield f"sweep, units of {UNIT}: a core of {core_count()} processes / this process alone", efficiency, 0.90, ""
    if ray:
        ratio = statistics.median(far / near for far, near in zip(ray, local, strict=True))
        yield f"sweep, units of {UNIT}: Ray / local, after start-up", ratio, 0.95, ""


def _cluster() -> RayCluster | None:
    try:
        return RayCluster()
    except ConfigError as error:
        print(f"not measured: {error}")
        return None


def _rate(sweep: Sweep, engine: SweepEngine, at_once: int) -> float:
    """Items a second, from when every process has done a unit."""
    times: list[tuple[int, float]] = []
    run(sweep, engine=engine, progress=lambda done, total: times.append((done, time.perf_counter())))
    (first, begin), (last, end) = times[at_once], times[-1]
    return (last - first) / (end - begin)
