"""The squeeze that holds an object through all loads with the smallest share of any motor: a linear program."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.metrics.contacts import Contacts
from allegro_twin.grasping.metrics.quality import import_scipy
from allegro_twin.types import Array, Vector

FACETS = 6
"""Of the pyramid inside a friction cone."""
COMPLIANCE = 2e-4
"""m/N, of a contact itself: what lets the palm, which no motor moves, share a load. Assumed; a rubber fingertip."""


class Preload(NamedTuple):
    """What the motors give before the load comes."""

    share: float
    """Of its limit, by the joint that is worst off under the worst load; inf where none will do."""
    torque: Vector
    """(n,), N·m; NaN where none will do."""
    force: Array
    """Of the hand on the object, at each contact, (k, 3), N."""


def least_preload(
    touch: Contacts,
    jacobians: Array,
    stiffness: Vector,
    limit: Vector,
    loads: Array,
    *,
    facets: int = FACETS,
    compliance: float = COMPLIANCE,
) -> Preload:
    """The contact forces f₀ of a hand held by springs that carry every one of some loads wₖ with the least of the
    motors:

    min t, subject to G f₀ = 0, f₀ + Δₖ in the friction cones, |Jᵀ(f₀ + Δₖ)|ⱼ ≤ t limitⱼ, for k = 0 … l, Δ₀ = 0.

    No controller acts on the load: it moves the object, and joints of `stiffness` (n,), N·m/rad, answer,
    Δₖ = −K Gᵀ (G K Gᵀ)⁻¹ wₖ with K = (J diag(1/stiffness) Jᵀ + compliance · 1)⁻¹. `loads`: (l, 6), N and N·m about
    the centre of mass. `jacobians`: of the hand at each contact, (k, 3, n), m/rad. Contacts are points without torsion;
    the pyramids are inside the cones, so what is found can be done. Raises ConfigError without SciPy, and for shapes
    that do not fit.
    """
    count, joints = len(touch), len(limit)
    if jacobians.shape != (count, 3, joints) or stiffness.shape != (joints,):
        raise ConfigError(f"jacobians have the shape ({count}, 3, {joints}), not {jacobians.shape}")
    none = Preload(np.inf, np.full(joints, np.nan), np.full((count, 3), np.nan))
    if count < 2:
        return none
    grip = _grip_matrix(touch)
    moved = jacobians.reshape(3 * count, joints)
    stiff = np.linalg.inv(moved @ (moved / stiffness).T + compliance * np.eye(3 * count))
    scale = np.array([1.0, 1.0, 1.0, *[1.0 / touch.length] * 3])
    spread, _, rank, _ = np.linalg.lstsq(grip @ stiff @ grip.T, (loads * scale).T, rcond=1e-9)
    if rank < 6:
        return none  # About some axis nothing resists: two contacts turn about the line between them.
    answers = np.hstack([np.zeros((3 * count, 1)), -stiff @ grip.T @ spread])
    cones, motors = _cone_facets(touch, facets), moved.T
    size = 3 * count
    # Rows: all facets and both signs of all motors, for every load; columns: f₀ and t.
    inside = np.vstack([cones, motors, -motors])
    bounds = np.concatenate([np.zeros(len(cones)), limit, limit])
    upper = [np.hstack([inside, -bounds[:, None]])] * answers.shape[1]
    right = [-inside @ answers[:, k] for k in range(answers.shape[1])]
    solved = import_scipy("optimize").linprog(
        np.append(np.zeros(size), 1.0), A_ub=np.vstack(upper), b_ub=np.concatenate(right),
        A_eq=np.hstack([grip, np.zeros((6, 1))]), b_eq=np.zeros(6), bounds=(None, None), method="highs",
    )  # fmt: skip
    if not solved.success:
        return none
    force = solved.x[:size]
    return Preload(float(solved.x[-1]), motors @ force, force.reshape(count, 3))


def _grip_matrix(touch: Contacts) -> Array:
    """Wrenches of unit forces along the axes at every contact, (6, 3 k); torques divided by the length."""
    found = np.zeros((6, len(touch), 3))
    arm = (touch.points - touch.centre) / touch.length
    found[:3] = np.eye(3)[:, None]
    for axis in range(3):
        found[3:, :, axis] = np.cross(arm, np.eye(3)[axis]).T
    return found.reshape(6, -1)


def _cone_facets(touch: Contacts, facets: int) -> Array:
    """Rows that are ≤ 0 for forces in the pyramids, (k facets, 3 k)."""
    angles = (np.arange(facets) + 0.5) * (2.0 * np.pi / facets)
    second = np.cross(touch.normals, touch.tangents)
    across = np.einsum("e,ki->kei", np.cos(angles), touch.tangents) + np.einsum("e,ki->kei", np.sin(angles), second)
    rows = across - (touch.friction * np.cos(np.pi / facets))[:, None, None] * touch.normals[:, None]
    found = np.zeros((len(touch), facets, len(touch), 3))
    found[np.arange(len(touch)), :, np.arange(len(touch))] = rows
    return found.reshape(len(touch) * facets, -1)
