"""Scripted motions, sampled at every control period: a residual policy adds its actions to one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from allegro_twin.control.trajectory import Moves, Waypoint, travel_time
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.types import Array, Vector, frozen


@dataclass(frozen=True, slots=True, eq=False)
class SampledScript:
    """Set-points of one motion; after the last the hand stays there."""

    position: Array
    """Shape (t, n), rad: row k is the set-point k periods after the beginning."""
    velocity: Array
    """Shape (t, n), rad/s."""


@dataclass(frozen=True, slots=True, eq=False)
class ScriptTable:
    """Several motions in one table, so that a batch reads each simulation's own at once."""

    position: Array
    """Shape (s, t, n), rad."""
    velocity: Array
    """Shape (s, t, n), rad/s."""

    @property
    def periods(self) -> int:
        return int(self.position.shape[1])


def sample_script(moves: Moves, start: Vector, periods: int, period: float) -> SampledScript:
    """Sample the motion from `start` at every period, exactly as a PD controller with the same reference follows it."""
    path = moves.begin(start)
    points = [path(k * period) for k in range(periods)]
    return SampledScript(frozen([point.position for point in points]), frozen([point.velocity for point in points]))


def script_table(scripts: Sequence[SampledScript]) -> ScriptTable:
    """Join motions of the same length to one table."""
    return ScriptTable(frozen([s.position for s in scripts]), frozen([s.velocity for s in scripts]))


def closing_moves(grasp: Grasp, wait: float, squeeze: float) -> Moves:
    """Motion of a scripted grasp: the pre-shape for `wait` seconds, closing at the grasp's own speed, and the squeeze
    for `squeeze` seconds."""
    return Moves(
        [
            grasp.waypoint("preshape", wait),
            Waypoint(grasp.close, speed=grasp.speed, profile=grasp.profile),
            grasp.waypoint("squeeze", squeeze),
        ]
    )


def holding_script(grasp: Grasp, periods: int) -> SampledScript:
    """The squeeze of a grasp alone."""
    still = frozen(np.tile(grasp.squeeze, (periods, 1)))
    return SampledScript(still, frozen(np.zeros_like(still)))


def closing_time(grasp: Grasp, wait: float, squeeze: float) -> float:
    """When the scripted grasp has squeezed, s."""
    return wait + travel_time(grasp.preshape, grasp.waypoint("close")) + squeeze
