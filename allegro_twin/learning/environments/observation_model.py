"""Observation model: joint signals with noise and delay, external torques, object pose from a camera, privileged
state."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import array_namespace
from allegro_twin.kinematics.orientation import rotate_quaternion
from allegro_twin.learning.environments.posterior import RandomDrive
from allegro_twin.learning.environments.random_streams import Draws, jitter
from allegro_twin.learning.environments.randomise import LONGEST_DELAY, Randomise
from allegro_twin.learning.policy.interface import BOUND, SPEED, Floats
from allegro_twin.learning.tasks.vectors import rotate_vectors
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.shared_model import FreeBody, SharedModelBatch
from allegro_twin.types import Array


class SignalModel:
    """Noise, quantisation and delays of the joint signals and commands of `n` hands. Ranges that are not set cost
    nothing."""

    def __init__(self, settings: Randomise, worlds: SharedModelBatch, drive: RandomDrive | None = None) -> None:
        n, joints = worlds.position.shape
        self._drive = drive
        self._worlds, self._xp = worlds, worlds.xp
        xp = worlds.xp
        self._key = xp.zeros(n, np.uint64)
        self._noise = {
            name: xp.zeros((n, 1))
            for name in ("encoder_noise", "velocity_noise", "quantisation")
            if getattr(settings, name) is not None
        }
        # Where the hand closes the loop, both belong to its motors: `randomise` writes them into the models.
        self._strength = None if settings.strength is None or worlds.closes_loop else xp.ones((n, 1))
        self._gains = None if settings.gains is None or worlds.closes_loop else xp.ones((n, 2))
        self._late = {
            name: xp.zeros(n, np.int64)
            for name in ("sensor_delay", "actuator_delay")
            if getattr(settings, name) is not None
        }
        self._past = {name: xp.zeros((LONGEST_DELAY + 1, n, 2 * joints)) for name in self._late}
        self.ideal = not self._noise and not self._late and self._strength is None and drive is None
        """Measurements and torques are exact and without delay."""
        self._limit = xp.asarray(worlds.spec.actuation.torque_limit)
        self._own = xp.arange(n)

    def begin(self, rows: Rows, values: dict[str, Array], draws: Draws) -> None:
        """Begin new episodes of some hands, with randomised `values`, (m,) each."""
        self._key[rows] = draws.keys()
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
            here = self._worlds.position[rows]  # Until the first command arrives the hand stays where it is.
            self._past["actuator_delay"][:, rows] = self._xp.concatenate([here, 0.0 * here], axis=-1)

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """What an episode changes, by name."""
        drawn = {"strength": self._strength, "gains": self._gains}
        return {
            "key": self._key,
            **{name: own for name, own in drawn.items() if own is not None},
            **self._noise,
            **self._late,
            **{f"past/{name}": own for name, own in self._past.items()},
        }

    def measure(self, tick: NDArray[np.int64]) -> tuple[Array, Array]:
        """Joint positions and speeds as the hands report them at their periods `tick` (n,), each (n, joints)."""
        position, velocity = self._worlds.position, self._worlds.velocity
        if self.ideal:
            return position, velocity
        joints, xp = position.shape[1], self._xp
        if (delay := self._late.get("sensor_delay")) is not None:
            both = self._delay("sensor_delay", delay, xp.concatenate([position, velocity], axis=-1), tick)
            position, velocity = both[:, :joints], both[:, joints:]
        if self._drive is not None:
            position = self._drive.report(position, tick)
        if (width := self._noise.get("encoder_noise")) is not None:
            position = position + width * jitter(self._key, tick, 0, joints)
        if (step := self._noise.get("quantisation")) is not None:
            position = xp.where(step > 0, step * xp.rint(position / xp.where(step > 0, step, 1.0)), position)
        if (width := self._noise.get("velocity_noise")) is not None:
            velocity = velocity + width * jitter(self._key, tick, 1, joints)
        return position, velocity

    def gains(self, nominal: Array) -> Array:
        """The gains kp and kd of these hands, (2, n, joints) where they differ, from the nominal ones, (2, 1,
        joints)."""
        return nominal if self._gains is None else nominal * self._gains.T[:, :, None]

    def send(self, command: Array, tick: NDArray[np.int64]) -> None:
        """Send torques, N·m, or for hands that close their own loop positions, rad, (n, joints)."""
        if (late := self._late.get("actuator_delay")) is not None:
            joints = command.shape[1]
            padded = self._xp.concatenate([command, 0.0 * command], axis=-1)
            command = self._delay("actuator_delay", late, padded, tick)[:, :joints]
        if self._drive is not None:
            command = self._drive.act(command, tick)
        if self._strength is not None:
            command = self._xp.clip(command, -self._limit, self._limit) * self._strength
        self._worlds.command(command)

    def _delay(self, name: str, late: NDArray[np.int64], now: Array, tick: NDArray[np.int64]) -> Array:
        """Values from `late` periods ago, from a ring buffer with one place per period."""
        past, own = self._past[name], self._own
        past[tick % len(past), own] = now
        found: Array = past[(tick - late) % len(past), own]
        return found


class ExternalTorque:
    """External torque on the joints of `n` hands, as a mirror beside a hand estimates it
    (docs/explanation/mirror.md). It includes the joints' dry friction, which looks like a contact at one moment."""

    def __init__(self, settings: Randomise, worlds: SharedModelBatch) -> None:
        self._worlds = worlds
        self._xp, self._limit = worlds.xp, worlds.xp.asarray(worlds.spec.actuation.torque_limit)
        self._range = settings.touch_noise
        self._noise = None if settings.touch_noise is None else worlds.xp.zeros((worlds.n, 1))
        self._key = worlds.xp.zeros(worlds.n, np.uint64)

    def begin(self, rows: Rows, values: dict[str, Array], draws: Draws) -> None:
        """Begin new episodes of some hands; the drawn noise joins `values`, (m,)."""
        if self._noise is not None and self._range is not None:
            self._key[rows] = draws.keys()
            self._noise[rows] = draws.uniform(*self._range)
            values["touch_noise"] = self._noise[rows, 0]

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """What an episode changes, by name."""
        return {"key": self._key} | ({} if self._noise is None else {"noise": self._noise})

    def observe(self, tick: NDArray[np.int64]) -> Array:
        """Shares of the torque limit, (n, joints), at the hands' periods `tick` (n,); zeros before the first period."""
        torque = self._xp.where(tick[:, None] > 0, self._worlds.external_torque, 0.0)
        if self._noise is not None:
            torque = torque + self._noise * jitter(self._key, tick, 10, torque.shape[1])
        share: Array = torque / self._limit
        return share


