"""Simulations that share a model, on a thread pool; a simulation alone is a batch of one."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.shared_model import SharedModelBatch, Snapshot
from allegro_twin.spec import HandSpec
from allegro_twin.sweep.processors import core_count
from allegro_twin.types import Array

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
# What setting constants derives, and the labels and looks that no simulation depends on.
_SKIPPED = {"names_map", "light_poscom0", "qpos_spring"}


def simulation_pool(model: mujoco.MjModel, n: int, threads: int, *, persistent: bool = False) -> batch.Batch:
    """`n` simulations on so many threads; 0: one for each processor. `persistent`: each keeps everything that MuJoCo
    computes. Raises ConfigError for more than there is memory for."""
    try:
        return batch.Batch(model, n, threads or core_count(), persistent=persistent)
    except (MemoryError, ValueError) as error:
        if isinstance(error, ValueError) and "bad_alloc" not in str(error):
            raise
        raise ConfigError(f"{n:,} simulations side by side have no room in this computer's memory: choose "
                          "fewer") from error  # fmt: skip


def bind(simulations: batch.Batch, name: str) -> Array:
    """A field of all simulations' data, (n, …), live and writeable: a new episode has no forces yet, and a restored one
    those of its last step."""
    found: Array = simulations.bind(name)  # Its arrays have no type.
    found.flags.writeable = True
    return found


class CpuBatch(SharedModelBatch):
    """`n` simulations on `threads` of MuJoCo; 0: one for each processor."""

    def __init__(self, spec: HandSpec, model: mujoco.MjModel, n: int = 1, threads: int = 0) -> None:
        self._batch = simulation_pool(model, n, threads)
        self._starts = np.empty((0, self._batch.nstate))
        super().__init__(spec, model, n)

    def step(self, rows: Rows | None, count: int) -> None:
        kept = self._room_for(count)
        if kept is None:
            self._batch.step(rows, nstep=count)
            return
        step, numbers = self._batch.step, self._outputs["sensordata"]
        for each in kept:  # A contact may last for one physics step, and sensors show the last one only.
            step(rows, 1)
            each[...] = numbers

    def add(self, model: mujoco.MjModel) -> int:
        sizes = [(m.nq, m.nv, m.nu, m.nbody, m.ngeom, m.njnt, m.nM) for m in (self.model, model)]
        if sizes[0] != sizes[1]:
            raise ConfigError("scenes of one batch must have the same layout")
        if not _same_meshes(self.model, model):
            raise ConfigError("scenes of one batch share their meshes")
        for name in batch.MODEL_FIELDS:
            if name.startswith("opt.") or name in self._rows or name in _SKIPPED:
                continue
            first, other = getattr(self.model, name), getattr(model, name)
            if isinstance(first, np.ndarray) and not np.array_equal(first, other):
                self.expand(name)
        return self._append(model)

    def expand(self, field: str) -> NDArray[Any]:
        if field not in self._rows:
            self._rows[field] = self._batch.expand(field)
        return self._rows[field]

    def derive(self, rows: Rows) -> None:
        self._batch.set_const(rows)
        for name in batch.MODEL_FIELDS:
            # What was derived belongs to the simulation, and its next variant must bring its own.
            if not name.startswith("opt.") and name not in self._rows and self._batch.expanded(name) is not None:
                self.expand(name)

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        return {"physics": self._batch.state} | super().live_arrays()

    def state(self, row: int) -> Array:
        return np.array(self._batch.state[row])

    def restore(self, row: int, state: Array) -> None:
        self._batch.state[row] = state

    def keep_start(self, variant: int, state: Array) -> None:
        self._starts[variant] = state

    def snapshot(self, row: int, into: Snapshot | None = None) -> Snapshot:
        if into is None:
            into = Snapshot(self._batch.get_model(row), self._batch.get_data(row), self.spec)
        else:
            self._batch.get_model(row, into.model)
            self._batch.get_data(row, into.data)
        mujoco.mj_forward(into.model, into.data)
        return into

    def _bind(self, name: str) -> Array:
        return bind(self._batch, name)

    def _begin(self, rows: Rows, variant: Rows) -> None:
        self._batch.state[rows] = self._starts[variant]

    def _learn_start(self, model: mujoco.MjModel) -> None:
        state = np.empty(self._batch.nstate)
        mujoco.mj_getState(model, mujoco.MjData(model), state, _STATE)
        self._starts = np.vstack([self._starts, state])


def _same_meshes(first: mujoco.MjModel, other: mujoco.MjModel) -> bool:
    """No simulation has meshes to itself: those of another model would be left out, or be read beyond their end."""
    return first.nmesh == other.nmesh and np.array_equal(first.mesh_vert, other.mesh_vert)
