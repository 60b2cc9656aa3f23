"""The mirror: a model that follows a hand's samples, on a bus, on a virtual hand or in a recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from allegro_twin.backend import limp_of, position_of, torque_of
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.sim.observer.loop_observer import LoopObserver
from allegro_twin.sim.observer.observer import NOISE, Estimate, StateObserver
from allegro_twin.spec import HandSpec
from allegro_twin.twin.mirror.contact_detection import (
    SETTLED,
    ContactTimer,
    MovingJoints,
    joint_thresholds,
    outermost_joint,
    push_ratio,
)
from allegro_twin.twin.mirror.fault_detection import FaultDetector, LinkWeights, Thresholds
from allegro_twin.twin.mirror.faults import KNOWN, NAMES, FaultReport, fault_text
from allegro_twin.types import Array, HandState, Sample, Vector

STOPS = ("contact", *NAMES)
"""Events that can stop a hand."""
BLIND = 0.1
"""s without a report after which the mirror starts again: by then 2 mN·m a period have carried it 20 mrad away."""
DIM = 0.02
"""s without a report after which no new contact is reported for as long again. Ours: friction that breaks away carries
a joint off its mirror by no linear law, and the effect is gone by then."""
COUNTS = 4
"""States within which a host counts a lost period (`drivers.can.driver.clock.PATIENCE`), and one more."""
CLEARLY = 0.25
"""Share of a step's squared error below which an uncounted period explains it. With half a period the share is 1."""
SPEEDS_UP = 30.0
"""rad/s²: a joint that speeds up so is no sign that periods were counted wrongly. Ours: usual motions have 10."""
MANY = 10
"""Periods, at most, that the joints' displacement tells: in more of them their speeds change."""
NOISIER = 1.25
"""Ratio of measured to assumed noise in the first half of SETTLED above which a mirror takes the measured one."""

UNROUNDED = 1e-9
"""rad: a smaller difference of positions is 0, but for the rounding of numbers."""


