"""Fingertips along straight lines in the palm frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.control.trajectory import Moves, Waypoint, number
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.finger import FingerKinematics
from allegro_twin.kinematics.hand import HandKinematics
from allegro_twin.kinematics.orientation import (
    angle_between,
    euler_from_matrix,
    matrix_from_euler,
    matrix_from_quaternion,
    quaternion_from_matrix,
    slerp,
)
from allegro_twin.kinematics.pose import Pose
from allegro_twin.kinematics.solutions import Best
from allegro_twin.types import Array, Vector

_SLOWEST = 1e-5  # m/s. Hours for the length of a finger: who asks for less has mistaken the unit.
_STEP = 0.002  # m between the points of a line that are solved; joints run straight in between.
_LEVER = 0.05  # m. A turn of a tip counts as this arc a radian: about its distance from the joint before its last.
_JUMP = 0.5  # rad. A joint that goes further between two points has changed over to another posture.
_TURNED = 0.01  # rad. An orientation that is nearer than this is met.


class _Line(NamedTuple):
    """The way of one tip."""

    solver: FingerKinematics
    joints: list[int]
    begin: Pose
    point: Vector
    """Where it ends, (3,), m."""
    rotation: Array | None
    """How it is turned then, (3, 3); None: as it comes."""
    euler: Vector | None
    """Its roll, pitch and yaw as they were given, (3,), rad."""

    @property
    def length(self) -> float:
        """m; of the way, or of the arc that a turn counts as."""
        turn = 0.0 if self.rotation is None else float(angle_between(self.begin.rotation, self.rotation))
        return max(float(np.linalg.norm(self.point - self.begin.position)), _LEVER * turn)


def straight_line_motion(
    hand: HandKinematics,
    start: Vector,
    targets: Mapping[str, ArrayLike],
    speed: float,
    euler: Mapping[str, ArrayLike] | None = None,
) -> Moves:
    """The motion of some fingertips from a posture (n,), rad, straight to their targets (3,), m, palm frame.

    They leave and arrive together, from rest to rest; the one that travels furthest peaks at `speed`, m/s. `euler`
    says how some of them are then turned: roll, pitch, yaw, (3,), rad. Each point takes the posture nearest to the one
    before. Other fingers stay. Raises ConfigError for a speed that no hand has; for a target out of reach, with the
    distance to the nearest point within it; for an orientation that the tip cannot have there, with the nearest; and
    for a line that leaves the reach on its way.
    """
    if not number(speed, "speed, in m/s,") >= _SLOWEST:
        raise ConfigError(f"speed must be positive, in m/s, and at least {_SLOWEST:g}; it is {speed}")
    if loose := [name for name in euler or {} if name not in targets]:
        raise ConfigError(f"euler is given for {loose[0]}, which has no target position")
    lines = [_line(hand, start, name, value, (euler or {}).get(name)) for name, value in targets.items()]
    furthest = max((line.length for line in lines), default=0.0)
    if furthest < 1e-6:
        return Moves([Waypoint(start, seconds=1e-3)])
    seconds = furthest * (15.0 / 8.0) / speed
    count = max(math.ceil(furthest / _STEP), 8)
    s = np.linspace(0.0, 1.0, count + 1)[1:]
    parts = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    rows = np.repeat(start[None], count, axis=0)
    for line in lines:
        rows[:, line.joints] = _solved(line, parts, start[line.joints])
    return Moves([Waypoint(row, seconds=seconds / count, profile="linear") for row in rows])


def _line(hand: HandKinematics, start: Vector, name: str, value: ArrayLike, euler: ArrayLike | None) -> _Line:
    joints, solver = list(hand.spec.finger(name).joints), hand.finger(name, start)
    if solver.shared:
        raise ConfigError(
            f"{hand.spec.name}: {name} cannot be moved alone, its motor moves {', '.join(solver.shared)} as well"
        )
    point = _three(value, f"{name}: a fingertip position is three finite numbers, m, palm frame")
    rotation = turn = None
    if euler is not None:
        turn = _three(euler, f"{name}: euler is roll, pitch and yaw, rad")
        solver.ik(point, euler=turn)  # Raises where this finger's orientation cannot be asked for.
        rotation = matrix_from_euler(turn)
    return _Line(solver, joints, solver.fk(start[joints]), point, rotation, turn)


def _solved(line: _Line, parts: Array, start: Vector) -> Array:
    """Postures for parts of a line in order, each nearest to the one before, (k, 4), rad."""
    _check_end(line, start)
    points = line.begin.position + parts[:, None] * (line.point - line.begin.position)
    turns = _turned(line.begin.rotation, line.rotation, parts)
    rows = [start]
    for point, turn in zip(points, turns, strict=True):
        best = _best(line.solver, point, turn, rows[-1])
        if not best.reached or np.abs(best.posture - rows[-1]).max() > _JUMP:
            raise ConfigError(
                f"{line.solver.name}: {_text(line.point)} m is in reach, but not on a straight line from here: the "
                f"finger cannot go on past {_text(point)} m; go by a point beside it"
            )
        rows.append(best.posture)
    return np.array(rows[1:])


def _check_end(line: _Line, near: Vector) -> None:
    best, name = _best(line.solver, line.point, line.rotation, near), line.solver.name
    if not best.reached:
        raise ConfigError(
            f"{name}: the tip cannot be at {_text(line.point)} m, palm frame; the nearest point in reach is "
            f"{float(best.distance) * 1000:.1f} mm from there"
        )
    if line.euler is not None and best.angle > _TURNED:
        nearest = _text(euler_from_matrix(line.solver.fk(best.posture).rotation))
        largest = float(np.abs(line.euler).max())
        unit = f"; euler is in radians: {largest:g}° is {math.radians(largest):.4f} rad" if largest > math.tau else ""
        raise ConfigError(
            f"{name}: at {_text(line.point)} m the tip cannot have euler {_text(line.euler)} rad; the nearest that it "
            f"can have there is {nearest}, {float(best.angle):.2f} rad away{unit}"
        )


def _best(solver: FingerKinematics, point: Vector, rotation: Array | None, near: Vector) -> Best:
    if rotation is None:
        return solver.ik(point, near=near).best(near)
    if isinstance(solver, ClosedFormFinger):  # It has every branch, and takes no posture to be near to.
        return solver.ik(point, rotation=rotation).best(near)
    return solver.ik(point, rotation=rotation, near=near).best(near)


def _turned(begin: Array, end: Array | None, parts: Array) -> list[Array | None]:
    """The orientations at parts of the shortest turn from one to another, None where none is asked for."""
    if end is None:
        return [None] * len(parts)
    return list(matrix_from_quaternion(slerp(quaternion_from_matrix(begin), quaternion_from_matrix(end), parts)))


def _three(value: ArrayLike, what: str) -> Vector:
    try:
        vector = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{what}; not {value!r}") from error
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ConfigError(f"{what}; not {value!r}")
    return vector


def _text(values: Vector) -> str:
    return f"[{', '.join(f'{value:.4f}' for value in values)}]"
