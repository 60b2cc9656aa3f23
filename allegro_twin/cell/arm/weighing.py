"""Weighing a tool: the arm turns it five ways, rests at each, and takes from what the flange felt what hangs on it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from allegro_twin.cell.arm.arm_with_hand import ArmWithHand
from allegro_twin.cell.arm.impedance import Impedance, Stiffness
from allegro_twin.cell.arm.target import CartesianTarget
from allegro_twin.cell.arm.tool import IdentifiedTool, identify_tool
from allegro_twin.controller import Controller
from allegro_twin.kinematics.arm import rotate
from allegro_twin.kinematics.pose import Pose
from allegro_twin.loop import interleave, run
from allegro_twin.types import Array, Sample

TILTS = ((0.0, 0.0, 0.0), (0.8, 0.0, 0.0), (-0.8, 0.0, 0.0), (0.0, 0.8, 0.0), (0.0, -0.8, 0.0))
"""Rotation vectors from where the arm begins, in the axes of the base, rad: what a wrist does without the elbow."""
_STAY, _LISTEN = 2.5, 0.2
"""s at each, and of that at the end what is listened to: when the arm has come to rest."""
_FIRM = Stiffness(800.0, 60.0)


def weigh_tool(robot: ArmWithHand, hand: Controller[Any], tilts: Sequence[Sequence[float]] = TILTS) -> IdentifiedTool:
    """Mass, centre and the sensor's bias of what hangs on the flange, while the hand does what its controller says.

    Raises ConfigError for tilts that do not tell them apart, and HandError.
    """
    home = robot.model.pose(robot.arm.reset().position)
    target = CartesianTarget(home)
    runs = (
        (run(robot.arm, Impedance(robot.model, target, _FIRM)), robot.arm.period),
        (run(robot.hand, hand), robot.hand.period),
    )
    samples = (sample for turn, sample in interleave(*runs) if turn == 0)
    axes, felt = [], []
    for number, tilt in enumerate(tilts):
        target.move(Pose(home.position, rotate(home.rotation, np.array(tilt))))
        rotation, wrench = _listened(robot, samples, _STAY * (number + 1))
        axes.append(rotation)
        felt.append(wrench)
    return identify_tool(axes, felt, robot.arm.reset().gravity)


def _listened(robot: ArmWithHand, samples: Iterator[Sample], end: float) -> tuple[Array, Array]:
    """The flange's axes and the mean of what it felt, (6,), in the last moments before a time."""
    heard = []
    for sample in samples:
        if sample.state.t > end - _LISTEN:
            heard.append(sample.state.wrench)
        if sample.state.t >= end - 1e-9:
            break
    return robot.model.pose(sample.state.position).rotation, np.mean(heard, axis=0)
