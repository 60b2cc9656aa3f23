"""Preload of a grasp: the share of its motors that a hand needs, by the springs of the squeeze and by limit
analysis.

Both are quadratic programs over forces in the friction cones. What holds in fact is between them: a contact that slips
hands its load on to others, as limit analysis has it, but joints are springs, and give no other torque than theirs.
"""

from __future__ import annotations

from types import ModuleType
from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.metrics.contacts import Contacts, cross_product
from allegro_twin.types import Array, Vector

FACETS = 6
"""Facets of the pyramid inside a friction cone."""
_TIES = 1e-7
"""ε, 1/N²: so little that shares are the least ones within 1e-5, and enough for one answer where many are equal."""
_UNBOUNDED = 1e30
_SOLVED = 1  # DAQP's exit flag.
COMPLIANCE = 2e-4
"""m/N, of a contact itself: what lets the palm, which no motor moves, share a load. Assumed; a rubber fingertip."""


class Preload(NamedTuple):
    """Motor torques before the load comes."""

    share: float
    """Share of its limit that the most loaded joint gives under the worst load; inf where no preload carries it."""
    torque: Vector
    """(n,), N·m; NaN where none will do."""
    force: Array
    """Force of the hand on the object at each contact, (k, 3), N."""


class GripForces:
    """Forces that a hand can make at its contacts with an object: f with G f = −w for a load w, in the friction cones,
    by torques |Jᵀ f| that its motors have."""

    def __init__(self, touch: Contacts, jacobians: Array, limit: Vector, *, facets: int = FACETS) -> None:
        """`jacobians`: of the hand at each contact, (k, 3, n), m/rad. `limit`: of the motors, (n,), N·m. Contacts are
        points without torsion; the pyramids are inside the cones, so what is found can be done. Raises ConfigError for
        shapes that do not fit."""
        count, joints = len(touch), len(limit)
        if jacobians.shape != (count, 3, joints):
            raise ConfigError(f"jacobians have the shape ({count}, 3, {joints}), not {jacobians.shape}")
        self._touch, self._few = touch, count < 2
        self._moved = jacobians.reshape(3 * count, joints)
        self._grip, cones = _grip_matrix(touch), _cone_facets(touch, facets)
        # Forces are f₁ + B z with G B = 0: of rows A f ≤ t b of cones and motors A B and −b are the same for all loads.
        self._inside = np.vstack([cones, self._moved.T, -self._moved.T])
        bounds = np.concatenate([np.zeros(len(cones)), limit, limit])
        self._balanced = np.linalg.svd(self._grip)[2][6:].T
        self._rows = np.ascontiguousarray(np.hstack([self._inside @ self._balanced, -bounds[:, None]]))

    def least_preload(self, stiffness: Vector, loads: Array, *, compliance: float = COMPLIANCE) -> Preload:
        """The contact forces f₀ of a hand held by springs that carry every one of some loads wₖ with the least of the
        motors:

        min t + ½ ε (|f₀|² + t²), subject to G f₀ = 0, f₀ + Δₖ in the friction cones, |Jᵀ(f₀ + Δₖ)|ⱼ ≤ t limitⱼ, for
        k = 0 … l, Δ₀ = 0: of the squeezes with the least share the weakest.

        No controller acts on the load: it moves the object, and joints of `stiffness` (n,), N·m/rad, answer,
        Δₖ = −K Gᵀ (G K Gᵀ)⁻¹ wₖ with K = (J diag(1/stiffness) Jᵀ + compliance · 1)⁻¹. `loads`: (l, 6), N and N·m
        about the centre of mass. Raises ConfigError without DAQP.
        """
        moved, grip = self._moved, self._grip
        none = Preload(np.inf, np.full(moved.shape[1], np.nan), np.full((len(self._touch), 3), np.nan))
        if self._few:
            return none
        stiff = np.linalg.inv(moved @ (moved / stiffness).T + compliance * np.eye(len(moved)))
        spread, _, rank, _ = np.linalg.lstsq(grip @ stiff @ grip.T, self._scaled(loads).T, rcond=1e-9)
        if rank < 6:
            return none  # About some axis nothing resists: two contacts turn about the line between them.
        answers = np.hstack([np.zeros((len(moved), 1)), -stiff @ grip.T @ spread])
        # Every load has the same rows, and the one that leaves the least room counts.
        solved = self._solve(answers)
        if solved is None:
            return none
        force = self._balanced @ solved[:-1]
        return Preload(float(solved[-1]), moved.T @ force, force.reshape(-1, 3))

    def limit_share(self, loads: Array) -> float:
        """The smallest share of the limits with which some forces carry every load, each load by forces of its own:

        max over k of min t, subject to G f = −wₖ, f in the friction cones, |Jᵀ f|ⱼ ≤ t limitⱼ.

        By the lower bound theorem of limit analysis a hand whose motors give their limits where they have to carries
        what needs a share below 1, however its contacts slip at first; no squeeze is told by it. inf where no forces
        do. `loads` and errors as `least_preload` has them.
        """
        if self._few:
            return np.inf
        wanted = self._scaled(loads)
        some, _, rank, _ = np.linalg.lstsq(self._grip, -wanted.T, rcond=1e-9)
        if rank < 6 and not np.allclose(self._grip @ some, -wanted.T, atol=1e-9):
            return np.inf
        worst = 0.0
        for force in some.T:
            solved = self._solve(force[:, None])
            if solved is None:
                return np.inf
            worst = max(worst, float(solved[-1]))
        return worst

    def _scaled(self, loads: Array) -> Array:
        """Torques divided by the length, as those of the grip matrix are."""
        scaled: Array = loads * np.array([1.0, 1.0, 1.0, *[1.0 / self._touch.length] * 3])
        return scaled

    def _solve(self, given: Array) -> Vector | None:
        """z and t, with the least t; of several given forces f₁, (3 k, m), for all at once. None: nothing does."""
        n, right = self._rows.shape[1], -(self._inside @ given).max(axis=1)
        solved, _, flag, _ = _import_daqp().solve(
            _TIES * np.eye(n), np.append(np.zeros(n - 1), 1.0), self._rows, right,
            np.full(len(right), -_UNBOUNDED), np.zeros(len(right), np.int32),
        )  # fmt: skip
        return solved if flag == _SOLVED else None


