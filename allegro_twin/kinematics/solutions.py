"""Results of inverse kinematics: all postures found, the best one, and the nearest where none reaches the target."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arguments import finite, rows
from allegro_twin.types import Array, Vector

Flags = NDArray[np.bool_]
"""True or false for each of many."""
_ALIKE = 1e-6  # rad: orientations no further apart count as equally near.


class Nearest(NamedTuple):
    """The posture that brings the tip nearest to a target, in straight-line distance of the tip's centre."""

    posture: Array
    """Joints, shape (..., k), rad; NaN where no posture has the angle asked for."""
    point: Array
    """Where the tip then is, in the palm frame, shape (..., 3), m."""
    distance: Array
    """From there to the target, shape (...), m; inf where no posture has the angle asked for."""


class Best(NamedTuple):
    """One posture for each target, inside the limits."""

    posture: Array
    """Joints, shape (..., k), rad: the chosen branch, or where none is inside the limits the nearest posture."""
    reached: Flags
    """Whether the tip is then on the target, shape (...)."""
    distance: Array
    """From the tip to the target, shape (...), m: zero where reached, inf where no posture has the angle asked for."""
    angle: Array
    """From the tip's orientation to the one asked for, shape (...), rad; zero where none was, NaN if not reached."""


@dataclass(frozen=True, slots=True, eq=False)
class Solutions:
    """The postures of a finger of k joints for targets of shape (...): b branches for each.

    An iterative solver has one branch, the posture that it finds.
    """

    position: Array
    """Joints of each branch, shape (..., b, k), rad; NaN where a branch does not exist."""
    within: Flags
    """Which branches are inside the limits less the margin, to 1e-9 rad, shape (..., b)."""
    angle: Array
    """From each branch's orientation to the one asked for, shape (..., b), rad; zero where none was asked for."""
    lower: Vector
    """The limits with the margin taken off, shape (k,), rad."""
    upper: Vector
    search: Callable[[Flags, bool], Nearest]
    """Finds the nearest reachable point for the marked targets (...); used by `nearest`."""

    @property
    def exists(self) -> Flags:
        """Which branches reach their target, inside the limits or not, shape (..., b)."""
        return np.asarray(~np.isnan(self.position[..., 0]))

    @property
    def reachable(self) -> Flags:
        """Whether any branch is inside the limits, shape (...)."""
        return np.asarray(self.within.any(axis=-1))

    def nearest(self, *, limits: bool = True) -> Nearest:
        """For every target the posture that brings the tip nearest to it.

        The nearest point is the one at the least straight-line distance among the tip positions of all postures that
        are inside the limits less the margin (`limits`), or of all postures, and that have the angle that was held. An
        orientation is not held: the position comes first. An iterative solver finds a local minimum of the distance.
        Targets that are reached have distance zero and their first branch.
        """
        good = self.within if limits else self.exists
        if good.ndim == 1:  # One target.
            found = self.search(np.asarray(not good.any()), limits)
            return found._replace(posture=self.position[int(np.argmax(good))]) if good.any() else found
        found = self.search(np.asarray(~good.any(axis=-1)), limits)
        first = np.take_along_axis(self.position, np.argmax(good, axis=-1)[..., None, None], axis=-2)[..., 0, :]
        return found._replace(posture=np.where(good.any(axis=-1, keepdims=True), first, found.posture))

    def best(self, near: ArrayLike | None = None) -> Best:
        """One posture for each target: of the branches inside the limits the one nearest to `near`, (..., k), rad.

        Without `near`, the one furthest from its nearest limit; a full pose prefers the least angle first.
        Where no branch is inside the limits, the nearest posture, and its distance. Raises ConfigError for a `near`
        that is not finite, or more than there are targets.
        """
        wanted = None if near is None else self._checked_near(near)
        if self.within.ndim == 1:
            return self._best_of_one(wanted)
        if wanted is None:
            cost = -np.minimum(self.position - self.lower, self.upper - self.position).min(axis=-1)
        else:
            cost = np.square(self.position - wanted[..., None, :]).sum(axis=-1)
        exact = self.angle <= np.where(self.within, self.angle, np.inf).min(axis=-1, keepdims=True) + _ALIKE
        chosen = np.argmin(np.where(self.within & exact, cost, np.inf), axis=-1)
        posture = np.take_along_axis(self.position, chosen[..., None, None], axis=-2)[..., 0, :]
        angle = np.take_along_axis(self.angle, chosen[..., None], axis=-1)[..., 0]
        reached = self.reachable
        if reached.all():
            return Best(posture, reached, np.zeros(reached.shape), angle)
        nearest = self.nearest()
        return Best(
            np.where(reached[..., None], posture, nearest.posture),
            reached,
            np.where(reached, 0.0, nearest.distance),
            np.where(reached, angle, np.nan),
        )

    def _checked_near(self, near: ArrayLike) -> Array:
        wanted, targets = rows("near", near, len(self.lower)), self.within.shape[:-1]
        try:
            fits = np.broadcast_shapes(wanted.shape[:-1], targets) == targets
        except ValueError:
            fits = False
        if not fits:
            raise ConfigError(f"near {wanted.shape} does not go with targets of shape {targets}")
        return finite("near", wanted, *wanted.shape)

    def _best_of_one(self, near: Vector | None) -> Best:
        """Best posture for one target, as `best` of many."""
        rows = [
            (angle, q)
            for q, ok, angle in zip(self.position.tolist(), self.within.tolist(), self.angle.tolist(), strict=True)
            if ok
        ]
        if not rows:
            nearest = self.nearest()
            return Best(nearest.posture, np.asarray(False), nearest.distance, np.asarray(np.nan))
        least = min(rows)[0] + _ALIKE
        lower, upper = self.lower.tolist(), self.upper.tolist()
        wanted = None if near is None else near.tolist()

        def cost(row: tuple[float, list[float]]) -> float:
            if row[0] > least:
                return math.inf
            if wanted is None:
                rooms = [min(q - low, high - q) for q, low, high in zip(row[1], lower, upper, strict=True)]
                return -float(min(rooms))
            return math.dist(row[1], wanted)

        angle, posture = min(rows, key=cost) if len(rows) > 1 else rows[0]
        return Best(np.array(posture), np.asarray(True), np.zeros(()), np.asarray(angle))
