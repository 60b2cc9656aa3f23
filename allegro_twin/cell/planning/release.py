"""Release pose of a held object: in the tray, above all that stands on the table, or where the object stood."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.motion.other_objects import box_around, height_around
from allegro_twin.cell.perception.fits.model import Solid, half_width
from allegro_twin.cell.planning.reachability import far_path, joint_room, reaches_straight
from allegro_twin.cell.planning.stored_grasps import GraspCandidate, yaw_rotation
from allegro_twin.cell.settings import TraySettings
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.pose import Pose
from allegro_twin.sim.contact.obstacle_clearance import TableObject
from allegro_twin.types import Array, Vector

_TURNS = 24
"""Ways to turn what is held about the vertical."""
_NEAR = 2e-3
"""m and rad."""
_ROOMS = (0.15, 0.06)
"""rad, to the end of every joint, and less where nothing else is reached."""
_OVER = 0.03
"""m, between what is held and all that it passes over."""
_LOW, _HIGH = 0.25, 0.45
"""m: the palm is carried at the first height at least, and at the second at most."""
_PLACES = np.array([[0.0, 0.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]]) / 6.0
"""Where objects are let go, in edges of the tray from its middle."""
_DISTANCES = np.arange(0.25, 0.85, 0.05)
"""m from the arm's base, at which another place for a tray is looked for."""
_ALIKE = 0.02
"""m: places under which things differ by less are as empty as each other."""
_NOTHING: Array = np.zeros((0, 3))


class ReleasePath(NamedTuple):
    """Path of a held object into the tray."""

    up: Pose
    """Pose of the palm in the world, straight up from where it is."""
    across: Vector
    """The arm's posture above the tray, (n,), rad."""
    over: Pose
    """Pose of the palm above the tray, in the world."""
    palm: Pose
    """Pose of the palm where the hand opens, straight below, in the world."""


class _ArmPath(NamedTuple):
    """A path, the arm's postures on it, and the largest turn of a joint, rad."""

    far: float
    postures: tuple[Vector, ...]
    path: ReleasePath


def release_path(
    tray: TraySettings, candidate: GraspCandidate, grasped: Pose, solid: Solid, others: Sequence[Array], now: Vector,
    cell: Cell, used: int = 0, inside: Array = _NOTHING,
) -> ReleasePath:  # fmt: skip
    """The path from a posture of the arm, `now` (n,), rad. `grasped`: the palm when the object, `solid`, stood on the
    table; `others`: points of what stands there still, (k, 3), m; `used`: so many objects are in the tray; `inside`:
    points of them and of the tray, (k, 3), world, m. It is let go where the tray is emptiest, and at the next
    of the tray's places where several are alike.

    Raises ConfigError where the arm reaches none with nothing in the way.
    """
    boxes = [box_around(points) for points in others]
    cell.clearance.clear_table()
    cell.clearance.set_obstacles(boxes)
    filled = height_around(inside, np.array(tray.at), float(np.hypot(*tray.size)) / 2.0)
    places = _emptiest_first(tray, solid, inside, used)
    tray = tray.model_copy(update={"height": max(tray.height, filled)})
    hand, speed, reached = candidate.card.grasp.squeeze, cell.settings.arm.joint_speed, 0
    for place in places:
        plans = sorted(_reached(tray, place, grasped, solid, boxes, now, cell), key=lambda each: each.far)
        reached += len(plans)
        for plan in plans:
            postures = pairwise((now, *plan.postures))
            arm = np.concatenate([far_path(begin, end, speed)[0] for begin, end in postures])
            if cell.clearance.check_path(arm, np.tile(hand, (len(arm), 1))) is None:
                return plan.path
    raise ConfigError(
        f"{cell.robot.spec.name} does not get to the tray at ({tray.at[0]:g}, {tray.at[1]:g}) with the {solid.shape}: "
        f"of {len(_PLACES) * _TURNS} poses above it the arm reaches {reached}, and something is in the way of all; "
        "move the tray (`tray.at`)"
    )


def _emptiest_first(tray: TraySettings, solid: Solid, inside: Array, used: int) -> list[Array]:
    """The tray's places, in edges of it from its middle, those first under which least stands."""
    radius = max(half_width(solid, way) for way in np.eye(3)[:2])
    heights = [height_around(inside, tray.at + place * tray.size, radius) for place in _PLACES]
    order = sorted(range(len(_PLACES)), key=lambda k: (round(heights[k] / _ALIKE), (k - used) % len(_PLACES)))
    return [_PLACES[k] for k in order]


