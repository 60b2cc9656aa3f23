"""Many simulations, each of a model of its own, side by side on a thread pool."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim import wrist
from allegro_twin.sim.backend import span
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

Rows = NDArray[np.int64]
_CTRL = mujoco.mjtState.mjSTATE_CTRL


def layout(model: mujoco.MjModel) -> tuple[int, ...]:
    """Simulations can stand side by side if this is equal: the sizes of everything that they hold."""
    sizes = ("nq", "nv", "nu", "na", "nbody", "ngeom", "nsite", "njnt", "neq", "nM", "nbvh", "nbvhdynamic")
    return tuple(int(getattr(model, name)) for name in sizes)


class Simulations:
    """One simulation a model, in step; each is bit for bit what `SimBackend` makes of that model.

    Arrays are live views with a row each. Raises ConfigError unless all models have the same layout.
    """

    def __init__(self, spec: HandSpec, models: Sequence[mujoco.MjModel], threads: int = 0) -> None:
        if len({layout(model) for model in models}) != 1:
            raise ConfigError("simulations side by side need models of one layout")
        model = models[0]
        self.spec, self.models, self.n = spec, list(models), len(models)
        self._batch = batch.Batch(model, self.n, threads, persistent=True)
        self._batch.set_models(self.models)
        self._batch.reset()
        qpos, qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        joints = [model.joint(name) for name in spec.joints]
        self.position: Array = qpos[:, span([joint.qposadr[0] for joint in joints])]
        """Of the joints, (n, joints), rad."""
        self.velocity: Array = qvel[:, span([joint.dofadr[0] for joint in joints])]
        """(n, joints), rad/s."""
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

    def joint(self, name: str) -> Array:
        """The positions of another joint of every model, (n, size), live; a free joint has seven."""
        joint = self.models[0].joint(name)
        place: Array = self._batch.bind("qpos")[:, joint.qposadr[0] : joint.qposadr[0] + len(joint.qpos0)]
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

    def advance(self, rows: Rows, torque: Array, drive: Array, steps: int) -> None:
        """Let physics steps pass in some simulations under torques (rows, joints), N·m, with the wrist's set-points for
        each step, (rows, steps, 6)."""
        control = np.repeat(self._ctrl[rows][:, None], steps, axis=1)
        control[:, :, self._motors] = torque[:, None]
        if self._wrist:
            control[:, :, self._wrist] = drive
        self._batch.rollout(steps, control, _CTRL, [], rows)

    def begin(self, drive: Array) -> None:
        """Set the wrist's first set-points, (n, 6), and compute what follows from the positions."""
        if self._wrist:
            self._batch.bind("ctrl")[:, self._wrist] = drive
        self.settle()

    def look(self, row: int, into: mujoco.MjData) -> None:
        """Copy one simulation as its last physics step left it."""
        self._batch.get_data(row, into)
