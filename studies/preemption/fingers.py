"""The fingers of many trials: each closes when it is told to, and squeezes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from allegro_twin.control import Gains, GravityFeedforward
from allegro_twin.grasping.batch import clamp_torques, pd_torque
from allegro_twin.hands import Grasp
from allegro_twin.safety import Limits
from allegro_twin.sim.batch import Rows, SeparateModelBatch
from allegro_twin.types import Array
from studies.preemption.protocol import Motion


class Fingers:
    """Those of n trials of one hand, from their pre-shapes through the closed posture to the squeeze:

    q(t) = q_pre + m((t - t₀)/T_c) (q_close - q_pre) + m((t - t₀ - T_c)/T_s) (q_squeeze - q_close), with m of minimum
    jerk, held at 0 and 1 outside its time, and t₀ when the hand begins.
    """

    def __init__(
        self, grasps: Sequence[Grasp], motion: Motion, gains: Gains, gravity: GravityFeedforward, limits: Limits
    ) -> None:
        self.open = np.array([grasp.preshape for grasp in grasps])
        closed = np.array([grasp.close for grasp in grasps])
        self._close = closed - self.open
        self._squeeze = np.array([grasp.squeeze for grasp in grasps]) - closed
        self.begun = np.full(len(grasps), np.inf)
        """When each has begun to close, s, (n,); infinite: not yet."""
        self._motion, self._gains, self._gravity, self._limits = motion, gains, gravity, limits

    def done(self, rows: Rows, t: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which have closed and squeezed."""
        return np.asarray(t >= self.begun[rows] + self._motion.close + self._motion.squeeze - 1e-9)

    def wanted(self, rows: Rows, t: float) -> tuple[Array, Array]:
        """Where they should be, rad, and how fast, rad/s: (rows, joints) each."""
        since = t - self.begun[rows]
        close, closing = _minimum_jerk(since / self._motion.close)
        squeeze, squeezing = _minimum_jerk((since - self._motion.close) / self._motion.squeeze)
        position = self.open[rows] + close * self._close[rows] + squeeze * self._squeeze[rows]
        speed = (
            closing / self._motion.close * self._close[rows] + squeezing / self._motion.squeeze * self._squeeze[rows]
        )
        return position, speed

    def __call__(self, rows: Rows, t: float, sims: SeparateModelBatch) -> Array:
        """What the motors are told for the period that comes, (rows, joints)."""
        position, speed = self.wanted(rows, t)
        if sims.closes_loop:
            return sims.servo_control(rows, np.clip(position, self._limits.lower, self._limits.upper))
        torque = pd_torque(sims, rows, position, speed, (self._gains.kp, self._gains.kd), self._gravity)
        return clamp_torques(torque, sims.position[rows], self._limits)


def _minimum_jerk(s: Array) -> tuple[Array, Array]:
    """The part of the way at a part of the time, and its derivative, (k, 1) each."""
    s = np.clip(s, 0.0, 1.0)[:, None]
    return s**3 * (10.0 + s * (6.0 * s - 15.0)), 30.0 * s**2 * (1.0 - s) ** 2
