"""One finger by iteration, for hands whose fingers have no closed form: damped least squares from a posture near by."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arguments import finite
from allegro_twin.kinematics.closed_form.solution import Best
from allegro_twin.kinematics.model import HandModel
from allegro_twin.kinematics.pose import Pose
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

_ROUNDS, _DAMPING = 200, 1e-3  # Damping in m, against joints that have no say.
_MET, _THERE = 1e-6, 1e-4  # m: good enough to stop, and to have reached it.
_SETTLED, _LONGEST = 1e-9, 0.3  # rad: a step that is the last, and the longest.
_PULL = 0.02  # Of the way back to where the search began, where that costs the tip nothing.


class _Answer(NamedTuple):
    """What `best` is asked of, as of the closed form's solutions."""

    found: Best

    def best(self, near: ArrayLike | None = None) -> Best:
        """The posture that was found from `near`, (k,), rad."""
        return self.found


class NumericFinger:
    """`fk` and `ik` of one finger with any number of joints of its own, in the palm frame. It finds the posture near a
    given one, and no other branch; where there is none inside the limits, the nearest that the descent came to."""

    def __init__(self, spec: HandSpec, model: HandModel, finger: str, posture: Vector) -> None:
        """`posture`: of the whole hand, (n,), rad. Raises ConfigError where a joint moves other fingers, too."""
        joints = list(spec.finger(finger).joints)
        shared = [f.name for f in spec.fingers if f.name != finger and set(f.joints) & set(joints)]
        if shared:
            raise ConfigError(
                f"{spec.name}: {finger} cannot be moved alone, its motor moves {', '.join(shared)} as well"
            )
        self.name, self.lower, self.upper = finger, spec.lower[joints], spec.upper[joints]
        self._model, self._joints, self._posture = model, joints, np.array(posture)

    def fk(self, position: ArrayLike) -> Pose:
        """The fingertip in the palm frame, joints (k,), rad."""
        self._posture[self._joints] = finite(f"{self.name}: position", position, len(self._joints))
        return self._model.fingertips(self._posture)[self.name]

    def ik(self, position: ArrayLike, *, near: ArrayLike) -> _Answer:
        """The tip at a point, (3,), m, from a posture of the finger, (k,), rad; turned as it comes."""
        target = finite(f"{self.name}: position", position, 3)
        start = finite(f"{self.name}: near", near, len(self._joints))
        q, closest, least = np.clip(start, self.lower, self.upper), start, np.inf
        for _ in range(_ROUNDS):
            self._posture[self._joints] = q
            places, jacobians = self._model.fingertip_jacobians(self._posture, [self.name])
            error, jacobian = target - places[0], jacobians[0][:, self._joints]
            distance = float(np.linalg.norm(error))
            if distance < least:
                closest, least = q, distance
            step = self._step(q, error, jacobian, start)
            q = np.clip(q + step, self.lower, self.upper)
            if distance < _MET or np.abs(q - closest).max() < _SETTLED:
                break
        return _Answer(Best(closest, np.asarray(least < _THERE), np.asarray(least), np.asarray(0.0)))

    def _step(self, q: Vector, error: Vector, jacobian: Array, start: Vector) -> Vector:
        """Δq = J⁺ e + (1 - J⁺ J) c (q₀ - q), J⁺ = Jᵀ (J Jᵀ + λ² 1)⁻¹, without joints that lean on a limit already."""
        free = np.ones(len(q), dtype=bool)
        for _ in range(len(q)):
            used = jacobian * free
            inverse = used.T @ np.linalg.inv(used @ used.T + _DAMPING**2 * np.eye(3))
            pull = _PULL * (start - q) * free
            step: Vector = inverse @ error + pull - inverse @ (used @ pull)
            beyond = free & (((q <= self.lower) & (step < 0.0)) | ((q >= self.upper) & (step > 0.0)))
            if not beyond.any():
                break
            free &= ~beyond
        return np.asarray(step * min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-12)))