class Mirror:
    """Follows the samples of a hand: with the torques that it reports, or, where it closes its own loop, with its
    commands. `torque_constant`: with which the host converts counts to N·m, (n,); only for the former."""

    def __init__(
        self,
        spec: HandSpec,
        observer: StateObserver | LoopObserver,
        torque_constant: Vector,
        thresholds: Thresholds | None = None,
        stop: Collection[str] = (),
        gravity: Vector | None = None,
    ) -> None:
        """`thresholds`: those of free motions; `stop`: events of STOPS that raise HandFault; `gravity`: in the palm
        frame, (3,), m/s², where the hand does not report it."""
        self._spec, self._observer, self._constant, self._stop = spec, observer, torque_constant, stop
        self._gravity, self._told = gravity, limp_of(spec)
        self._heard_down = (-np.inf, np.full(3, np.nan))  # s: when the hand last said where down is, and where.
        self._thresholds = thresholds or Thresholds.default(spec)
        self._estimate: Estimate | None = None
        self._begun, self._clear = np.nan, 0.0  # s: when it began, and from when on a new contact is reported.
        self._contact = ContactTimer(len(spec.fingers), observer.period)
        self._tick, self._since = 0, np.zeros(spec.n_joints, dtype=int)
        self._lost = LostPeriods(observer.period)
        self._noise: NoiseEstimator | None = NoiseEstimator(spec.n_joints)
        self._pace, self._moving = MovingJoints(spec.n_joints, observer.period), np.zeros(spec.n_joints, dtype=bool)
        self._compensates, self._changes = isinstance(observer, StateObserver), 0
        self._diagnosis = FaultDetector(spec, self._thresholds, observer.period, compensates=self._compensates)
        self._last = np.full(spec.n_joints, np.nan)

    @property
    def spec(self) -> HandSpec:
        return self._spec

    @property
    def observer(self) -> StateObserver | LoopObserver:
        """The simulation beside the hand."""
        return self._observer

    @property
    def gravity(self) -> Vector | None:
        """Gravity in the palm frame, (3,), m/s², where it was given; otherwise the hand reports it."""
        return self._gravity

    @property
    def external_torque(self) -> Vector:
        """External torque on the joints, (n,), N·m; NaN before the second sample."""
        return self.columns()["disturbance"]

    @property
    def contacts(self) -> tuple[str, ...]:
        """Names of the fingers in contact."""
        return tuple(f.name for f, held in zip(self._spec.fingers, self._contact.touched, strict=True) if held)

    @property
    def touched_joints(self) -> dict[str, int]:
        """For every finger in contact its outermost joint that is pushed beyond its own axis: the contact is on the
        link that this joint moves, or further out. -1 where that cannot be told."""
        share = np.square(self.external_torque / self.contact_thresholds)
        return {f.name: outermost_joint(share, f.joints) for f in self._spec.fingers if f.name in self.contacts}

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Which joints have moved for a while, (n,)."""
        return self._moving

    @property
    def contact_thresholds(self) -> Vector:
        """Contact thresholds now, (n,), N·m: those of free motions, larger while the disturbance is less certain than
        in them, or a named fault disturbs the joint; infinite for a joint of which nothing can be known."""
        wider, unknown = self._observer.spread / self._thresholds.spread, 0.0 if self._compensates else 1.0
        above = joint_thresholds(self._thresholds.contact, self._moving) * np.maximum(wider, 1.0)
        above = above + (unknown + KNOWN) * np.abs(self._diagnosis.explained)
        return np.asarray(np.where(self._diagnosis.faults.hidden, np.inf, above))

    @property
    def unchecked_faults(self) -> tuple[str, ...]:
        """Names of faults that cannot be found without thresholds of a free motion."""
        return self._thresholds.unchecked_faults

    @property
    def faults(self) -> tuple[FaultReport, ...]:
        """All faults of the hand that were named, in this order: those with an infinite `ended` hold now."""
        return tuple(self._diagnosis.faults.reports)

    @property
    def fault_detector(self) -> FaultDetector:
        """The detector of faults, with its windows."""
        return self._diagnosis

    def watch(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """Observe samples and pass them on (a stage). Raises ConfigError for a hand whose gravity is unknown, HandFault
        for an event of `stop`."""
        for sample in samples:
            self.observe(sample)
            yield sample

    def observe(self, sample: Sample) -> None:
        """Observe the next sample. Periods that its tick says are missing pass without a report. Raises as `watch`."""
        state = self._held_down(sample.state)
        heard = np.isfinite(state.position)
        self._last = np.where(heard, state.position, self._last)
        self._diagnosis.hear(state.t, heard)
        gone = self._lost.count(state, max(state.tick - self._tick, 1), self._estimate)
        unknown = self._compensates and not np.isfinite(state.torque).all()
        if not self._begun >= 0.0 or unknown or gone * self._observer.period > BLIND:
            self._begin(state)
        else:
            blind = gone * self._observer.period
            if blind > DIM:
                self._clear = max(self._clear, state.t + blind)
            self._since += gone
            for lost, (estimate, torque) in enumerate(self._estimates(state, gone), 1):
                ends = lost == gone
                whole, since = state, self._since
                if not ends or not heard.all():
                    known = heard & ends
                    whole = replace(state, position=np.where(known, state.position, estimate.predicted))
                    since = np.where(known, self._since, 0)
                self._estimate, self._moving = estimate, self._pace(estimate.velocity)
                if state.t > self._begun + SETTLED:
                    self._judge(whole, torque, since)
            self._since[heard] = 0
            self._measure_noise(state, gone)
        self._told, self._tick = sample.command, state.tick

    def _held_down(self, state: HandState) -> HandState:
        """The state with the last known gravity for BLIND, where an IMU missed a sample. Raises ConfigError after."""
        if np.isfinite(self.gravity_in_palm(state)).all():
            self._heard_down = state.t, state.gravity
        elif state.t - self._heard_down[0] <= BLIND:
            return replace(state, gravity=self._heard_down[1])
        elif np.isfinite(self._heard_down[0]):
            raise ConfigError(
                f"the hand has not said where down is since {self._heard_down[0]:.3f} s, and a mirror must know: "
                "--gravity, `backend.gravity`, or mend its IMU"
            )
        return state

    def _estimates(self, state: HandState, gone: int) -> Iterator[tuple[Estimate, Vector]]:
        """The periods up to a state, and the model's motor torques in each, (n,), N·m. A host that waits for a report
        sends nothing new, so the torque is that of the whole gap. A log that lost rows has it of the last period alone,
        and the command before the first: between these it is interpolated."""
        observer, down = self._observer, self.gravity_in_palm(state)
        if isinstance(observer, LoopObserver):
            told = position_of(self._told, self._spec)
            for _ in range(gone - 1):
                yield observer.missed(told, down), observer.torque
            yield observer.step(told, down, state.position), observer.torque
            return
        limit, duty = self._spec.actuation.torque_limit, state.torque / self._constant
        if gone > 1:
            first = np.clip(torque_of(self._told, self._spec), -limit, limit) / self._constant
            for part in np.linspace(0.0, 1.0, gone)[:-1]:
                between = first + part * (duty - first)
                yield observer.missed(between, down, np.abs(duty - first)), between * observer.torque_constant
        yield observer.step(duty, down, state.position), duty * observer.torque_constant

    def _measure_noise(self, state: HandState, gone: int) -> None:
        """Measure the noise of the hand's reports, at first."""
        if self._noise is None:
            return
        self._noise.add(state.position, gone)
        if state.t > self._begun + SETTLED / 2.0:
            found, self._noise = self._noise.estimate(), None
            if (found > NOISIER * self._observer.noise).any():
                self._observer.noisier(np.maximum(found, self._observer.noise))

    def gravity_in_palm(self, state: HandState) -> Vector:
        """Gravity in the palm frame, (3,), m/s²: as given, or as the hand reports it."""
        return state.gravity if self._gravity is None else self._gravity

    def columns(self) -> dict[str, Array]:
        """Further columns of a recording. `event`, (fingers + n,): 1 for every finger in contact; then, for every
        joint, the sum of 2^k over its faults, k: the place of the name in `faults.NAMES`, from 0."""
        unknown, estimate, codes = np.full(self._spec.n_joints, np.nan), self._estimate, np.zeros(self._spec.n_joints)
        for each in self._diagnosis.faults.active:
            codes[each.joint] += 2 ** NAMES.index(each.name)
        return {
            "predicted": unknown if estimate is None else estimate.predicted,
            "disturbance": unknown if estimate is None else estimate.disturbance,
            "event": np.concatenate([self._contact.touched, codes]).astype(float),
        }

    def _begin(self, state: HandState) -> None:
        if not np.isfinite(self.gravity_in_palm(state)).all():
            raise ConfigError("the mirror must know where down is: --gravity, `backend.gravity`, or the hand's IMU")
        position = np.where(np.isfinite(state.position), state.position, self._last)
        if not np.isfinite(position).all():
            return  # It cannot start at an unknown position.
        self._begun, self._clear, self._estimate = state.t, 0.0, None
        self._since[:], self._contact = 0, ContactTimer(len(self._spec.fingers), self._observer.period)
        self._observer.reset(position, state.t)
        self._lost = LostPeriods(self._observer.period)
        self._pace = MovingJoints(self._spec.n_joints, self._observer.period)
        self._diagnosis.restart()
        if self._noise is not None:
            self._noise = NoiseEstimator(self._spec.n_joints)

    def _weights(self, down: Vector) -> LinkWeights:
        observer, free = self._observer, np.ones(self._spec.n_joints, dtype=bool)
        for finger, touched in zip(self._spec.fingers, self._contact.touched, strict=True):
            free[list(finger.joints)] = not touched
        if isinstance(observer, StateObserver):
            return LinkWeights(observer.pull(), observer.lean(), free, down)
        return LinkWeights(observer.pull(), None, free, down)

    def _judge(self, state: HandState, torque: Vector, since: NDArray[np.int_]) -> None:
        """`state`: with predicted positions where none were reported; `since`: periods from each joint's last report to
        this one, 0 where there is none, (n,)."""
        estimate, diagnosis = self._estimate, self._diagnosis
        assert estimate is not None
        off = state.position - estimate.predicted
        weights = self._weights(self.gravity_in_palm(state)) if diagnosis.row_due else None
        diagnosis.add(state, estimate, torque, off, weights, since, self._observer.expected)
        self._compensate()
        if not since.any():
            return  # Without any report there is nothing to judge.
        above, held = self.contact_thresholds, np.where(self._moving, 0.0, self._thresholds.held)
        over = push_ratio(estimate.disturbance, above, self._spec, held=held) > 1.0
        if state.t < self._clear:
            over &= self._contact.touched
        self._contact.add(over)
        diagnosis.judge_touches(self._contact.touched, state.t)
        if "contact" in self._stop and self.contacts:
            joint = int(np.argmax(np.abs(estimate.disturbance) / self.contact_thresholds))
            raise HandFault(
                f"something touches {', '.join(self.contacts)}: {self._spec.joint_labels[joint]} is pushed by "
                f"{1000 * estimate.disturbance[joint]:+.0f} mN·m at {state.t:.3f} s"
            )
        for each in diagnosis.faults.active:
            if each.name in self._stop:
                raise HandFault(f"{fault_text(each, self._spec)}, at {state.t:.3f} s")

    def _compensate(self) -> None:
        """Let the model have the faults that were named: what remains is a touch, or the next fault."""
        faults = self._diagnosis.faults
        if faults.changes != self._changes and isinstance(self._observer, StateObserver):
            self._observer.compensate(faults.model_change())
        self._changes = faults.changes


