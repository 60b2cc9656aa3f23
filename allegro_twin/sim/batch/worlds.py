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
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.batch.bodies import Body as Body
from allegro_twin.sim.batch.motors import Driven
from allegro_twin.sim.objects.presenter import NAME as PRESENTER
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
    """The library of its arrays (allegro_twin/array_api.py)."""

    def __init__(self, spec: HandSpec, model: mujoco.MjModel, n: int, threads: int = 0) -> None:
        self.spec, self.n, self.model = spec, n, model
        self._models = [model]
        self._rows: dict[str, NDArray[Any]] = {}
        self._palettes: dict[str, NDArray[Any]] = {}
        self.variant: Rows = self.xp.zeros(n, np.int64)
        self._make(threads)
        self._driven = Driven(spec, model)
        self.leads = self._driven.leads
        """Whether the motors are told where to be, for the hands close the loop; else torques."""
        self.torque: Array = self._ctrl[:, self._driven.motors]
        """What motors that take torques are told, (n, joints), N·m."""
        columns = self._driven.columns
        self._live = None if columns is None else (self._qpos[:, columns[0]], self._qvel[:, columns[1]])
        self._learn_start(model)

    @property
    def position(self) -> Array:
        """Of what is driven, (n, joints), rad; live where every motor turns a joint of its own, for writing, too."""
        return self._driven.position(self._qpos) if self._live is None else self._live[0]

    @property
    def velocity(self) -> Array:
        """(n, joints), rad/s; live likewise."""
        return self._driven.velocity(self._qvel) if self._live is None else self._live[1]

    @property
    def live(self) -> tuple[Array, Array] | None:
        """Positions and speeds of hands that take torques, where both are NumPy's own and live."""
        return None if self.leads or self.xp is not np else self._live

    def place(self, rows: Rows, posture: Array) -> None:
        """Put hands into postures, (m, joints), rad, with what follows where nothing is in its way."""
        if self._live is None:
            self._qpos[rows] = self._driven.placed(posture, self._qpos[rows])
        else:
            self._live[0][rows] = posture

    def tell(self, values: Array) -> None:
        """Tell all motors a torque, N·m, or where the hands close the loop a position, rad, (n, joints)."""
        self.torque[...] = self._driven.told(values)

    def _make(self, threads: int) -> None:
        """The simulations, and their arrays."""
        self._batch = batch.Batch(self.model, self.n, threads)
        self._starts = np.empty((0, self._batch.nstate))
        self._qpos, self._qvel, self._ctrl = (self._batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self._push = self._batch.bind("xfrc_applied")

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

    @cached_property
    def _constraint(self) -> Array:
        """(n, nv), N·m."""
        return self._batch.bind("qfrc_constraint")  # type: ignore[no-any-return]  # Its arrays have no type.

    @cached_property
    def _given(self) -> Array:
        """By all actuators, (n, nu), N·m."""
        return self._batch.bind("actuator_force")  # type: ignore[no-any-return]  # Likewise.

    @property
    def dofs(self) -> NDArray[np.int64]:
        """Of all that moves in the hand, in a model's speeds."""
        return self._driven.dofs

    @property
    def motors(self) -> slice:
        """Of the hand, among a model's actuators."""
        return self._driven.motors

    def external(self) -> Array:
        """What contacts, dry friction and end stops do to what is driven, (n, joints), N·m, as of the last step; where
        a motor moves several joints, by virtual work along the hand's free way."""
        columns = self._driven.columns
        if columns is None:
            return self._driven.reduced(self._constraint, self.position)
        return self._constraint[:, columns[1]]

    def given(self) -> Array:
        """What the motors gave at the last step, (n, joints), N·m; of hands that take torques what they were told,
        within their limits."""
        if self.leads:
            return self._given[:, self.motors]
        limit = self.xp.asarray(self.spec.actuation.torque_limit)
        found: Array = self.xp.clip(self.torque, -limit, limit)
        return found

    def presenter(self) -> tuple[Array, Array, Array]:
        """Where the presenter's hand is, (n, 3), m, its quaternion, (n, 4), and whether it holds, (n,), 1 or 0;
        live."""
        place, turn = self._batch.bind("mocap_pos"), self._batch.bind("mocap_quat")
        return place[:, 0], turn[:, 0], self._batch.bind("eq_active")[:, self.model.equality(PRESENTER).id]

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
