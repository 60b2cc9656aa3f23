"""Many simulations, each of a model of its own, side by side on a thread pool."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import batch

from allegro_twin.errors import ConfigError
from allegro_twin.sim.drivetrain.servos import Rows as Rows
from allegro_twin.sim.drivetrain.servos import Servos
from allegro_twin.sim.drivetrain.transmission import Lengths
from allegro_twin.sim.model import wrist
from allegro_twin.sim.model.postures import Posed, span
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

_CTRL = mujoco.mjtState.mjSTATE_CTRL


def layout(model: mujoco.MjModel) -> tuple[int, ...]:
    """Simulations can stand side by side if this is equal: the sizes of everything that they hold."""
    sizes = ("nq", "nv", "nu", "na", "nbody", "ngeom", "nsite", "njnt", "neq", "nM", "nbvh", "nbvhdynamic")
    return tuple(int(getattr(model, name)) for name in sizes)


class Simulations:
    """One simulation a model, in step; each is bit for bit what `SimBackend` makes of that model.

    Arrays have a row each; those that are attributes are live views. `period`: s, of control, in which timed commands
    of a hand that closes its own loop are counted. Raises ConfigError unless all models have the same layout.
    """

    def __init__(
        self, spec: HandSpec, models: Sequence[mujoco.MjModel], threads: int = 0, period: float = 0.003
    ) -> None:
        if len({layout(model) for model in models}) != 1:
            raise ConfigError("simulations side by side need models of one layout")
        model = models[0]
        self.spec, self.models, self.n = spec, list(models), len(models)
        self._batch = batch.Batch(model, self.n, threads, persistent=True)
        self._batch.set_models(self.models)
        self._batch.reset()
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self.servos = None if "torque" in spec.commands else Servos(spec, models, period)
        """Where the hand closes its own loop: what its motors are told follows from commands."""
        self._lengths, self._posed = Lengths(spec, model), Posed(spec, model)
        self._live = None if self.servos is not None else _columns(spec, model)
        self._motors = [model.actuator(name).id for name in spec.joints]
        names = {model.actuator(i).name for i in range(model.nu)}
        self._wrist = [model.actuator(name).id for name in wrist.JOINTS if name in names]
        self._force = self._batch.bind("actuator_force")
        self.body_position: Array = self._batch.bind("xpos")
        """Of all bodies as they were before the last physics step, (n, bodies, 3), m."""
        self.body_quaternion: Array = self._batch.bind("xquat")
        """(n, bodies, 4), w x y z."""
        self._frames = self._batch.bind("xmat")
        self._palm = model.body("palm_link").id
        self._gravity = np.array([each.opt.gravity for each in models])
        self.push: Array = self._batch.bind("xfrc_applied")
        """On the centre of mass of all bodies, force and moment, world, (n, bodies, 6), N and N·m."""
        self._ctrl = np.zeros((self.n, model.nu))

    @property
    def position(self) -> Array:
        """Of the joints, (n, joints), rad; live for a hand that takes torques."""
        found: Array = (
            self._qpos[:, self._live[0]] if self._live is not None
            else self._lengths.position(self._qpos) if self._lengths.sums
            else self._looked()[0]
        )  # fmt: skip
        return found

    @property
    def velocity(self) -> Array:
        """(n, joints), rad/s; live for a hand that takes torques."""
        found: Array = (
            self._qvel[:, self._live[1]] if self._live is not None
            else self._lengths.velocity(self._qvel) if self._lengths.sums
            else self._looked()[1]
        )  # fmt: skip
        return found

    def place(self, postures: Array) -> None:
        """Put every hand into a posture, (n, joints), rad: with what follows."""
        for row, posture in enumerate(postures):
            self._posed(posture, self._qpos[row])

    def joint(self, name: str) -> Array:
        """The positions of another joint of every model, (n, size), live; a free joint has seven."""
        joint = self.models[0].joint(name)
        place: Array = self._qpos[:, joint.qposadr[0] : joint.qposadr[0] + len(joint.qpos0)]
        return place

    def settle(self) -> None:
        """Compute what follows from positions that were written."""
        self._batch.forward()

    @property
    def torque(self) -> Array:
        """Applied by the motors, (n, joints), N·m; a copy."""
        return np.array(self._force[:, self._motors])

    @property
    def gravity(self) -> Array:
        """In the palm's frame, (n, 3), m/s²."""
        turns = self._frames[:, self._palm].reshape(-1, 3, 3)
        found: Array = (self._gravity[:, None] @ turns)[:, 0]
        return found

    def command(self, rows: Rows, position: Array, effort: Array | None = None, duration: Array | float = 0.0) -> Array:
        """Tell some hands that close their own loop where to be, (rows, joints), rad, with efforts, N·m, and durations,
        (rows,), s; what their motors are told for the period that comes."""
        assert self.servos is not None
        if self.servos.command(rows, position, effort, duration):
            self._batch.set_models(self.models)
        return self.servos.told(rows)

    def advance(self, rows: Rows, told: Array, drive: Array, steps: int) -> None:
        """Let physics steps pass in some simulations while their motors are told something, (rows, joints): torques,
        N·m, or what `command` says; with the wrist's set-points for each step, (rows, steps, 6)."""
        control = np.repeat(self._ctrl[rows][:, None], steps, axis=1)
        control[:, :, self._motors] = told[:, None]
        if self._wrist:
            control[:, :, self._wrist] = drive
        self._batch.rollout(steps, control, _CTRL, [], rows)

    def begin(self, drive: Array) -> None:
        """Set the wrist's first set-points, (n, 6), and compute what follows from the positions; hands that close their
        own loop are limp until they are told something."""
        if self._wrist:
            self._batch.bind("ctrl")[:, self._wrist] = drive
        everyone = np.arange(self.n)
        if self.servos is not None and self.servos.limp(everyone):
            self._batch.set_models(self.models)
        self.settle()
        if self.servos is not None:
            self.servos.reset(everyone, self.position)

    def look(self, row: int, into: mujoco.MjData) -> None:
        """Copy one simulation as its last physics step left it."""
        self._batch.get_data(row, into)

    def _looked(self) -> tuple[Array, Array]:
        """Position and velocity where tendons run through space."""
        data, found = mujoco.MjData(self.models[0]), []
        for row, model in enumerate(self.models):
            self._batch.get_data(row, data)
            found.append(self._lengths.look(model, data))
        position, velocity = zip(*found, strict=True)
        return np.array(position), np.array(velocity)


def _columns(spec: HandSpec, model: mujoco.MjModel) -> tuple[slice | list[int], slice | list[int]]:
    """Of the joints in qpos and in qvel."""
    joints = [model.joint(name) for name in spec.joints]
    return span([joint.qposadr[0] for joint in joints]), span([joint.dofadr[0] for joint in joints])