class LostPeriods:
    """Counts the periods between two states. The host's `tick` counts a lost period only with the third late state,
    since a state that is merely late is followed by one that is not; and a state that is late by two or more it counts
    as lost at once, though the host may have been busy. The joints' displacement tells both."""

    def __init__(self, period: float) -> None:
        self._period, self._t, self._at = period, np.inf, np.zeros(0)
        self._ahead, self._left = 0, 0  # Periods that `tick` lacks, and states within which it will count them.

    def count(self, state: HandState, counted: int, last: Estimate | None) -> int:
        """Periods from the last state to this one; `counted`: by the ticks."""
        stamped = round((state.t - self._t) / self._period) if np.isfinite(self._t) else counted
        step = state.position - self._at if last is not None else np.zeros(0)
        self._t, self._at, self._left = state.t, state.position, self._left - 1
        if self._left < 0:
            self._ahead = 0
        gone = counted
        if counted > 1 and stamped < counted:
            gone -= min(max(self._ahead, 0), counted - 1)
        most = max(counted, stamped, counted - self._ahead)
        if last is not None and most > 1:
            gone = self._moved(step, last.velocity, gone, min(most, MANY))
        if gone != counted:
            self._ahead, self._left = self._ahead + gone - counted, COUNTS
        return gone

    def _moved(self, step: Vector, velocity: Vector, expected: int, most: int) -> int:
        """Periods, at most so many, that explain a step of the joints, (n,), rad, clearly better than those expected.
        One joint alone may have jumped: each counts no more than as if it had not moved for two periods."""
        went = self._period * velocity
        periods = np.array([expected, *range(1, most + 1)])[:, None]
        faster = SPEEDS_UP * (np.square(periods) - 1) * self._period**2 / 2.0
        off = np.clip(np.abs(step - periods * went) - faster, 0.0, 2.0 * np.abs(went) + NOISE)
        squares = np.nansum(np.square(off), axis=1)
        best = int(squares.argmin())
        return int(periods[best, 0]) if squares[best] < CLEARLY * squares[0] else expected


class NoiseEstimator:
    """Estimates the noise of reports from third differences of successive positions, to which a motion below 15 Hz adds
    nothing: those of white noise have the variance 20 σ²."""

    def __init__(self, n: int) -> None:
        self._last: deque[Vector] = deque(maxlen=4)
        self._third: list[Vector] = [np.zeros(n)]

    def add(self, position: Vector, gone: int) -> None:
        """Add a reported position, (n,), rad, some periods after the last."""
        if gone > 1:
            self._last.clear()
        self._last.append(position)
        if len(self._last) == 4:
            self._third.append(np.abs(np.diff(np.array(self._last), n=3, axis=0)[0]))

    def estimate(self) -> Vector:
        """Standard deviation, (n,), rad. Differences beyond three times the usual count as that: an impact. Of a coarse
        encoder most may be 0; the least other, a count, is then the usual one."""
        third = np.nan_to_num(np.array(self._third))
        count = np.where(third > UNROUNDED, third, np.inf).min(axis=0)
        usual = np.maximum(np.median(third, axis=0), np.where(np.isfinite(count), count, 0.0))
        most = 3.0 * usual / 0.6745
        return np.asarray(np.sqrt(np.square(np.minimum(third, most)).mean(axis=0) / 20.0))
