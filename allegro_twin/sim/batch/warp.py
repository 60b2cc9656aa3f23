"""Batches on an NVIDIA GPU, in single precision: MuJoCo Warp steps the simulations, which never leave it."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any, Literal, TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import tensor_namespace, to_numpy
from allegro_twin.errors import ConfigError
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.shared_model import SharedModelBatch, Snapshot
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

SimDevice: TypeAlias = Literal["cpu", "warp", "warp:cpu"]
"""MuJoCo on all processors; MuJoCo Warp on an NVIDIA GPU; and the same kernels on one processor, for tests."""
_STATE = ("time", "qpos", "qvel", "act", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied", "eq_active",
          "mocap_pos", "mocap_quat")  # fmt: skip
"""What an episode begins with, and all that decides how it goes on."""
_DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0", "geom_rbound", "geom_aabb")
"""What follows from masses, sizes and inertias. Of the rest that MuJoCo derives our scenes have nothing."""
# Of an overflow's bits: the solver stopped at its last iteration, which MuJoCo does in silence.
_ITERATIONS = ("ITERATIONS", "LS_ITERATIONS")
# Two shapes met in a way that the general collider has no room for; that room is fixed, nobody could raise it.
_MISSED = "EPA_HORIZON"
# Each simulation has room of its own for constraints. That for contacts is shared: nobody can say whose were left out.
_OWN_ROOM = ("NEFC", "NJMAX_NNZ")
_FEW = 0.1
"""Share of the simulations that may outgrow their own room at once, and end. With more the room is too small."""
_PLACES = {"body_pos", "body_quat", "geom_pos", "geom_quat"}
"""Where things are that nothing moves: MuJoCo Warp places the geoms of those once, in `make_data`."""
_PICTURED = {"bvh_aabb"}
"""What the device has no use for, and MuJoCo's own model of a simulation has."""
_IDLE = {"dof_length"}  # Only sleeping reads it, and no scene lets anything sleep.


