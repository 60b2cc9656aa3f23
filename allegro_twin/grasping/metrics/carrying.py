"""Load carrying: normal forces and joint torques that carry a load."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.metrics.contacts import EDGES, Contacts, cone_forces, cone_wrenches
from allegro_twin.grasping.metrics.quality import import_scipy
from allegro_twin.types import Array, Vector


class JointEffort(NamedTuple):
    """The least that the joints have to give."""

    share: float
    """Share of its limit that the most loaded joint gives; inf where no torque carries the load."""
    torque: Vector
    """Torques of the hand on the object, (n,), N·m; NaN where none carries it."""
    normal_force: Vector
    """At each contact, (k,), N."""


def weight_load(mass: float, down: ArrayLike = (0.0, 0.0, -1.0), gravity: float = 9.81) -> Vector:
    """The load of an object's weight, (6,), at its centre of mass; `down` is in the contacts' frame."""
    return np.append(mass * gravity * np.asarray(down, dtype=np.float64), np.zeros(3))


def least_normal_force(touch: Contacts, loads: ArrayLike, edges: int = EDGES) -> Vector:
    """For each load (l, 6), N and N·m about the centre of mass, the smallest sum of normal forces that carries it:

    min Σ xᵢ, subject to Σ xᵢ wᵢ + load = 0, xᵢ ≥ 0.

    Shape (l,), N; inf where none does. Linear programs (HiGHS), exact for the pyramids and so an upper bound for the
    cones. Raises ConfigError without SciPy.
    """
    points = cone_wrenches(touch, edges)
    found = []
    for load in _loads(loads, touch.length):
        if not len(points):
            found.append(np.inf if load.any() else 0.0)
            continue
        solved = import_scipy("optimize").linprog(np.ones(len(points)), A_eq=points.T, b_eq=-load, method="highs")
        found.append(float(solved.fun) if solved.success else np.inf)
    return np.array(found)


def least_effort(touch: Contacts, jacobians: Array, limit: Vector, load: ArrayLike, edges: int = EDGES) -> JointEffort:
    """The forces that carry a load (6,) with the least of the clip:

    min t, subject to Σ xᵢ wᵢ + load = 0, |Σ xᵢ Jᵀ(fᵢ, mᵢ)|ⱼ ≤ t limitⱼ, xᵢ ≥ 0.

    `jacobians`: of the hand at each contact, (k, 3, n), m/rad, or with spin below, (k, 6, n), both in the contacts'
    frame; without spin the contacts are taken as hard, for a twist could not be charged to any joint. `limit`: (n,),
    N·m. Statics alone: the fingers' own weight is not in it. A linear program (HiGHS), exact for the pyramids and so an
    upper bound for the cones. Raises ConfigError without SciPy, and for shapes that do not fit.
    """
    rows, joints = _shape(jacobians, touch, limit)
    force, moment, owner = cone_forces(touch, edges)
    wrench = cone_wrenches(touch, edges)
    if rows == 3:
        hard = ~moment.any(axis=1)
        force, moment, owner, wrench = force[hard], moment[hard], owner[hard], wrench[hard]
    unknown_effort = JointEffort(np.inf, np.full(joints, np.nan), np.full(len(touch), np.nan))
    wanted = _loads(load, touch.length)[0]
    if not len(owner):
        return unknown_effort if wanted.any() else JointEffort(0.0, np.zeros(joints), np.zeros(0))
    applied = force if rows == 3 else np.hstack([force, moment])
    torque = np.einsum("gr,grn->ng", applied, jacobians[owner])
    solved = import_scipy("optimize").linprog(
        np.append(np.zeros(len(owner)), 1.0),
        A_ub=np.block([[torque, -limit[:, None]], [-torque, -limit[:, None]]]), b_ub=np.zeros(2 * joints),
        A_eq=np.hstack([wrench.T, np.zeros((6, 1))]), b_eq=-wanted, method="highs",
    )  # fmt: skip
    if not solved.success:
        return unknown_effort
    shares = solved.x[:-1]
    return JointEffort(float(solved.fun), torque @ shares, np.bincount(owner, shares, len(touch)).astype(np.float64))


def _loads(loads: ArrayLike, length: float) -> Array:
    """Loads (l, 6) with their torques divided as those of the contacts are."""
    rows = np.atleast_2d(np.asarray(loads, dtype=np.float64))
    if rows.ndim != 2 or rows.shape[1] != 6 or not np.isfinite(rows).all():
        raise ConfigError(f"a load is six finite numbers, N and N·m; these have the shape {rows.shape}")
    scaled: Array = rows / np.array([1.0, 1.0, 1.0, length, length, length])
    return scaled


def _shape(jacobians: Array, touch: Contacts, limit: Vector) -> tuple[int, int]:
    if jacobians.ndim != 3 or jacobians.shape[0] != len(touch) or jacobians.shape[1] not in (3, 6):
        raise ConfigError(f"jacobians have the shape ({len(touch)}, 3 or 6, joints), not {jacobians.shape}")
    if limit.shape != (jacobians.shape[2],) or not (limit > 0.0).all():
        raise ConfigError(f"limit is {jacobians.shape[2]} torques above 0, N·m; it is {limit.tolist()}")
    return jacobians.shape[1], jacobians.shape[2]
