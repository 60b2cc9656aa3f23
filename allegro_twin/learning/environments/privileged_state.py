"""What only the simulation knows, for a critic that sees more than the policy that it teaches (Pinto et al. 2018)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from allegro_twin.learning.policy.interface import BOUND, SPEED, Floats
from allegro_twin.learning.tasks.vectors import turned
from allegro_twin.sim.batch.cpu import FreeBody, Rows, SimBatch
from allegro_twin.types import Array

FACTORS = ("mass", "size", "friction")
"""What an episode has drawn of these; 1, 1 and 0.8 where nothing was."""
_USUAL = {"mass": 1.0, "size": 1.0, "friction": 0.8}
_PLACE, _FAST, _SPINS = 0.1, 0.5, 5.0
"""m, m/s and rad/s by which an object's numbers are divided, to be of order 1."""


class State:
    """Of `n` hands. In order: the joints' positions (±1 at their limits), speeds (by 5 rad/s), the torques of their
    motors and those from outside (by the limit), as they are; and where there is an object, in the world's axes, where
    it is (by 0.1 m), its quaternion, velocity (by 0.5 m/s) and spin (by 5 rad/s), and `FACTORS`."""

    def __init__(self, worlds: SimBatch, thing: FreeBody | None) -> None:
        self._worlds, self._thing = worlds, thing
        spec, self._xp = worlds.spec, worlds.xp
        place = worlds.xp.asarray
        self._middle, self._half = place((spec.lower + spec.upper) / 2), place((spec.upper - spec.lower) / 2)
        self._limit = place(spec.actuation.torque_limit)
        self._factors = place(np.tile([_USUAL[name] for name in FACTORS], (worlds.n, 1)))
        self.size = 4 * spec.n_joints + (0 if thing is None else 13 + len(FACTORS))
        """Numbers of one hand."""

    def begin(self, rows: Rows, values: dict[str, Array]) -> None:
        """A new episode of some hands, with what was drawn for it, (m, …) each."""
        for column, name in enumerate(FACTORS):
            self._factors[rows, column] = values.get(name, _USUAL[name])

    def __call__(self, tick: NDArray[np.int64]) -> Floats:
        """Now, (n, size), `tick` (n,) periods after the beginning; zeros for a simulation that has diverged."""
        worlds, begun, xp = self._worlds, tick[:, None] > 0, self._xp
        parts = [
            (worlds.position - self._middle) / self._half,
            worlds.velocity / SPEED,
            xp.where(begun, worlds.applied_torque, 0.0) / self._limit,
            xp.where(begun, worlds.external_torque, 0.0) / self._limit,
        ]
        if (thing := self._thing) is not None:
            pose, spin = thing.pose, turned(thing.pose[:, 3:], thing.spin)
            parts += [pose[:, :3] / _PLACE, pose[:, 3:], thing.velocity / _FAST, spin / _SPINS, self._factors]
        whole = xp.clip(xp.nan_to_num(xp.concatenate(parts, axis=-1)), -BOUND, BOUND)
        return xp.asarray(whole, np.float32)  # type: ignore[no-any-return]
