"""Reachability of grasps: the one that the arm reaches best, with nothing in its path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from allegro_twin.cell.arm.arm_with_hand import ArmWithHand
from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.motion.arm_motion import ACCELERATION
from allegro_twin.cell.motion.finger_paths import OPENING
from allegro_twin.cell.perception.errors import position_text
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.planning.adaptation import GraspAdapter
from allegro_twin.cell.planning.stored_grasps import (
    MOST,
    GraspCandidate,
    StoredGrasp,
    extent_mismatch,
    grasp_candidates,
    nearest_stored,
    table_object,
    turned_candidates,
)
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arm import rotate, rotation_between
from allegro_twin.kinematics.pose import Pose
from allegro_twin.sim.contact.obstacle_clearance import CLEAR, OTHERS, ClearanceViolation, TableObject
from allegro_twin.types import Array, Vector

_TRIED = 8
"""Ways, those first in which the arm bends the least."""
_NEAR = 2e-3
"""m and rad: how exactly it has to reach them on paper; the spring goes on from there."""
_RIGHT = (0.5, 0.7, -0.2, -2.1, -1.7, 1.7, 1.0)
_LEFT = (-0.6, 0.7, 0.3, -2.1, 1.9, 1.8, 1.2)
"""rad. From where postures with the hand to either side are looked for; for an arm of Franka's."""
_OUT = ((1.6, 1.2, -1.1, -2.6, -2.4, 2.1, 1.6), (-1.6, 1.2, 1.1, -2.6, 2.4, 2.1, 0.0))
"""rad. With the elbow out to either side, where those reach none: fingers that point at the arm, or away from it."""


class ReachSearch(NamedTuple):
    """Start postures and variants for the search of a reachable grasp."""

    near: Sequence[Sequence[float]]
    """Postures to begin from."""
    askew: bool = False
    """Those a little off what symmetry leaves open."""


_PLAIN = ReachSearch((_RIGHT, _LEFT))
_EVERY = (_PLAIN, ReachSearch((_RIGHT, _LEFT), askew=True), ReachSearch(_OUT))
_CLEAR = 0.12
"""m: the palm above a thing's top, so that no finger meets it on a far way."""
_LITTLE = 0.04
"""m: not worth a way of its own."""
_ROOM, _MORE_ROOM = 0.08, 0.16
"""rad: to the end of every joint, and of an adapted grasp: the spring and the way of the elbow take some, and there are
other grasps."""
_TURN = 0.7
"""rad: the most that a joint turns on a straight way, which takes 1 s. Near a singular posture the elbow swings far,
faster than the arm may, while the hand hardly moves."""
_STEP = 0.02
"""rad between two postures of a far way that are looked at: 16 mm at the end of a stretched arm."""

_LOOKED = 3
"""Ways of an adapted grasp that are looked at for obstacles: there are other grasps."""

_CLOSING = 16
"""Postures of the approach, of the fingers on their way, and of the lift that are looked at beside other objects."""


class GraspPlan(NamedTuple):
    """A way that the arm reaches."""

    far: float
    """The largest turn of a joint from where it waits, rad."""
    candidate: GraspCandidate
    through: tuple[Vector, ...]
    """Postures of the arm on the way to where the approach begins, which is the last, (n,) each, rad."""
    there: tuple[Vector, Vector]
    """Those of the grasp and of the end of the lift."""
    room: float
    """The least to the end of a joint, rad, at the begin of the approach, the grasp, and the end of the lift."""


