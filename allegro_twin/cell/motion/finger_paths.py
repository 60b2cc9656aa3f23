"""Finger control along a path that is steered from outside, for hands with and without torque commands."""

from __future__ import annotations

from dataclasses import dataclass

from allegro_twin.control.controllers import PD, GravityFeedforward, PositionControl, ReferenceMemory
from allegro_twin.control.trajectory import Path
from allegro_twin.controller import Controller
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.hand import HandKinematics
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector

OPENING = 2.0
"""rad/s, of the fingers in the air."""


@dataclass(frozen=True, slots=True, eq=False)
class SteeredReference:
    """A reference whose path is steered from outside."""

    path: Path

    def begin(self, position: Vector) -> Path:
        """The path; it begins where the hand was told to be."""
        return self.path


def finger_controller(
    reference: SteeredReference, gains: str, spec: HandSpec, model: HandKinematics
) -> Controller[ReferenceMemory]:
    """The controller of a hand in the cell. Raises ConfigError for gains that it does not have."""
    if "torque" in spec.commands:
        return PD(reference, load_gains(gains, spec), GravityFeedforward(model.gravity_torque))
    load_gains(gains, spec)
    return PositionControl(reference)