FACTORS = ("mass", "size", "friction")
"""Randomised factors; 1, 1 and 0.8 where none was drawn."""
_USUAL = {"mass": 1.0, "size": 1.0, "friction": 0.8}
_PLACE, _FAST, _SPINS = 0.1, 0.5, 5.0
"""m, m/s and rad/s: scales of an object's numbers."""


class PrivilegedState:
    """State that only the simulation knows, for a critic that sees more than its policy (Pinto et al. 2018). 2018).

    For each of `n` hands, in this order: joint positions (±1 at their limits), speeds (by 5 rad/s), motor torques and
    external torques (by the limit). With an object, in world axes: its position (by 0.1 m), quaternion, velocity (by
    0.5 m/s), angular velocity (by 5 rad/s), and `FACTORS`.
    """

    def __init__(self, worlds: SharedModelBatch, object_body: FreeBody | None) -> None:
        self._worlds, self._object_body = worlds, object_body
        spec, self._xp = worlds.spec, worlds.xp
        place = worlds.xp.asarray
        self._middle, self._half = place((spec.lower + spec.upper) / 2), place((spec.upper - spec.lower) / 2)
        self._limit = place(spec.actuation.torque_limit)
        self._factors = place(np.tile([_USUAL[name] for name in FACTORS], (worlds.n, 1)))
        self.size = 4 * spec.n_joints + (0 if object_body is None else 13 + len(FACTORS))
        """Numbers per hand."""

    def begin(self, rows: Rows, values: dict[str, Array]) -> None:
        """Begin new episodes of some hands, with randomised values, (m, …) each."""
        for column, name in enumerate(FACTORS):
            self._factors[rows, column] = values.get(name, _USUAL[name])

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """What an episode changes, by name."""
        return {"factors": self._factors}

    def __call__(self, tick: NDArray[np.int64]) -> Floats:
        """The state now, (n, size), `tick` (n,) periods after the beginning; zeros for a simulation that has
        diverged."""
        worlds, begun, xp = self._worlds, tick[:, None] > 0, self._xp
        parts = [
            (worlds.position - self._middle) / self._half,
            worlds.velocity / SPEED,
            xp.where(begun, worlds.applied_torque, 0.0) / self._limit,
            xp.where(begun, worlds.external_torque, 0.0) / self._limit,
        ]
        if (object_body := self._object_body) is not None:
            pose, spin = object_body.pose, rotate_vectors(object_body.pose[:, 3:], object_body.spin)
            parts += [pose[:, :3] / _PLACE, pose[:, 3:], object_body.velocity / _FAST, spin / _SPINS, self._factors]
        whole = xp.clip(xp.nan_to_num(xp.concatenate(parts, axis=-1)), -BOUND, BOUND)
        return xp.asarray(whole, np.float32)  # type: ignore[no-any-return]


