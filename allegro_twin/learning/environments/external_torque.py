"""What contact does to the joints: the external torque that a hand's twin estimates beside it (docs/mirror.md)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from allegro_twin.learning.environments.random_streams import Draws, jitter
from allegro_twin.learning.environments.randomise import Randomise
from allegro_twin.sim.batch.cpu import Rows, SimBatch
from allegro_twin.types import Array


class Touch:
    """Of `n` hands; with the dry friction of their joints, which nobody can tell from a contact in one moment."""

    def __init__(self, settings: Randomise, worlds: SimBatch) -> None:
        self._worlds = worlds
        self._xp, self._limit = worlds.xp, worlds.xp.asarray(worlds.spec.actuation.torque_limit)
        self._range = settings.touch_noise
        self._noise = None if settings.touch_noise is None else worlds.xp.zeros((worlds.n, 1))
        self._key = worlds.xp.zeros(worlds.n, np.uint64)

    def begin(self, rows: Rows, values: dict[str, Array], draws: Draws) -> None:
        """A new episode of some hands; what is drawn joins `values`, (m,)."""
        if self._noise is not None and self._range is not None:
            self._key[rows] = draws.key()
            self._noise[rows] = draws.within(*self._range)
            values["touch_noise"] = self._noise[rows, 0]

    def felt(self, tick: NDArray[np.int64]) -> Array:
        """In parts of the torque limit, (n, joints), at the hands' periods `tick` (n,); before the first one nothing
        has been felt."""
        torque = self._xp.where(tick[:, None] > 0, self._worlds.external_torque, 0.0)
        if self._noise is not None:
            torque = torque + self._noise * jitter(self._key, tick, 10, torque.shape[1])
        share: Array = torque / self._limit
        return share
