"""The way of what is held to the tray: up over all that stands on the table, across, and down to its rim."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.motion.other_objects import box_around
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.perception.target import half_width
from allegro_twin.cell.planning.reachability import far_path
from allegro_twin.cell.planning.stored_grasps import GraspCandidate, yaw_rotation
from allegro_twin.cell.settings import TraySettings
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.pose import Pose
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


class ReleasePath(NamedTuple):
    """How what is held gets into the tray."""

    up: Pose
    """Of the palm, in the world: straight up from where it is."""
    across: Vector
    """The arm's posture above the tray, (n,), rad."""
    over: Pose
    """Of the palm there, and"""
    palm: Pose
    """where the hand opens, straight below."""


def release_path(
    tray: TraySettings, way: GraspCandidate, grasped: Pose, solid: Solid, others: Sequence[Array], now: Vector,
    cell: Cell,
) -> ReleasePath:  # fmt: skip
    """The path from a posture of the arm, `now` (n,), rad. `grasped`: the palm when the object, `solid`, stood on the
    table; `others`: points of what stands there still, (k, 3), m.

    Raises ConfigError where the arm reaches none with nothing in the way.
    """
    boxes = [box_around(points) for points in others]
    cell.clearance.nothing()
    cell.clearance.beside(boxes)
    highest = max([tray.height, *(each.extents[2] for each in boxes)])
    bottom = float(solid.position[2]) - half_width(solid, np.array([0.0, 0.0, 1.0]))
    low = grasped.position[2] - bottom + tray.height + tray.above
    high = min(max(low, grasped.position[2] - bottom + highest + _OVER, _LOW), max(_HIGH, low))
    plans = list[tuple[float, tuple[Vector, ...], ReleasePath]]()
    for room, turn in product(_ROOMS, [yaw_rotation(float(k)) for k in np.linspace(0.0, 2.0 * np.pi, _TURNS + 1)[:-1]]):
        if plans and room != _ROOMS[0]:
            break
        x, y = tray.at + (turn @ (grasped.position - solid.position))[:2]
        turned = turn @ grasped.rotation
        up = Pose(np.array([*grasped.position[:2], high]), grasped.rotation)
        over, there = (Pose(np.array([x, y, height]), turned) for height in (high, low))
        postures = _postures([up, over, there], now, room, cell)
        if postures:
            far = float(np.abs(np.stack(postures) - now).max())
            plans.append((far, postures, ReleasePath(up, postures[1], over, there)))
    hand, speed = way.card.grasp.squeeze, cell.settings.arm.joint_speed
    for _, plan, found in sorted(plans, key=lambda each: each[0]):
        arm = np.concatenate([far_path(begin, end, speed)[0] for begin, end in pairwise((now, *plan))])
        if cell.clearance.on_way(arm, np.tile(hand, (len(arm), 1))) is None:
            return found
    raise ConfigError(
        f"{cell.robot.spec.name} does not get to the tray at ({tray.at[0]:g}, {tray.at[1]:g}) with the {solid.shape}: "
        f"of {_TURNS} turns it reaches {len(plans)}, and something is in the way of all; move the tray (`tray.at`)"
    )


def _postures(palms: Sequence[Pose], near: Vector, room: float, cell: Cell) -> tuple[Vector, ...]:
    """Of the arm, one after the other; none where one of them is out of reach, or has less `room`, rad, in a joint."""
    robot, spec, found = cell.robot, cell.robot.spec, list[Vector]()
    for palm in palms:
        try:
            near = robot.model.reach(robot.flange_for(palm), near, _NEAR)
        except ConfigError:
            return ()  # The answer, not an error.
        if float(np.minimum(near - spec.lower, spec.upper - near).min()) < room:
            return ()
        found.append(near)
    return tuple(found)
