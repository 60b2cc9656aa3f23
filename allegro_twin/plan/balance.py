"""Could these contacts hold it? Forces inside friction cones that balance each other, and that carry the weight."""

from __future__ import annotations

from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.plan.workbench import Touch
from allegro_twin.types import Array

EDGES = 8
LEVER = 0.04
"""m: what makes a moment a force, about the radius of what a hand holds."""
UNBEARABLE = 1e3


def wrenches(touch: Touch, centre: Array, friction: float) -> Array:
    """The edges of all friction cones, each with a normal force of 1, as columns (6, EDGES k): force over moment /
    LEVER about the centre."""
    first, second = _tangents(touch.normals)
    angle = 2.0 * np.pi * np.arange(EDGES) / EDGES
    edges = touch.normals[:, None] + friction * (
        np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    )
    arms = np.repeat(touch.points[:, None] - centre, EDGES, axis=1)
    columns: Array = np.concatenate([edges, np.cross(arms, edges) / LEVER], axis=2).reshape(-1, 6).T
    return columns


def imbalance(columns: Array) -> float:
    """How far contacts that press with 1 in all are from balancing each other: min |G x| over x ≥ 0, Σ x = 1."""
    nnls = _scipy().nnls
    heavy = 10.0  # The weight of Σ x = 1 among the equations.
    equations = np.concatenate([columns, np.full((1, columns.shape[1]), heavy)])
    forces, _ = nnls(equations, np.array([0.0] * 6 + [heavy]))
    total = float(forces.sum())
    return float(np.linalg.norm(columns @ forces)) / total if total > 1e-9 else UNBEARABLE


def carrying(columns: Array, loads: Array) -> float:
    """The smallest sum of normal forces that bears the worst of some loads (k, 6), N: max over loads of min Σ x with
    G x = -load, x ≥ 0; UNBEARABLE where there is none."""
    linprog, worst = _scipy().linprog, 0.0
    for load in loads:
        found = linprog(np.ones(columns.shape[1]), A_eq=columns, b_eq=-load, method="highs")
        if found.status != 0:
            return UNBEARABLE
        worst = max(worst, float(found.fun))
    return worst


def _scipy() -> Any:
    try:
        from scipy import optimize
    except ImportError as error:
        raise ConfigError("planning grasps needs SciPy: pip install 'allegro-twin[objects]'") from error
    return optimize


def _tangents(normals: Array) -> tuple[Array, Array]:
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(normals, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)
