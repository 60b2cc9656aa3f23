"""Core of the batches of a hand's simulations: poses of hands and bodies, and the forces on them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from allegro_twin.sim.batch.motors import BatchMotors
from allegro_twin.sim.drivetrain.servos import Rows as Rows
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


class BatchCore(ABC):
    """`n` simulations, a row each in every array. Array attributes are live views unless they say otherwise; a write is
    the simulation's state at its next step.

    `columns`: of the driven joints in positions and in speeds, where these are read and written as they stand there.
    `outputs`: what a step computes besides the state and is read afterwards.
    """

    def __init__(
        self,
        spec: HandSpec,
        model: mujoco.MjModel,
        n: int,
        motors: BatchMotors,
        columns: tuple[slice, slice] | None,
        outputs: Sequence[str],
    ) -> None:
        self.spec, self.model, self.n, self._motors = spec, model, n, motors
        self._qpos, self._qvel, self._ctrl = (self._bind(name) for name in ("qpos", "qvel", "ctrl"))
        self._outputs = {name: self._bind(name) for name in outputs}
        """Bound here, for what is bound later is zero until a step, (n, …)."""
        self.push: Array = self._bind("xfrc_applied")
        """On the centre of mass of every body, force and moment, world, (n, bodies, 6), N and N·m."""
        self._live = None if columns is None else (self._qpos[:, columns[0]], self._qvel[:, columns[1]])

    @abstractmethod
    def _bind(self, name: str) -> Array:
        """A field of all simulations' data, (n, …), live and writeable."""

    def _output(self, name: str) -> Array:
        """An output to read, live."""
        found = self._outputs[name]
        if isinstance(found, np.ndarray):
            found = found.view()
            found.flags.writeable = False
        return found

    @property
    def closes_loop(self) -> bool:
        """Whether the hands close their own loop: their motors take positions, not torques."""
        return self._motors.closes_loop

    @property
    def motors(self) -> slice | list[int]:
        """Actuators of the hand in a model."""
        return self._motors.ids

    @property
    def position(self) -> Array:
        """Positions of the driven joints, (n, joints), rad; live, for writing too, where every motor turns a joint of
        its own."""
        return self._live[0] if self._live is not None else self._read(self._motors.position, self._qpos, 0)

    @property
    def velocity(self) -> Array:
        """Velocities of the driven joints, (n, joints), rad/s; live as `position` is."""
        return self._live[1] if self._live is not None else self._read(self._motors.velocity, self._qvel, 1)

    @property
    @abstractmethod
    def applied_torque(self) -> Array:
        """What the motors gave at the last step, (n, joints), N·m; a copy."""

    @property
    def body_position(self) -> Array:
        """Positions of all bodies before the last physics step, (n, bodies, 3), m."""
        return self._output("xpos")

    @property
    def body_quaternion(self) -> Array:
        """Orientations of all bodies before the last physics step, (n, bodies, 4), w x y z."""
        return self._output("xquat")

    def joint(self, name: str) -> Array:
        """The positions of another joint, (n, size), live; a free joint has seven."""
        joint = self.model.joint(name)
        place: Array = self._qpos[:, joint.qposadr[0] : joint.qposadr[0] + len(joint.qpos0)]
        return place

    def place(self, rows: Rows, posture: Array) -> None:
        """Put hands into postures, (m, joints), rad, with what follows where nothing is in its way."""
        if self._live is None:
            self._qpos[rows] = self._motors.placed(posture, self._qpos[rows])
        else:
            self._live[0][rows] = posture

    def _read(self, read: Callable[[Array], Array], states: Array, which: int) -> Array:
        """Positions or speeds that no columns of the states are: sums of columns."""
        return read(states)
