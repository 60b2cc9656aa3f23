"""Contact from torque and position alone: a finger that is pushed and does not move has met something."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array


class Stall(NamedTuple):
    """How long each finger has been pushed without moving, shape (k,), s."""

    seconds: Array

    @property
    def begun(self) -> bool:
        return bool((self.seconds > 0).any())


def stalling(
    stall: Stall, velocity: Array, torque: Array, dt: float, *, still: float = 0.05, push: float = 0.05
) -> Stall:
    """Update of the stall times. `velocity`, `torque`: the joints of each finger, (k, j), rad/s and N·m.

    A finger counts as pushed when some joint is given more than `push` beyond what moves it freely, and as still when
    no joint is faster than `still`; anything else begins its time anew.
    """
    blocked = (np.abs(velocity).max(axis=-1) < still) & (np.abs(torque).max(axis=-1) > push)
    return Stall(np.where(blocked, stall.seconds + dt, 0.0))


def touching(stall: Stall, after: float = 0.06) -> NDArray[np.bool_]:
    """Which fingers are in contact, shape (k,), bool: stalled for at least `after` seconds."""
    return stall.seconds >= after
