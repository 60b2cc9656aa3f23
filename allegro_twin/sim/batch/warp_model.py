"""A model of MuJoCo's on a device of MuJoCo Warp's: which device, what becomes of it, and what simulations can own."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any, Literal, TypeAlias

import mujoco

from allegro_twin.errors import ConfigError

Device: TypeAlias = Literal["cpu", "warp", "warp:cpu"]
"""MuJoCo on all processors; MuJoCo Warp on an NVIDIA GPU; and the same kernels on one processor, for tests."""
_IDLE = {"dof_length"}  # Only sleeping reads it, and no scene lets anything sleep.


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
