"""The actuators of somebody's MJCF, read as the motors of a hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array


class Motor:
    """One actuator, read. Raises ConfigError for one that nobody could command as a hand."""

    def __init__(self, model: mujoco.MjModel, number: int, path: Path) -> None:
        self.number, self.actuator = number, model.actuator(number).name
        if not self.actuator:
            raise ConfigError(f"{path}: actuator {number} has no name: give it one")
        where, kind = f"{path}: actuator {self.actuator}", int(model.actuator_trntype[number])
        target = int(model.actuator_trnid[number, 0])
        on_tendon = kind == mujoco.mjtTrn.mjTRN_TENDON
        if kind != mujoco.mjtTrn.mjTRN_JOINT and not on_tendon:
            raise ConfigError(f"{where} acts on neither a joint nor a tendon")
        if model.actuator_dyntype[number] != mujoco.mjtDyn.mjDYN_NONE:
            raise ConfigError(f"{where} has dynamics of its own, which no command can stand for")
        self.joint = None if on_tendon else target
        """That it turns; None: it pulls a tendon."""
        self.name = self.actuator if on_tendon else model.joint(target).name
        gain, bias = float(model.actuator_gainprm[number, 0]), model.actuator_biasprm[number]
        self.torque = not bias[:3].any()
        if self.torque and on_tendon:
            raise ConfigError(f"{where} pulls a tendon with a given force, and nobody would know where its joints are")
        if not self.torque and bias[1] >= 0.0:
            raise ConfigError(f"{where} is no position servo: a velocity, say, is no place to go to")
        span = _span(model, number, target, on_tendon, where)
        self.lower, self.upper = span
        if not self.torque and model.actuator_ctrllimited[number]:
            ends = -(bias[0] + gain * model.actuator_ctrlrange[number]) / bias[1]
            self.lower, self.upper = float(ends.min()), float(ends.max())
        self.effort = _effort(model, number, gain, bias, self.upper - self.lower)
        self._gain, self._bias = gain, bias

    def told(self, position: float) -> float:
        """What a position servo is told to go to a position."""
        return float(-(self._bias[0] + self._bias[1] * position) / self._gain)

    def row(self) -> dict[str, Any]:
        numbers = {"lower": round(self.lower, 6), "upper": round(self.upper, 6), "effort": round(self.effort, 6)}
        loop = {} if self.torque else {"stiffness": round(-float(self._bias[1]), 6)}
        return {"name": self.name, "actuator": self.actuator} | numbers | loop


def _span(model: mujoco.MjModel, number: int, target: int, on_tendon: bool, where: str) -> tuple[float, float]:
    limited, span = (
        (model.tendon_limited[target], model.tendon_range[target])
        if on_tendon
        else (model.jnt_limited[target], model.jnt_range[target])
    )
    if not limited and not model.actuator_ctrllimited[number]:
        raise ConfigError(f"{where}: neither it nor what it moves has a range: where may it go?")
    return float(span[0]), float(span[1])


def _effort(model: mujoco.MjModel, number: int, gain: float, bias: Array, span: float) -> float:
    """The most that it can give by the file: its force range, or what its range of control comes to."""
    if model.actuator_forcelimited[number]:
        return float(np.abs(model.actuator_forcerange[number]).max())
    if bias[1]:
        return float(-bias[1] * span)
    ends = np.abs(gain * model.actuator_ctrlrange[number])
    return float(ends.max()) or 1.0
