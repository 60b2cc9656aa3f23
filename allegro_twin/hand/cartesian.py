"""Fingertips along straight lines in the palm frame."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.closed_form import FingerKinematics
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

_STEP = 0.002  # m between the points of a line that are solved; joints run straight in between.


def straight(spec: HandSpec, start: Vector, targets: Mapping[str, ArrayLike], speed: float) -> Moves:
    """The motion of some fingertips from a posture (n,), rad, straight to their targets (3,), m, palm frame.

    They leave and arrive together, from rest to rest; the one that travels furthest peaks at `speed`, m/s. Each point
    takes the posture nearest to the one before. Other fingers stay. Raises ConfigError for a target out of reach, with
    the distance to the nearest point within it.
    """
    if not speed > 0.0:
        raise ConfigError(f"speed must be positive, in m/s; it is {speed}")
    goals = {name: _point(spec, name, value) for name, value in targets.items()}
    solvers = {name: FingerKinematics(spec, name) for name in goals}
    joints = {name: list(spec.finger(name).joints) for name in goals}
    begin = {name: solvers[name].fk(start[joints[name]]).position for name in goals}
    furthest = max((float(np.linalg.norm(goals[name] - begin[name])) for name in goals), default=0.0)
    if furthest < 1e-6:
        return Moves([Waypoint(start, seconds=1e-3)])
    seconds = furthest * (15.0 / 8.0) / speed
    count = max(math.ceil(furthest / _STEP), 8)
    s = np.linspace(0.0, 1.0, count + 1)[1:]
    parts = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    rows = np.repeat(start[None], count, axis=0)
    for name, solver in solvers.items():
        points = begin[name] + parts[:, None] * (goals[name] - begin[name])
        rows[:, joints[name]] = _solved(solver, points, start[joints[name]])
    return Moves([Waypoint(row, seconds=seconds / count, profile="linear") for row in rows])


def _solved(solver: FingerKinematics, points: Array, near: Vector) -> Array:
    """Postures for points in order, each nearest to the one before, (k, 4), rad."""
    rows = []
    for point in points:
        best = solver.ik(point, near=near).best(near)
        if not best.reached:
            place = ", ".join(f"{value:.4f}" for value in point)
            raise ConfigError(
                f"{solver.name}: the tip cannot be at [{place}] m, palm frame; the nearest point in reach is "
                f"{float(best.distance) * 1000:.1f} mm from there"
            )
        near = best.posture
        rows.append(near)
    return np.array(rows)


def _point(spec: HandSpec, name: str, value: ArrayLike) -> Vector:
    spec.finger(name)
    point = np.asarray(value, dtype=np.float64)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise ConfigError(f"{name}: a fingertip position is three finite numbers, m, palm frame; not {value!r}")
    return point