def plan_grasp(
    solid: Solid,
    cell: Cell,
    others: Sequence[TableObject] = (),
    adapter: GraspAdapter | None = None,
    clear: float = CLEAR,
    deliverable: Callable[[GraspPlan], bool] = lambda plan: True,
    prefer: Callable[[GraspPlan], bool] = lambda plan: True,
) -> GraspPlan:
    """The way whose approach, grasp and lift the arm reaches with the least turn of a joint from where it waits, and on
    which it comes near to nothing: neither to the table nor to `others`. With
    a stored grasp of such a thing or, with an `adapter`, with one that is adapted to what was seen. `clear`: other
    objects may be so much wider than they were seen, m. `deliverable`: whether the arm gets from a
    plan's lift to the tray; `prefer`: whether it is taken before others that do.

    Raises ConfigError where no grasp is for the thing, the arm reaches none of the ways, or something is in all.
    """
    body = table_object(solid)
    solids = sum(len(other.solids) for other in others)
    if solids > OTHERS:
        raise ConfigError(f"{solids} other objects are on the table, and {OTHERS} can be kept clear of: take some away")
    cell.clearance.see(body)
    cell.clearance.set_obstacles(others, clear)
    if adapter is None:
        return _stored_plan(body, cell, others, MOST, deliverable, prefer)
    spec, same = cell.hand.spec, adapter.settings.same
    stored = nearest_stored(body, spec.model, spec.side)
    if stored is None or extent_mismatch(stored.body, body) > same:
        return _adapted_plan(body, cell, others, adapter, clear, deliverable, prefer)
    kept: GraspPlan | ConfigError
    try:
        kept = _stored_plan(body, cell, others, same, deliverable, prefer)
    except ConfigError as error:
        kept = error
    if isinstance(kept, GraspPlan) and prefer(kept):
        return kept
    try:
        return _adapted_plan(body, cell, others, adapter, clear, deliverable, prefer)
    except ConfigError:
        if isinstance(kept, GraspPlan):
            return kept
        raise kept from None


def _stored_plan(
    body: TableObject, cell: Cell, others: Sequence[TableObject], most: float, deliverable: Callable[[GraspPlan], bool],
    prefer: Callable[[GraspPlan], bool],
) -> GraspPlan:  # fmt: skip
    first, other = "", None
    for one in reachable_grasps(body, cell.robot, cell.posture, cell.settings.lift, most=most):
        found = _clear_of_obstacles(one, cell)
        if not isinstance(found, GraspPlan):
            first = first or f"{found} on the way to its {one.candidate.card.name} grasp"
        elif deliverable(found):
            if prefer(found):
                return found
            other = other or found
    if other is not None:
        return other
    first = first or "from where it would hold it, it does not get to the tray"
    where = ", ".join(position_text(each.position) for each in others)
    beside = f", and so may be the other objects at {where}" if others else ""
    raise ConfigError(
        f"{cell.robot.spec.name} does not get to the {body.kind} at {position_text(body.position)}: {first}, and "
        f"something is in every other{beside}; move the thing, or turn it"
    )


def _adapted_plan(
    body: TableObject, cell: Cell, others: Sequence[TableObject], adapter: GraspAdapter, room: float,
    deliverable: Callable[[GraspPlan], bool], prefer: Callable[[GraspPlan], bool],
) -> GraspPlan:  # fmt: skip
    return adapter.plan(body, lambda card: clear_plan(card, body, cell, deliverable), others, room, prefer)


def clear_plan(
    card: StoredGrasp, body: TableObject, cell: Cell, deliverable: Callable[[GraspPlan], bool] = lambda plan: True
) -> GraspPlan | None:
    """The way to take a body with a grasp that the arm reaches with nothing near, and that is deliverable; None where
    there is none. What is in the way is what `cell.clearance` knows of; with other objects there the grasp is not
    turned."""
    ways = turned_candidates(card, body)[: 1 if cell.clearance.crowded else None]
    reached = _reached(ways, body, cell.robot, cell.posture, cell.settings.lift, _PLAIN.near)
    for one in [each for each in reached if each.room > _MORE_ROOM][:_LOOKED]:
        found = _clear_of_obstacles(one, cell)
        if isinstance(found, GraspPlan) and deliverable(found):
            return found
    return None


