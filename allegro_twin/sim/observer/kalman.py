"""Kalman gains of independent joints: steady while every report comes, and what they must be after missed ones.

For every joint, with the states x = (position, speed, disturbance), in a period T:

    x ← A x + white noise of covariance Q;    reported: position + white noise of variance R

The steady solution costs nothing. After missed reports, and when the noise of reports changes, Riccati's recursion runs
until it is steady again. Beside it runs the covariance S of the estimate in a hand that nothing pushes: how large an
estimated disturbance is by noise alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array, Vector

try:
    from scipy.linalg import solve_discrete_are  # type: ignore[import-untyped]  # Its types are a package of their own.
except ImportError as error:
    raise ConfigError("a twin needs SciPy: pip install 'allegro-twin[twin]'") from error

SAME = 1e-4
"""Share of its variances by which a period may change them where they count as steady."""
LONGEST = 5000
"""Periods in which S is steady at the latest."""
_C = np.array([[1.0, 0.0, 0.0]])


class _Covariance(NamedTuple):
    P: Array
    """Covariance of the error before a report, (n, 3, 3)."""
    S: Array
    """Covariance of the estimate where nothing pushes, (n, 3, 3)."""


class JointKalman:
    """Gains for n joints. `A` and `Q`: (n, 3, 3), the walk of the disturbance last on Q's diagonal; `noise`: standard
    deviation of reports, (n,), rad; `period`: s."""

    def __init__(self, A: Array, Q: Array, noise: Vector, period: float) -> None:
        self._A, self._Q, self._still = A, Q, Q.copy()
        self._still[:, 2, 2] = 0.0
        self._kick = np.array([period**2 / 2.0, period, 0.0])
        self._R = np.square(noise)
        rows = zip(A, Q, self._R, strict=True)
        P = np.array([solve_discrete_are(a.T, _C.T, q, np.array([[r]])) for a, q, r in rows])
        self._K: Array = P[:, :, 0] / (P[:, 0, 0] + self._R)[:, None]
        S = self._still
        for _ in range(LONGEST):
            before, S = S, _carried(A, self._corrected(S, self._K), self._still)
            if _same(before, S):
                break
        self._now = self._steady = _Covariance(P, S)
        self._rests, self._known = True, True  # The covariances are steady; it is known which are.
        self.expected = self._expected()
        """Standard deviation of the last reports from what was predicted, (n,), rad."""

    @property
    def spread(self) -> Vector:
        """Standard deviation of the disturbance that is estimated where there is none, (n,), N·m."""
        return np.asarray(np.sqrt(self._now.S[:, 2, 2]))

    def noisier(self, noise: Vector) -> None:
        """From now on reports have this noise, (n,), rad."""
        self._R, self._rests, self._known = np.square(noise), False, False

    def missed(self, unsure: Vector, keeps: Vector | None = None) -> None:
        """A period without any report, whose accelerations may be off by `unsure`, (n,), rad/s², more than always.
        `keeps`: what it leaves of an error in speed, (n,), more than 1 where that grows; None: as always."""
        more = np.square(unsure)[:, None, None] * np.outer(self._kick, self._kick)
        A = self._A.copy()
        A[:, 1, 1] = A[:, 1, 1] if keeps is None else keeps
        P, S = self._now
        self._now = _Covariance(_carried(A, P, self._Q + more), _carried(A, S, self._still + more))
        self._rests = False

    def gains(self, reported: NDArray[np.bool_]) -> Array:
        """On position, speed and disturbance, (3, n), for the reports that end a period; 0 for joints that are not
        `reported`, (n,)."""
        whole, self.expected = bool(reported.all()), self._expected()
        if self._rests and whole:
            return self._K.T
        before, P = self._now, self._now.P
        K = np.where(reported[:, None], P[:, :, 0] / (P[:, 0, 0] + self._R)[:, None], 0.0)
        P, S = (self._corrected(each, K) for each in before)
        self._now = _Covariance(_carried(self._A, P, self._Q), _carried(self._A, S, self._still))
        self._rests = whole and all(map(_same, before, self._now))
        if self._rests and self._known:
            self._now = self._steady
        elif self._rests:
            self._steady, self._K, self._known = self._now, K, True
        return K.T

    def _expected(self) -> Vector:
        return np.asarray(np.sqrt(self._now.P[:, 0, 0] + self._R))

    def _corrected(self, covariance: Array, K: Array) -> Array:
        left = np.eye(3) - K[:, :, None] * _C
        return np.asarray(left @ covariance @ left.swapaxes(1, 2) + self._R[:, None, None] * K[:, :, None] * K[:, None])


def _carried(A: Array, covariance: Array, Q: Array) -> Array:
    """By a period."""
    return np.asarray(A @ covariance @ A.swapaxes(1, 2) + Q)


def _same(before: Array, after: Array) -> bool:
    """Whether variances are those of a period ago."""
    one, two = (np.diagonal(each, axis1=1, axis2=2) for each in (before, after))
    return bool((np.abs(two - one) <= SAME * one).all())
