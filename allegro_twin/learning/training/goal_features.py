"""Goal features: the remaining difference to a goal, a further input of policies with goals.

For positions it is the difference. For orientations, unit quaternions g and a, it is 2 sign(w) v with (w, v) = g a⁻¹:
the axis of the remaining rotation, in world axes, times twice the sine of half its angle. w and v are sums of products
of entries, given by the same matrices for NumPy, PyTorch and ONNX.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from allegro_twin.array_api import array_namespace

# (entry of the result, sign, entry of the goal, entry of what is achieved)
_PRODUCTS = [
    *((0, 1.0, k, k) for k in range(4)),
    *((k, 1.0, k, 0) for k in (1, 2, 3)),
    *((k, -1.0, 0, k) for k in (1, 2, 3)),
    *((k, -1.0, 1 + k % 3, 1 + (k + 1) % 3) for k in (1, 2, 3)),
    *((k, 1.0, 1 + (k + 1) % 3, 1 + k % 3) for k in (1, 2, 3)),
]


def _matrices() -> tuple[Any, Any, Any, Any]:
    wanted, had = np.zeros((4, len(_PRODUCTS)), np.float32), np.zeros((4, len(_PRODUCTS)), np.float32)
    scalar, vector = np.zeros((len(_PRODUCTS), 1), np.float32), np.zeros((len(_PRODUCTS), 3), np.float32)
    for product, (entry, sign, goal, achieved) in enumerate(_PRODUCTS):
        wanted[goal, product] = had[achieved, product] = 1.0
        if entry:
            vector[product, entry - 1] = 2.0 * sign
        else:
            scalar[product] = sign
    return wanted, had, scalar, vector


WANTED, HAD, SCALAR, VECTOR = _matrices()


def goal_difference(desired: Any, achieved: Any, turns: bool) -> Any:
    """Difference of goals (n, k), or with `turns` of orientations (n, 4), shape (n, 3)."""
    if not turns:
        return desired - achieved
    xp = array_namespace(desired)
    wanted, had, scalar, vector = (xp.asarray(matrix, np.float32) for matrix in (WANTED, HAD, SCALAR, VECTOR))
    products = (desired @ wanted) * (achieved @ had)
    return (products @ vector) * xp.sign(products @ scalar)


def goal_difference_width(width: int, turns: bool) -> int:
    """Number of these features, for goals of `width` numbers."""
    return 3 if turns else width
