"""The actuators of a hand in its simulation: what they are told, where they are, and what they give."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, PositionCommand, Vector


class Servos:
    """Motors whose firmware closes the loop: an actuator with a spring to where it is told to go, on a joint or on a
    tendon. Positions are those of the actuator, its length in MuJoCo's words: rad, or m.

    Until the first command of a session, and after one without effort, they give nothing.
    """

    def __init__(self, spec: HandSpec, model: mujoco.MjModel, period: float) -> None:
        self._model, self._period = model, period
        self._ids = np.array([model.actuator(name).id for name in spec.joints])
        bias, gain = model.actuator_biasprm[self._ids], model.actuator_gainprm[self._ids, 0]
        # Force = gain u + b0 + b1 l + b2 dl/dt is zero at rest where u = - (b0 + b1 l) / gain.
        self._offset, self._slope = -bias[:, 0] / gain, -bias[:, 1] / gain
        self._limit = spec.actuation.torque_limit
        limited = model.actuator_forcelimited[self._ids].astype(bool)[:, None]
        own = np.where(limited, model.actuator_forcerange[self._ids], self._limit[:, None] * [-1.0, 1.0])
        self._range = np.clip(own, -self._limit[:, None], self._limit[:, None])
        model.actuator_forcelimited[self._ids] = True
        self._tendons = bool((model.actuator_trntype[self._ids] == mujoco.mjtTrn.mjTRN_TENDON).any())
        joints, self._gear = model.actuator_trnid[self._ids, 0], model.actuator_gear[self._ids, 0].copy()
        places = ([], []) if self._tendons else (model.jnt_qposadr[joints], model.jnt_dofadr[joints])
        self._qpos, self._dof = (np.array(place, dtype=int) for place in places)
        self._wish = np.zeros(len(self._ids))
        self._from, self._ticks, self._passed = self._wish, 0, 0

    def reset(self, data: mujoco.MjData) -> None:
        """Limp, where they are."""
        self._let(np.zeros(len(self._ids)))
        self._wish = self._from = self.position(data)
        self._ticks = 0

    def command(self, command: PositionCommand) -> None:
        """From the next period on."""
        effort = self._limit if command.effort is None else np.minimum(command.effort, self._limit)
        self._let(effort / self._limit)
        self._from = self._wish if self._ticks == 0 else self._now()
        self._wish, self._passed = command.position, 0
        self._ticks = 0 if command.duration is None else round(command.duration / self._period)

    def drive(self, data: mujoco.MjData) -> None:
        """Before a period: where to be at its end."""
        self._passed += 1
        data.ctrl[self._ids] = self._offset + self._slope * self._now()

    def release(self) -> None:
        """Limp, for good."""
        self._let(np.zeros(len(self._ids)))

    @contextmanager
    def able(self) -> Iterator[None]:
        """With all that they can give, for who asks what the model is."""
        now = self._model.actuator_forcerange[self._ids].copy()
        self._let(np.ones(len(self._ids)))
        yield
        self._model.actuator_forcerange[self._ids] = now

    def position(self, data: mujoco.MjData) -> Array:
        """(n,), rad or m."""
        if self._tendons:
            # A step leaves lengths as they were before it moved the joints.
            for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_transmission):
                stage(self._model, data)
            return np.array(data.actuator_length[self._ids])
        return np.array(data.qpos[self._qpos] * self._gear)

    def velocity(self, data: mujoco.MjData) -> Array:
        """(n,), rad/s or m/s."""
        if self._tendons:
            mujoco.mj_fwdVelocity(self._model, data)
            return np.array(data.actuator_velocity[self._ids])
        return np.array(data.qvel[self._dof] * self._gear)

    def _now(self) -> Vector:
        """Where the way of a timed command has led; its end for any other."""
        if self._passed >= self._ticks:
            return self._wish
        return self._from + (self._wish - self._from) * (self._passed / self._ticks)

    def _let(self, share: Vector) -> None:
        """What share of its force each motor may give."""
        self._model.actuator_forcerange[self._ids] = self._range * share[:, None]
