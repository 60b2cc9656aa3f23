"""Encoder drift detection: what gravity says of a joint's angle, over half a minute to two minutes.

An encoder that reads o too much makes its mirror expect the weight of another posture. The remaining disturbance is

    d = −K o,    K = ∂(torque of gravity) / ∂q,

on all joints of the finger. With a drift, o grows: o(t) = o₀ + r t. Least squares over blocks of 1.5 s give r, with o₀
free in every joint and r in one; dry friction is taken out block by block. The uncertainty of r follows from the
residuals of the blocks (White's sandwich estimator). Both halves of the span must agree, otherwise it was a step. A
motor that fades as it warms up competes as an explanation, so it is not taken for a drift. Where gravity does not
change with a joint (K = 0: an upright axis, or a first joint that carries little) no drift can be found.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import cycle
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

BLOCK = 50
"""Rows of a block, 1.5 s."""
SPANS = (20, 40, 80)
"""Blocks that are evaluated together: half a minute, one minute, two minutes."""
SURE = 9.0
"""Standard deviations: with 16 degrees of freedom two false alarms in ten million, and there are 10⁵ evaluations an
hour."""
SLOW = (3e-4, 3e-3)
"""rad/s: rates that count as a drift. A faster one would show within seconds."""
HALVES = 2.0
"""Factor by which the rates of a span's halves may differ."""
CLEAR = 0.1
"""Share of the best explanation's squares that the next one, a joint or a fading motor, must lack."""
PART = 0.5
"""Share of a fault's gain that a drift must explain to compete with it: blocks leave out fingers in contact."""
_TINY = 1e-12


class DriftRamp(NamedTuple):
    """Fitted ramps of one finger's candidates: its joints' encoders, then its motors. (2m,) each."""

    rate: Vector
    """rad/s; for motors, shares per second."""
    gain: Vector
    """Sum of squares that the ramp explains, N²m²."""
    sure: Vector
    """Standard deviations from zero."""


class DriftBlock(NamedTuple):
    """A block after dry friction is taken out: products of the shapes x with each other and with d."""

    squares: Array
    """Products of the encoders' and motors' shapes, (2n, 2n)."""
    along: Vector
    """(2n,)"""
    heavy: Array
    """Products of the payloads' shapes: with themselves, and with d, (2, n)."""


