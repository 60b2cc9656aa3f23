"""What a camera would tell of an object: its pose and its motion, late and with noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import library
from allegro_twin.kinematics.orientation import turned_by
from allegro_twin.learning.environments.random_streams import Draws, jitter
from allegro_twin.learning.environments.randomise import LONGEST_DELAY, Randomise
from allegro_twin.learning.tasks.vectors import turned
from allegro_twin.sim.batch.cpu import FreeBody, Rows
from allegro_twin.types import Array


class Seen(NamedTuple):
    """Of an object, all in the world's axes."""

    position: Array
    """(n, 3), m."""
    quaternion: Array
    """(n, 4)."""
    velocity: Array
    """(n, 3), m/s."""
    spin: Array
    """(n, 3), rad/s."""


class Camera:
    """Looks at a body of `n` simulations once a decision. Noise is drawn anew in each picture; a picture is late by
    whole decisions. Speeds come from elsewhere and are late only."""

    def __init__(self, settings: Randomise, body: FreeBody, decimation: int) -> None:
        n, xp = len(body.pose), library(body.pose)
        self._body, self._decimation, self._xp = body, decimation, xp
        self._key, self._own = xp.zeros(n, np.uint64), xp.arange(n)
        self._noise = {
            name: xp.zeros((n, 1)) for name in ("camera_shift", "camera_turn") if getattr(settings, name) is not None
        }
        self._late = None if settings.camera_delay is None else xp.zeros(n, np.int64)
        self._past = xp.zeros((LONGEST_DELAY + 1, n, 13))

    def begin(self, rows: Rows, values: dict[str, Array], draws: Draws) -> None:
        """A new episode of some simulations: `values` as they were drawn, (m,) each."""
        if self._noise:
            self._key[rows] = draws.key()
        for name, own in self._noise.items():
            own[rows, 0] = values[name]
        if self._late is not None:
            self._late[rows] = self._xp.asarray(values["camera_delay"], np.int64)
            self._past[:, rows] = self._now()[rows]

    def look(self, tick: NDArray[np.int64]) -> Seen:
        """The picture at the decision `tick` (n,) periods after the beginning."""
        shown, picture = self._now(), tick // self._decimation
        if self._late is not None:
            self._past[picture % len(self._past), self._own] = shown
            shown = self._past[(picture - self._late) % len(self._past), self._own]
        position, quaternion, velocity, spin = shown[:, :3], shown[:, 3:7], shown[:, 7:10], shown[:, 10:]
        if (width := self._noise.get("camera_shift")) is not None:
            position = position + width * jitter(self._key, picture, 8, 3)
        if (width := self._noise.get("camera_turn")) is not None:
            quaternion = turned_by(quaternion, width * jitter(self._key, picture, 9, 3))
        return Seen(position, quaternion, velocity, spin)

    def _now(self) -> Array:
        body = self._body
        now: Array = self._xp.concatenate([body.pose, body.velocity, turned(body.pose[:, 3:], body.spin)], axis=-1)
        return now
