"""How the fingers follow a path that is steered from outside, of hands that take torques and of those that do not."""

from __future__ import annotations

from dataclasses import dataclass

from allegro_twin.control.controllers import PD, Follow, Following, Gravity
from allegro_twin.control.trajectory import Path
from allegro_twin.controller import Controller
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.model import HandModel
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


def finger_controller(wish: SteeredReference, gains: str, spec: HandSpec, model: HandModel) -> Controller[Following]:
    """The controller of a hand in the cell. Raises ConfigError for gains that it does not have."""
    if "torque" in spec.commands:
        return PD(wish, load_gains(gains, spec), Gravity(model.gravity_torque))
    load_gains(gains, spec)
    return Follow(wish)
