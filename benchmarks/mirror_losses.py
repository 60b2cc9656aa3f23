"""`python -m benchmarks.mirror_losses`: a mirror beside hands whose reports are lost and noisy.

It counts what the mirror says of a hand with nothing wrong, and how soon it notices a push. Hands and motions are those
of `benchmarks.mirror`. The host is that of a CAN bus: a lost report of one finger costs that period and the next, and
while none comes the hand keeps its torques. A burst loses 5 to 30 periods on end. The mirror is not told how noisy the
encoders are.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allegro_twin.backend import PassThroughBackend, torque_of
from allegro_twin.control.controllers import PD
from allegro_twin.drivers.can.driver.velocity_filter import VelocityFilter
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.loop import run, until
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.twin.mirror.fault_detection import Thresholds
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Command, HandState, TorqueCommand, Vector, frozen
from benchmarks.mirrored_hands import FULL, PERIOD, N, hand, mirror_of, moves, simulated

CUTOFF = 30.0  # Hz, of the host's speeds.
BURST = (5, 30)  # Periods.
PUSH = 0.06  # N·m, of one joint.


class Host(PassThroughBackend):
    """A simulated hand as a CAN host hears it, `loss`: share of reports of one finger that are lost; `bursts`: share of
    periods that begin a burst."""

    def __init__(self, backend: SimBackend, loss: float, bursts: float, seed: int) -> None:
        super().__init__(backend)
        self._rng = np.random.default_rng((seed, 9))
        self._loss, self._bursts = 1.0 - (1.0 - loss) ** 4, bursts
        self._sent: Vector = frozen(np.zeros(N))

    def reset(self) -> HandState:
        state = self._inner.reset()
        self._filter, self._sent = VelocityFilter(CUTOFF, state.position), frozen(np.zeros(N))
        return replace(state, torque=self._sent, velocity=frozen(np.zeros(N)))

    def write(self, command: Command) -> None:
        limit = self.spec.actuation.torque_limit
        self._sent = frozen(np.trunc(np.clip(torque_of(command, self.spec), -limit, limit) * FULL) / FULL)
        self._inner.write(TorqueCommand(self._sent))

    def read(self) -> HandState:
        state, gone, lost = self._inner.read(), 1, self._lost()
        while lost:
            self._inner.write(TorqueCommand(self._sent))
            state, gone, lost = self._inner.read(), gone + 1, max(lost - 1, self._lost())
        velocity = self._filter(state.position, gone * PERIOD)
        return replace(state, torque=self._sent, velocity=velocity)

    def _lost(self) -> int:
        """How many periods a loss that begins now costs."""
        if self._rng.random() < self._bursts:
            return int(self._rng.integers(*BURST))
        return 2 if self._rng.random() < self._loss else 0


class Said(NamedTuple):
    """What a mirror said."""

    touches: int
    anomaly: str
    noticed: float
    """s from a push to the first touch of its finger; infinite: none."""


def drawn(seed: int, noise: float, *, mismatched: bool) -> HandSpec:
    """A hand whose encoders have some noise, rad, before counts are rounded; NaN: each joint its own of 60 to 400
    µrad."""
    spec = hand(seed, mismatched=mismatched)
    own = np.random.default_rng((seed, 8)).uniform(6e-5, 4e-4, N) if np.isnan(noise) else np.full(N, noise)
    assert isinstance(spec.drive, Drive)
    return replace(spec, drive=replace(spec.drive, encoder_noise=frozen(own)))


def learned(spec: HandSpec, seed: int, seconds: float, loss: float) -> Thresholds:
    """From a free motion."""
    each, rows = mirror_of(spec), []
    each.fault_detector.keep_rows()
    host = Host(simulated(spec, seed), loss, 0.0, seed)
    for _ in each.watch(until(seconds, run(host, PD(moves(spec, seed, seconds), load_gains("v4", spec))))):
        rows.append((each.columns()["disturbance"], each.moving, each.observer.spread))
    disturbance, moving, spread = (np.array(column[1:]) for column in zip(*rows, strict=True))
    usual = np.median(spread, axis=0)
    kept = np.nan_to_num(disturbance) / np.maximum(spread / usual, 1.0)
    shapes = each.fault_detector.free_shapes()
    return Thresholds.from_free_motion(kept, moving, each.observer.held, shapes, PERIOD, spec, usual)


def heard(
    spec: HandSpec, calm: Thresholds | None, seed: int, seconds: float, loss: float, bursts: float, at: float
) -> Said:
    """`at`: s, when something begins to push one joint; infinite: nothing does."""
    backend = simulated(spec, seed)
    each = Mirror(spec, mirror_of(spec).observer, np.ones(N), calm)
    touches, before, noticed, rng = 0, set[str](), np.inf, np.random.default_rng((seed, 11))
    finger = spec.fingers[seed % len(spec.fingers)]
    push = np.zeros(N)
    push[finger.joints[1 + seed % 2]] = PUSH * rng.choice([-1.0, 1.0])
    host = Host(backend, loss, bursts, seed)
    samples = until(seconds, run(host, PD(moves(spec, seed, seconds), load_gains("v4", spec))))
    for sample in each.watch(samples):
        t = sample.state.t
        if t >= at:
            backend.push(push)
            if finger.name in each.contacts:
                noticed = t - at
                break
        now = set(each.contacts)
        touches += len(now - before)
        before = now
    return Said(touches, each.faults[0].fault.name if each.faults else "", noticed)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--loss", type=float, nargs="*", default=[0.0, 0.001, 0.01, 0.05])
    options.add_argument("--noise", type=float, nargs="*", default=[6e-5, 2e-4, 4e-4, float("nan")], help="rad")
    options.add_argument("--bursts", type=float, default=0.0)
    options.add_argument("--minutes", type=int, default=10, help="of each, on as many hands")
    options.add_argument("--first", type=int, default=600, help="seed of the first hand")
    options.add_argument("--learn", type=float, default=0.0, help="s of free motion for thresholds; 0: the usual ones")
    options.add_argument("--mismatched", action="store_true")
    options.add_argument("--pushes", type=int, default=0, help="of each")
    chosen = options.parse_args()
    assert load_spec().n_joints == N
    for noise in chosen.noise:
        hands = chosen.minutes or 5
        specs = [drawn(chosen.first + k, noise, mismatched=chosen.mismatched) for k in range(hands)]
        for loss in chosen.loss:
            calms = [learned(s, 3000 + k, chosen.learn, loss) if chosen.learn else None for k, s in enumerate(specs)]
            called, touches = Counter[str](), 0
            for k in range(chosen.minutes):
                said = heard(specs[k], calms[k], 7000 + k, 60.0, loss, chosen.bursts, np.inf)
                touches += said.touches
                called[said.anomaly] += 1
            del called[""]
            after = np.array([
                heard(specs[k % hands], calms[k % hands], 8000 + k, 3.4, loss, chosen.bursts, 3.0).noticed
                for k in range(chosen.pushes)
            ])  # fmt: skip
            late = "" if not len(after) else (
                f"; {PUSH} N·m on a joint noticed in {np.mean(after <= 0.0401):.0%} in 40 ms, "
                f"{np.mean(after <= 0.4):.0%} in 400 ms, median {1e3 * np.median(after):.0f} ms"
            )  # fmt: skip
            print(
                f"noise {1e6 * noise:.0f} µrad, loss {loss:.1%}, bursts {chosen.bursts:.1%}: {chosen.minutes} minutes, "
                f"{touches} touches, names {dict(called)}{late}", flush=True,
            )  # fmt: skip


if __name__ == "__main__":
    main()
