"""Between the simulation and the policy's law: what a hand measures, and what its motors make of a command."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from allegro_twin.learning.environments.random_streams import Draws, jitter
from allegro_twin.learning.environments.randomise import LONGEST_DELAY, Randomise
from allegro_twin.sim.batch.cpu import Rows, SimBatch
from allegro_twin.types import Array


class Sensing:
    """Noise, quantisation and delays of `n` hands; whatever no range asks for costs nothing."""

    def __init__(self, settings: Randomise, worlds: SimBatch) -> None:
        n, joints = worlds.position.shape
        self._worlds, self._xp = worlds, worlds.xp
        xp = worlds.xp
        self._key = xp.zeros(n, np.uint64)
        self._noise = {
            name: xp.zeros((n, 1))
            for name in ("encoder_noise", "velocity_noise", "quantisation")
            if getattr(settings, name) is not None
        }
        # Where the hand closes the loop, both are the motors' own: `randomise` writes them into the models.
        self._strength = None if settings.strength is None or worlds.closes_loop else xp.ones((n, 1))
        self._gains = None if settings.gains is None or worlds.closes_loop else xp.ones((n, 2))
        self._late = {
            name: xp.zeros(n, np.int64)
            for name in ("sensor_delay", "actuator_delay")
            if getattr(settings, name) is not None
        }
        self._past = {name: xp.zeros((LONGEST_DELAY + 1, n, 2 * joints)) for name in self._late}
        self.ideal = not self._noise and not self._late and self._strength is None
        """Measurements are exact and at once, and so are torques."""
        self._limit = xp.asarray(worlds.spec.actuation.torque_limit)
        self._own = xp.arange(n)

    def begin(self, rows: Rows, values: dict[str, Array], draws: Draws) -> None:
        """A new episode of some hands: `values` as they were drawn, (m,) each."""
        self._key[rows] = draws.key()
        for name, own in self._noise.items():
            own[rows, 0] = values[name]
        if self._strength is not None:
            self._strength[rows, 0] = values["strength"]
        if self._gains is not None:
            self._gains[rows] = values["gains"]
        for name, late in self._late.items():
            late[rows] = self._xp.asarray(values[name], np.int64)
            self._past[name][:, rows] = 0.0
        if "sensor_delay" in self._past:
            here = self._xp.concatenate([self._worlds.position[rows], self._worlds.velocity[rows]], axis=-1)
            self._past["sensor_delay"][:, rows] = here
        if "actuator_delay" in self._past and self._worlds.closes_loop:
            here = self._worlds.position[rows]  # Until the first word arrives it stays where it is.
            self._past["actuator_delay"][:, rows] = self._xp.concatenate([here, 0.0 * here], axis=-1)

    def measured(self, tick: NDArray[np.int64]) -> tuple[Array, Array]:
        """Joint positions and speeds as the hands report them at their periods `tick` (n,), each (n, joints)."""
        position, velocity = self._worlds.position, self._worlds.velocity
        if self.ideal:
            return position, velocity
        joints, xp = position.shape[1], self._xp
        if (late := self._late.get("sensor_delay")) is not None:
            both = self._delayed("sensor_delay", late, xp.concatenate([position, velocity], axis=-1), tick)
            position, velocity = both[:, :joints], both[:, joints:]
        if (width := self._noise.get("encoder_noise")) is not None:
            position = position + width * jitter(self._key, tick, 0, joints)
        if (step := self._noise.get("quantisation")) is not None:
            position = xp.where(step > 0, step * xp.rint(position / xp.where(step > 0, step, 1.0)), position)
        if (width := self._noise.get("velocity_noise")) is not None:
            velocity = velocity + width * jitter(self._key, tick, 1, joints)
        return position, velocity

    def gains(self, nominal: Array) -> Array:
        """The law's gains, kp and kd (2, 1, joints), as these hands have them, (2, n, joints) where they differ."""
        return nominal if self._gains is None else nominal * self._gains.T[:, :, None]

    def drive(self, told: Array, tick: NDArray[np.int64]) -> None:
        """Tell the motors torques, N·m, or where the hand closes the loop positions, rad, (n, joints)."""
        if (late := self._late.get("actuator_delay")) is not None:
            joints = told.shape[1]
            padded = self._xp.concatenate([told, 0.0 * told], axis=-1)
            told = self._delayed("actuator_delay", late, padded, tick)[:, :joints]
        if self._strength is not None:
            told = self._xp.clip(told, -self._limit, self._limit) * self._strength
        self._worlds.command(told)

    def _delayed(self, name: str, late: NDArray[np.int64], now: Array, tick: NDArray[np.int64]) -> Array:
        """What was `late` periods ago, from a ring with one place a period."""
        past, own = self._past[name], self._own
        past[tick % len(past), own] = now
        found: Array = past[(tick - late) % len(past), own]
        return found
