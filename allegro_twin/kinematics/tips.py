"""All fingertips of a hand at once: what `FingerKinematics.tip` says of each, in a third of the operations.

Every finger turns about one axis and bends in the plane that it turns; the thumb's whole chain turns once more
(docs/kinematics.md#finger, #thumb). So one table of angles serves them all:
(x, y, z) = offset + (r cos q_t, r sin q_t, h), r = Σ lₖ sin αₖ, h = Σ lₖ cos αₖ.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from allegro_twin.kinematics.geometry import load_geometry
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


class Fingertips:
    """Sums are written out or run over a row, so that a row comes out the same whatever the size of its batch."""

    def __init__(self, spec: HandSpec, xp: Any = np) -> None:
        """`xp`: the library of the arrays that it is called with (allegro_twin/arrays.py)."""
        parts = [load_geometry(spec.model, finger.name) for finger in spec.fingers]
        self._thumbs = np.array([part.is_thumb for part in parts])
        # Columns of the table of angles: the turn, then what bends. The thumb's first joint takes the second column.
        order = np.where(self._thumbs[:, None], [1, 0, 2, 3], [0, 1, 2, 3])
        self._joints = np.take_along_axis(np.array([finger.joints for finger in spec.fingers]), order, axis=1)
        left = spec.side == "left"
        flips = np.isin(np.arange(spec.n_joints), spec.mirror_flips)
        self._signs = np.where(left & flips, -1.0, 1.0)[self._joints]
        self._links = np.array([[*(0.0,) * (4 - len(part.links)), *part.links] for part in parts])
        self._offset = np.array([part.offset + np.array([0.0, 0.0, part.rise]) for part in parts])
        self._bends = ~self._thumbs
        reflect = np.array([1.0, -1.0 if left else 1.0, 1.0])
        self._axes = [np.array([part.base[:, k] * reflect for part in parts]) for k in range(3)]
        self._origin = np.array([part.origin * reflect for part in parts])
        self._xp = xp
        for name in ("thumbs", "joints", "signs", "links", "offset", "bends", "origin"):
            setattr(self, f"_{name}", xp.asarray(getattr(self, f"_{name}")))
        self._axes = [xp.asarray(axis) for axis in self._axes]

    def __call__(self, position: Array) -> Array:
        """Joints (..., n), rad → fingertips in the palm frame, in the spec's order, (..., fingers, 3), m."""
        angle = position[..., self._joints] * self._signs
        bent = angle[..., 1] * self._bends
        angle[..., 2] += bent
        angle[..., 3] += angle[..., 2]
        sine, cosine = self._xp.sin(angle), self._xp.cos(angle)
        r, h = ((part * self._links).sum(axis=-1) for part in (sine, cosine))
        x = self._offset[:, 0] + r * cosine[..., 0]
        y = self._offset[:, 1] + r * sine[..., 0]
        z = self._offset[:, 2] + h
        # Fingers do not turn once more: sine 0, cosine 1.
        s, c = sine[..., 1] * self._thumbs, cosine[..., 1] * self._thumbs + self._bends
        y, z = c * y + s * z, c * z - s * y
        first, second, third = self._axes
        tips: Array = x[..., None] * first + y[..., None] * second + z[..., None] * third + self._origin
        return tips
