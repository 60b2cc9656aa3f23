"""Contacts of a hand on an object, and the wrenches that it can apply there.

A wrench is a force (N) and a torque about the object's centre of mass divided by a length (N): dividing is what makes
forces and torques comparable, so a figure that mixes them means nothing without its length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array, Vector, frozen

Indices: TypeAlias = NDArray[np.int_]
EDGES = 8
"""Default number of edges of the pyramid that stands for a friction cone; as in DexGraspBench's Q1."""


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """k places where the hand presses, in any frame that is the same for all of them."""

    points: Array
    """(k, 3), m."""
    normals: Array
    """(k, 3), unit, into the object."""
    tangents: Array
    """(k, 3), unit, across the normals: where the first edge of each pyramid lies."""
    friction: Vector
    """Sliding, (k,)."""
    torsion: Vector
    """Torsional, (k,), m: the moment about the normal is at most so many times the normal force. 0: a hard contact."""
    centre: Vector
    """The object's centre of mass, (3,), m."""
    length: float
    """What torques are divided by, m: the largest distance of the object's surface from its centre, say."""

    def __len__(self) -> int:
        return len(self.points)


def make_contacts(
    points: ArrayLike,
    normals: ArrayLike,
    friction: ArrayLike,
    torsion: ArrayLike = 0.0,
    *,
    centre: ArrayLike = (0.0, 0.0, 0.0),
    length: float,
    tangents: ArrayLike | None = None,
) -> Contacts:
    """Contacts from arrays; friction and torsion may be one number for all. Raises ConfigError for wrong shapes, values
    that are not finite, normals without length and coefficients below zero."""
    places = _rows(points, "points")
    inward = _unit(_rows(normals, "normals"), "normals")
    if len(inward) != len(places):
        raise ConfigError(f"{len(places)} contact points and {len(inward)} normals: one each")
    across = _across(inward) if tangents is None else _unit(_rows(tangents, "tangents"), "tangents")
    if across.shape != inward.shape or np.abs(np.einsum("ki,ki->k", across, inward)).max(initial=0.0) > 1e-6:
        raise ConfigError("tangents must be one a contact, at right angles to its normal")
    if not (np.isfinite(length) and length > 0.0):
        raise ConfigError(f"the length that torques are divided by is {length} m; it must be above 0")
    middle = np.asarray(centre, dtype=np.float64)
    if middle.shape != (3,) or not np.isfinite(middle).all():
        raise ConfigError(f"the centre of mass is three finite numbers, m, not {middle.tolist()}")
    return Contacts(
        frozen(places),
        frozen(inward),
        frozen(across),
        _coefficients(friction, len(places), "friction"),
        _coefficients(torsion, len(places), "torsion"),
        frozen(middle),
        float(length),
    )


def cone_forces(touch: Contacts, edges: int = EDGES) -> tuple[Array, Array, Indices]:
    """The extreme forces of every contact's cone, each with a normal part of 1 N.

    Returns the forces (g, 3), N, the moments about the contact point (g, 3), N·m, and the contact of each, (g,). A cone
    √(f₁² + f₂²) ≤ µ fₙ is replaced by the pyramid whose `edges` lie in it; with torsion, (f₁² + f₂²)/µ² + m²/µₜ² ≤ fₙ²
    by the hull of that pyramid and its two purest twists. Both lie inside the cone, so whatever is found with them can
    be done, and what is not found may still be possible. Raises ConfigError for fewer than 3 edges.
    """
    if edges < 3:
        raise ConfigError(f"a pyramid has 3 edges or more, not {edges}")
    angles = np.arange(edges) * (2.0 * np.pi / edges)
    second = cross_product(touch.normals, touch.tangents)
    ways = np.einsum("e,ki->kei", np.cos(angles), touch.tangents) + np.einsum("e,ki->kei", np.sin(angles), second)
    slanted = touch.normals[:, None] + touch.friction[:, None, None] * ways
    soft = np.flatnonzero(touch.torsion > 0.0)
    twist = touch.torsion[soft, None] * touch.normals[soft]
    force = np.concatenate([slanted.reshape(-1, 3), touch.normals[soft], touch.normals[soft]])
    moment = np.concatenate([np.zeros((len(touch) * edges, 3)), twist, -twist])
    return force, moment, np.concatenate([np.repeat(np.arange(len(touch)), edges), soft, soft])


def cone_wrenches(touch: Contacts, edges: int = EDGES) -> Array:
    """Extreme wrenches of every contact's cone on the object, (g, 6): force, N; ((p − c) × f + m) / length, N."""
    force, moment, owner = cone_forces(touch, edges)
    arm = touch.points[owner] - touch.centre
    return np.hstack([force, (cross_product(arm, force) + moment) / touch.length])


def cross_product(first: Array, second: Array) -> Array:
    """Cross product of rows, (k, 3), as `np.cross`, which takes five times as long for a few of them."""
    (x, y, z), (u, v, w) = first.T, second.T
    found: Array = np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
    return found


def _rows(values: ArrayLike, what: str) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if array.size == 0:
        array = array.reshape(0, 3)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ConfigError(f"{what} have the shape (k, 3), not {array.shape}")
    if not np.isfinite(array).all():
        bad = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise ConfigError(f"{what}[{bad}] is {array[bad].tolist()}; every number must be finite")
    return array


def _unit(vectors: Array, what: str) -> Array:
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    if (size < 1e-9).any():
        raise ConfigError(f"{what}[{int(np.argmin(size))}] has no length")
    scaled: Array = vectors / size
    return scaled


def _across(normals: Array) -> Array:
    """A direction across each normal: the axis that is least along it, made square."""
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    return _unit(axis - np.einsum("ki,ki->k", axis, normals)[:, None] * normals, "tangents")


def _coefficients(values: ArrayLike, count: int, what: str) -> Vector:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0:
        array = np.full(count, float(array))
    if array.shape != (count,):
        raise ConfigError(f"{what} needs one value or {count}, one a contact; it has {array.size}")
    if not (np.isfinite(array).all() and (array >= 0.0).all()):
        raise ConfigError(f"{what} must be finite and not below 0; it is {array.tolist()}")
    return frozen(array)
