"""Which grasp for what was seen: one rule for all things.

Every scenario that ships is a thing, a grasp and the palm's place beside it; those in scenarios/on_arm come first. What
was seen is taken as that thing of the same kind of solid whose extents are the nearest by ratio; its grasp is turned
about the vertical with the thing, in one of the ways that symmetry leaves open.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from allegro_twin.cell.perception.errors import place
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.grasping.scenario import Scenario, load_scenario
from allegro_twin.kinematics.orientation import matrix_facing
from allegro_twin.kinematics.pose import Pose
from allegro_twin.sim.objects.catalogue import Thing, catalogue
from allegro_twin.types import Array

_ROUND = 24  # Ways to take what is round: every 15 degrees.
_SQUARE = 1.03  # Ratio of level edges under which a box is square.
_ON_ARM = "on_arm"  # The folder of scenarios that leave room for an arm behind the hand; they come before others.
_NEARLY = 1.3  # Ratio of level extents under which an egg is so nearly round that its grasp may be turned a little.
_LITTLE = np.radians([-10.0, 10.0, -20.0, 20.0])  # OWN: lemons were held by an Allegro Hand so in 40 of 40 trials.
_MOST = 0.25  # Of the logarithm of a ratio of extents: beyond it no stored grasp is for the thing.


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A solid on the table, whichever way it came to be known."""

    kind: str
    """Its shape; with `lying` before it where an axis of revolution is level."""
    extents: tuple[float, float, float]
    """The longer level one, the shorter level one, the height, m."""
    yaw: float
    """Of the longer level one in the world, rad."""
    position: Array
    """Of the middle, (3,), m."""


@dataclass(frozen=True, slots=True, eq=False)
class Card:
    """A stored grasp of a thing, in the frame of its middle with x along its longer level extent."""

    name: str
    body: Body
    grasp: str
    palm: Pose
    retreat: Array
    """(3,), m."""


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """One way to take what was seen, in the world."""

    card: Card
    palm: Pose
    before: Pose
    """Where the approach begins."""


def body_of(solid: Solid) -> Body:
    """What perception found. What leans is as it would stand."""
    upright = int(np.argmax(np.abs(solid.axes[2])))
    level = [k for k in range(3) if k != upright]
    first, second = sorted(level, key=lambda k: -solid.size[k])
    way = solid.axes[:, first]
    lying = "lying " if solid.shape in ("cylinder", "ellipsoid") and upright != 0 else ""
    extents = (solid.size[first], solid.size[second], solid.size[upright])
    return Body(lying + solid.shape, extents, float(np.arctan2(way[1], way[0])), solid.position)


def ways(body: Body, model: str, *, askew: bool = False) -> list[Way]:
    """Every way to take it that symmetry leaves open; `askew`: those that are a little off one of them, of what is
    nearly round. Raises ConfigError where no stored grasp is for such a thing."""
    fitting = [card for card in cards(model) if card.body.kind == body.kind]
    best = min(fitting, key=lambda card: unlike(card.body, body), default=None)
    if best is None or unlike(best.body, body) > _MOST:
        size = " x ".join(f"{1e3 * edge:.0f}" for edge in body.extents)
        raise ConfigError(
            f"no grasp of {model} is for a {body.kind} of {size} mm at {place(body.position)}: put it on another side, "
            "or add a scenario that takes it"
        )
    turns = _turns(body)
    if askew:
        turns = np.add.outer(turns, _askew(body)).ravel()
    return [_turned(best, body, body.yaw + turn) for turn in turns]


def unlike(one: Body, other: Body) -> float:
    """The largest logarithm of a ratio of their extents."""
    return float(np.abs(np.log(np.divide(one.extents, other.extents))).max())


@cache
def cards(model: str) -> tuple[Card, ...]:
    """What ships for a model of hand. Raises ConfigError where nothing does."""
    found: dict[str, Card] = {}
    for path in sorted((data_root() / "scenarios").glob("*/*.yaml"), key=_order):
        one = load_scenario(path)[0]
        thing = one.objects[0].name
        # The one that is named after its thing, with the hand before it or not: others show other grasps of it.
        named = path.parent.name == _ON_ARM or path.stem.removeprefix(f"{model}_") == thing
        if one.hand == model and one.objects[0].shape is None and named:
            found[thing] = _card(one)
    if not found:
        raise ConfigError(f"no scenario takes a thing of the catalogue with the hand {model}: add some to scenarios/")
    return tuple(found.values())


def _order(path: Path) -> tuple[bool, Path]:
    return path.parent.name == _ON_ARM, path


def _card(scenario: Scenario) -> Card:
    settings, wrist = scenario.objects[0], scenario.wrist
    thing = catalogue()[settings.name]
    body = standing(thing, np.radians(settings.yaw))
    offset = np.array(wrist.position)
    if wrist.over is not None:
        offset[2] = max(wrist.over.table - body.extents[2] / 2.0, body.extents[2] / 2.0 + wrist.over.top)
    back = about(-body.yaw)
    palm = Pose(back @ offset, back @ matrix_facing(wrist.facing, wrist.fingers))
    return Card(settings.name, body, scenario.grasp, palm, back @ np.array(wrist.retreat))


def standing(thing: Thing, yaw: float) -> Body:
    """A thing of the catalogue with its own z up."""
    x, y, height = (2.0 * thing.half_extents()).tolist()
    lying = "lying " if thing.shape == "ellipsoid" else ""
    extents = (max(x, y), min(x, y), height)
    return Body(lying + thing.shape, extents, yaw + (np.pi / 2.0 if y > x else 0.0), np.zeros(3))


def _turns(body: Body) -> Array:
    """By how much it may be turned and is as it was, rad."""
    if body.kind in ("sphere", "cylinder"):
        count = _ROUND
    else:
        count = 4 if body.kind == "box" and body.extents[0] < _SQUARE * body.extents[1] else 2
    return np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)


def _askew(body: Body) -> Array:
    """By how much a grasp may be off, rad."""
    nearly = body.kind == "lying ellipsoid" and body.extents[0] < _NEARLY * body.extents[1]
    return _LITTLE if nearly else np.empty(0)


def _turned(card: Card, body: Body, yaw: float) -> Way:
    turn = about(yaw)
    palm = Pose(body.position + turn @ card.palm.position, turn @ card.palm.rotation)
    return Way(card, palm, Pose(palm.position + turn @ card.retreat, palm.rotation))


def about(angle: float) -> Array:
    """A turn about the vertical, (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
