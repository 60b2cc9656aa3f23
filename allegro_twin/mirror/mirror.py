"""The mirror: a stage over samples, so it works on a bus, on a virtual hand and on a recording alike."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

import numpy as np

from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.mirror.anomalies import NAMES, Anomaly, words
from allegro_twin.mirror.diagnosis import Calm, Diagnosis
from allegro_twin.mirror.events import PERIODS, SETTLED, pushed
from allegro_twin.sim.observer import Estimate, Observer
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, HandState, Sample, Vector

STOPS = ("contact", *NAMES)
"""What can stop a hand."""


class Mirror:
    """Keeps up with samples. `torque_constant`: with which the host's counts became N·m, (n,)."""

    def __init__(
        self,
        spec: HandSpec,
        observer: Observer,
        torque_constant: Vector,
        calm: Calm | None = None,
        stop: Collection[str] = (),
    ) -> None:
        """`calm`: what free motions do not reach; `stop`: of STOPS, what leaves the hand limp."""
        self._spec, self._observer, self._constant, self._stop = spec, observer, torque_constant, stop
        self._calm = calm or Calm.usual(spec)
        self._estimate: Estimate | None = None
        self._begun: float | None = None
        self._over = np.zeros(len(spec.fingers), dtype=int)
        self._diagnosis = Diagnosis(spec, self._calm.gains)

    @property
    def spec(self) -> HandSpec:
        return self._spec

    @property
    def observer(self) -> Observer:
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
            self.see(sample.state)
            yield sample

    def see(self, state: HandState) -> None:
        """The next state. Raises as `watched`."""
        if self._begun is None:
            self._begin(state)
            return
        duty = state.torque / self._constant
        self._estimate = self._observer.step(duty, state.gravity, state.position)
        if state.t > self._begun + SETTLED:
            self._judge(state, self._estimate, duty)

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
        if not np.isfinite(state.gravity).all():
            raise ConfigError("the mirror must know where down is: `backend.gravity`, or the hand's IMU")
        self._begun = state.t
        self._observer.reset(state.position)

    def _judge(self, state: HandState, estimate: Estimate, duty: Vector) -> None:
        over = pushed(estimate.disturbance, self._calm.above, self._spec) > 1.0
        self._over = np.where(over, self._over + 1, 0)
        diagnosis = self._diagnosis
        torque, off = duty * self._observer.torque_constant, state.position - estimate.predicted
        diagnosis.add(state, estimate, torque, off, self._observer.pull() if diagnosis.due else None)
        if "contact" in self._stop and self.contacts:
            joint = int(np.argmax(np.abs(estimate.disturbance) / self._calm.above))
            raise HandFault(
                f"something touches {', '.join(self.contacts)}: {self._spec.joints[joint]} is pushed by "
                f"{1000 * estimate.disturbance[joint]:+.0f} mN·m at {state.t:.3f} s"
            )
        if self.anomaly is not None and self.anomaly.name in self._stop:
            raise HandFault(f"{words(self.anomaly, self._spec)}, at {state.t:.3f} s")
