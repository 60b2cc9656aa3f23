"""Gains for a hand that takes torques, by the inertia of its joints and what its motors give."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from allegro_twin.sim.hand_import.couplings import coupled_slopes
from allegro_twin.sim.hand_import.urdf import ANGLE, WAY

BANDWIDTH = 30.0
"""rad/s, of each joint alone, with all others held."""
FASTEST = 160.0
"""rad/s, of the fastest damping of all joints together: half of what a loop of 3 ms shows within a period."""
WINDUP = 5.0
"""1/s. The integral gain, per kp."""


class MotorJoint(NamedTuple):
    """A joint that a motor turns by a torque."""

    joint: int
    effort: float | None
    """The most that the motor gives, N·m or N; None: unknown."""


def motor_gains(model: mujoco.MjModel, motors: list[MotorJoint]) -> dict[str, list[float]]:
    """kp, kd, ki and clamp of each motor, in their order: critically damped.

    kp = ω²I and kd = 2ωI − d, of inertia I of a joint at rest with the joints that follow it and all others held, their
    armature included, and of their damping d. ω is `BANDWIDTH`, lower where 2ω times the largest eigenvalue of
    M⁻¹ diag(I) is above `FASTEST`, and of a joint lower where the motor's effort is reached before `ANGLE` rad or `WAY`
    m. ki = `WINDUP` kp, up to kp times that angle or way.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    whole = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, whole)
    moved = np.zeros((model.nv, len(motors)))
    for column, motor in enumerate(motors):
        for joint, slope in ({motor.joint: 1.0} | coupled_slopes(model, motor.joint)).items():
            moved[model.jnt_dofadr[joint], column] = slope
    inertia = moved.T @ whole @ moved
    own = np.diag(inertia)
    most = float(np.abs(np.linalg.eigvals(np.linalg.solve(inertia, np.diag(own)))).max())
    bandwidth = min(BANDWIDTH, FASTEST / (2.0 * most))
    slides = model.jnt_type[[motor.joint for motor in motors]] == mujoco.mjtJoint.mjJNT_SLIDE
    reach = np.where(slides, WAY, ANGLE)
    limit = np.array([np.inf if motor.effort is None else motor.effort for motor in motors])
    kp = np.minimum(bandwidth**2 * own, limit / reach)
    kd = np.maximum(2.0 * np.sqrt(kp * own) - model.dof_damping @ moved**2, 0.0)
    rows = {"kp": kp, "kd": kd, "ki": WINDUP * kp, "clamp": kp * reach}
    return {name: [float(f"{value:.4g}") for value in row] for name, row in rows.items()}
