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

import numpy as np

from allegro_twin.gym.env import HandEnv
from allegro_twin.gym.vector import HandVectorEnv

ROUNDS, BURST, STEPS, MANY = 25, 12, 60, 256
PEER = {"timestep": 0.002, "period": 0.004, "decimation": 10}  # Its 20 substeps of 2 ms a step.
Figure = tuple[str, float, float, str]


def figures() -> Iterator[Figure]:
    for task in ("Reorient", "Reach", "Grasp"):
        plain, wrapped = single(task)
        yield f"single {task} over the bare mj_step loop (bar: at least)", plain, 0.70, "x"
        yield f"the same as gymnasium.make wraps it ({task})", wrapped, 0.70, "x"
    yield f"{MANY} environments over the bare mujoco.batch loop (at least)", vector(), 0.90, "x"
    yield "reset over a step (bar: at most)", reset(), 1.0, "x"
    yield "memory of 4,096 simulations (bar: at most)", _in_process("memory"), 2.0, "GB"
    yield from peer()


def single(task: str) -> tuple[float, float]:
    """Env steps a second over those of bare stepping from the same state with the same torques; bare and as made."""
    import gymnasium
    import mujoco

    made = gymnasium.make(f"allegro_twin.gym:AllegroTwin/{task}-v0")
    env, still = made.unwrapped, np.zeros(16, np.float32)
    worlds = env.engine.worlds  # type: ignore[attr-defined]  # Ours.
    count = env.engine.settings.decimation * 3  # type: ignore[attr-defined]  # Ours.
    seconds: list[list[float]] = [[], [], []]
    for _ in range(ROUNDS):
        for kept, each in zip(seconds, (made, env), strict=False):
            made.reset(seed=0)
            for _ in range(BURST):
                each.step(still)
            seen = worlds.snapshot(0)
            kept.append(timed(lambda: each.step(still), BURST))  # noqa: B023  # Called at once.
        seconds[2].append(timed(lambda: mujoco.mj_step(seen.model, seen.data, count), BURST))  # noqa: B023
    wrapped, plain, bare = (min(kept) for kept in seconds)
    return bare / plain, bare / wrapped


def vector() -> float:
    """The same for a batch, over one that only steps: one call for all physics steps of an action."""
    from mujoco import batch

    env = HandVectorEnv("Reorient", MANY, threads=2)
    worlds, count = env.engine.worlds, env.engine.settings.decimation * 3
    bare = batch.Batch(worlds.model, MANY, 2)
    still, ours, theirs = np.zeros((MANY, 16), np.float32), [], []
    for _ in range(ROUNDS // 3):
        env.reset(seed=0)
        bare.state[:] = [worlds.state(row) for row in range(MANY)]
        ours.append(timed(lambda: env.step(still), BURST // 2))
        theirs.append(timed(lambda: bare.step(nstep=count), BURST // 2))
    return min(theirs) / min(ours)


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


def timed(act: Callable[[], object], times: int = STEPS) -> float:
    """Seconds a call."""
    start = time.perf_counter()
    for _ in range(times):
        act()
    return (time.perf_counter() - start) / times


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
