"""The mirror: a stage over samples, so it works on a bus, on a virtual hand and on a recording alike."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.mirror.events import PERIODS, SETTLED
from allegro_twin.sim.observer import Estimate, Observer
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, HandState, Sample, Vector


class Mirror:
    """Keeps up with samples. `torque_constant`: with which the host's counts became N·m, (n,)."""

    def __init__(
        self, spec: HandSpec, observer: Observer, torque_constant: Vector, above: Vector | None = None
    ) -> None:
        """`above`: disturbances, (n,), N·m, that stop the hand; None: none do."""
        self._spec, self._observer, self._constant, self._above = spec, observer, torque_constant, above
        self._estimate: Estimate | None = None
        self._over = np.zeros(spec.n_joints, dtype=int)

    def watched(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """A stage that passes the samples on. Raises ConfigError for a hand that does not say where down is, HandFault
        for a touch that is to stop it."""
        begun: float | None = None
        for sample in samples:
            state = sample.state
            if begun is None:
                begun = state.t
                self._begin(state)
            else:
                duty = state.torque / self._constant
                self._estimate = self._observer.step(duty, state.gravity, state.position)
                if state.t > begun + SETTLED:
                    self._judge(state)
            yield sample

    def latest(self) -> dict[str, Array]:
        """Further columns of a recording."""
        if self._estimate is None:
            unknown = np.full(self._spec.n_joints, np.nan)
            return {"predicted": unknown, "disturbance": unknown}
        return {"predicted": self._estimate.predicted, "disturbance": self._estimate.disturbance}

    def _begin(self, state: HandState) -> None:
        if not np.isfinite(state.gravity).all():
            raise ConfigError("the mirror must know where down is: `backend.gravity`, or the hand's IMU")
        self._estimate = None
        self._over[:] = 0
        self._observer.reset(state.position)

    def _judge(self, state: HandState) -> None:
        if self._above is None or self._estimate is None:
            return
        over = np.abs(self._estimate.disturbance) > self._above
        self._over = np.where(over, self._over + 1, 0)
        if (self._over >= PERIODS).any():
            joint = int(np.argmax(np.abs(self._estimate.disturbance) / self._above))
            raise HandFault(
                f"{self._spec.joints[joint]} is pushed by {1000 * self._estimate.disturbance[joint]:+.0f} mN·m at "
                f"{state.t:.3f} s, more than {1000 * self._above[joint]:.0f}: something touches it"
            )
