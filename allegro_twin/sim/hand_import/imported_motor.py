"""Actuators of an imported hand: what each moves, in which range, and with which effort."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.sim.drivetrain import lugre_friction
from allegro_twin.sim.hand_import.couplings import reachable_range
from allegro_twin.sim.hand_import.urdf import is_urdf

UNKNOWN = "unknown"
"""The effort of a motor whose file does not say it."""


class ImportedMotor:
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
        self.tendon = target if on_tendon else None
        self.name = self.actuator if on_tendon else model.joint(target).name
        gain, bias = float(model.actuator_gainprm[number, 0]), model.actuator_biasprm[number]
        self.torque = not bias[:3].any()
        if self.torque and on_tendon:
            raise ConfigError(f"{where} pulls a tendon with a given force, and nobody would know where its joints are")
        if not self.torque and bias[1] >= 0.0:
            raise ConfigError(
                f"{where} is no position servo: with kp {0.0 - bias[1]:g} nothing brings it to a place; a <position> "
                "has a positive kp"
            )
        self.lower, self.upper = _span(model, number, target, on_tendon, self.torque, where)
        self.effort = _effort(model, number, gain, self.torque)
        """The most that it gives by the file; None: the file does not say it."""
        self._gain, self._bias = gain, bias

    def command_for(self, position: float) -> float:
        """What a position servo is told to go to a position."""
        return float(-(self._bias[0] + self._bias[1] * position) / self._gain)

    def row(self) -> dict[str, Any]:
        """Its row in the card."""
        effort = UNKNOWN if self.effort is None else round(self.effort, 6)
        numbers = {"lower": round(self.lower, 6), "upper": round(self.upper, 6), "effort": effort}
        loop = {} if self.torque else {"stiffness": round(-float(self._bias[1]), 6)}
        return {"name": self.name, "actuator": self.actuator} | numbers | loop


def read_motors(model: mujoco.MjModel, path: Path) -> tuple[list[ImportedMotor], list[str]]:
    """The motors of a hand, and notes on ranges that are not those of the file. Raises ConfigError for a file
    without motors, for motors that nobody could command as a hand, and for two that drive one joint."""
    given = [
        k
        for k in range(model.nu)
        if not lugre_friction.is_friction_only(model.actuator_gaintype[k], model.actuator_gainprm[k])
    ]
    if not given:
        way = (
            "no joint of it moves: a driven one is revolute, continuous or prismatic and has no <mimic>"
            if is_urdf(path)
            else "nothing in it can be driven; add an <actuator> with position servos, or take the hand's URDF"
        )
        raise ConfigError(f"{path} has no actuators: {way}")
    motors, notes = [ImportedMotor(model, k, path) for k in given], list[str]()
    _check_one_each(motors, path)
    _check_same_commands(motors, path)
    for motor in motors:
        if motor.joint is not None:
            motor.lower, motor.upper, note = reachable_range(model, motor.joint, motor.lower, motor.upper, path)
            notes += [note] if note else []
    return motors, notes


def _span(
    model: mujoco.MjModel, number: int, target: int, on_tendon: bool, torque: bool, where: str
) -> tuple[float, float]:
    """The range of what it moves, met with the range that its command can ask for."""
    limited, span = (
        (model.tendon_limited[target], model.tendon_range[target])
        if on_tendon
        else (model.jnt_limited[target], model.jnt_range[target])
    )
    commanded = not torque and bool(model.actuator_ctrllimited[number])
    if not limited and not commanded:
        raise ConfigError(f"{where}: neither it nor what it moves has a range: where may it go?")
    lower, upper = (float(span[0]), float(span[1])) if limited else (-np.inf, np.inf)
    if commanded:
        gain, bias = float(model.actuator_gainprm[number, 0]), model.actuator_biasprm[number]
        ends = -(bias[0] + gain * model.actuator_ctrlrange[number]) / bias[1]
        met = max(lower, float(ends.min())), min(upper, float(ends.max()))
        if met[0] >= met[1]:
            raise ConfigError(
                f"{where}: its range of control comes to {ends.min():g} … {ends.max():g}, and what it moves has the "
                f"range {lower:g} … {upper:g}: they have nothing in common"
            )
        lower, upper = met
    return lower, upper


def _effort(model: mujoco.MjModel, number: int, gain: float, torque: bool) -> float | None:
    """The most that it can give by the file: the smallest of its force range, its joint's force range, and, of a motor
    that takes torques, its range of control. None: it has none of them."""
    found = []
    if model.actuator_forcelimited[number]:
        found.append(float(np.abs(model.actuator_forcerange[number]).max()))
    if torque and model.actuator_ctrllimited[number]:
        found.append(float(np.abs(gain * model.actuator_ctrlrange[number]).max()))
    if model.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_JOINT:
        joint = int(model.actuator_trnid[number, 0])
        if model.jnt_actfrclimited[joint]:
            found.append(float(np.abs(model.jnt_actfrcrange[joint]).max()))
    else:
        tendon = int(model.actuator_trnid[number, 0])
        if model.tendon_actfrclimited[tendon]:
            found.append(float(np.abs(model.tendon_actfrcrange[tendon]).max()))
    return min((each for each in found if each > 0.0), default=None)


def _check_one_each(motors: Sequence[ImportedMotor], path: Path) -> None:
    """Raises ConfigError for a joint or a tendon that two motors drive."""
    for k, motor in enumerate(motors):
        for other in motors[:k]:
            if (motor.joint, motor.tendon) == (other.joint, other.tendon):
                what = "one tendon" if motor.joint is None else f"joint {motor.name}"
                raise ConfigError(
                    f"{path}: actuators {other.actuator} and {motor.actuator} both drive {what}: leave one of them"
                )


def _check_same_commands(motors: Sequence[ImportedMotor], path: Path) -> None:
    """Raises ConfigError where some motors take torques and others positions."""
    odd = next((motor for motor in motors if motor.torque != motors[0].torque), None)
    if odd is None:
        return
    takes = [f"{motor.actuator} takes {'a torque' if motor.torque else 'a position'}" for motor in (motors[0], odd)]
    raise ConfigError(f"{path}: {' and '.join(takes)}; a hand takes one of them: make all <motor>, or all <position>")
