"""The same simulations on an NVIDIA GPU: `Worlds` that MuJoCo Warp steps and that never leave it, in single precision.

Their arrays are PyTorch's tensors over the device's own memory: what tasks write is the state at the next step, and
nothing is copied to the host and back.
"""

from __future__ import annotations

import copy
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import tensor_namespace, to_numpy
from allegro_twin.errors import ConfigError
from allegro_twin.sim.batch.warp_model import Device, device_named, fields_of, libraries, on_device
from allegro_twin.sim.batch.worlds import Rows, Snapshot, Worlds
from allegro_twin.sim.objects.presenter import NAME as PRESENTER
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

_STATE = ("time", "qpos", "qvel", "act", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied", "eq_active",
          "mocap_pos", "mocap_quat")  # fmt: skip
"""What an episode begins with, and all that decides how it goes on."""
_DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0", "geom_rbound", "geom_aabb")
"""What follows from masses, sizes and inertias. Of the rest that MuJoCo derives our scenes have nothing."""
# Of an overflow's bits: the solver stopped at its last iteration, which MuJoCo does in silence.
_ITERATIONS = ("ITERATIONS", "LS_ITERATIONS")
# Two shapes met in a way that the general collider has no room for; that room is fixed, nobody could raise it.
_MISSED = "EPA_HORIZON"
_PLACES = {"body_pos", "body_quat", "geom_pos", "geom_quat"}
"""Where things are that nothing moves: MuJoCo Warp places the geoms of those once, in `make_data`."""
_PICTURED = {"bvh_aabb"}
"""What the device has no use for, and MuJoCo's own model of a simulation has."""


class WarpWorlds(Worlds):
    """`n` simulations on a device; on a GPU no two runs are equal to the bit. Raises ConfigError."""

    def __init__(
        self,
        spec: HandSpec,
        model: mujoco.MjModel,
        n: int,
        *,
        device: Device = "warp",
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
        self._dropped = ~int(np.bitwise_or.reduce([int(bit) for bit in iterations])) & ~self._missed
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
        self._models.append(model)
        self._palettes.clear()
        for name in different:
            self.expand(name)
        self._learn_start(model)
        return len(self._models) - 1

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

    @cached_property
    def _constraint(self) -> Array:
        forces: Array = self._wp.to_torch(self._d.qfrc_constraint)
        return forces

    def presenter(self) -> tuple[Array, Array, Array]:
        own = self._own
        return own["mocap_pos"][:, 0], own["mocap_quat"][:, 0], own["eq_active"][:, self.model.equality(PRESENTER).id]

    def step(self, rows: Rows | None, count: int) -> None:
        if self._displaced:
            self._place()
        before = None if rows is None else {name: own.clone() for name, own in self._own.items()}
        with self._wp.ScopedDevice(self._device):
            self._run(count, lambda: [self._mjw.step(self._m, self._d) for _ in range(count)])
        if before is not None:
            still = self.xp.ones(self.n, bool)
            still[rows] = False
            for name, own in self._own.items():
                own[still] = before[name][still]

    def check(self) -> None:
        """Raise ConfigError where contacts or constraints found no room, instead of going on without them. A simulation
        in which the collider gave a contact up is one that has diverged."""
        overflow = to_numpy(self._overflow)
        if (overflow & self._missed).any():
            rows = self.xp.asarray(np.flatnonzero(overflow & self._missed))
            self._qpos[rows] = np.nan
            self._overflow[rows] &= ~self._missed
        dropped = overflow & self._dropped
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
        model = copy.copy(self._models[int(self.variant[row])])
        for field, own in self._rows.items():
            theirs = getattr(model, field)
            theirs[...] = to_numpy(own[row]).reshape(theirs.shape)
        mujoco.mj_setConst(model, mujoco.MjData(model))  # Of what follows from these, the device has not all.
        into = Snapshot(model, self._data(row), self.spec)
        mujoco.mj_forward(into.model, into.data)
        return into

    def _make(self, threads: int) -> None:
        self._fields = fields_of(self._mjw.Model, self.model)
        with self._wp.ScopedDevice(self._device):
            self._m = on_device(self._mjw, self.model, {})
            self._d = self._mjw.make_data(self.model, nworld=self.n, **self._room)
            self._own = {name: self._wp.to_torch(getattr(self._d, name)) for name in _STATE}
            self._overflow = self._wp.to_torch(self._d.overflow)
        self._starts: dict[str, Any] = {name: own[:0] for name, own in self._own.items()}  # type: ignore[assignment]
        self._qpos, self._qvel, self._ctrl = (self._own[name] for name in ("qpos", "qvel", "ctrl"))
        self._push = self._own["xfrc_applied"]

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
                self._rows[name] = self.xp.asarray(np.repeat(nominal[None], self.n, axis=0))
            else:
                self._rows[name] = self._wp.to_torch(getattr(self._m, name)).view(self.n, *nominal.shape)
            if name in kept:
                self._rows[name][...] = kept[name]
            elif len(self._models) > 1:
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


def _same(first: mujoco.MjModel, other: mujoco.MjModel, name: str) -> bool:
    return np.array_equal(getattr(first, name), getattr(other, name))
