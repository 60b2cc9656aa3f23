"""From the joints that a hand drives to all that move with them, and back."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

_STEP = 1e-6  # Of a driven joint's range.


class Moving:
    """Configurations of a Pinocchio model from postures of a hand; joints that the model does not have are motors of
    tendons, and show in what follows them."""

    def __init__(self, spec: HandSpec, model: pin.Model) -> None:
        self._spec = spec
        known = [k for k, name in enumerate(spec.joints) if model.existJointName(name)]
        names = [spec.joints[k] for k in known] + [each.name for each in spec.followers]
        # Pinocchio orders the fingers by name; `_order` says where it has what we have.
        self._order = np.array([model.idx_vs[model.getJointId(name)] for name in names])
        self._place = np.argsort(self._order)
        self._known = known
        self._direct = not spec.followers and len(known) == spec.n_joints

    def configuration(self, position: Vector) -> Vector:
        """Of a posture, (n,), rad: the model's."""
        if self._direct:
            return position[self._place]
        return self._all(position)[self._place]

    def driven(self, columns: Array, position: Vector) -> Array:
        """What is said of each of the model's joints, (..., joints), as said of those that are driven, (..., n): by the
        chain rule, Σ ∂q/∂qₖ over all that move with joint k."""
        ours: Array = columns[..., self._order]
        return ours if self._direct else ours @ self._slope(position)

    def _all(self, position: Vector) -> Vector:
        return np.concatenate([position[self._known], self._spec.followed(position)])

    def _slope(self, position: Vector) -> Array:
        lower, upper = self._spec.lower, self._spec.upper
        columns = []
        for k, wide in enumerate(_STEP * (upper - lower)):
            below, above = np.array(position), np.array(position)
            below[k], above[k] = max(position[k] - wide, lower[k]), min(position[k] + wide, upper[k])
            columns.append((self._all(above) - self._all(below)) / (above[k] - below[k]))
        return np.stack(columns, axis=-1)
