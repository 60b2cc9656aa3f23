"""Check of a simulated cell where it begins: what cannot stand as the config says, or hides what is looked for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from allegro_twin.cell.arm.arm_with_hand import ArmWithHand
from allegro_twin.cell.settings import LabSettings
from allegro_twin.errors import ConfigError
from allegro_twin.sim.contact.initial_overlap import check_objects_apart, initial_overlaps
from allegro_twin.sim.model.scene import WALL
from allegro_twin.sim.objects.catalogue import PlacedObject
from allegro_twin.types import Vector

_TABLE, _TRAY = "table", "tray"


def check_scene(robot: ArmWithHand, settings: LabSettings, objects: Sequence[PlacedObject]) -> None:
    """Raise ConfigError, one line for the first thing that is wrong: objects beside, below or in the table or in each
    other, an arm or a hand that waits in something, a tray where objects are looked for, a camera below the table."""
    names, position = [each.grasp_object.name for each in objects], _waiting(robot)
    _check_on_table(robot, objects)
    check_objects_apart(robot.world.model, names, position)
    _check_tray(settings)
    still = {_TABLE, _TRAY}
    for parts, depth in initial_overlaps(robot.world.model, names, position):
        pair = {_TRAY if part.startswith(f"{_TRAY}_") else part for part in parts}
        into = sorted(pair & {*still, *names}, key=lambda part: part in names)
        what = sorted(pair - still, key=lambda part: part in names)
        if not into or not what:
            continue  # Of the robot alone.
        if what[0] in names:
            raise ConfigError(
                f"{what[0]} stands {1e3 * depth:.0f} mm deep in the {into[0]} where the cell begins: move it by its "
                "`at`"
            )
        there = into[0] if into[0] in names else f"the {into[0]}"
        at = "tray.at" if into[0] == _TRAY else f"the `at` of {into[0]}"
        if what[0] in _foot(robot) and into[0] != _TABLE:
            raise ConfigError(
                f"{at}: {there} stands {1e3 * depth:.0f} mm deep in {what[0]}, and the arm stands at "
                f"{_place(robot.base.position[:2])} whatever it does; move {there} away from it"
            )
        other = "" if into[0] == _TABLE else f", or move {there} by {at}"
        raise ConfigError(
            f"security.position {_place(settings.security.position)}: {what[0]} would wait {1e3 * depth:.0f} mm deep "
            f"in {there}; take a place with more room, such as a higher one{other}"
        )
    _check_camera(settings)


def _foot(robot: ArmWithHand) -> set[str]:
    """Bodies of the arm that are in the same place in every posture: the one that its first joint turns, and those
    below it."""
    model = robot.world.model
    body = int(model.jnt_bodyid[model.joint(robot.spec.joints[0]).id])
    found = set[str]()
    while body:
        found.add(model.body(body).name)
        body = int(model.body_parentid[body])
    return found


def _waiting(robot: ArmWithHand) -> Vector:
    """Generalised position of the scene where arm and hand wait, (nq,)."""
    position, before = robot.world.data.qpos, robot.world.data.qpos.copy()
    robot.arm_sim.lay()
    robot.hand_sim.lay()
    found: Vector = position.copy()
    position[:] = before
    return found


def _check_on_table(robot: ArmWithHand, objects: Sequence[PlacedObject]) -> None:
    table = robot.world.model.geom(_TABLE)
    lower, upper = table.pos - table.size, table.pos + table.size
    for each in objects:
        place, name = np.array(each.position), each.grasp_object.name
        if np.any(place[:2] < lower[:2]) or np.any(place[:2] > upper[:2]):
            raise ConfigError(
                f"{name} at {_place(place[:2])} stands beside the table, which reaches from {_place(lower[:2])} to "
                f"{_place(upper[:2])}: move it by its `at`"
            )
        if place[2] < upper[2]:
            raise ConfigError(
                f"{name} at {_place(place)} is below the table, whose top is at {upper[2]:g} m: leave out the third "
                "number of its `at`, and it stands on the table"
            )


def _check_tray(settings: LabSettings) -> None:
    tray, seen = settings.tray, settings.perception.workspace
    if tray is None:
        return
    low, high = np.subtract(tray.at, np.divide(tray.size, 2.0)), np.add(tray.at, np.divide(tray.size, 2.0))
    if np.all(low < seen.upper[:2]) and np.all(high > seen.lower[:2]):
        raise ConfigError(
            f"tray.at {_place(tray.at)}: the tray reaches from {_place(low)} to {_place(high)} and stands in "
            f"perception's `workspace`, {_place(seen.lower[:2])} to {_place(seen.upper[:2])}, where it would hide "
            "objects: move one out of the other"
        )
    if min(tray.size) <= 2.0 * WALL:
        raise ConfigError(
            f"tray.size {tray.size[0]:g} x {tray.size[1]:g} m: walls of {1e3 * WALL:.0f} mm leave no room between "
            "them; make it larger"
        )


def _check_camera(settings: LabSettings) -> None:
    mount = settings.camera.mount
    place = mount.local().position
    if not settings.at_the_wrist and place[2] <= 0.0:
        raise ConfigError(
            f"camera.mount.position {_place(place)}: the camera is below the table, whose top is at 0 m: raise it"
        )


def _place(position: object) -> str:
    return f"({', '.join(f'{value:.2f}' for value in np.asarray(position))})"
