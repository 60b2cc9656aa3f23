"""What the environments cost over bare MuJoCo, and against gymnasium-robotics where it is installed.

The two sides of a ratio take turns, and each counts with its fastest round: what else the machine does slows both and
decides nothing. Against a peer it is the median of the rounds' ratios.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np

from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.tasks import TASKS
from allegro_twin.sim.batch.cpu import CpuBatch
from allegro_twin.sim.batch.shared_model import SharedModelBatch

ROUNDS, BURST, STEPS, MANY = 25, 12, 60, 256
PEER = {"timestep": 0.002, "period": 0.004, "decimation": 10, "palm": "allowed"}  # Its 20 substeps of 2 ms a step.
_USER = int(mujoco.mjtState.mjSTATE_USER)
Figure = tuple[str, float, float, str]


def figures() -> Iterator[Figure]:
    # First, for a process begins with the peak of the one that started it.
    yield "memory of 4,096 simulations (bar: at most)", _in_process("memory"), 2.0, "GB"
    for task in TASKS:
        plain, wrapped = single(task)
        yield f"single {task} over its bare physics steps (bar: at least)", plain, 0.70, "x"
        yield f"the same as gymnasium.make wraps it ({task})", wrapped, 0.70, "x"
    for task in ("Reorient", "Reach", "Grasp"):
        yield f"{MANY} of {task} over their bare physics steps (at least)", vector(task), 0.90, "x"
    yield "reset over a step (bar: at most)", reset(), 1.0, "x"
    yield from peer()


def single(task: str) -> tuple[float, float]:
    """Env steps a second over those of bare stepping, of one environment; bare and as made. In seconds of the
    processor, for one thread does it all."""
    import gymnasium

    made = gymnasium.make(f"allegro_twin.gym:AllegroTwin/{task}-v0")
    env = made.unwrapped
    still = np.zeros(16, np.float32)
    bare = []
    seconds: list[list[float]] = [[], []]
    for _ in range(ROUNDS):
        for kept, each in zip(seconds, (made, env), strict=True):
            begun(made, still)
            kept.append(timed(lambda: each.step(still), BURST, time.process_time))  # noqa: B023  # Called at once.
        begun(made, still)
        alone = Physics(env.engine.worlds, lambda: env.step(still), BURST)  # type: ignore[attr-defined]  # Ours.
        bare.append(timed(alone.play, 1, time.process_time) / BURST)
    wrapped, plain = (min(kept) for kept in seconds)
    return min(bare) / plain, min(bare) / wrapped


def vector(task: str) -> float:
    """The same of a batch."""
    env = HandVectorEnv(task, MANY, threads=2)
    still, ours, bare = np.zeros((MANY, 16), np.float32), [], []
    for _ in range(ROUNDS // 3):
        env.reset(seed=0)
        ours.append(timed(lambda: env.step(still), BURST // 2))
        env.reset(seed=0)
        alone = Physics(env.engine.worlds, lambda: env.step(still), BURST // 2)
        bare.append(timed(alone.play, 1) / (BURST // 2))
    return min(bare) / min(ours)


def begun(env: Any, still: Any) -> None:
    """Some steps into an episode, always the same."""
    env.reset(seed=0)
    for _ in range(BURST):
        env.step(still)


class Physics:
    """What some actions were in MuJoCo's own steps and nothing else: from the same state, in the same models, with the
    same torques and forces in every step, and as one call an action, which is the fastest that there is."""

    def __init__(self, worlds: SharedModelBatch, act: Callable[[], object], times: int) -> None:
        assert isinstance(worlds, CpuBatch), "MuJoCo's own steps are those on processors"
        self._simulations, self._start = worlds._batch, worlds._batch.state.copy()
        self._inputs: list[Any] = []
        taken = worlds.step

        def noted(rows: Any, count: int) -> None:
            assert rows is None, "an episode has ended"
            self._inputs += [[_inputs(worlds.model, row) for row in self._simulations.state]] * count
            taken(rows, count)

        worlds.step = noted  # type: ignore[method-assign]  # For as long as it is listened to.
        for _ in range(times):
            act()
        worlds.step = taken  # type: ignore[method-assign]
        end = self._simulations.state.copy()
        # By action: (simulations, steps, inputs).
        self._inputs = [np.ascontiguousarray(part) for part in np.split(np.stack(self._inputs, axis=1), times, axis=1)]
        self._seen = {"qpos": np.empty((len(end), self._inputs[0].shape[1], worlds.model.nq))}
        self.play()
        np.testing.assert_array_equal(self._simulations.state, end)

    def play(self) -> None:
        self._simulations.state[:] = self._start
        for inputs in self._inputs:
            self._simulations.rollout(inputs.shape[1], inputs, _USER, record=("qpos",), out=self._seen)


def _inputs(model: Any, state: Any) -> Any:
    """What a user sets, of all that decides how a simulation goes on."""
    inputs = np.empty(mujoco.mj_stateSize(model, _USER))
    mujoco.mj_extractState(model, state, int(mujoco.mjtState.mjSTATE_INTEGRATION), inputs, _USER)
    return inputs


def reset() -> float:
    """Everything randomised, on the task with the most objects."""
    env = HandEnv("Grasp", randomise="default")
    still = np.zeros(16, np.float32)
    ratios = []
    for _ in range(ROUNDS // 3):
        again = timed(env.reset)
        ratios.append(again / timed(lambda: env.step(still)))
    return statistics.median(ratios)


def memory() -> float:
    """The most that a process with 4,096 simulations and nothing else holds, GB; run in a process of its own."""
    env = HandVectorEnv("Grasp", 4096, randomise="default")
    env.reset(seed=0)
    env.step(np.zeros((4096, 16), np.float32))
    return _peak() / 1e6


def peer() -> Iterator[Figure]:
    """At the peer's own setting, an object in the hand, random actions; left out where it is not installed."""
    try:
        import gymnasium_robotics  # noqa: F401  # Only whether it is there.
    except ImportError:
        return
    yield "single environment over HandManipulateBlock (at least)", against_single(), 2.0, "x"
    yield "vector environment on 2 cores over its AsyncVectorEnv(2)", against_vector(), 3.6, "x"