def _clear_of_obstacles(one: GraspPlan, cell: Cell) -> GraspPlan | ClearanceViolation:
    """The plan, or the same from above; or what is in the way of the first."""
    first: ClearanceViolation | None = None
    for each in (one, *_higher(one, cell.robot)):
        met = obstacle_on(each, cell)
        if met is None:
            return each
        first = first or met
    assert first is not None
    return first


def plain_grasps(body: TableObject, robot: ArmWithHand, waiting: Vector, lift: float) -> list[GraspPlan]:
    """Grasps that the arm reaches from where it waits, (n,), rad, for a lift, m, without a collision check, never with
    the elbow out and never askew; the one with the least rotation of a joint first."""
    return reachable_grasps(body, robot, waiting, lift, (_PLAIN,))


def reachable_grasps(
    body: TableObject, robot: ArmWithHand, waiting: Vector, lift: float, searches: Sequence[ReachSearch] = _EVERY,
    most: float = MOST,
) -> list[GraspPlan]:  # fmt: skip
    """The ways that the arm reaches, that with the least turn of a joint first; at least one. `searches`: each where
    those before lead to none. Raises ConfigError."""
    spec = robot.hand.spec
    for search in searches:
        ways = grasp_candidates(body, spec.model, spec.side, askew=search.askew, most=most)
        reached = _reached(ways, body, robot, waiting, lift, search.near)
        if reached:
            return reached
    name = grasp_candidates(body, spec.model, spec.side, most=most)[0].card.name
    raise ConfigError(
        f"{robot.spec.name} does not reach the {name} grasp of the {body.kind} "
        f"at {position_text(body.position)} with room in its joints: move the thing nearer, or turn it by 90 degrees"
    )


def _reached(
    ways: Sequence[GraspCandidate], body: TableObject, robot: ArmWithHand, waiting: Vector, lift: float,
    near: Sequence[Sequence[float]],
) -> list[GraspPlan]:  # fmt: skip
    """Grasp plans that the arm reaches from one of some postures, the one with the least rotation of a joint first."""
    top = float(body.position[2]) + body.extents[2] / 2.0
    first = sorted(ways, key=lambda way: -_across(way.palm, robot.base))[:_TRIED]
    each = (_from(way, top, robot, waiting, lift, np.array(side)) for way in first for side in near)
    return sorted((one for one in each if one is not None), key=lambda one: one.far)


def obstacle_on(one: GraspPlan, cell: Cell) -> ClearanceViolation | None:
    """What arm or hand would come too near to on far ways, and the arm at the grasp and after the lift; to other
    objects also while the hand goes there, closes, and lifts."""
    grasp = one.candidate.card.grasp
    open_hand, shaped = cell.open, grasp.preshape
    shaping = SmoothSetpoint(open_hand)
    shaping.head_for(0.0, shaped, OPENING)
    begin, t = cell.posture, 0.0
    for end in one.through:
        arm, times = far_path(begin, end, cell.settings.arm.joint_speed)
        met = cell.clearance.check_path(arm, np.stack([shaping(t + each).position for each in times]))
        if met is not None:
            return met
        begin, t = end, t + float(times[-1])
    met = next(filter(None, (cell.clearance.of_arm(at, shaped) for at in one.there)), None)
    if met is not None or not cell.clearance.crowded:
        return met
    part = np.linspace(0.0, 1.0, _CLOSING)[:, None]
    there, up = one.there
    arm = np.concatenate(
        [begin + part * (there - begin), there + 0.0 * part, there + 0.0 * part, there + part * (up - there)]
    )
    hand = np.concatenate([shaped + 0.0 * part, shaped + part * (grasp.close - shaped),
                           grasp.close + part * (grasp.squeeze - grasp.close), grasp.squeeze + 0.0 * part])  # fmt: skip
    return cell.clearance.of_others(arm, hand)


