"""Many simulations of one hand on a thread pool, each with a scene of its own; one simulation is a batch of one.

Scenes are variants: models of the same layout (other objects, other places of the palm), compiled once. A simulation
takes a variant by copying the fields in which the variants differ into its own row, so a reset compiles nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from mujoco import batch
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.backend import span
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

Rows = NDArray[np.int64]
"""Numbers of simulations, ascending."""
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
# What setting constants derives, and the labels and looks that no simulation depends on.
_SKIPPED = {"names_map", "light_poscom0", "qpos_spring"}


class Worlds:
    """`n` simulations. Arrays are live views with one row each; a write is the simulation's state at its next step."""

    xp: Any = np
    """The library of its arrays (allegro_twin/arrays.py)."""

    def __init__(self, spec: HandSpec, model: mujoco.MjModel, n: int, threads: int = 0) -> None:
        self.spec, self.n, self.model = spec, n, model
        self._models = [model]
        self._rows: dict[str, NDArray[Any]] = {}
        self._palettes: dict[str, NDArray[Any]] = {}
        self.variant: Rows = self.xp.zeros(n, np.int64)
        self._make(threads)
        place, motion, motors = _columns(spec, model)
        self.position: Array = self._qpos[:, place]
        """Of the joints, (n, joints), rad."""
        self.velocity: Array = self._qvel[:, motion]
        """(n, joints), rad/s."""
        self.torque: Array = self._ctrl[:, motors]
        """What the motors are told, (n, joints), N·m."""
        self._motion_columns = motion
        self._learn_start(model)

    def _make(self, threads: int) -> None:
        """The simulations, and their arrays."""
        self._batch = batch.Batch(self.model, self.n, threads)
        self._starts = np.empty((0, self._batch.nstate))
        self._qpos, self._qvel, self._ctrl = (self._batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self._push = self._batch.bind("xfrc_applied")

    @cached_property
    def motion(self) -> Array | None:
        """Positions and velocities in one array, (2, n, joints), for reading; None where they are not neighbours."""
        return _both(self.position, self.velocity)

    def add(self, model: mujoco.MjModel) -> int:
        """The number of a further variant. Raises ConfigError unless its layout is the first one's."""
        sizes = [(m.nq, m.nv, m.nu, m.nbody, m.ngeom, m.njnt, m.nM) for m in (self.model, model)]
        if sizes[0] != sizes[1]:
            raise ConfigError(f"scenes of one batch must have the same layout; {sizes[1]} is not {sizes[0]}")
        for name in batch.MODEL_FIELDS:
            if name.startswith("opt.") or name in self._rows or name in _SKIPPED:
                continue
            first, other = getattr(self.model, name), getattr(model, name)
            if isinstance(first, np.ndarray) and not np.array_equal(first, other):
                self.expand(name)
        self._models.append(model)
        self._palettes.clear()
        self._learn_start(model)
        return len(self._models) - 1

    def expand(self, field: str) -> NDArray[Any]:
        """A model field with a row for every simulation, live; after a write of masses or sizes call `derive`."""
        if field not in self._rows:
            self._rows[field] = self._batch.expand(field)
        return self._rows[field]

    def choose(self, rows: Rows, variant: Rows) -> None:
        """Give simulations a variant each, and the state in which it begins."""
        for field, own in self._rows.items():
            own[rows] = self._palette(field)[variant]
        self.variant[rows] = variant
        self._begin(rows, variant)

    def _begin(self, rows: Rows, variant: Rows) -> None:
        self._batch.state[rows] = self._starts[variant]

    def derive(self, rows: Rows) -> None:
        """Recompute what follows from masses, sizes and inertias."""
        self._batch.set_const(rows)
        for name in batch.MODEL_FIELDS:
            # What was derived belongs to the simulation, and its next variant must bring its own.
            if not name.startswith("opt.") and name not in self._rows and self._batch.expanded(name) is not None:
                self.expand(name)

    def step(self, rows: Rows | None, count: int) -> None:
        """Let `count` physics steps pass in some simulations, or in all."""
        self._batch.step(rows, nstep=count)

    def check(self) -> None:
        """Raise ConfigError where steps have left out what they had no room for."""
        return

    def free(self, body: str) -> Body:
        """A free body of every variant's scene, by its name in the first."""
        return Body(self.model, body, self._qpos, self._qvel, self._push)

    def joint(self, name: str) -> tuple[Array, Array]:
        """Position and set-point of a joint with a servo of its own, (n,) each, live."""
        joint = self.model.joint(name)
        return self._qpos[:, joint.qposadr[0]], self._ctrl[:, self.model.actuator(name).id]

    def meshes(self, body: Body) -> NDArray[np.bool_]:
        """Of each variant, (variants,): whether a body has a mesh among its shapes, which no simulation can resize."""
        found = [bool((model.geom_type[body.geoms] == mujoco.mjtGeom.mjGEOM_MESH).any()) for model in self._models]
        known: NDArray[np.bool_] = self.xp.asarray(np.array(found))
        return known

    def external(self) -> Array:
        """What contacts, dry friction and end stops do to the joints, (n, joints), N·m: as of the last step, live."""
        forces: Array = self._batch.bind("qfrc_constraint")[:, self._motion_columns]
        return forces

    def presenter(self) -> tuple[Array, Array, Array]:
        """Where the presenter's hand is, (n, 3), m, its quaternion, (n, 4), and whether it holds, (n,), 1 or 0;
        live."""
        place, turn = self._batch.bind("mocap_pos"), self._batch.bind("mocap_quat")
        return place[:, 0], turn[:, 0], self._batch.bind("eq_active")[:, 0]

    def state(self, row: int) -> Array:
        """A copy of everything that decides how a simulation goes on."""
        return np.array(self._batch.state[row])

    def restore(self, row: int, state: Array) -> None:
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

    def _palette(self, field: str) -> NDArray[Any]:
        if field not in self._palettes:
            shape = tuple(self._rows[field].shape[1:])
            # The bounding boxes of the bodies precede those of the meshes, which no simulation has to itself.
            flat = [np.ravel(getattr(model, field))[: math.prod(shape)] for model in self._models]
            self._palettes[field] = self.xp.asarray(np.stack(flat).reshape(-1, *shape))
        return self._palettes[field]

    def _learn_start(self, model: mujoco.MjModel) -> None:
        data = mujoco.MjData(model)
        state = np.empty(self._batch.nstate)
        mujoco.mj_getState(model, data, state, _STATE)
        self._starts = np.vstack([self._starts, state])


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A simulation of its own."""

    model: mujoco.MjModel
    data: mujoco.MjData
    spec: HandSpec


class Body:
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


def _both(first: Array, second: Array) -> Array:
    """Two parts of the same rows as one view, so that one operation reads both."""
    apart = second.__array_interface__["data"][0] - first.__array_interface__["data"][0]
    assert first.strides == second.strides
    return as_strided(first, (2, *first.shape), (apart, *first.strides), writeable=False)


def _columns(spec: HandSpec, model: mujoco.MjModel) -> tuple[slice, slice, slice]:
    """Of the joints in qpos, in qvel and in ctrl. Raises ConfigError unless they follow one another."""
    joints = [model.joint(name) for name in spec.joints]
    found = (
        span([joint.qposadr[0] for joint in joints]),
        span([joint.dofadr[0] for joint in joints]),
        span([model.actuator(name).id for name in spec.joints]),
    )
    match found:
        case (slice() as place, slice() as motion, slice() as motors):
            return place, motion, motors
    raise ConfigError(f"{spec.name}: the joints of this model do not follow one another, as a batch needs them to")
