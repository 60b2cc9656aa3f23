"""Stored grasps for an observed object: one rule for all objects.

Every scenario that ships is a thing, a grasp and the palm's place beside it; those in scenarios/on_arm come first. What
was seen is taken as that thing of the same kind of solid whose extents are the nearest by ratio; its grasp is turned
about the vertical with the thing, in one of the ways that symmetry leaves open.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from allegro_twin.cell.perception.errors import position_text
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.grasping.scenario import Scenario, load_scenario
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import Library
from allegro_twin.kinematics.orientation import matrix_facing
from allegro_twin.kinematics.pose import Pose
from allegro_twin.sim.contact.obstacle_clearance import TableObject
from allegro_twin.sim.objects.catalogue import GraspObject, object_catalogue
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Array, Vector

MIRROR = np.diag([1.0, -1.0, 1.0])
"""Mirror of a right hand's vectors for a left hand."""
_ROUND = 24  # Ways to take what is round: every 15 degrees.
_SQUARE = 1.03  # Ratio of level edges under which a box is square.
_ON_ARM = "on_arm"  # The folder of scenarios that leave room for an arm behind the hand; they come before others.
_NEARLY = 1.3  # Ratio of level extents under which an egg is so nearly round that its grasp may be turned a little.
_LITTLE = np.radians([-10.0, 10.0, -20.0, 20.0])  # OWN: lemons were held by an Allegro Hand so in 40 of 40 trials.
_SHIFTED, _TURNED_BY = 0.004, 0.1
"""m, and the sine of an angle, between parts of compounds that are alike."""
MOST = 0.25
"""Largest logarithm of a ratio of extents for which a stored grasp is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredGrasp:
    """A stored grasp of a thing, in the frame of its middle with x along its longer level extent."""

    name: str
    body: TableObject
    grasp: Grasp
    palm: Pose
    retreat: Array
    """(3,), m."""
    rest: Vector | None = None
    """Where the joints came to rest on the thing in physics, (n,), rad; None: nobody knows."""


@dataclass(frozen=True, slots=True, eq=False)
class GraspCandidate:
    """One way to take what was seen, in the world."""

    card: StoredGrasp
    palm: Pose
    before: Pose
    """Where the approach begins."""


def table_object(solid: Solid) -> TableObject:
    """What perception found, with its parts where it is a compound. What leans is as it would stand."""
    upright = int(np.argmax(np.abs(solid.axes[2])))
    level = [k for k in range(3) if k != upright]
    first, second = sorted(level, key=lambda k: -solid.size[k])
    way = solid.axes[:, first]
    lying = "lying " if solid.shape in ("cylinder", "ellipsoid") and upright != 0 else ""
    extents = (solid.size[first], solid.size[second], solid.size[upright])
    parts = tuple(table_object(part) for part in solid.parts)
    return TableObject(lying + solid.shape, extents, float(np.arctan2(way[1], way[0])), solid.position, parts)


def grasp_candidates(
    body: TableObject, model: str, side: Side = "right", *, askew: bool = False, most: float = MOST
) -> list[GraspCandidate]:
    """Every way to take it that symmetry leaves open with the grasp of the nearest thing; `askew`: those that are a
    little off one of them, of what is nearly round. Raises ConfigError where no stored grasp is for a thing within a
    mismatch of `most`."""
    best = nearest_stored(body, model, side)
    if best is None or extent_mismatch(best.body, body) > most:
        raise ConfigError(
            f"no grasp of {model} is for a {body_text(body)}: put it on another side, or add a scenario that takes it"
        )
    return turned_candidates(best, body, askew=askew)


def nearest_stored(body: TableObject, model: str, side: Side = "right") -> StoredGrasp | None:
    """The stored grasp of the most similar thing of the same kind; None where there is none of that kind."""
    fitting = [card for card in stored_grasps(model, side) if card.body.kind == body.kind]
    return min(fitting, key=lambda card: extent_mismatch(card.body, body), default=None)


def turned_candidates(card: StoredGrasp, body: TableObject, *, askew: bool = False) -> list[GraspCandidate]:
    """A grasp of such a thing in all the ways that symmetry leaves open; `askew` as of `grasp_candidates`."""
    turns = symmetric_turns(body)
    if askew:
        turns = np.add.outer(turns, _askew(body)).ravel()
    return [_turned(card, body, body.yaw + turn) for turn in turns]


def body_text(body: TableObject) -> str:
    """What it is and where, for a person."""
    size = " x ".join(f"{1e3 * edge:.0f}" for edge in body.extents)
    return f"{body.kind} of {size} mm at {position_text(body.position)}"


def extent_mismatch(one: TableObject, other: TableObject) -> float:
    """The largest logarithm of a ratio of their extents; inf where one has parts that the other has not in that place,
    or not turned so."""
    found = float(np.abs(np.log(np.divide(one.extents, other.extents))).max())
    if len(one.parts) != len(other.parts):
        return float("inf")
    for mine, theirs in zip(own_parts(one), own_parts(other), strict=True):
        away = float(np.linalg.norm(mine.position - theirs.position))
        turned = abs(float(np.sin(mine.yaw - theirs.yaw)))
        if mine.kind != theirs.kind or away > _SHIFTED or turned > _TURNED_BY:
            return float("inf")
        found = max(found, extent_mismatch(mine, theirs))
    return found


def own_parts(body: TableObject) -> tuple[TableObject, ...]:
    """The parts of a compound, or none, in the frame of its middle with x along its longer level extent."""
    back = yaw_rotation(-body.yaw)
    return tuple(
        replace(part, yaw=part.yaw - body.yaw, position=back @ (part.position - body.position)) for part in body.parts
    )


@cache
def stored_grasps(model: str, side: Side = "right") -> tuple[StoredGrasp, ...]:
    """What ships for a model of hand; a left hand's are the mirror images. Raises ConfigError where nothing does."""
    found: dict[str, StoredGrasp] = {}
    spec = load_spec(model, side)
    for path in sorted((data_root() / "scenarios").glob("*/*.yaml"), key=_order):
        one = load_scenario(path)[0]
        object_name = one.objects[0].name
        # The one that is named after its thing, with the hand before it or not: others show other grasps of it.
        named = path.parent.name == _ON_ARM or path.stem.removeprefix(f"{model}_") == object_name
        if one.hand == model and one.objects[0].shape is None and named:
            found[object_name] = _card(one, spec)
    if not found:
        raise ConfigError(f"no scenario takes a thing of the catalogue with the hand {model}: add some to scenarios/")
    return tuple(found.values())