class WarpBatch(SharedModelBatch):
    """`n` simulations on a device; on a GPU no two runs are equal to the bit. Raises ConfigError."""

    def __init__(
        self,
        spec: HandSpec,
        model: mujoco.MjModel,
        n: int,
        *,
        device: SimDevice = "warp",
        contacts: int = 64,
        constraints: int = 256,
    ) -> None:
        if "torque" not in spec.commands:
            raise ConfigError(f"device {device}: {spec.name} closes its own loop, which is simulated on cpu only")
        self._wp, self._mjw = libraries()
        self._device = device_named(self._wp, device)
        self.xp = tensor_namespace(self._wp.device_to_torch(self._device))
        self._room = {"nconmax": contacts, "njmax": constraints}
        self._graphs: dict[Any, Any] = {}
        iterations = (getattr(self._mjw.OverflowType, name) for name in _ITERATIONS)
        self._displaced = False
        self._loose: Any = None
        self._missed = int(self._mjw.OverflowType[_MISSED])
        self._outgrown = int(np.bitwise_or.reduce([int(self._mjw.OverflowType[name]) for name in _OWN_ROOM]))
        self._dropped = ~int(np.bitwise_or.reduce([int(bit) for bit in iterations])) & ~self._missed
        self._fields = fields_of(self._mjw.Model, model)
        with self._wp.ScopedDevice(self._device):
            self._m = on_device(self._mjw, model, {})
            self._d = self._mjw.make_data(model, nworld=n, **self._room)
            self._own = {name: self._wp.to_torch(getattr(self._d, name)) for name in _STATE}
            self._overflow = self._wp.to_torch(self._d.overflow)
        self._starts: dict[str, Any] = {name: own[:0] for name, own in self._own.items()}
        super().__init__(spec, model, n)

    @property
    def device(self) -> str:
        """Where the steps are taken, as Warp calls it."""
        return str(self._device)

    def add(self, model: mujoco.MjModel) -> int:
        asked = self._fields | _PICTURED | {"geom_type", "geom_dataid"}
        different = sorted(name for name in asked if not _same(self.model, model, name))
        if unknown := [name for name in different if name not in self._fields | _PICTURED]:
            raise ConfigError(f"MuJoCo Warp has one {unknown[0]} for all simulations, and these scenes differ in it; "
                              "choose objects of primitive shapes, or one mesh")  # fmt: skip
        self._expand([name for name in different if name not in self._rows])
        return self._append(model)

    def expand(self, field: str) -> NDArray[Any]:
        if field not in self._rows:
            self._expand([field])
        return self._rows[field]

    def choose(self, rows: Rows, variant: Rows) -> None:
        super().choose(rows, variant)
        self._displaced = bool(_PLACES & self._rows.keys())

    def derive(self, rows: Rows) -> None:
        self._expand([name for name in _DERIVED if name not in self._rows])
        with self._wp.ScopedDevice(self._device):
            self._run("derive", lambda: self._mjw.set_const(self._m, self._d))
        self._displaced = bool(_PLACES & self._rows.keys())

    def step(self, rows: Rows | None, count: int) -> None:
        if self._displaced:
            self._place()
        before = None if rows is None else {name: own.clone() for name, own in self._own.items()}
        kept = self._room_for(count)

        def steps() -> None:
            for k in range(count):
                self._mjw.step(self._m, self._d)
                if kept is not None:
                    self._wp.copy(self._wp.from_torch(kept[k]), self._d.sensordata)

        with self._wp.ScopedDevice(self._device):
            self._run((count, kept is not None), steps)
        if before is not None:
            still = self.xp.ones(self.n, bool)
            still[rows] = False
            for name, own in self._own.items():
                own[still] = before[name][still]

    def check(self) -> None:
        """Raise ConfigError where contacts or constraints found no room, instead of going on without them. A simulation
        in which the collider gave a contact up is one that has diverged, and so are a few that outgrow their room."""
        overflow = to_numpy(self._overflow)
        ended = overflow & self._missed
        if np.count_nonzero(overflow & self._outgrown) <= _FEW * self.n:
            ended |= overflow & self._outgrown
        if ended.any():
            rows = self.xp.asarray(np.flatnonzero(ended))
            self._qpos[rows] = np.nan
            self._overflow[rows] &= ~(self._missed | self._outgrown)
        dropped = overflow & self._dropped & ~ended
        if dropped.any():
            row = int(np.flatnonzero(dropped)[0])
            what = self._mjw.OverflowType(int(dropped[row])).name
            raise ConfigError(f"simulation {row} of {self.n} has more contacts or constraints than room on the device "
                              f"({what}): raise contacts above {self._room['nconmax']} or constraints above "
                              f"{self._room['njmax']}")  # fmt: skip

    def state(self, row: int) -> Array:
        data = self._data(row)
        found = np.empty(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(self.model, data, found, mujoco.mjtState.mjSTATE_INTEGRATION)
        return found

    def restore(self, row: int, state: Array) -> None:
        for name, value in self._parts(state).items():
            self._own[name][row] = value

    def keep_start(self, variant: int, state: Array) -> None:
        for name, value in self._parts(state).items():
            self._starts[name][variant] = value

    def snapshot(self, row: int, into: Snapshot | None = None) -> Snapshot:
        model = copy.copy(self.models[int(self.variant[row])])
        for field, own in self._rows.items():
            value = to_numpy(own[row])
            getattr(model, field).reshape(-1)[: value.size] = value.reshape(-1)  # Boxes of meshes stay.
        mujoco.mj_setConst(model, mujoco.MjData(model))  # Of what follows from these, the device has not all.
        into = Snapshot(model, self._data(row), self.spec)
        mujoco.mj_forward(into.model, into.data)
        return into

    def _bind(self, name: str) -> Array:
        found: Array = self._own[name] if name in self._own else self._wp.to_torch(getattr(self._d, name))
        return found

    def _place(self) -> None:
        """Put what nothing moves where each simulation has it now: by a model to which no body belongs to the world."""
        with self._wp.ScopedDevice(self._device):
            if self._loose is None:
                self._loose = copy.copy(self._m)
                self._loose.body_weldid = self._wp.ones_like(self._m.body_weldid)
            self._run("place", lambda: self._mjw.kinematics(self._loose, self._d))
        self._displaced = False

    def _begin(self, rows: Rows, variant: Rows) -> None:
        for name, own in self._own.items():
            own[rows] = self._starts[name][variant]

    def _learn_start(self, model: mujoco.MjModel) -> None:
        data = mujoco.MjData(model)
        for name, start in self._starts.items():
            self._starts[name] = self.xp.concatenate([start, self._one(name, getattr(data, name))])

    def _parts(self, state: Array) -> dict[str, Any]:
        data = mujoco.MjData(self.model)
        mujoco.mj_setState(self.model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        return {name: self._one(name, getattr(data, name))[0] for name in _STATE}

    def _one(self, name: str, value: Any) -> Any:
        """A value of MuJoCo's as a row of the device's."""
        own = self._own[name]
        return self.xp.asarray(np.asarray(value, np.float64)).to(own.dtype).reshape(1, *own.shape[1:])

    def _data(self, row: int) -> mujoco.MjData:
        data = mujoco.MjData(self.model)
        for name, own in self._own.items():
            value = to_numpy(own[row])
            if name == "time":
                data.time = float(value)
            else:
                getattr(data, name)[...] = value.reshape(getattr(data, name).shape)
        return data

    def _expand(self, fields: list[str]) -> None:
        """A row of the device's model for every simulation; the model is made anew, with what the rows hold already."""
        if not fields:
            return
        kept: dict[str, Any] = {name: self.xp.copy(own) for name, own in self._rows.items()}
        with self._wp.ScopedDevice(self._device):
            self._m = on_device(self._mjw, self.model, dict.fromkeys({*kept, *fields} - _PICTURED, self.n))
        self._graphs.clear()
        self._loose = None
        for name in (*kept, *fields):
            nominal = getattr(self.model, name)
            if name in _PICTURED:
                # Those of meshes follow those of bodies: a thousand times as many, and the same for everybody.
                last = int((self.model.body_bvhadr + self.model.body_bvhnum).max())
                self._rows[name] = self.xp.asarray(np.repeat(nominal[None, :last], self.n, axis=0))
            else:
                self._rows[name] = self._wp.to_torch(getattr(self._m, name)).view(self.n, *nominal.shape)
            if name in kept:
                self._rows[name][...] = kept[name]
            elif len(self.models) > 1:
                self._rows[name][...] = self._palette(name)[self.variant]

    def _run(self, key: Any, act: Any) -> None:
        """In PyTorch's own order. On a GPU once as it is, which compiles what capturing must not, and from then on as a
        captured graph."""
        if not self._device.is_cuda:
            act()
            return
        wp = self._wp
        with wp.ScopedStream(wp.stream_from_torch(self.xp.torch.cuda.current_stream(self.xp.device))):
            if key not in self._graphs:
                act()
                self._graphs[key] = None
                return
            if self._graphs[key] is None:
                with wp.ScopedStream(wp.Stream(self._device)), wp.ScopedCapture() as capture:
                    act()
                self._graphs[key] = capture.graph
            wp.capture_launch(self._graphs[key])


def libraries() -> tuple[Any, Any]:
    try:
        import warp

        warp.config.log_level = warp.LOG_WARNING
        import mujoco_warp
        import torch  # noqa: F401
    except ImportError as error:
        raise ConfigError(f"device 'warp' needs MuJoCo Warp: pip install 'allegro-twin[warp]' ({error})") from error
    return warp, mujoco_warp


def device_named(wp: Any, device: str) -> Any:
    if device == "warp:cpu":
        return wp.get_device("cpu")
    if not wp.get_cuda_device_count():
        raise ConfigError("device 'warp' needs an NVIDIA GPU, and Warp finds none; 'cpu' is MuJoCo on all processors, "
                          "'warp:cpu' Warp's kernels on one, slowly")  # fmt: skip
    return wp.get_preferred_device()


def on_device(mjw: Any, model: mujoco.MjModel, sizes: dict[str, int]) -> Any:
    """Raises ConfigError for what MuJoCo Warp has not."""
    model = copy.copy(model)
    # MuJoCo Warp never resets a simulation that diverges, so it does not know the flag that forbids it.
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    # Boxes then meet boxes as in MuJoCo, in up to 8 points; its general collider finds 4 (the manual's parity guide).
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    try:
        there = mjw.put_model(model, batch_sizes=sizes)
    except NotImplementedError as error:
        raise ConfigError(f"MuJoCo Warp cannot simulate this scene: {error}") from error
    there.opt.warn_overflow = False  # It prints; `check` raises.
    return there


def fields_of(theirs: Any, model: mujoco.MjModel) -> set[str]:
    """What simulations can have to themselves of MuJoCo's model."""
    known = {field.name: getattr(field.type, "shape", ()) for field in dataclasses.fields(theirs)}
    return {name for name, shape in known.items() if shape[:1] == ("*",) and hasattr(model, name)} - _IDLE


def _same(first: mujoco.MjModel, other: mujoco.MjModel, name: str) -> bool:
    return np.array_equal(getattr(first, name), getattr(other, name))
