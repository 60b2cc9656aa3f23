"""Where a palm could be: it looks at a point of the surface, with its fingers along the object or any other way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from allegro_twin.grasping.plan.close_in_geometry import units
from allegro_twin.grasping.plan.surface import Random, Surface
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

NEAREST, FURTHEST = 0.012, 0.085
"""m, from the palm's origin along its x to the point that it looks at."""
SIDE, LOW, HIGH = 0.030, -0.030, 0.060
"""m, of that point along the palm's y and z."""
AWRY = np.radians(7.0)
FROM_ABOVE, ALIGNED, TAKEN = 0.3, 0.65, 0.85
"""Shares of palms that look down whatever the surface, of rolls along an axis, and of pre-shapes from the library."""
NOISE = 0.05  # rad.


class Guesses(NamedTuple):
    """Palms and pre-shapes, a row each."""

    position: Array
    """(k, 3), m."""
    rotation: Array
    """(k, 3, 3)."""
    preshape: Array
    """(k, n), rad."""
    closing: Array
    """(k, n), 1, 0 or -1."""
    template: list[str]


def guesses(on: Surface, axes: Array, templates: Sequence[Grasp], spec: HandSpec, random: Random) -> Guesses:
    """One for every point of a surface. `axes`: the object's own, as columns, (3, 3), world."""
    count = len(on.points)
    look = _looking(on.normals, random)
    rotation = _rolled(look, axes, random)
    offset = np.stack([
        random.uniform(NEAREST, FURTHEST, count), random.uniform(-SIDE, SIDE, count), random.uniform(LOW, HIGH, count)
    ], axis=1)  # fmt: skip
    position = on.points - np.einsum("kij,kj->ki", rotation, offset)
    chosen = random.integers(len(templates), size=count)
    preshape = np.stack([_opened(templates[number], spec, random) for number in chosen])
    closing = np.stack([closing_of(templates[number], spec) for number in chosen])
    return Guesses(position, rotation, preshape, closing, [templates[number].name for number in chosen])


def closing_of(grasp: Grasp, spec: HandSpec) -> Array:
    """Which way each motor goes from pre-shape to squeeze; 0 where what it moves turns by less than 0.1 rad."""
    travel = grasp.squeeze - grasp.preshape
    closing: Array = np.where(np.abs(travel) > 0.1 * units(spec), np.sign(travel), 0.0)
    return closing


def _opened(grasp: Grasp, spec: HandSpec, random: Random) -> Array:
    """A pre-shape of the library, more or less open than it is."""
    part = random.uniform(-0.4, 0.7)
    noise, edge = random.normal(0.0, NOISE, spec.n_joints) * units(spec), 0.01 * units(spec)
    posture = grasp.preshape + part * (grasp.close - grasp.preshape) + noise
    inside: Array = np.clip(posture, spec.lower + edge, spec.upper - edge)
    return inside


def _looking(normals: Array, random: Random) -> Array:
    """Directions of the palm's x: at the surface, or down."""
    down = np.array([0.0, 0.0, -1.0]) + random.normal(0.0, 0.35, normals.shape)
    at = -normals + np.tan(AWRY) * random.normal(size=normals.shape)
    look = np.where((random.random(len(normals)) < FROM_ABOVE)[:, None], down, at)
    unit: Array = look / np.linalg.norm(look, axis=1, keepdims=True)
    return unit


def _rolled(look: Array, axes: Array, random: Random) -> Array:
    """Palms that look along `look`, their fingers along an axis of the object or any way."""
    count = len(look)
    along = axes.T[random.integers(3, size=count)] * random.choice([-1.0, 1.0], count)[:, None]
    along = along + np.tan(AWRY) * random.normal(size=(count, 3))
    any_ = random.normal(size=(count, 3))
    fingers = np.where((random.random(count) < ALIGNED)[:, None], along, any_)
    fingers = fingers - np.sum(fingers * look, axis=1, keepdims=True) * look
    short = np.linalg.norm(fingers, axis=1) < 0.2  # The axis is where the palm looks: any other way.
    fingers[short] = np.cross(look[short], any_[short])
    fingers /= np.linalg.norm(fingers, axis=1, keepdims=True)
    return np.stack([look, np.cross(fingers, look), fingers], axis=2)
