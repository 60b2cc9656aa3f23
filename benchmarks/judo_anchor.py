"""Judo's own in-hand tasks, in lockstep, beside ours: `python benchmarks/judo_anchor.py MESHES TASK … [--seconds 30]`.

Judo (judo-rai 0.1.0) needs MuJoCo 3.6, so it runs with an interpreter of its own that has judo-rai, and this file does
not import this package. Its wheel has no meshes. Only those of the fingertips touch anything: MESHES is a folder with
`tip.obj` and `thumb_tip.obj`, those of MuJoCo Menagerie's `leap_hand/assets`. What is only seen is a box here.
Prints a JSON line for each task: goals reached, drops, share of the time that the cube is within 10 cm of its place,
and processor seconds of a plan, with Judo's own settings.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np

SEEN = ("palm_right", "base", "proximal", "medial", "distal", "thumb_base", "thumb_proximal", "thumb_distal",
        "leap_mount")  # fmt: skip
TOUCHING = ("tip", "thumb_tip")
IN_HAND = 0.1  # m. One that lies on the floor of `caltech_leap_cube` is never counted as dropped by Judo.
STATE = ("qpos", "qvel", "xpos", "xquat", "mocap_pos", "mocap_quat")
BOX = "\n".join(
    [f"v {x} {y} {z}" for x in (-0.01, 0.01) for y in (-0.01, 0.01) for z in (-0.01, 0.01)]
    + ["f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4", ""]
)


def lay_meshes(folder: Path) -> None:
    """Put the meshes where Judo looks for them."""
    from judo import MODEL_PATH

    target = Path(MODEL_PATH) / "meshes" / "leap"
    target.mkdir(parents=True, exist_ok=True)
    for name in SEEN:
        (target / f"{name}.obj").write_text(BOX)
    for name in TOUCHING:
        shutil.copy(folder / f"{name}.obj", target)


def measure(name: str, optimizer: str, seconds: float, seed: int) -> dict[str, Any]:
    """Run a task for so many seconds of the hand's time, which stops while the planner works."""
    import mujoco
    from judo.app.structs import MujocoState
    from judo.controller.controller import Controller, ControllerConfig
    from judo.optimizers import get_registered_optimizers
    from judo.tasks import get_registered_tasks

    np.random.seed(seed)
    task = get_registered_tasks()[name][0]()
    kind, settings_type = get_registered_optimizers()[optimizer]
    settings, planning = settings_type(), ControllerConfig()
    for each in (settings, planning):
        each.set_override(name)
    controller = Controller(planning, task, kind(settings, task.nu))
    count = {"goals": 0, "drops": 0}
    count_calls(task, "_update_goal_quat", count, "goals")
    count_calls(task, "reset", count, "drops")  # Which draws a goal, too.
    period, data, used, plans, held = task.sim_model.opt.timestep, task.data, 0.0, 0, 0
    every = max(round(1.0 / planning.control_freq / period), 1)
    for step in range(round(seconds / period)):
        now = step * period
        if step % every == 0:
            state = {part: np.copy(getattr(data, part)) for part in STATE}
            controller.update_states(MujocoState(time=now, **state, sim_metadata=task.get_sim_metadata()))
            began = time.process_time()
            controller.update_action()
            used, plans = used + time.process_time() - began, plans + 1
        data.ctrl[:] = controller.action(now)
        task.pre_sim_step()
        mujoco.mj_step(task.sim_model, data)
        held += bool(np.linalg.norm(data.qpos[:3] - task.goal_pos) < IN_HAND)
        task.post_sim_step()
    return {
        "task": name, "optimizer": optimizer, "seed": seed, "seconds": seconds,
        "goals": count["goals"] - count["drops"], "drops": count["drops"],
        "in_hand": round(held * period / seconds, 3), "cpu_a_plan": round(used / plans, 3),
        "plans_a_second": planning.control_freq, "samples": settings.num_rollouts, "horizon": planning.horizon,
    }  # fmt: skip


def count_calls(task: Any, method: str, count: dict[str, int], name: str) -> None:
    """Count the calls of a task's method."""
    called = getattr(task, method)

    def counted() -> None:
        count[name] += 1
        called()

    setattr(task, method, counted)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("tasks", nargs="+", choices=["leap_cube", "leap_cube_down", "caltech_leap_cube"])
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--optimizer", default="ps", help="ps, cem or mppi")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    lay_meshes(given.meshes)
    for each in given.tasks:
        print(json.dumps(measure(each, given.optimizer, given.seconds, given.seed)), flush=True)
