"""Simulations that share a model and its variants: what tasks of learning run on, on processors or on a device.

A variant is another object, another place of the palm, another friction, in a model of the same layout. A simulation
takes one by copying the fields in which the variants differ into its own row, so a reset compiles nothing.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.sim.batch.core import BatchCore, Rows
from allegro_twin.sim.batch.motors import BatchMotors
from allegro_twin.sim.model.contact_sensors import PREFIX
from allegro_twin.sim.model.scene import PRESENTER
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

_FIELDS = "fields/"
"""Before the names of model fields among `live_arrays`."""
_FORCES = ("actuator_force", "qfrc_constraint")


class SharedModelBatch(BatchCore):
    """`n` simulations that share one model and the variants that `add` appends: `CpuBatch` on processors, `WarpBatch`
    on a GPU. Raises ConfigError for motors that a batch cannot read, and for more simulations than there is memory
    for."""

    xp: Any = np
    """The library of its arrays (allegro_twin/array_api.py)."""

    def __init__(self, spec: HandSpec, model: mujoco.MjModel, n: int) -> None:
        self.models: list[mujoco.MjModel] = [model]
        """The variants."""
        self.contact_steps: Array | None = None
        """Net force of each link on the object at each physics step of the last `step`, world, (steps, n, links, 3), N;
        None where nobody asks for them (`watch_contacts`)."""
        self._sensor_steps: dict[int, Array] | None = None
        """What all sensors report at each physics step, by the number of steps, (steps, n, numbers); None where the
        last one is enough."""
        self._rows: dict[str, NDArray[Any]] = {}
        self._palettes: dict[str, NDArray[Any]] = {}
        self.variant: Rows = self.xp.zeros(n, np.int64)
        motors, sensors = BatchMotors(spec, model, alone=True), ("sensordata",) if model.nsensor else ()
        super().__init__(spec, model, n, motors, motors.slices, (*_FORCES, "xpos", "xquat", *sensors))
        self.control: Array = self._ctrl[:, self.motors]
        """What the model's motors are told, (n, joints): torques, N·m, or what `command` makes of positions."""
        self._learn_start(model)

    @property
    def dofs(self) -> NDArray[np.int64]:
        """Degrees of freedom of all that moves in the hand, in a model's speeds."""
        return self._motors.dofs

    @property
    def live(self) -> tuple[Array, Array] | None:
        """Positions and speeds of hands that take torques, where both are NumPy's own and live."""
        return None if self.closes_loop or self.xp is not np else self._live

    @property
    def applied_torque(self) -> Array:
        """What the motors gave at the last step, (n, joints), N·m; a copy. Of hands that take torques what they were
        told, within their limits."""
        if self.closes_loop:
            return self.xp.copy(self._outputs["actuator_force"][:, self.motors])  # type: ignore[no-any-return]
        limit = self.xp.asarray(self.spec.actuation.torque_limit)
        found: Array = self.xp.clip(self.control, -limit, limit)
        gain = self._rows.get("actuator_gainprm")
        return found if gain is None else found * gain[:, self.motors, 0]

    @property
    def joint_force(self) -> Array:
        """What acts on everything that moves besides motors, contacts and gravity, (n, nv), N and N·m; live, until the
        next reset of a simulation, which begins without any."""
        return self._bind("qfrc_applied")

    @property
    def external_torque(self) -> Array:
        """What contacts, dry friction and end stops do to what is driven, (n, joints), N·m, as of the last step; where
        a motor moves several joints, by virtual work along the hand's free way."""
        constraint, columns = self._output("qfrc_constraint"), self._motors.slices
        return self._motors.reduce(constraint, self.position) if columns is None else constraint[:, columns[1]]

    def watch_contacts(self, within: bool) -> tuple[str, ...]:
        """Start to measure contact forces of links, for scenes with `Stage.sensed`, and return the links.
        `contact_steps` then has them: `within` a `step` those of each of its physics steps, else those of the last
        one."""
        found = [self.model.sensor(k) for k in range(self.model.nsensor)]
        sensors = [each for each in found if each.name.startswith(PREFIX)]
        first = int(sensors[0].adr[0])
        self._contacts, self._sensor_steps = slice(first, first + 3 * len(sensors)), {} if within else None
        self.contact_steps = self._forces(self._output("sensordata")[None])
        return tuple(each.name.removeprefix(PREFIX) for each in sensors)

    def _forces(self, numbers: Array) -> Array:
        """Contact forces, (steps, n, links, 3), among the numbers of all sensors, (steps, n, numbers)."""
        return numbers[:, :, self._contacts].reshape(len(numbers), self.n, -1, 3)

    def _room_for(self, count: int) -> Array | None:
        """Where the sensors of so many physics steps are kept, (count, n, numbers); None for one, whose numbers are the
        live ones, and where nobody asks for contacts within a step."""
        if self._sensor_steps is None:
            return None
        assert self.contact_steps is not None
        if len(self.contact_steps) != count:
            if count > 1 and count not in self._sensor_steps:
                self._sensor_steps[count] = self.xp.zeros((count, *self._output("sensordata").shape))
            kept = self._output("sensordata")[None] if count == 1 else self._sensor_steps[count]
            self.contact_steps = self._forces(kept)
        return None if count == 1 else self._sensor_steps[count]

    def free_body(self, name: str) -> FreeBody:
        """A body that flies freely, by its name in the first model."""
        return FreeBody(self.model, name, self._qpos, self._qvel, self.push)

    def set_point(self, joint: str) -> Array:
        """Set-points of a joint with a servo of its name, (n,), live."""
        return self._ctrl[:, self.model.actuator(joint).id]

    def presenter(self) -> tuple[Array, Array, Array]:
        """Where the presenter's hand is, (n, 3), m, its quaternion, (n, 4), and whether it holds, (n,), 1 or 0;
        live."""
        place, turn = self._bind("mocap_pos"), self._bind("mocap_quat")
        return place[:, 0], turn[:, 0], self._bind("eq_active")[:, self.model.equality(PRESENTER).id]

    def command(self, values: Array) -> None:
        """Tell all motors a torque, N·m, or where the hands close the loop a position, rad, (n, joints)."""
        self.control[...] = self._motors.control(values)

    @abstractmethod
    def step(self, rows: Rows | None, count: int) -> None:
        """Let `count` physics steps pass in some simulations, or in all."""

    def check(self) -> None:
        """Raise ConfigError where steps have left out what they had no room for."""
        return

    @abstractmethod
    def add(self, model: mujoco.MjModel) -> int:
        """The number of a further variant. Raises ConfigError unless its layout is the first one's."""

    @abstractmethod
    def expand(self, field: str) -> NDArray[Any]:
        """A model field with a row for every simulation, live; after a write of masses or sizes call `derive`."""

    def reset_fields(self, names: Iterable[str]) -> None:
        """Give all simulations what their variants have of model fields, by their names among `live_arrays`."""
        for name in names:
            field = name.removeprefix(_FIELDS)
            self._rows[field][...] = self._palette(field)[self.variant]

    def choose(self, rows: Rows, variant: Rows) -> None:
        """Give simulations a variant each, and the state in which it begins, without a force of the episode before."""
        for field, own in self._rows.items():
            own[rows] = self._palette(field)[variant]
        self.variant[rows] = variant
        self._begin(rows, variant)
        for name in _FORCES:
            self._outputs[name][rows] = 0.0

    @abstractmethod
    def derive(self, rows: Rows) -> None:
        """Recompute what follows from masses, sizes and inertias."""

    def meshes(self, body: FreeBody) -> NDArray[np.bool_]:
        """Whether a body has a mesh among its shapes, which no simulation can resize, in each variant, (variants,)."""
        found = [bool((model.geom_type[body.geoms] == mujoco.mjtGeom.mjGEOM_MESH).any()) for model in self.models]
        known: NDArray[np.bool_] = self.xp.asarray(np.array(found))
        return known

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """What decides how the simulations go on, by name, live: variants, forces of the last step, the model fields
        that they have to themselves, and on processors their states."""
        outputs = {f"outputs/{name}": own for name, own in self._outputs.items()}
        fields = {f"{_FIELDS}{name}": own for name, own in self._rows.items()}
        return {"variant": self.variant} | outputs | fields

    def expand_as(self, names: Iterable[str]) -> set[str]:
        """Expand the model fields that are among the names of another batch's `live_arrays`. Returns the names of those
        that only this one has expanded."""
        fields = {name for name in names if name.startswith(_FIELDS)}
        for name in sorted(fields):
            self.expand(name.removeprefix(_FIELDS))
        return {f"{_FIELDS}{field}" for field in self._rows} - fields

    @abstractmethod
    def state(self, row: int) -> Array:
        """A copy of everything that decides how a simulation goes on."""

    @abstractmethod
    def restore(self, row: int, state: Array) -> None:
        """Put a simulation into a `state`."""

    @abstractmethod
    def keep_start(self, variant: int, state: Array) -> None:
        """Begin a variant in another state from now on."""

    @abstractmethod
    def snapshot(self, row: int, into: Snapshot | None = None) -> Snapshot:
        """One simulation as it is now, for pictures and for everything else that MuJoCo can do; a new one, or written
        into one that is there."""

    def _append(self, model: mujoco.MjModel) -> int:
        self.models.append(model)
        self._palettes.clear()
        self._learn_start(model)
        return len(self.models) - 1

    @abstractmethod
    def _begin(self, rows: Rows, variant: Rows) -> None:
        """Put simulations into the state in which their variant begins."""

    @abstractmethod
    def _learn_start(self, model: mujoco.MjModel) -> None:
        """Keep the state in which a further variant begins."""

    def _palette(self, field: str) -> NDArray[Any]:
        """A field of all variants, (variants, …)."""
        if field not in self._palettes:
            shape = tuple(self._rows[field].shape[1:])
            # The bounding boxes of the bodies precede those of the meshes, which no simulation has to itself.
            flat = [np.ravel(getattr(model, field))[: math.prod(shape)] for model in self.models]
            self._palettes[field] = self.xp.asarray(np.stack(flat).reshape(-1, *shape))
        return self._palettes[field]


