"""Simulations side by side with a model each: what trials of grasps run on."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.sim.batch.core import BatchCore, Rows
from allegro_twin.sim.batch.cpu import bind, simulation_pool
from allegro_twin.sim.batch.motors import BatchMotors
from allegro_twin.sim.drivetrain.servos import Servos
from allegro_twin.sim.model.wrist import WRIST_JOINTS
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


def layout(model: mujoco.MjModel) -> tuple[float, ...]:
    """The timestep, s, and the sizes of everything that a simulation holds: models of one batch have the same."""
    sizes = ("nq", "nv", "nu", "na", "nbody", "ngeom", "nsite", "njnt", "neq", "nM", "nbvh", "nbvhdynamic")
    return float(model.opt.timestep), *(int(getattr(model, name)) for name in sizes)


class SeparateModelBatch(BatchCore):
    """A simulation of each of some models on a thread pool, bit for bit what `SimBackend` makes of that model; it keeps
    everything that MuJoCo computes. `period`: s, of control, in which timed commands of a hand that closes its own loop
    are counted. Raises ConfigError for models of different layouts, and for more simulations than there is memory
    for."""

    def __init__(
        self, spec: HandSpec, models: Sequence[mujoco.MjModel], threads: int = 0, period: float = 0.003
    ) -> None:
        self.models = list(models)
        """One for each simulation."""
        if len({layout(model) for model in self.models}) != 1:
            raise ConfigError("simulations side by side need models of one layout")
        model, n = self.models[0], len(self.models)
        self._batch = simulation_pool(model, n, threads, persistent=True)
        self._batch.set_models(self.models)
        self._batch.reset()
        names = {model.actuator(i).name for i in range(model.nu)}
        self._wrist = [model.actuator(name).id for name in WRIST_JOINTS if name in names]
        self._still = np.zeros((n, model.nu))
        self.scratch = mujoco.MjData(model)
        self._palm = model.body("palm_link").id
        self._gravity = np.array([each.opt.gravity for each in self.models])
        motors = BatchMotors(spec, model, alone=False)
        self.servos = Servos(spec, self.models, period) if motors.closes_loop else None
        """Firmware of hands that close their own loop."""
        columns = None if motors.closes_loop else motors.slices
        super().__init__(spec, model, n, motors, columns, ("actuator_force", "xpos", "xquat", "xmat"))

    @property
    def applied_torque(self) -> Array:
        return np.copy(self._output("actuator_force")[:, self.motors])

    @property
    def gravity(self) -> Array:
        """In the palm's frame, (n, 3), m/s²."""
        turns = self._output("xmat")[:, self._palm].reshape(-1, 3, 3)
        found: Array = (self._gravity[:, None] @ turns)[:, 0]
        return found

    def begin(self, set_points: Array) -> None:
        """Set the wrist's first set-points, (n, 6), and compute what follows from the positions; hands that close their
        own loop are limp until they are told something."""
        if self._wrist:
            self._ctrl[:, self._wrist] = set_points
        everyone = np.arange(self.n)
        if self.servos is not None and self.servos.limp(everyone):
            self._batch.set_models(self.models)
        self._batch.forward()
        if self.servos is not None:
            self.servos.reset(everyone, self.position)

    def servo_control(
        self, rows: Rows, position: Array, effort: Array | None = None, duration: Array | float = 0.0
    ) -> Array:
        """What motors of some hands that close their own loop are told in the period that comes, (rows, joints), to be
        at positions, (rows, joints), rad, with efforts, N·m, after durations, (rows,), s."""
        assert self.servos is not None
        if self.servos.command(rows, position, effort, duration):
            self._batch.set_models(self.models)
        return self.servos.commands(rows)

    def copy(self, rows: Rows, of: Rows) -> None:
        """Make some what others are, (rows,) each; what is computed from that is theirs after the next step."""
        self._batch.state[rows] = self._batch.state[of]
        if self.servos is not None and self.servos.copy(rows, of):
            self._batch.set_models(self.models)

    def advance(self, rows: Rows, control: Array, set_points: Array, steps: int) -> None:
        """Let physics steps pass in some simulations while their motors are told something, (rows, joints): torques,
        N·m, or a `servo_control`; with the wrist's set-points for each step, (rows, steps, 6)."""
        told = np.repeat(self._still[rows][:, None], steps, axis=1)
        told[:, :, self.motors] = control[:, None]
        if self._wrist:
            told[:, :, self._wrist] = set_points
        self._batch.rollout(steps, told, mujoco.mjtState.mjSTATE_CTRL, [], rows)

    def look(self, row: int) -> mujoco.MjData:
        """One simulation as its last physics step left it: `scratch`, until another look."""
        return self._batch.get_data(row, self.scratch)

    def _bind(self, name: str) -> Array:
        return bind(self._batch, name)

    def _read(self, read: Callable[[Array], Array], states: Array, which: int) -> Array:
        """Positions or speeds that no column of the states is: sums of columns, or those of tendons in space."""
        if self._motors.readable:
            return read(states)
        data, found = mujoco.MjData(self.model), []
        for row, model in enumerate(self.models):
            self._batch.get_data(row, data)
            found.append(self._motors.lengths.look(model, data)[which])
        return np.array(found)