class DriftDetector:
    """Collects blocks of rows and evaluates them. `period`: of a row, s."""

    def __init__(self, spec: HandSpec, period: float) -> None:
        self._fingers = [list(finger.joints) for finger in spec.fingers]
        self._columns = [[*own, *(spec.n_joints + k for k in own)] for own in self._fingers]
        self._period, self._n = period, spec.n_joints
        self._turns = cycle([(finger, span) for finger in range(len(spec.fingers)) for span in SPANS])
        self._before = np.zeros((2, spec.n_joints))
        self._blocks: deque[DriftBlock] = deque(maxlen=SPANS[-1])
        self._clear()

    def add(self, d: Vector, made: Array, tells: NDArray[np.bool_], lean: Array, pull: Array) -> None:
        """Add a row. `d`: disturbances, (n,), N·m; `made`: the motors' torques and the sides of friction, (2, n);
        `tells`: joints that move on a finger without contact; `lean`: derivative of gravity's torques by the joints,
        (n, n), N·m/rad; `pull`: torque on each joint of a kilogram at each link, (n, n), N·m."""
        torque, side = np.where(
            tells, (2.0 * made + self._before) / 3.0, 0.0
        )  # A disturbance follows its cause with a delay.
        self._before = made
        shapes = np.concatenate([-lean * tells[:, None], np.diag(-torque)], axis=1)
        self._squares += shapes.T @ shapes
        self._along += d @ shapes
        self._rubbed += side[:, None] * shapes
        self._rub += side * side
        self._rub_along += side * d
        carried = pull * tells
        self._heavy += np.square(carried).sum(axis=1), carried @ d
        self._heavy_rubbed += carried * side
        self._rows += 1
        if self._rows == BLOCK:
            self._blocks.append(self._reduce())
            self._clear()

    def forget(self, own: Sequence[int]) -> None:
        """Forget what was seen of some joints: their model has changed."""
        own = list(own)
        both = [*own, *(self._n + k for k in own)]
        for each in self._blocks:
            each.squares[both] = each.squares[:, both] = each.along[both] = each.heavy[:, own] = 0.0
        self._squares[both] = self._squares[:, both] = self._along[both] = self._heavy[:, own] = 0.0
        self._rubbed[own] = self._rubbed[:, both] = 0.0
        self._rub[own] = self._rub_along[own] = self._heavy_rubbed[own] = self._heavy_rubbed[:, own] = 0.0

    def check(self) -> tuple[int, float] | None:
        """The joint whose encoder drifts, and its rate, rad/s; None where nothing is certain. Each call evaluates one
        finger and one span: all of them together would take longer than a period."""
        finger, span = next(self._turns)
        if span > len(self._blocks):
            return None
        own, columns, blocks = self._fingers[finger], self._columns[finger], list(self._blocks)[-span:]
        cut = np.ix_(columns, columns)
        squares = np.array([each.squares[cut] for each in blocks])
        along = np.array([each.along[columns] for each in blocks])
        ramp, m = self._ramp(squares, along), len(own)
        slow = np.abs(ramp.rate[:m])
        can = np.concatenate([(slow > SLOW[0]) & (slow < SLOW[1]), np.ones(m, dtype=bool)])
        gain = np.where(can, ramp.gain, 0.0)
        first, second = np.argsort(-gain)[:2]
        if first >= m or ramp.sure[first] < SURE or gain[second] > (1.0 - CLEAR) * gain[first]:
            return None
        halves = (slice(span // 2), slice(span // 2, None))
        shares = [self._ramp(squares[half], along[half]).rate[first] / ramp.rate[first] for half in halves]
        steady = min(shares) > 1.0 / HALVES and max(shares) < HALVES
        return (own[first], float(ramp.rate[first])) if steady else None

    def explains_more(self, name: str, joint: int, gain: float) -> bool:
        """Whether a drift of an encoder of this joint's finger, begun at any time, explains the data better than a
        fault of this name that came at any time, and also a good part of the fault's `gain`, N²m², in the last seconds.
        Blocks contain nothing that friction explains: for friction the gain alone counts."""
        blocks, n = [*self._blocks, self._reduce()], self._n
        own = next(own for own in self._fingers if joint in own)
        ages = np.arange(len(blocks))
        since = np.maximum(ages[None, :] - ages[:, None] + 0.5, 0.0)  # (begun, b), blocks
        squares = np.array([each.squares[own, own] for each in blocks])  # (b, m)
        along = np.array([each.along[own] for each in blocks])
        drifts = _explained_squares(since * BLOCK * self._period, squares, along, SLOW[1])
        if name == "friction" or drifts < PART * gain:
            return drifts > gain
        came = np.array([each.heavy[:, joint] for each in blocks])
        if name == "weak":
            came = np.array([(each.squares[n + joint, n + joint], each.along[n + joint]) for each in blocks])
        steps = np.concatenate([np.minimum(since, 1.0), np.sign(since)])
        return drifts > _explained_squares(steps, came[:, :1], came[:, 1:], np.inf)

    def _ramp(self, squares: Array, along: Array) -> DriftRamp:
        """Fit blocks (b, 2m, 2m) and (b, 2m): o₀ free in all, r in one at a time."""
        b = len(squares)
        t = (np.arange(b) - (b - 1) / 2.0) * BLOCK * self._period
        s0, s1, s2 = squares.sum(axis=0), np.tensordot(t, squares, 1), np.tensordot(t * t, squares, 1)
        a0, a1 = along.sum(axis=0), t @ along
        back = s1 @ np.linalg.pinv(s0, rcond=1e-9, hermitian=True)
        size = np.maximum((s2 - back @ s1).diagonal(), _TINY)
        rate = (a1 - back @ a0) / size
        start = np.linalg.pinv(s0, rcond=1e-9, hermitian=True) @ (a0[:, None] - s1 * rate)  # (2m, candidate)
        left = along[:, :, None] - np.einsum("bkl,lc->bkc", squares, start)
        left -= t[:, None, None] * squares * rate
        scores = t[:, None] * np.einsum("bcc->bc", left) - np.einsum("bkc,ck->bc", left, back)
        spread = np.sqrt(np.square(scores).sum(axis=0) * b / (b - along.shape[1] / 2.0 - 1.0))
        return DriftRamp(rate, np.square(rate) * size, np.abs(rate) * size / np.maximum(spread, _TINY))

    def _reduce(self) -> DriftBlock:
        """The unfinished block, after dry friction is taken out."""
        rub = np.maximum(self._rub, _TINY)
        squares = self._squares - self._rubbed.T @ (self._rubbed / rub[:, None])
        sides = np.stack([self._heavy_rubbed, np.broadcast_to(self._rub_along, self._heavy_rubbed.shape)])
        heavy = self._heavy - (sides * self._heavy_rubbed / rub).sum(axis=2)
        return DriftBlock(squares, self._along - (self._rub_along / rub) @ self._rubbed, heavy)

    def _clear(self) -> None:
        n = self._n
        self._rows, self._squares, self._along = 0, np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
        self._rubbed, self._rub, self._rub_along = np.zeros((n, 2 * n)), np.zeros(n), np.zeros(n)
        self._heavy, self._heavy_rubbed = np.zeros((2, n)), np.zeros((n, n))


def _explained_squares(course: Array, squares: Array, along: Array, most: float) -> float:
    """Sum of squares that the best of some time courses (c, b) explains of blocks (b, m), with an amount of at most
    `most`, N²m²."""
    size = np.maximum(np.square(course) @ squares, _TINY)
    amount = np.clip((course @ along) / size, -most, most)
    return float((amount * (2.0 * (course @ along) - amount * size)).max())