def _order(path: Path) -> tuple[bool, Path]:
    return path.parent.name == _ON_ARM, path


def _card(scenario: Scenario, spec: HandSpec) -> StoredGrasp:
    settings, wrist = scenario.objects[0], scenario.wrist
    grasp_object = object_catalogue()[settings.name]
    body = standing_object(grasp_object, np.radians(settings.yaw))
    offset = np.array(wrist.position)
    if wrist.over is not None:
        offset[2] = max(wrist.over.table - body.extents[2] / 2.0, body.extents[2] / 2.0 + wrist.over.top)
    rotation, retreat = matrix_facing(wrist.facing, wrist.fingers), np.array(wrist.retreat)
    back = yaw_rotation(-body.yaw)
    offset, rotation, retreat = back @ offset, back @ rotation, back @ retreat
    if spec.side == "left":  # The solid is its own mirror image.
        offset, rotation, retreat = MIRROR @ offset, MIRROR @ rotation @ MIRROR, MIRROR @ retreat
    return StoredGrasp(settings.name, body, Library().grasp(scenario.grasp, spec), Pose(offset, rotation), retreat)


def standing_object(grasp_object: GraspObject, yaw: float) -> TableObject:
    """A thing of the catalogue with its own z up."""
    x, y, height = (2.0 * grasp_object.half_extents()).tolist()
    lying = "lying " if grasp_object.shape == "ellipsoid" else ""
    extents = (max(x, y), min(x, y), height)
    return TableObject(lying + grasp_object.shape, extents, yaw + (np.pi / 2.0 if y > x else 0.0), np.zeros(3))


def symmetric_turns(body: TableObject) -> Array:
    """By how much it may be turned and is as it was, rad."""
    if body.kind in ("sphere", "cylinder"):
        count = _ROUND
    elif body.parts:
        count = 1
    else:
        count = 4 if body.kind == "box" and body.extents[0] < _SQUARE * body.extents[1] else 2
    return np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)


def _askew(body: TableObject) -> Array:
    """By how much a grasp may be off, rad."""
    nearly = body.kind == "lying ellipsoid" and body.extents[0] < _NEARLY * body.extents[1]
    return _LITTLE if nearly else np.empty(0)


def _turned(card: StoredGrasp, body: TableObject, yaw: float) -> GraspCandidate:
    turn = yaw_rotation(yaw)
    palm = Pose(body.position + turn @ card.palm.position, turn @ card.palm.rotation)
    return GraspCandidate(card, palm, Pose(palm.position + turn @ card.retreat, palm.rotation))


def yaw_rotation(angle: float) -> Array:
    """A turn about the vertical, (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
