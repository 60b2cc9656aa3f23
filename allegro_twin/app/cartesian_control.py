"""Cartesian controllers made from the controller block of an arm's config."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from allegro_twin.app.controller_settings import CartesianSettings
from allegro_twin.controller import Controller
from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import ArmSpec

if TYPE_CHECKING:
    from allegro_twin.cell.arm.impedance import Stiffness

STAY = 2.0
"""s that an arm is watched after its way."""


def leading(settings: CartesianSettings, spec: HandSpec) -> tuple[Controller[Any], float | None]:
    """The controller that brings the flange to its pose, and how long that takes. Raises ConfigError."""
    from allegro_twin.cell.arm.compliance import Compliance, Pull
    from allegro_twin.cell.arm.impedance import Impedance
    from allegro_twin.cell.arm.target import CartesianTarget, Smoothing
    from allegro_twin.cell.arm.tool import WrenchCompensation
    from allegro_twin.kinematics.arm import ArmModel, rotate
    from allegro_twin.kinematics.pose import Pose
    from allegro_twin.spec.arm import Load

    assert isinstance(spec, ArmSpec)
    model = ArmModel(spec)
    home = model.pose(spec.rest)
    goal = Pose(np.array(settings.position), rotate(home.rotation, np.array(settings.turn)))
    model.reach(goal, spec.rest, tolerance=1e-3)
    smoothing, target = Smoothing(settings.speed, settings.turning), CartesianTarget(goal)
    way = float(np.linalg.norm(goal.position - home.position)) / settings.speed
    seconds = max(way, float(np.linalg.norm(settings.turn)) / settings.turning) + STAY
    compensation = WrenchCompensation(spec.load or Load(0.0, np.zeros(3)))
    if settings.kind == "impedance":
        hung = Impedance(
            model, target, _stiffness(settings, 200.0, 10.0), smoothing=smoothing, compensation=compensation
        )
        return hung, seconds
    pull = Pull(iterations=settings.iterations)
    return Compliance(
        model, target, compensation, _stiffness(settings, 500.0, 50.0), pull, smoothing=smoothing
    ), seconds


def _stiffness(settings: CartesianSettings, linear: float, angular: float) -> Stiffness:
    from allegro_twin.cell.arm.impedance import Stiffness

    return Stiffness(settings.stiffness or linear, settings.angular_stiffness or angular)