def against_single() -> float:
    theirs, ours = peer_env(), HandEnv("Reorient", **PEER)  # type: ignore[arg-type]  # By name.
    return statistics.median(_random(theirs) / _random(ours) for _ in range(ROUNDS // 3))


def against_vector() -> float:
    """Environment steps a second, all together."""
    import gymnasium

    theirs = gymnasium.vector.AsyncVectorEnv([peer_env, peer_env], context="spawn")
    ours = HandVectorEnv("Reorient", MANY, threads=2, **PEER)  # type: ignore[arg-type]  # By name.
    ratios = [(_random(theirs) / 2) / (_random(ours, STEPS // 6) / MANY) for _ in range(ROUNDS // 3)]
    theirs.close()
    return statistics.median(ratios)


def peer_env() -> Any:
    """HandManipulateBlock, repaired for MuJoCo 4 here and nowhere else: its joint types are compared as integers."""
    import gymnasium
    import gymnasium_robotics
    import mujoco
    from gymnasium_robotics.utils import mujoco_utils

    gymnasium.register_envs(gymnasium_robotics)
    for old in ("get_joint_qpos", "get_joint_qvel", "set_joint_qpos", "set_joint_qvel"):
        function = getattr(mujoco_utils, old)
        function.__globals__["mujoco"] = _Integers(mujoco)
    return gymnasium.make("HandManipulateBlock-v1", disable_env_checker=True)


class _Integers:
    """MuJoCo with joint types that are equal to the integers in a model."""

    def __init__(self, real: Any) -> None:
        self._real = real

    def __getattr__(self, name: str) -> Any:
        if name == "mjtJoint":
            kind = self._real.mjtJoint
            return type("mjtJoint", (), {key: int(value) for key, value in kind.__members__.items()})
        return getattr(self._real, name)


def timed(act: Callable[[], object], times: int = STEPS, clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds a call."""
    start = clock()
    for _ in range(times):
        act()
    return (clock() - start) / times


def _random(env: Any, times: int = STEPS * 2) -> float:
    """Seconds a step with random actions, resets included as they fall."""
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(times)]
    single = not hasattr(env, "num_envs")
    start = time.perf_counter()
    for action in actions:
        _, _, ended, cut, _ = env.step(action)
        if single and (ended or cut):
            env.reset()
    return (time.perf_counter() - start) / times


def _in_process(name: str) -> float:
    code = f"from benchmarks.gym import {name}; print({name}())"
    return float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)


def _peak() -> float:
    """The most memory this process has held, kB (Linux)."""
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


if __name__ == "__main__":
    for what, measured, bar, unit in figures():
        print(f"{what:<64}{measured:>8.2f} {unit:<2}{bar:>8} {unit}")