class ObjectObservation(NamedTuple):
    """Pose and motion of an object as observed, in world axes."""

    position: Array
    """(n, 3), m."""
    quaternion: Array
    """(n, 4)."""
    velocity: Array
    """(n, 3), m/s."""
    spin: Array
    """Angular velocity, (n, 3), rad/s."""


class ObjectCamera:
    """Observes a body in `n` simulations once per decision. Noise is drawn anew in each picture; a picture is late by
    whole decisions. Speeds have the delay, but no noise."""

    def __init__(self, settings: Randomise, body: FreeBody, decimation: int) -> None:
        n, xp = len(body.pose), array_namespace(body.pose)
        self._body, self._decimation, self._xp = body, decimation, xp
        self._key, self._own = xp.zeros(n, np.uint64), xp.arange(n)
        self._noise = {
            name: xp.zeros((n, 1)) for name in ("camera_shift", "camera_turn") if getattr(settings, name) is not None
        }
        self._late = None if settings.camera_delay is None else xp.zeros(n, np.int64)
        self._past = xp.zeros((LONGEST_DELAY + 1, n, 13))

    def begin(self, rows: Rows, values: dict[str, Array], draws: Draws) -> None:
        """Begin new episodes of some simulations, with randomised `values`, (m,) each."""
        if self._noise:
            self._key[rows] = draws.keys()
        for name, own in self._noise.items():
            own[rows, 0] = values[name]
        if self._late is not None:
            self._late[rows] = self._xp.asarray(values["camera_delay"], np.int64)
            self._past[:, rows] = self._now()[rows]

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """What an episode changes, by name."""
        late = {} if self._late is None else {"camera_delay": self._late, "past": self._past}
        return {"key": self._key, **self._noise, **late}

    def look(self, tick: NDArray[np.int64]) -> ObjectObservation:
        """The picture at the decision `tick` (n,) periods after the beginning."""
        shown, picture = self._now(), tick // self._decimation
        if self._late is not None:
            self._past[picture % len(self._past), self._own] = shown
            shown = self._past[(picture - self._late) % len(self._past), self._own]
        position, quaternion, velocity, spin = shown[:, :3], shown[:, 3:7], shown[:, 7:10], shown[:, 10:]
        if (width := self._noise.get("camera_shift")) is not None:
            position = position + width * jitter(self._key, picture, 8, 3)
        if (width := self._noise.get("camera_turn")) is not None:
            quaternion = rotate_quaternion(quaternion, width * jitter(self._key, picture, 9, 3))
        return ObjectObservation(position, quaternion, velocity, spin)

    def _now(self) -> Array:
        body = self._body
        now: Array = self._xp.concatenate(
            [body.pose, body.velocity, rotate_vectors(body.pose[:, 3:], body.spin)], axis=-1
        )
        return now
