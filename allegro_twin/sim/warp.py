"""The same simulations on an NVIDIA GPU: `Worlds` whose physics steps MuJoCo Warp takes, in single precision.

All but the stepping is the batch's own. What tasks read and write are rows in the host's memory; they travel to the
device before a control period and back after it.
"""

from __future__ import annotations

import copy
import dataclasses
from typing import Any, Literal, TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.batch import Rows, Worlds
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

Device: TypeAlias = Literal["cpu", "warp", "warp:cpu"]
"""MuJoCo on all processors; MuJoCo Warp on an NVIDIA GPU; and the same kernels on one processor, for tests."""
_IN = ("time", "qpos", "qvel", "act", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied", "eq_active",
       "mocap_pos", "mocap_quat")  # fmt: skip
_OUT = ("time", "qpos", "qvel", "act", "qacc_warmstart")
# Of an overflow's bits: the solver stopped at its last iteration, which MuJoCo does in silence.
_ITERATIONS = ("ITERATIONS", "LS_ITERATIONS")

_IDLE = {"dof_length"}  # Only sleeping reads it, and no scene lets anything sleep.


class WarpWorlds(Worlds):
    """`n` simulations on a device; on a GPU no two runs are equal to the bit. Raises ConfigError."""

    def __init__(
        self,
        spec: HandSpec,
        model: mujoco.MjModel,
        n: int,
        threads: int = 0,
        *,
        device: Device = "warp",
        contacts: int = 64,
        constraints: int = 256,
    ) -> None:
        super().__init__(spec, model, n, threads)
        self._wp, self._mjw = _libraries()
        self._device = _device(self._wp, device)
        self._room = {"nconmax": contacts, "njmax": constraints}
        self._m: Any = None
        self._d: Any = None
        self._graphs: dict[int, Any] = {}
        self._edited = True
        """A model field may have been written since the device has seen it."""
        iterations = (getattr(self._mjw.OverflowType, name) for name in _ITERATIONS)
        self._dropped = ~int(np.bitwise_or.reduce([int(bit) for bit in iterations]))

    @property
    def device(self) -> str:
        """Where the steps are taken, as Warp calls it."""
        return str(self._device)

    def expand(self, field: str) -> NDArray[Any]:
        self._edited = True
        return super().expand(field)

    def choose(self, rows: Rows, variant: Rows) -> None:
        self._edited = True
        super().choose(rows, variant)

    def external(self) -> Array:
        raise ConfigError("on a Warp device nobody tells the joints' external torque: touch and state need device: cpu")

    def step(self, rows: Rows | None, count: int) -> None:
        """As a batch does, for all at once; those not in `rows` stay as they were. Raises ConfigError where contacts or
        constraints found no room, instead of going on without them."""
        with self._wp.ScopedDevice(self._device):
            if self._edited:
                self._send_model()
            for name in _IN:
                self._send(getattr(self._d, name), self._batch.bind(name))
            self._advance(count)
            self._check_room()
            for name in _OUT:
                mine, theirs = self._batch.bind(name), getattr(self._d, name).numpy()
                mine[slice(None) if rows is None else rows] = theirs if rows is None else theirs[rows]

    def _advance(self, count: int) -> None:
        if not self._device.is_cuda:
            for _ in range(count):
                self._mjw.step(self._m, self._d)
            return
        if count not in self._graphs:
            self._mjw.step(self._m, self._d)  # Compiles what capturing must not.
            for name in _IN:
                self._send(getattr(self._d, name), self._batch.bind(name))
            with self._wp.ScopedCapture() as capture:
                for _ in range(count):
                    self._mjw.step(self._m, self._d)
            self._graphs[count] = capture.graph
        self._wp.capture_launch(self._graphs[count])

    def _send_model(self) -> None:
        """All fields that simulations have to themselves; the device's model is made anew when there are more."""
        fields = _batched(self._mjw.Model, self._rows)
        if self._m is None or any(len(getattr(self._m, field)) != self.n for field in fields):
            self._m = _on_device(self._mjw, self.model, dict.fromkeys(fields, self.n))
            self._d = self._mjw.make_data(self.model, nworld=self.n, **self._room)
            self._graphs.clear()
        for field in fields:
            self._send(getattr(self._m, field), self._rows[field])
        self._edited = False

    def _send(self, theirs: Any, mine: Array) -> None:
        if mine.size:
            kind = self._wp.dtype_to_numpy(getattr(theirs.dtype, "_wp_scalar_type_", theirs.dtype))
            own_shape = getattr(theirs.dtype, "_shape_", ())
            theirs.assign(np.ascontiguousarray(mine, kind).reshape(*theirs.shape, *own_shape))

    def _check_room(self) -> None:
        dropped = self._d.overflow.numpy() & self._dropped
        if dropped.any():
            row = int(np.flatnonzero(dropped)[0])
            what = self._mjw.OverflowType(int(dropped[row])).name
            raise ConfigError(f"simulation {row} of {self.n} has more contacts or constraints than room on the device "
                              f"({what}): raise contacts above {self._room['nconmax']} or constraints above "
                              f"{self._room['njmax']}")  # fmt: skip


def _libraries() -> tuple[Any, Any]:
    try:
        import warp

        warp.config.log_level = warp.LOG_WARNING
        import mujoco_warp
    except ImportError as error:
        raise ConfigError(f"device 'warp' needs MuJoCo Warp: pip install 'allegro-twin[warp]' ({error})") from error
    return warp, mujoco_warp


def _device(wp: Any, device: str) -> Any:
    if device == "warp:cpu":
        return wp.get_device("cpu")
    if not wp.get_cuda_device_count():
        raise ConfigError("device 'warp' needs an NVIDIA GPU, and Warp finds none; 'cpu' is MuJoCo on all processors, "
                          "'warp:cpu' Warp's kernels on one, slowly")  # fmt: skip
    return wp.get_preferred_device()


def _on_device(mjw: Any, model: mujoco.MjModel, sizes: dict[str, int]) -> Any:
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
    there.opt.warn_overflow = False  # It prints; `_check_room` raises.
    return there


def _batched(model: Any, rows: dict[str, NDArray[Any]]) -> list[str]:
    """Those of some fields that the device's model has. Raises ConfigError for one that it has once for all."""
    known = {field.name: getattr(field.type, "shape", ()) for field in dataclasses.fields(model)}
    for field in rows:
        if field in known and known[field][:1] != ("*",) and field not in _IDLE:
            raise ConfigError(f"MuJoCo Warp has one {field} for all simulations, and these scenes differ in it; "
                              "choose objects of one shape")  # fmt: skip
    return [field for field in rows if field in known and field not in _IDLE]
