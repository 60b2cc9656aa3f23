"""Inverse kinematics of any hand beside mink: `python -m benchmarks.hand_ik [MODEL …]`, models or cards.

The same reachable targets for both, 10 µm, no posture near by. mink takes one frame task a step with daqp, from the
middle of the ranges, as its examples do, until it is there or for 200 steps; its time is that of the targets which it
solves.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Iterator

import mujoco
import numpy as np

from allegro_twin.hands import load_spec
from allegro_twin.kinematics import hand_kinematics
from allegro_twin.sim.model import Stage, compile_scene
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

TARGETS, BESIDE, CLOSE = 10_000, 60, 1e-5


def rows(name: str) -> Iterator[str]:
    """A line for each finger of a hand."""
    spec = load_spec(name)
    hand = hand_kinematics(spec)
    for finger in spec.fingers:
        solver = hand.numeric(finger.name)
        postures = np.random.default_rng(5).uniform(solver.lower, solver.upper, (TARGETS, len(solver.lower)))
        targets = solver.fk(postures).position
        began = time.perf_counter()
        found = solver.ik(targets)
        batch = (time.perf_counter() - began) / TARGETS
        reached = found.reachable
        apart = np.linalg.norm(solver.fk(found.position[reached, 0]).position - targets[reached], axis=1)
        alone = []
        for target in targets[:300]:
            began = time.perf_counter()
            solver.ik(target)
            alone.append(time.perf_counter() - began)
        line = (f"{spec.name} {finger.name}: {int((apart < CLOSE).sum())} of {TARGETS} to 10 µm; one call "
                f"{1e6 * statistics.median(alone):.0f} µs (mean {1e6 * statistics.mean(alone):.0f}); batch "
                f"{1e6 * batch:.1f} µs a target")  # fmt: skip
        if not spec.followers and not solver.shared:
            theirs, solved = mink_time(spec, finger.name, targets[:BESIDE])
            line += f"; mink {1e6 * theirs:.0f} µs, {solved} of {BESIDE}: {theirs / batch:.0f} times"
        yield line


def mink_time(spec: HandSpec, finger: str, targets: Array) -> tuple[float, int]:
    """s a target that comes to 10 µm, and how many do."""
    import mink

    model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
    start = np.array(model.qpos0)
    for number in spec.finger(finger).joints:
        joint = model.joint(spec.joints[number])
        start[joint.qposadr[0]] = (spec.lower[number] + spec.upper[number]) / 2.0
    tip = spec.finger(finger).tip
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    palm = mink.SE3.from_rotation_and_translation(
        mink.SO3.from_matrix(data.body("palm_link").xmat.reshape(3, 3)), data.body("palm_link").xpos
    )
    task = mink.FrameTask(tip, "site", position_cost=1.0, orientation_cost=0.0, lm_damping=1e-6)
    limits, spent, solved = [mink.ConfigurationLimit(model)], 0.0, 0
    for target in targets:
        configuration = mink.Configuration(model, start)
        task.set_target(palm @ mink.SE3.from_translation(target))
        began = time.perf_counter()
        for _ in range(200):
            if np.linalg.norm(task.compute_error(configuration)[:3]) < CLOSE:
                solved += 1
                spent += time.perf_counter() - began
                break
            velocity = mink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits)
            configuration.integrate_inplace(velocity, 1.0)
    return spent / max(solved, 1), solved


if __name__ == "__main__":
    for each in sys.argv[1:] or ["allegro", "leap"]:
        for row in rows(each):
            print(row, flush=True)