def far_path(begin: Vector, end: Vector, speed: float) -> tuple[Array, Vector]:
    """Postures of a far way from rest to rest, (k, n), rad, and when they are, (k,), s."""
    path = SmoothSetpoint(begin)
    times = np.linspace(0.0, path.head_for(0.0, end, speed, ACCELERATION), int(np.abs(end - begin).max() / _STEP) + 2)
    return np.stack([path(t).position for t in times]), times


def _from(
    way: GraspCandidate, top: float, robot: ArmWithHand, waiting: Vector, lift: float, at: Vector
) -> GraspPlan | None:
    model, postures = robot.model, list[Vector]()
    lifted = Pose(way.palm.position + np.array([0.0, 0.0, lift]), way.palm.rotation)
    for palm in (way.before, way.palm, lifted):
        try:
            at = model.reach(robot.flange_for(palm), at, _NEAR)
        except ConfigError:
            return None  # The answer, not an error.
        postures.append(at)
    room = joint_room(postures, robot)
    if room < _ROOM or not all(reaches_straight(*ends, robot) for ends in pairwise(postures)):
        return None
    far = float(np.abs(np.stack(postures) - waiting).max())
    return GraspPlan(far, way, (*_over(way, top, robot, postures[0]), postures[0]), (postures[1], postures[2]), room)


def joint_room(postures: Sequence[Vector], robot: ArmWithHand) -> float:
    """The least to the end of a joint, rad."""
    spec = robot.spec
    return min(float(np.minimum(q - spec.lower, spec.upper - q).min()) for q in postures)


def reaches_straight(begin: Vector, end: Vector, robot: ArmWithHand, room: float = _ROOM) -> bool:
    """Whether no joint turns far, or has less `room` to its end, rad, while the flange goes straight between postures,
    (n,) each, rad."""
    first, last, model = robot.model.pose(begin), robot.model.pose(end), robot.model
    turn = rotation_between(first.rotation, last.rotation)
    middle = Pose((first.position + last.position) / 2.0, rotate(first.rotation, turn / 2.0))
    try:
        between = model.reach(middle, begin, _NEAR)
    except ConfigError:
        return False
    far = max(float(np.abs(one - other).max()) for one, other in ((begin, between), (between, end), (begin, end)))
    return far <= _TURN and joint_room([between], robot) >= room


def _over(way: GraspCandidate, top: float, robot: ArmWithHand, at: Vector) -> tuple[Vector, ...]:
    """The posture above where the approach begins, from which the hand comes down beside a thing of such a height, m;
    none where it is above already, or the arm does not reach so high."""
    up = top + _CLEAR - float(way.before.position[2])
    return _above(way, up, robot, at) if up >= _LITTLE else ()


def _higher(one: GraspPlan, robot: ArmWithHand) -> list[GraspPlan]:
    """Plan of a grasp from above, where the path to it is straight: a hand that turns low over the table may sweep
    it."""
    above = _above(one.candidate, _CLEAR, robot, one.through[-1]) if len(one.through) == 1 else ()
    return [one._replace(through=(*above, *one.through))] if above else []


def _above(way: GraspCandidate, up: float, robot: ArmWithHand, at: Vector) -> tuple[Vector, ...]:
    for part in (1.0, 0.6):
        above = Pose(way.before.position + np.array([0.0, 0.0, part * up]), way.before.rotation)
        try:
            found = robot.model.reach(robot.flange_for(above), at, _NEAR)
        except ConfigError:
            continue  # Lower, or straight on.
        if joint_room([found], robot) >= _ROOM:
            return (found,)
    return ()


def _across(palm: Pose, base: Pose) -> float:
    """How well stretched fingers point across the way from the arm's foot to the palm, 0 to 1: there no joint is near
    its end."""
    away = (palm.position - base.position)[:2]
    return abs(float(palm.rotation[:2, 2] @ np.array([away[1], -away[0]]) / np.linalg.norm(away)))