class FreeBody:
    """A free body in every simulation: its pose, its motion, and what pushes it. Live views, one row each."""

    def __init__(self, model: mujoco.MjModel, name: str, qpos: Array, qvel: Array, push: Array) -> None:
        body, joint = model.body(name), model.joint(name)
        self.id, self.geoms = int(body.id), slice(int(body.geomadr[0]), int(body.geomadr[0] + body.geomnum[0]))
        first = int(model.body_bvhadr[self.id])
        self.boxes = slice(first, first + int(model.body_bvhnum[self.id]))
        """Its rows of `bvh_aabb`."""
        place, motion = int(joint.qposadr[0]), int(joint.dofadr[0])
        self.pose: Array = qpos[:, place : place + 7]
        """Position and quaternion in the world, (n, 7), m."""
        self.velocity: Array = qvel[:, motion : motion + 3]
        """World, (n, 3), m/s."""
        self.spin: Array = qvel[:, motion + 3 : motion + 6]
        """In the body's own axes, (n, 3), rad/s."""
        self.force: Array = push[:, self.id, :3]
        """On its centre of mass, world, (n, 3), N."""
        self.moment: Array = push[:, self.id, 3:]
        """World, (n, 3), N·m."""


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A simulation of its own."""

    model: mujoco.MjModel
    data: mujoco.MjData
    spec: HandSpec
