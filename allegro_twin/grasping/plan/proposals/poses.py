"""Palm poses: the palm faces a point of the surface, with its fingers along the object or in another direction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.plan.proposals.close_in_geometry import motor_scale
from allegro_twin.grasping.plan.proposals.opposition import OpposingGrasp
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

NEAREST, FURTHEST = 0.012, 0.085
"""m, from the palm's origin along its x to the point that it looks at."""
SIDE, LOW, HIGH = 0.030, -0.030, 0.060
"""m, of that point along the palm's y and z."""
VARIED = 0.5
"""Share of that box, about the place between fingertips, where a pre-shape has one."""
AWRY = np.radians(7.0)
FROM_ABOVE, ALIGNED = 0.3, 0.65
"""Shares of palms that look down whatever the surface, and of rolls along an axis."""
NOISE = 0.05  # rad.


class PoseGuesses(NamedTuple):
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


def guess_poses(
    on: SurfaceSample, axes: Array, templates: Sequence[Grasp], spec: HandSpec, random: Random
) -> PoseGuesses:
    """One for every point of a surface. `axes`: the object's own, as columns, (3, 3), world."""
    count = len(on.points)
    look = _looking(on.normals, random)
    rotation = _rolled(look, axes, random)
    offset = np.stack([
        random.uniform(NEAREST, FURTHEST, count), random.uniform(-SIDE, SIDE, count), random.uniform(LOW, HIGH, count)
    ], axis=1)  # fmt: skip
    chosen = random.integers(len(templates), size=count)
    for row, number in enumerate(chosen):
        offset[row] = _between_fingers(offset[row], templates[number])
    position = on.points - np.einsum("kij,kj->ki", rotation, offset)
    preshape = np.stack([_opened(templates[number], spec, random) for number in chosen])
    closing = np.stack([closing_directions(templates[number], spec) for number in chosen])
    return PoseGuesses(position, rotation, preshape, closing, [templates[number].name for number in chosen])


def _between_fingers(offset: Array, grasp: Grasp) -> Array:
    """Where the palm has the point that it looks at, (3,), m: as drawn; of a grasp that has room for a ball, on the
    near side of the ball, and by a part of what was drawn beside it."""
    if not isinstance(grasp, OpposingGrasp):
        return offset
    middle = np.array([(NEAREST + FURTHEST) / 2.0, 0.0, (LOW + HIGH) / 2.0])
    on_ball = grasp.centre - np.array([grasp.diameter / 2.0, 0.0, 0.0])
    beside: Array = on_ball + VARIED * (offset - middle)
    return beside


def closing_directions(grasp: Grasp, spec: HandSpec) -> Array:
    """Which way each motor goes from pre-shape to squeeze; 0 where what it moves turns by less than 0.1 rad."""
    travel = grasp.squeeze - grasp.preshape
    closing: Array = np.where(np.abs(travel) > 0.1 * motor_scale(spec), np.sign(travel), 0.0)
    return closing


def _opened(grasp: Grasp, spec: HandSpec, random: Random) -> Array:
    """A pre-shape of the library, more or less open than it is."""
    part = random.uniform(-0.4, 0.7)
    noise, edge = random.normal(0.0, NOISE, spec.n_joints) * motor_scale(spec), 0.01 * motor_scale(spec)
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


Random = np.random.Generator


class SurfaceSample(NamedTuple):
    """Drawn uniformly by area."""

    points: Array
    """(k, 3), m."""
    normals: Array
    """Outward, (k, 3)."""


def sample_placed_surface(placed: PlacedObject, count: int, random: Random) -> SurfaceSample:
    """Points on an object where it stands, world."""
    own = sample_surface(placed.grasp_object, count, random)
    turn = matrix_from_quaternion(np.array(placed.quaternion))
    return SurfaceSample(own.points @ turn.T + placed.position, own.normals @ turn.T)


def sample_surface(grasp_object: GraspObject, count: int, random: Random) -> SurfaceSample:
    """Points on an object, in its own frame. Raises ConfigError for an MJCF."""
    match grasp_object.shape, grasp_object.size:
        case "sphere", (diameter,):
            normals = _unit(random.normal(size=(count, 3)))
            return SurfaceSample(diameter / 2 * normals, normals)
        case "cylinder", (diameter, height):
            return _cylinder(diameter / 2, height, count, random)
        case "box", _:
            return _box(grasp_object.half_extents(), count, random)
        case "ellipsoid", _:
            return _ellipsoid(grasp_object.half_extents(), count, random)
        case "mesh", _:
            return _mesh(grasp_object, count, random)
    raise ConfigError(
        f"object {grasp_object.name}: the surface of an {grasp_object.shape} is not known; give it as a mesh"
    )


def _cylinder(radius: float, height: float, count: int, random: Random) -> SurfaceSample:
    side = random.random(count) < height / (height + radius)  # 2πrh of 2πrh + 2πr²
    angle = random.uniform(0.0, 2.0 * np.pi, count)
    round_ = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    end = random.choice([-1.0, 1.0], count)
    flat = np.stack([np.zeros(count), np.zeros(count), end], axis=1)
    along = random.uniform(-0.5, 0.5, count) * height
    within = radius * np.sqrt(random.random(count))
    points = np.where(side[:, None], radius * round_, within[:, None] * round_)
    points[:, 2] = np.where(side, along, end * height / 2)
    return SurfaceSample(points, np.where(side[:, None], round_, flat))


def _box(half: Array, count: int, random: Random) -> SurfaceSample:
    areas = np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
    axis = random.choice(3, count, p=areas / areas.sum())
    end = random.choice([-1.0, 1.0], count)
    points = random.uniform(-1.0, 1.0, (count, 3)) * half
    points[np.arange(count), axis] = end * half[axis]
    normals = np.zeros((count, 3))
    normals[np.arange(count), axis] = end
    return SurfaceSample(points, normals)


def _ellipsoid(half: Array, count: int, random: Random) -> SurfaceSample:
    """By rejection: an area element of the sphere is stretched by |diag(1/half) n| det(half)."""
    found = np.empty((0, 3))
    while len(found) < count:
        unit = _unit(random.normal(size=(2 * count, 3)))
        stretch = np.linalg.norm(unit / half, axis=1) * half.min()
        found = np.concatenate([found, unit[random.random(2 * count) < stretch]])
    found = found[:count]
    return SurfaceSample(found * half, _unit(found / half))


def _mesh(grasp_object: GraspObject, count: int, random: Random) -> SurfaceSample:
    mesh = grasp_object.mesh()
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    face = random.choice(len(area), count, p=area / area.sum())
    u, v = random.random((2, count, 1))
    folded = u + v > 1.0
    u, v = np.where(folded, 1.0 - u, u), np.where(folded, 1.0 - v, v)
    points = a[face] + u * (b[face] - a[face]) + v * (c[face] - a[face])
    return SurfaceSample(points, cross[face] / area[face, None])


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit
