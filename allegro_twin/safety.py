"""The guard: a backend in front of a backend, which limits what goes down and stops what comes up wrong."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allegro_twin.backend import HandBackend, PassThroughBackend, limp_of, position_of, torque_of
from allegro_twin.errors import ConfigError, HandError, HandFault, LinkTimeout, TooFast
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, PositionCommand, Sample, TorqueCommand, Vector

HISTORY = 500  # Samples: 1.5 s at 333 Hz.
SILENCE, PERIODS = 0.05, 10
"""s, and periods of the hand, whichever is longer, without a new time after which a hand counts as silent."""


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """Limits of the guard. Arrays have one value per joint, shape (n,).

    Raises ConfigError for a zone or speeds that are not positive, for soft stops in the wrong order, and unless the
    warm temperature is below the hot one.
    """

    torque: Vector
    """Ceiling, N·m."""
    velocity: Vector
    """Faster than this is a fault, rad/s."""
    lower: Vector
    """Soft stops, rad."""
    upper: Vector
    zone: float = 0.02
    """Before a soft stop a torque towards it fades over this stretch, rad."""
    warm: float = 60.0
    """From here on torque fades, °C."""
    hot: float = 75.0
    """Here it is zero, and a fault, °C."""
    rate: Vector | None = None
    """The fastest that a torque may change, N·m/s; None: at once."""
    speeds: Callable[[Vector], tuple[Vector, Vector]] | None = None
    """The fastest down, negative, and up where joints are at a position, (n,), rad/s; None: `velocity` anywhere."""

    def __post_init__(self) -> None:
        if not 0.0 < self.zone < math.inf:
            raise ConfigError(f"limits: zone {self.zone:g} rad: a torque fades over it, so it must be positive")
        if not self.warm < self.hot:
            raise ConfigError(f"limits: warm {self.warm:g} °C must be below hot {self.hot:g} °C: torque fades between")
        if not (self.velocity > 0.0).all():
            raise ConfigError(
                f"limits: velocity {np.min(self.velocity):g} rad/s stops every motion: it must be positive"
            )
        if not (self.lower <= self.upper).all():
            joint = int(np.argmin(self.lower <= self.upper))
            raise ConfigError(
                f"limits: joint {joint} has its lower soft stop {self.lower[joint]:g} rad above its upper one of "
                f"{self.upper[joint]:g} rad"
            )


def clamp(torque: Vector, state: HandState, limits: Limits) -> Vector:
    """What may be sent of a wanted torque, shape (n,), N·m: |τ| under the ceiling, fading to nothing towards a soft
    stop and from warm to hot. What a state does not report limits nothing."""
    limited = np.minimum(np.maximum(torque, -limits.torque), limits.torque)
    room = np.where(limited > 0.0, limits.upper - state.position, state.position - limits.lower)
    near = room < limits.zone
    if near.any():
        limited = np.where(near, limited * np.maximum(room, 0.0) / limits.zone, limited)
    if (state.temperature > limits.warm).any():
        fade = np.clip((limits.hot - state.temperature) / (limits.hot - limits.warm), 0.0, 1.0)
        limited = limited * np.where(np.isnan(fade), 1.0, fade)
    return limited


def no_faster(torque: Vector, before: Vector, most: Vector) -> Vector:
    """A torque that differs from the one before by no more than `most`, shape (n,), N·m."""
    return np.minimum(np.maximum(torque, before - most), before + most)


def bounded(command: PositionCommand, state: HandState, limits: Limits, spec: HandSpec) -> PositionCommand:
    """What may be sent of wanted positions: inside the soft stops; where the hand can limit efforts, under the ceiling
    and fading from warm to hot."""
    position = np.minimum(np.maximum(command.position, limits.lower), limits.upper)
    if "limited_position" not in spec.commands or command.limp:
        return PositionCommand(position, command.effort, command.duration)
    wanted = limits.torque if command.effort is None else np.minimum(command.effort, limits.torque)
    fade = np.clip((limits.hot - state.temperature) / (limits.hot - limits.warm), 0.0, 1.0)
    return PositionCommand(position, wanted * np.where(np.isnan(fade), 1.0, fade), command.duration)


def violation(state: HandState, limits: Limits, spec: HandSpec) -> HandFault | None:
    """Why the hand must stop now, or None; `TooFast` for a joint's speed."""
    if not np.isfinite(state.position).all():
        joint = int(np.isfinite(state.position).argmin())
        return HandFault(
            f"{spec.joint_labels[joint]} reports the position {state.position[joint]}: see to its encoder, or to the "
            "backend, which must report numbers"
        )
    fastest = limits.velocity
    if limits.speeds is not None:
        down, up = limits.speeds(state.position)
        fastest = np.where(state.velocity < 0.0, -down, up)
    if (np.abs(state.velocity) > fastest).any():
        joint = int(np.nanargmax(np.abs(state.velocity) / fastest))
        speed, limit = state.velocity[joint], fastest[joint]
        where = "" if limit == limits.velocity[joint] else f" at {state.position[joint]:.2f} rad"
        label = spec.joint_labels[joint]
        return TooFast(f"{label} moves at {speed:.2f} rad/s, over its limit of {limit:.2f} rad/s{where}")
    if (state.temperature >= limits.hot).any():
        joint = int(np.nanargmax(state.temperature))
        celsius = state.temperature[joint]
        return HandFault(f"{spec.joint_labels[joint]} is at {celsius:.0f} °C, over its limit of {limits.hot:.0f} °C")
    return None


def check_speed(peak: Vector, limits: Limits, spec: HandSpec, what: str, setting: str = "") -> None:
    """Raises ConfigError for a motion in which the joints reach speeds, (n,), rad/s, at which a guard stops them.
    `what` it is and the `setting` that the limits come from stand in the message."""
    share = limits.velocity / np.maximum(peak, 1e-12)
    joint = int(np.argmin(share))
    if share[joint] >= 1.0 - 1e-9:
        return
    unit = 10.0 ** (math.floor(math.log10(share[joint])) - 1)
    raise ConfigError(
        f"{what}: {spec.joint_labels[joint]} would move at {peak[joint]:.3g} rad/s; {limits.velocity[joint]:g} is "
        f"where the guard stops: slow down to {math.floor(share[joint] / unit + 1e-6) * unit:.2g} of that"
        + (f", or raise {setting}" if setting else "")
    )


PathCheck = Callable[[Vector, Vector], None]
"""Raises CommandError for a position and a goal, (n,), rad, between which a hand must not go."""


class GuardMemory(NamedTuple):
    """State of a guard in a session."""

    history: tuple[Sample, ...]
    state: HandState | None
    fault: HandError | None
    states: int
    """Since `reset`."""


class Guard(PassThroughBackend):
    """Limits and trips. A fault leaves the hand limp until `reset`; every HandError carries the last samples.

    A state that is no newer than the one before is passed over; a hand that tells no new time for SILENCE, or PERIODS,
    is a LinkTimeout, and one whose time goes back a HandFault.

    `path_check`: examines the path to a commanded position before it is sent.
    """

    def __init__(self, inner: HandBackend, limits: Limits, path_check: PathCheck | None = None) -> None:
        super().__init__(inner)
        self._limits, self._path_check = limits, path_check
        self._history: deque[Sample] = deque(maxlen=HISTORY)
        self._limp = limp_of(inner.spec)
        self._state: HandState | None = None
        self._fault: HandError | None = None
        self._count = 0
        """States since `reset`."""

    @property
    def limits(self) -> Limits:
        """What this guard lets through."""
        return self._limits

    @property
    def applied(self) -> Command:
        """What the last command became, or the limp one before the first."""
        return self._history[-1].command if self._history else self._limp

    def reset(self) -> HandState:
        self._history.clear()
        self._fault, self._count = None, 0
        self._state = self._inner.reset()
        return self._state

    def write(self, command: Command) -> None:
        state = self._ready()
        try:
            limited = self._limited(command, state)
            self._history.append(Sample(state, limited))
            self._inner.write(limited)
        except HandError as error:
            raise self._stopped(error) from error.__cause__

    def read(self) -> HandState:
        before = self._ready()
        try:
            state = self._inner.read()
            if not (state.t > before.t and state.tick > before.tick):
                state = self._newer(state, before)
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._state, self._count = state, self._count + 1
        reason = violation(state, self._limits, self.spec)
        if reason is not None:
            self._history.append(Sample(state, self._limp))
            raise self._stopped(type(reason)(f"stopped: {reason}; reset to go on"))
        return state

    def save(self) -> GuardMemory:
        """Its state in the session; the backend's own state is no part of it."""
        return GuardMemory(tuple(self._history), self._state, self._fault, self._count)

    def restore(self, memory: GuardMemory) -> None:
        """Go on from what `save` returned; the backend is restored by who owns it."""
        history, self._state, self._fault, self._count = memory
        self._history = deque(history, maxlen=HISTORY)

    def recover(self) -> HandState:
        """Go on after a fault in the same session, where the backend can; torques begin anew from nothing.

        Raises HandFault where only a reset leads out."""
        self._state = state = super().recover()
        self._fault, self._count = None, self._count + 1
        self._history.append(Sample(state, self._limp))
        return state

    def _newer(self, state: HandState, before: HandState) -> HandState:
        """The first state that is newer than the one before, of a hand that has just told the same time again. Raises
        LinkTimeout where it goes on telling it, HandFault where its time goes back."""
        limit, began = max(SILENCE, PERIODS * self.period), time.monotonic()
        while not (state.t > before.t and state.tick > before.tick):
            if not (state.t >= before.t and state.tick >= before.tick):
                name = "t" if not state.t >= before.t else "tick"
                raise HandFault(
                    f"{self.spec.name}: state {self._count + 1} after reset: {name} is {getattr(state, name):g} after "
                    f"{getattr(before, name):g}; it must increase: see to the backend's clock"
                )
            if time.monotonic() - began > limit:
                raise LinkTimeout(
                    f"no new state from {self.spec.name} for {limit:g} s: it tells t {state.t:g} s, tick {state.tick} "
                    "again and again; see to the hand, and to the backend, whose t and tick must increase"
                )
            state = self._inner.read()
        return state

    def _limited(self, command: Command, state: HandState) -> Command:
        spec, limits = self.spec, self._limits
        if "torque" in spec.commands:
            torque = clamp(torque_of(command, spec), state, limits)
            if limits.rate is not None:
                torque = no_faster(torque, torque_of(self.applied, spec), limits.rate * self.period)
            return TorqueCommand(torque)
        allowed = bounded(position_of(command, spec), state, limits, spec)
        if self._path_check is not None and not allowed.limp:
            self._path_check(state.position, allowed.position)
        return allowed

    def _ready(self) -> HandState:
        if self._fault is not None:
            raise self._fault
        if self._state is None:
            raise HandFault("the hand has not been reset; call reset() before read() or write()")
        return self._state

    def _stopped(self, error: HandError) -> HandError:
        """Leave the hand limp and remember why."""
        error.history = tuple(self._history)
        self._fault = error
        try:
            self._inner.write(self._limp)
        except HandError:
            pass  # Nothing left to say it with; the first error is the one that counts.
        return error