def reaches_tray(tray: TraySettings, grasped: Pose, solid: Solid, lifted: Vector, cell: Cell) -> bool:
    """Whether the arm, lifted to a posture (n,), rad, would get to the middle of the tray with what it holds, if
    nothing were in the way."""
    return next(_reached(tray, _PLACES[0], grasped, solid, (), lifted, cell), None) is not None


def check_tray(tray: TraySettings, cell: Cell) -> None:
    """Raises ConfigError for a tray out of the arm's reach, however the hand is turned over it, with the nearest
    place on the line through the arm's base that is in reach."""
    if _reaches_above(np.array(tray.at), cell):
        return
    base = cell.robot.base.position[:2]
    away = np.array(tray.at) - base
    far = float(np.linalg.norm(away))
    line = away / far if far > 0.0 else np.array([1.0, 0.0])
    reached = (at for at in sorted(_DISTANCES, key=lambda at: abs(at - far)) if _reaches_above(base + at * line, cell))
    other = next(reached, None)
    there = f"({tray.at[0]:g}, {tray.at[1]:g}), {far:.2f} m from its base at ({base[0]:g}, {base[1]:g})"
    way = "it reaches nothing on that side: put the tray on another side of it"
    if other is not None:
        x, y = base + other * line
        way = f"put the tray {'nearer' if other < far else 'farther away'}, such as at ({x:.2f}, {y:.2f})"
    raise ConfigError(f"tray.at: {cell.robot.spec.name} does not reach above {there}, however it turns the hand; {way}")


def _reaches_above(place: Array, cell: Cell) -> bool:
    """Whether the arm gets above a place on the table, (2,), m, with the hand turned in some way."""
    for height, turn in product((_LOW, _HIGH), _turns()):
        above = Pose(np.array([*place, height]), turn @ cell.security.rotation)
        if _postures([above], cell.posture, _ROOMS[-1], cell):
            return True
    return False


def _turns() -> list[Array]:
    """About the vertical, (3, 3) each."""
    return [yaw_rotation(float(angle)) for angle in np.linspace(0.0, 2.0 * np.pi, _TURNS, endpoint=False)]


def _reached(
    tray: TraySettings, place: Array, grasped: Pose, solid: Solid, others: Sequence[TableObject], now: Vector,
    cell: Cell,
) -> Iterator[_ArmPath]:  # fmt: skip
    """Paths to one of the tray's places that the arm reaches, those with less room in the joints where there are no
    others."""
    highest = max([tray.height, *(each.extents[2] for each in others)])
    bottom = float(solid.position[2]) - half_width(solid, np.array([0.0, 0.0, 1.0]))
    low = grasped.position[2] - bottom + tray.height + tray.above
    high = min(max(low, grasped.position[2] - bottom + highest + _OVER, _LOW), max(_HIGH, low))
    up = Pose(np.array([*grasped.position[:2], high]), grasped.rotation)
    some = False
    for room, turn in product(_ROOMS, _turns()):
        if some and room != _ROOMS[0]:
            break
        x, y = tray.at + place * tray.size + (turn @ (grasped.position - solid.position))[:2]
        turned = turn @ grasped.rotation
        over, there = (Pose(np.array([x, y, height]), turned) for height in (high, low))
        postures = _postures([up, over, there], now, room, cell)
        straight = ((now, postures[0]), (postures[1], postures[2])) if postures else ()
        if postures and all(reaches_straight(begin, end, cell.robot, room) for begin, end in straight):
            some = True
            far = float(np.abs(np.stack(postures) - now).max())
            yield _ArmPath(far, postures, ReleasePath(up, postures[1], over, there))


def _postures(palms: Sequence[Pose], near: Vector, room: float, cell: Cell) -> tuple[Vector, ...]:
    """Postures of the arm for palm poses, one after the other; empty where one is out of reach, or has less `room`,
    rad, in a joint."""
    robot, found = cell.robot, list[Vector]()
    for palm in palms:
        try:
            near = robot.model.reach(robot.flange_for(palm), near, _NEAR)
        except ConfigError:
            return ()  # The answer, not an error.
        if joint_room([near], robot) < room:
            return ()
        found.append(near)
    return tuple(found)
