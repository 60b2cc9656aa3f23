"""Inverse kinematics by iteration, for fingers without a closed form: damped least squares from a posture near by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arguments import check_margin, finite, rows
from allegro_twin.kinematics.pose import Pose
from allegro_twin.kinematics.solutions import Flags, Nearest, Solutions
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector, frozen

_ROUNDS, _DAMPING = 200, 1e-3  # Damping in m, against joints that hardly move the tip.
_MET, _THERE = 1e-6, 1e-4  # m: near enough to stop, and to count as reached.
_SETTLED, _LONGEST = 1e-9, 0.3  # rad: a step that is the last, and the longest.
_NO_LIMITS = np.array(-np.inf), np.array(np.inf)
_PULL = 0.02  # Of the way back to where the search began, where that costs the tip nothing.


class _Hand(Protocol):
    """The part of `HandKinematics` that the iteration needs."""

    spec: HandSpec

    def fingertips(self, position: ArrayLike) -> dict[str, Pose]: ...

    def fingertip_jacobians(self, position: ArrayLike, fingers: Sequence[str]) -> tuple[Array, Array]: ...


class NumericFinger:
    """Forward and inverse kinematics of a finger with any number k of joints, or motors, of its own, in the palm frame.

    It finds the posture near a given one, and no other branch; where there is none inside the limits, the nearest that
    the descent comes to. The tip turns as it comes: no orientation is solved for.
    """

    def __init__(self, hand: _Hand, finger: str) -> None:
        """Raises ConfigError where a joint moves other fingers, too."""
        spec = hand.spec
        joints = list(spec.finger(finger).joints)
        shared = [f.name for f in spec.fingers if f.name != finger and set(f.joints) & set(joints)]
        if shared:
            raise ConfigError(
                f"{spec.name}: {finger} cannot be moved alone, its motor moves {', '.join(shared)} as well"
            )
        self.name, self.lower, self.upper = finger, spec.lower[joints], spec.upper[joints]
        self._hand, self._joints, self._posture = hand, joints, np.array(spec.rest)

    def fk(self, position: ArrayLike) -> Pose:
        """The fingertip in the palm frame, joints (..., k), rad → position (..., 3), m, and rotation (..., 3, 3)."""
        k = len(self._joints)
        q = rows(f"{self.name}: position", position, k)
        if q.ndim == 1:
            return self._fk(finite(f"{self.name}: position", q, k))
        poses = [self._fk(row) for row in finite(f"{self.name}: position", q, *q.shape).reshape(-1, k)]
        shape = q.shape[:-1]
        return Pose(
            np.array([pose.position for pose in poses]).reshape(*shape, 3),
            np.array([pose.rotation for pose in poses]).reshape(*shape, 3, 3),
        )

    def _fk(self, position: Vector) -> Pose:
        self._posture[self._joints] = position
        return self._hand.fingertips(self._posture)[self.name]

    def ik(
        self,
        position: ArrayLike,
        *,
        rotation: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        euler: ArrayLike | None = None,
        near: ArrayLike | None = None,
        margin: float = 0.0,
        **held: ArrayLike | None,
    ) -> Solutions:
        """The posture with the tip at a point, shape (..., 3), m, one branch for each; the descent begins at `near`, a
        posture of the finger, (..., k), rad, by default the middle of its range.

        `margin` is taken off both ends of every joint's range, rad. Raises ConfigError for what does not fit, and for
        an orientation or another angle, which it does not solve for.
        """
        asked = {**held, "rotation": rotation, "quaternion": quaternion, "euler": euler}
        if loose := [name for name, value in asked.items() if value is not None]:
            raise ConfigError(
                f"{self.name} of {self._hand.spec.name} has no closed form: leave out {loose[0]}, its tip turns as it "
                f"comes"
            )
        margin = float(finite(f"{self.name}: margin", margin))
        check_margin(self.name, margin, self.lower, self.upper)
        limits, targets = (self.lower + margin, self.upper - margin), rows(f"{self.name}: position", position, 3)
        starts, shape = self._starts(near, targets.shape[:-1], limits), targets.shape[:-1]
        targets = finite(f"{self.name}: position", targets, *targets.shape).reshape(-1, 3)
        postures, distances = self._descents(targets, starts, limits)
        reached = distances < _THERE

        def nearest(missing: Flags, limited: bool) -> Nearest:
            left, far = (postures, distances) if limited else self._descents(targets, starts, _NO_LIMITS)
            points = np.where(missing.reshape(-1, 1), self.fk(left).position, targets)
            far = np.where(missing.reshape(-1), far, 0.0)
            return Nearest(left.reshape(*shape, -1), points.reshape(*shape, 3), far.reshape(shape))

        found = np.where(reached[:, None], postures, np.nan).reshape(*shape, 1, len(self.lower))
        within = reached.reshape(*shape, 1)
        return Solutions(found, within, np.zeros(within.shape), frozen(limits[0]), frozen(limits[1]), nearest)

    def _starts(self, near: ArrayLike | None, shape: tuple[int, ...], limits: tuple[Vector, Vector]) -> Array:
        """A posture for each target to begin at, (targets, k), rad."""
        k = len(self.lower)
        start = (limits[0] + limits[1]) / 2 if near is None else rows(f"{self.name}: near", near, k)
        start = finite(f"{self.name}: near", start, *start.shape)
        try:
            return np.broadcast_to(start, (*shape, k)).reshape(-1, k)
        except ValueError as error:
            raise ConfigError(f"{self.name}: near {start.shape} does not go with positions {(*shape, 3)}") from error

    def _descents(self, targets: Array, starts: Array, limits: tuple[Vector, Vector]) -> tuple[Array, Array]:
        """For each target the posture that the descent finds, (targets, k), rad, and its distance, (targets,), m."""
        found = [self._descent(*each, *limits) for each in zip(targets, starts, strict=True)]
        return np.array([q for q, _ in found]).reshape(starts.shape), np.array([distance for _, distance in found])

    def _descent(self, target: Vector, start: Vector, lower: Vector, upper: Vector) -> tuple[Vector, float]:
        """The posture that is found from another, (k,), rad, and the distance that it leaves, m."""
        q, closest, least = np.clip(start, lower, upper), start, np.inf
        for _ in range(_ROUNDS):
            self._posture[self._joints] = q
            places, jacobians = self._hand.fingertip_jacobians(self._posture, [self.name])
            error, jacobian = target - places[0], jacobians[0][:, self._joints]
            distance = float(np.linalg.norm(error))
            if distance < least:
                closest, least = q, distance
            q = np.clip(q + _step(q, error, jacobian, start, lower, upper), lower, upper)
            if distance < _MET or np.abs(q - closest).max() < _SETTLED:
                break
        return closest, least


def _step(q: Vector, error: Vector, jacobian: Array, start: Vector, lower: Vector, upper: Vector) -> Vector:
    """Δq = J⁺ e + (1 - J⁺ J) c (q₀ - q), J⁺ = Jᵀ (J Jᵀ + λ² 1)⁻¹, without joints that lean on a limit already."""
    free = np.ones(len(q), dtype=bool)
    for _ in range(len(q)):
        used = jacobian * free
        inverse = used.T @ np.linalg.inv(used @ used.T + _DAMPING**2 * np.eye(3))
        pull = _PULL * (start - q) * free
        step: Vector = inverse @ error + pull - inverse @ (used @ pull)
        beyond = free & (((q <= lower) & (step < 0.0)) | ((q >= upper) & (step > 0.0)))
        if not beyond.any():
            break
        free &= ~beyond
    return np.asarray(step * min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-12)))
