"""Mass, centre of mass and inertia of a link from its primitives, at uniform density."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.hands.description.facts import BoxFacts, LinkFacts, TipFacts
from allegro_twin.types import Array


class MassProperties(NamedTuple):
    mass: float
    """kg."""
    center: Array
    """Centre of mass in the link's frame, shape (3,), m."""
    inertia: Array
    """About the centre of mass, axes of the link's frame, shape (3, 3), kg·m²."""


def box_inertia(mass: float, box: BoxFacts) -> MassProperties:
    """I = m/3 diag(b²+c², a²+c², a²+b²) for half-sizes a, b, c."""
    squares = np.square(box.half)
    return MassProperties(mass, np.array(box.at), mass / 3.0 * np.diag(squares.sum() - squares))


def tip_inertia(tip: TipFacts) -> MassProperties:
    """A solid capsule along z: a cylinder of length l and two half-spheres of radius r, sharing the mass by volume."""
    r, length = tip.radius, tip.end - tip.start
    cylinder = tip.mass * length / (length + 4.0 / 3.0 * r)
    ball = tip.mass - cylinder
    along = cylinder * r**2 / 2.0 + ball * 2.0 / 5.0 * r**2
    across = cylinder * (length**2 / 12.0 + r**2 / 4.0)
    across += ball * (2.0 / 5.0 * r**2 + length**2 / 4.0 + 3.0 / 8.0 * length * r)
    return MassProperties(tip.mass, np.array([0.0, 0.0, (tip.start + tip.end) / 2.0]), np.diag([across, across, along]))


def combine(parts: list[MassProperties]) -> MassProperties:
    """One rigid body from several: I = Σ Iₖ + mₖ(|dₖ|² 1 - dₖdₖᵀ), dₖ from the common centre of mass."""
    mass = sum(part.mass for part in parts)
    center = sum((part.mass * part.center for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        d = part.center - center
        # d·d without BLAS, whose sums depend on the processor: files are made of this, and compared byte for byte.
        inertia += part.inertia + part.mass * (float(np.square(d).sum()) * np.eye(3) - np.outer(d, d))
    return MassProperties(mass, center, inertia)


def link_inertia(link: LinkFacts) -> MassProperties:
    """The link with its fingertip, where it has one."""
    parts = [box_inertia(link.mass, link.box)]
    if link.tip is not None:
        parts.append(tip_inertia(link.tip))
    return combine(parts)


def nearest_physical(tensor: Array) -> Array:
    """The nearest inertia that a rigid body can have, (3, 3), kg·m²; one that a body can have stays as it is.

    ∫ r rᵀ dm = ½ tr(I) 1 - I has no negative eigenvalue, or one principal moment exceeds the sum of the others. What is
    below a thousandth of the largest is raised to that: as thin as a plate, and no thinner.
    """
    spread, axes = np.linalg.eigh(np.trace(tensor) / 2.0 * np.eye(3) - tensor)
    if spread.min() >= 0.0:
        return tensor
    moments = (axes * np.maximum(spread, 1e-3 * spread.max())) @ axes.T
    # To 1e-15 kg·m², beyond which processors round differently and the files that are made of it would differ.
    return np.asarray(np.round(np.trace(moments) * np.eye(3) - moments, 15))