def _import_daqp() -> ModuleType:
    try:
        import daqp
    except ImportError as error:
        raise ConfigError("planned squeezes need DAQP: pip install 'allegro-twin[objects]'") from error
    return daqp  # type: ignore[no-any-return]  # It has no types.


def _grip_matrix(touch: Contacts) -> Array:
    """Wrenches of unit forces along the axes at every contact, (6, 3 k); torques divided by the length."""
    found = np.zeros((6, len(touch), 3))
    arm = (touch.points - touch.centre) / touch.length
    found[:3] = np.eye(3)[:, None]
    x, y, z = arm.T
    # The columns of arm × e for the three axes e.
    found[4, :, 0], found[5, :, 0] = z, -y
    found[3, :, 1], found[5, :, 1] = -z, x
    found[3, :, 2], found[4, :, 2] = y, -x
    return found.reshape(6, -1)


def _cone_facets(touch: Contacts, facets: int) -> Array:
    """Rows that are ≤ 0 for forces in the pyramids, (k facets, 3 k)."""
    angles = (np.arange(facets) + 0.5) * (2.0 * np.pi / facets)
    second = cross_product(touch.normals, touch.tangents)
    across = np.einsum("e,ki->kei", np.cos(angles), touch.tangents) + np.einsum("e,ki->kei", np.sin(angles), second)
    rows = across - (touch.friction * np.cos(np.pi / facets))[:, None, None] * touch.normals[:, None]
    found = np.zeros((len(touch), facets, len(touch), 3))
    found[np.arange(len(touch)), :, np.arange(len(touch))] = rows
    return found.reshape(len(touch) * facets, -1)
