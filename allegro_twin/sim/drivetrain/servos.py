"""The actuators of a hand in its simulations: what they are told, where they go, and how much they may give."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

_UNLIMITED = 1e6  # N·m. More than any servo of a hand can ask for.
Rows: TypeAlias = NDArray[np.int64]
ONE: Rows = np.zeros(1, dtype=np.int64)
"""The row of a simulation alone."""


class Servos:
    """Motors whose firmware closes the loop: an actuator with a spring to where it is told to go, on a joint or on a
    tendon. Positions are those of the actuator, its length in MuJoCo's words: rad, or m. One simulation, or many side
    by side, a row each.

    Until the first command of a session, and after one without effort, they give nothing.
    """

    def __init__(self, spec: HandSpec, models: Sequence[mujoco.MjModel], period: float) -> None:
        self._models, self._period, n = list(models), period, len(models)
        self._ids = ids = np.array([models[0].actuator(name).id for name in spec.joints])
        self._offset, self._slope = map(np.array, zip(*(control_map(model, ids) for model in models), strict=True))
        self._limit = _in_simulation(spec.actuation.torque_limit)
        self._range = np.array([model.actuator_forcerange[ids] for model in models])
        self._share = np.ones((n, len(ids)))
        self._wish, self._from = np.zeros((2, n, len(ids)))
        self._ticks, self._passed = np.zeros((2, n), dtype=np.int64)

    def reset(self, rows: Rows, position: Array) -> None:
        """Where they are, (rows, n), limp already."""
        self._wish[rows] = self._from[rows] = position
        self._ticks[rows] = 0

    def limp(self, rows: Rows) -> bool:
        """Nothing is given from now on; whether that is news to a model."""
        return self._let(rows, np.zeros((len(rows), len(self._ids))))

    def command(self, rows: Rows, position: Array, effort: Array | None, duration: Array | float) -> bool:
        """From the next period on, (rows, n); durations (rows,), s. Whether a model has changed."""
        self._from[rows] = self._now(rows)
        self._wish[rows], self._passed[rows] = position, 0
        self._ticks[rows] = np.rint(np.asarray(duration) / self._period)
        most = np.tile(self._limit, (len(rows), 1)) if effort is None else np.minimum(effort, self._limit)
        return self._let(rows, most / self._limit)

    def copy(self, rows: Rows, of: Rows) -> bool:
        """Make some what others are, (rows,) each. Whether a model has changed."""
        for kept in self._memory():
            kept[rows] = kept[of]
        return self._let(rows, self._share[of])

    def save(self) -> tuple[Any, ...]:
        """Copy of the state that decides how they go on."""
        return tuple(kept.copy() for kept in (*self._memory(), self._share))

    def restore(self, state: tuple[Any, ...]) -> None:
        """Go on from what `save` returned."""
        *memory, share = state
        for kept, saved in zip(self._memory(), memory, strict=True):
            kept[:] = saved
        self._let(np.arange(len(self._models)), share)

    def commands(self, rows: Rows) -> Array:
        """Before a period: what they are told so that they are where they should be at its end, (rows, n)."""
        self._passed[rows] += 1
        told: Array = self._offset[rows] + self._slope[rows] * self._now(rows)
        return told

    @contextmanager
    def able(self) -> Iterator[None]:
        """With all that they can give, for who asks what the models are."""
        rows, now = np.arange(len(self._models)), self._share.copy()
        self._let(rows, np.ones_like(now))
        yield
        self._let(rows, now)

    def _memory(self) -> tuple[NDArray[Any], ...]:
        """Live arrays, a row each: all but the share of the force."""
        return self._wish, self._from, self._ticks, self._passed

    def _now(self, rows: Rows) -> Array:
        """Where the way of a timed command has led; its end for any other."""
        begin, wish = self._from[rows], self._wish[rows]
        ticks, passed = self._ticks[rows], self._passed[rows]
        if not ticks.any():
            return wish
        part = passed / np.maximum(ticks, 1)
        return np.where((passed >= ticks)[:, None], wish, begin + (wish - begin) * part[:, None])

    def _let(self, rows: Rows, share: Array) -> bool:
        """What share of its force each motor may give, (rows, n)."""
        news = rows[(share != self._share[rows]).any(axis=1)]
        self._share[rows] = share
        for row in news.tolist():
            self._models[row].actuator_forcerange[self._ids] = self._range[row] * self._share[row, :, None]
        return len(news) > 0


def control_map(model: mujoco.MjModel, motors: slice | list[int] | NDArray[np.int64]) -> tuple[Array, Array]:
    """Offset and slope, (n,) each, from where actuators with a spring are to rest to what they are told:
    force = gain u + b0 + b1 l + b2 dl/dt is zero at rest where u = - (b0 + b1 l) / gain."""
    bias, gain = model.actuator_biasprm[motors], model.actuator_gainprm[motors, 0]
    return -bias[:, 0] / gain, -bias[:, 1] / gain


def limit_forces(model: mujoco.MjModel, spec: HandSpec) -> None:
    """Give no motor of a compiled scene more force than its hand says, whatever its file lets it have."""
    ids = np.array([model.actuator(name).id for name in spec.joints])
    limit = _in_simulation(spec.actuation.torque_limit)[:, None]
    limited = model.actuator_forcelimited[ids].astype(bool)[:, None]
    own = np.where(limited, model.actuator_forcerange[ids], limit * [-1.0, 1.0])
    model.actuator_forcerange[ids] = np.clip(own, -limit, limit)
    model.actuator_forcelimited[ids] = True


def _in_simulation(limit: Vector) -> Vector:
    """Limits with a number for those that are unknown, N·m, so that they can be scaled to zero."""
    return np.where(np.isinf(limit), _UNLIMITED, limit)
