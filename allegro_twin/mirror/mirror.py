"""The mirror: a stage over samples, so it works on a bus, on a virtual hand and on a recording alike."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from allegro_twin.backend import limp_of, position_of
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.mirror.anomalies import NAMES, Anomaly, words
from allegro_twin.mirror.diagnosis import Calm, Diagnosis, Weights
from allegro_twin.mirror.events import PERIODS, SETTLED, Pace, axes, outermost, pushed
from allegro_twin.sim.beside.loop_observer import LoopObserver
from allegro_twin.sim.beside.observer import Estimate, Observer
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, HandState, Sample, Vector

STOPS = ("contact", *NAMES)
"""What can stop a hand."""


class Mirror:
    """Keeps up with samples: with the torques that a hand reports, or, where it closes its own loop, with what it is
    told. `torque_constant`: with which the host's counts became N·m, (n,); of the former alone."""

    def __init__(
        self,
        spec: HandSpec,
        observer: Observer | LoopObserver,
        torque_constant: Vector,
        calm: Calm | None = None,
        stop: Collection[str] = (),
        gravity: Vector | None = None,
    ) -> None:
        """`calm`: what free motions do not reach; `stop`: of STOPS, what leaves the hand limp; `gravity`: in the palm
        frame, (3,), m/s², where the hand does not report it."""
        self._spec, self._observer, self._constant, self._stop = spec, observer, torque_constant, stop
        self._gravity, self._told = gravity, limp_of(spec)
        self._calm = calm or Calm.usual(spec)
        self._estimate: Estimate | None = None
        self._begun: float | None = None
        self._over = np.zeros(len(spec.fingers), dtype=int)
        self._pace, self._moving = Pace(spec.n_joints, observer.period), np.zeros(spec.n_joints, dtype=bool)
        self._diagnosis = Diagnosis(spec, self._calm, observer.period)

    @property
    def spec(self) -> HandSpec:
        return self._spec

    @property
    def observer(self) -> Observer | LoopObserver:
        """The simulation beside the hand."""
        return self._observer

    @property
    def external_torque(self) -> Vector:
        """What pushes the joints from outside, (n,), N·m; NaN before the second sample."""
        return self.latest()["disturbance"]

    @property
    def contacts(self) -> tuple[str, ...]:
        """The fingers that something touches."""
        return tuple(f.name for f, over in zip(self._spec.fingers, self._over, strict=True) if over >= PERIODS)

    @property
    def touched_joints(self) -> dict[str, int]:
        """Of every finger that something touches the outermost joint that is pushed beyond its own axis: it touches the
        link that this joint moves, or one further out; -1 where that cannot be told."""
        share = np.square(self.external_torque / self.above)
        return {f.name: outermost(share, f.joints) for f in self._spec.fingers if f.name in self.contacts}

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Which joints have moved for a while, (n,)."""
        return self._moving

    @property
    def above(self) -> Vector:
        """More than this is a touch now, (n,), N·m."""
        return np.asarray(axes(self._calm.above, self._moving))

    @property
    def anomaly(self) -> Anomaly | None:
        """What is wrong with the hand, once that is sure."""
        return self._diagnosis.found

    @property
    def diagnosis(self) -> Diagnosis:
        """For thresholds: its windows."""
        return self._diagnosis

    def watched(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """A stage that passes the samples on. Raises ConfigError for a hand that does not say where down is, HandFault
        for what is to stop it."""
        for sample in samples:
            self.see(sample)
            yield sample

    def see(self, sample: Sample) -> None:
        """The next sample. Raises as `watched`."""
        state = sample.state
        if self._begun is None:
            self._begin(state)
        else:
            self._estimate, torque = self._expected(state)
            self._moving = self._pace(self._estimate.velocity)
            if state.t > self._begun + SETTLED:
                self._judge(state, self._estimate, torque)
        self._told = sample.command

    def _expected(self, state: HandState) -> tuple[Estimate, Vector]:
        """Of the period that ended with a state, and what the motors gave in it by the model, (n,), N·m."""
        observer, down = self._observer, self.down(state)
        if isinstance(observer, LoopObserver):
            told = position_of(self._told, self._spec)
            return observer.step(told, down, state.position), observer.torque
        duty = state.torque / self._constant
        return observer.step(duty, down, state.position), duty * observer.torque_constant

    def down(self, state: HandState) -> Vector:
        """Gravity in the palm frame, (3,), m/s²: as it was told, or as the hand reports it."""
        return state.gravity if self._gravity is None else self._gravity

    def latest(self) -> dict[str, Array]:
        """Further columns of a recording. `event`: 1 for every finger that is touched, then which anomaly, counted from
        1 in the order of `anomalies.NAMES`, and its joint; 0 and -1 where there is none."""
        unknown, estimate, found = np.full(self._spec.n_joints, np.nan), self._estimate, self.anomaly
        which = (0.0, -1.0) if found is None else (1.0 + NAMES.index(found.name), float(found.joint))
        return {
            "predicted": unknown if estimate is None else estimate.predicted,
            "disturbance": unknown if estimate is None else estimate.disturbance,
            "event": np.array([*(self._over >= PERIODS), *which], dtype=float),
        }

    def _begin(self, state: HandState) -> None:
        if not np.isfinite(self.down(state)).all():
            raise ConfigError("the mirror must know where down is: --gravity, `backend.gravity`, or the hand's IMU")
        self._begun = state.t
        self._observer.reset(state.position)

    def _weights(self, down: Vector, velocity: Vector) -> Weights:
        observer, free = self._observer, np.ones(self._spec.n_joints, dtype=bool)
        for finger, over in zip(self._spec.fingers, self._over, strict=True):
            free[list(finger.joints)] = over < PERIODS
        if isinstance(observer, Observer):
            return Weights(observer.pull(), observer.lean(), free, down, observer.rub(velocity))
        return Weights(observer.pull(), None, free, down, np.ones(self._spec.n_joints))

    def _judge(self, state: HandState, estimate: Estimate, torque: Vector) -> None:
        over = pushed(estimate.disturbance, self.above, self._spec) > 1.0
        self._over = np.where(over, self._over + 1, 0)
        diagnosis = self._diagnosis
        off = state.position - estimate.predicted
        weights = self._weights(self.down(state), estimate.velocity) if diagnosis.due else None
        diagnosis.add(state, estimate, torque, off, weights)
        if "contact" in self._stop and self.contacts:
            joint = int(np.argmax(np.abs(estimate.disturbance) / self.above))
            raise HandFault(
                f"something touches {', '.join(self.contacts)}: {self._spec.joints[joint]} is pushed by "
                f"{1000 * estimate.disturbance[joint]:+.0f} mN·m at {state.t:.3f} s"
            )
        if self.anomaly is not None and self.anomaly.name in self._stop:
            raise HandFault(f"{words(self.anomaly, self._spec)}, at {state.t:.3f} s")
