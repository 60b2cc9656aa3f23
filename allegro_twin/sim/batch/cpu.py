"""Many simulations of one hand on a thread pool; a simulation alone is a batch of one.

The simulations of a batch have models of one layout: other objects, other places of the palm, other friction.
Either each has a model of its own, or all share one model and its variants. A simulation then takes a variant by
copying the fields in which the variants differ into its own row, so a reset compiles nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.batch.motors import BatchMotors
from allegro_twin.sim.drivetrain.servos import Rows as Rows
from allegro_twin.sim.drivetrain.servos import Servos
from allegro_twin.sim.model.contact_sensors import PREFIX
from allegro_twin.sim.model.scene import PRESENTER
from allegro_twin.sim.model.wrist import WRIST_JOINTS
from allegro_twin.spec import HandSpec
from allegro_twin.sweep.processors import core_count
from allegro_twin.types import Array

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_FORCES = ("actuator_force", "qfrc_constraint")
# What setting constants derives, and the labels and looks that no simulation depends on.
_SKIPPED = {"names_map", "light_poscom0", "qpos_spring"}


def _same_meshes(first: mujoco.MjModel, other: mujoco.MjModel) -> bool:
    """No simulation has meshes to itself: those of another model would be left out, or be read beyond their end."""
    return first.nmesh == other.nmesh and np.array_equal(first.mesh_vert, other.mesh_vert)


def layout(model: mujoco.MjModel) -> tuple[float, ...]:
    """The timestep, s, and the sizes of everything that a simulation holds: models of one batch have the same."""
    sizes = ("nq", "nv", "nu", "na", "nbody", "ngeom", "nsite", "njnt", "neq", "nM", "nbvh", "nbvhdynamic")
    return float(model.opt.timestep), *(int(getattr(model, name)) for name in sizes)


class SimBatch:
    """`n` simulations, a row each in every array.

    `models`: one for all `n` simulations, which share it with the variants that `add` appends; or a sequence with one
    for each simulation, which is then bit for bit what `SimBackend` makes of that model, and keeps everything that
    MuJoCo computes. `period`: s, of control, in which timed commands of a hand that closes its own loop are counted.
    Array attributes are live views unless they say otherwise; a write is the simulation's state at its next step.
    Raises ConfigError for models of different layouts, for motors that a batch cannot read, and for more simulations
    than there is memory for.
    """

    xp: Any = np
    """The library of its arrays (allegro_twin/array_api.py)."""

    def __init__(
        self,
        spec: HandSpec,
        models: mujoco.MjModel | Sequence[mujoco.MjModel],
        n: int = 1,
        threads: int = 0,
        period: float = 0.003,
    ) -> None:
        shared = isinstance(models, mujoco.MjModel)
        self.models: list[mujoco.MjModel] = [models] if isinstance(models, mujoco.MjModel) else list(models)
        """The variants; or one for each simulation."""
        self.spec, self.n, self.model = spec, n if shared else len(self.models), self.models[0]
        if not shared and len({layout(model) for model in self.models}) != 1:
            raise ConfigError("simulations side by side need models of one layout")
        self._each = not shared
        self.contact_steps: Array | None = None
        """Net force of each link on the object at each physics step of the last `step`, world, (steps, n, links, 3), N;
        None where nobody asks for them (`watch_contacts`)."""
        self._sensor_steps: dict[int, Array] | None = None
        """What all sensors report at each physics step, by the number of steps, (steps, n, numbers); None where the
        last one is enough."""
        self._rows: dict[str, NDArray[Any]] = {}
        self._palettes: dict[str, NDArray[Any]] = {}
        self.variant: Rows = self.xp.zeros(self.n, np.int64)
        self._make(threads)
        self._qpos, self._qvel, self._ctrl = (self._bind(name) for name in ("qpos", "qvel", "ctrl"))
        self._outputs = {name: self._bind_output(name) for name in self._output_names()}
        """What a step computes besides the state, (n, …): bound here, for what is bound later is zero until a step."""
        self.push: Array = self._bind("xfrc_applied")
        """On the centre of mass of every body, force and moment, world, (n, bodies, 6), N and N·m."""
        self._motors = BatchMotors(spec, self.model, alone=shared)
        self.servos = None if shared or not self.closes_loop else Servos(spec, self.models, period)
        """Firmware of hands that close their own loop, where each simulation has a model of its own; else None."""
        self.control: Array = self._ctrl[:, self.motors]
        """What the model's motors are told, (n, joints): torques, N·m, or what `command` makes of positions."""
        columns = None if self.servos is not None else self._motors.slices
        self._live = None if columns is None else (self._qpos[:, columns[0]], self._qvel[:, columns[1]])
        if shared:
            self._learn_start(self.model)

    def _make(self, threads: int) -> None:
        """The simulations."""
        try:
            self._batch = batch.Batch(self.model, self.n, threads or core_count(), persistent=self._each)
        except (MemoryError, ValueError) as error:
            if isinstance(error, ValueError) and "bad_alloc" not in str(error):
                raise
            raise ConfigError(f"{self.n:,} simulations side by side have no room in this computer's memory: choose "
                              "fewer") from error  # fmt: skip
        self._starts = np.empty((0, self._batch.nstate))
        if self._each:
            self._batch.set_models(self.models)
            self._batch.reset()
            names = {self.model.actuator(i).name for i in range(self.model.nu)}
            self._wrist = [self.model.actuator(name).id for name in WRIST_JOINTS if name in names]
            self._still = np.zeros((self.n, self.model.nu))
            self.scratch = mujoco.MjData(self.model)
            self._palm = self.model.body("palm_link").id
            self._gravity = np.array([model.opt.gravity for model in self.models])

    def _bind(self, name: str) -> Array:
        """A field of all simulations' data, (n, …), live."""
        return self._batch.bind(name)  # type: ignore[no-any-return]  # Its arrays have no type.

    def _output_names(self) -> tuple[str, ...]:
        sensors = ("sensordata",) if self.model.nsensor else ()
        return (*_FORCES, "xpos", "xquat", *sensors, *(("xmat",) if self._each else ()))

    def _bind_output(self, name: str) -> Array:
        """An output, live. It can be written: a new episode has no forces yet, and a restored one those of its last
        step."""
        found = self._bind(name)
        if isinstance(found, np.ndarray):
            found.flags.writeable = True
        return found

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
        """Of the hand, among a model's actuators."""
        return self._motors.ids

    @property
    def dofs(self) -> NDArray[np.int64]:
        """Of all that moves in the hand, in a model's speeds."""
        return self._motors.dofs

    @property
    def position(self) -> Array:
        """Of what is driven, (n, joints), rad; live, for writing too, where every motor turns a joint of its own."""
        return self._live[0] if self._live is not None else self._read(self._motors.position, self._qpos, 0)

    @property
    def velocity(self) -> Array:
        """(n, joints), rad/s; live likewise."""
        return self._live[1] if self._live is not None else self._read(self._motors.velocity, self._qvel, 1)

    @property
    def live(self) -> tuple[Array, Array] | None:
        """Positions and speeds of hands that take torques, where both are NumPy's own and live."""
        return None if self.closes_loop or self.xp is not np else self._live

    @property
    def applied_torque(self) -> Array:
        """What the motors gave at the last step, (n, joints), N·m; a copy. Of hands that take torques and share a model
        what they were told, within their limits."""
        if self.closes_loop or self._each:
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

    @property
    def gravity(self) -> Array:
        """In the palm's frame, (n, 3), m/s², where each simulation has a model of its own."""
        turns = self._output("xmat")[:, self._palm].reshape(-1, 3, 3)
        found: Array = (self._gravity[:, None] @ turns)[:, 0]
        return found

    @property
    def body_position(self) -> Array:
        """Of all bodies as they were before the last physics step, (n, bodies, 3), m."""
        return self._output("xpos")

    @property
    def body_quaternion(self) -> Array:
        """Likewise, (n, bodies, 4), w x y z."""
        return self._output("xquat")

    def watch_contacts(self, within: bool) -> tuple[str, ...]:
        """Of scenes with `Stage.sensed`: the links. From now on `contact_steps` has their forces: `within` a `step`
        those of each of its physics steps, else those of the last one."""
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

    def joint(self, name: str) -> Array:
        """The positions of another joint, (n, size), live; a free joint has seven."""
        joint = self.model.joint(name)
        place: Array = self._qpos[:, joint.qposadr[0] : joint.qposadr[0] + len(joint.qpos0)]
        return place

    def set_point(self, joint: str) -> Array:
        """Of a joint with a servo of its name, (n,), live."""
        return self._ctrl[:, self.model.actuator(joint).id]

    def presenter(self) -> tuple[Array, Array, Array]:
        """Where the presenter's hand is, (n, 3), m, its quaternion, (n, 4), and whether it holds, (n,), 1 or 0;
        live."""
        place, turn = self._bind("mocap_pos"), self._bind("mocap_quat")
        return place[:, 0], turn[:, 0], self._bind("eq_active")[:, self.model.equality(PRESENTER).id]

    def place(self, rows: Rows, posture: Array) -> None:
        """Put hands into postures, (m, joints), rad, with what follows where nothing is in its way."""
        if self._live is None:
            self._qpos[rows] = self._motors.placed(posture, self._qpos[rows])
        else:
            self._live[0][rows] = posture

    def command(self, values: Array) -> None:
        """Tell all motors a torque, N·m, or where the hands close the loop a position, rad, (n, joints)."""
        self.control[...] = self._motors.control(values)

    def step(self, rows: Rows | None, count: int) -> None:
        """Let `count` physics steps pass in some simulations, or in all."""
        kept = self._room_for(count)
        if kept is None:
            self._batch.step(rows, nstep=count)
            return
        step, numbers = self._batch.step, self._outputs["sensordata"]
        for each in kept:  # A contact may last for one physics step, and sensors show the last one only.
            step(rows, 1)
            each[...] = numbers

    def check(self) -> None:
        """Raise ConfigError where steps have left out what they had no room for."""
        return

    # Simulations with a model each.

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
        return self.servos.told(rows)

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

    # Simulations that share a model: its variants, and each simulation's own changes of it.

    def add(self, model: mujoco.MjModel) -> int:
        """The number of a further variant. Raises ConfigError unless its layout is the first one's."""
        sizes = [(m.nq, m.nv, m.nu, m.nbody, m.ngeom, m.njnt, m.nM) for m in (self.model, model)]
        if sizes[0] != sizes[1]:
            raise ConfigError(f"scenes of one batch must have the same layout; {sizes[1]} is not {sizes[0]}")
        if not _same_meshes(self.model, model):
            raise ConfigError("scenes of one batch share their meshes, and these have different ones: "
                              "make an environment for each mesh")  # fmt: skip
        for name in batch.MODEL_FIELDS:
            if name.startswith("opt.") or name in self._rows or name in _SKIPPED:
                continue
            first, other = getattr(self.model, name), getattr(model, name)
            if isinstance(first, np.ndarray) and not np.array_equal(first, other):
                self.expand(name)
        return self._append(model)

    def expand(self, field: str) -> NDArray[Any]:
        """A model field with a row for every simulation, live; after a write of masses or sizes call `derive`."""
        if field not in self._rows:
            self._rows[field] = self._batch.expand(field)
        return self._rows[field]

    def reset_field(self, field: str) -> None:
        """Give all simulations what their variants have of a model field that is expanded."""
        self._rows[field][...] = self._palette(field)[self.variant]

    def choose(self, rows: Rows, variant: Rows) -> None:
        """Give simulations a variant each, and the state in which it begins, without a force of the episode before."""
        for field, own in self._rows.items():
            own[rows] = self._palette(field)[variant]
        self.variant[rows] = variant
        self._begin(rows, variant)
        for name in _FORCES:
            self._outputs[name][rows] = 0.0

    def derive(self, rows: Rows) -> None:
        """Recompute what follows from masses, sizes and inertias."""
        self._batch.set_const(rows)
        for name in batch.MODEL_FIELDS:
            # What was derived belongs to the simulation, and its next variant must bring its own.
            if not name.startswith("opt.") and name not in self._rows and self._batch.expanded(name) is not None:
                self.expand(name)

    def meshes(self, body: FreeBody) -> NDArray[np.bool_]:
        """Of each variant, (variants,): whether a body has a mesh among its shapes, which no simulation can resize."""
        found = [bool((model.geom_type[body.geoms] == mujoco.mjtGeom.mjGEOM_MESH).any()) for model in self.models]
        known: NDArray[np.bool_] = self.xp.asarray(np.array(found))
        return known

    def state(self, row: int) -> Array:
        """A copy of everything that decides how a simulation goes on."""
        return np.array(self._batch.state[row])

    def restore(self, row: int, state: Array) -> None:
        """Put a simulation into a `state`."""
        self._batch.state[row] = state

    def keep_start(self, variant: int, state: Array) -> None:
        """Begin a variant in another state from now on."""
        self._starts[variant] = state

    def snapshot(self, row: int, into: Snapshot | None = None) -> Snapshot:
        """One simulation as it is now, for pictures and for everything else that MuJoCo can do; a new one, or written
        into one that is there."""
        if into is None:
            into = Snapshot(self._batch.get_model(row), self._batch.get_data(row), self.spec)
        else:
            self._batch.get_model(row, into.model)
            self._batch.get_data(row, into.data)
        mujoco.mj_forward(into.model, into.data)
        return into

    def _append(self, model: mujoco.MjModel) -> int:
        self.models.append(model)
        self._palettes.clear()
        self._learn_start(model)
        return len(self.models) - 1

    def _begin(self, rows: Rows, variant: Rows) -> None:
        self._batch.state[rows] = self._starts[variant]

    def _palette(self, field: str) -> NDArray[Any]:
        """A field of all variants, (variants, …)."""
        if field not in self._palettes:
            shape = tuple(self._rows[field].shape[1:])
            # The bounding boxes of the bodies precede those of the meshes, which no simulation has to itself.
            flat = [np.ravel(getattr(model, field))[: math.prod(shape)] for model in self.models]
            self._palettes[field] = self.xp.asarray(np.stack(flat).reshape(-1, *shape))
        return self._palettes[field]

    def _learn_start(self, model: mujoco.MjModel) -> None:
        state = np.empty(self._batch.nstate)
        mujoco.mj_getState(model, mujoco.MjData(model), state, _STATE)
        self._starts = np.vstack([self._starts, state])

    def _read(self, read: Callable[[Array], Array], states: Array, which: int) -> Array:
        """Positions or speeds that no column of the states is: sums of columns, or those of tendons in space."""
        if self._motors.readable:
            return read(states)
        data, found = mujoco.MjData(self.model), []
        for row, model in enumerate(self.models):
            self._batch.get_data(row, data)
            found.append(self._motors.lengths.look(model, data)[which])
        return np.array(found)


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
