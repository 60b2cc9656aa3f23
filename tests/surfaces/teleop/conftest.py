"""Hands that are led, and a retargeting that needs no library: each finger's own closed form."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.spec import HandSpec, Side
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.teleop.follower import HandFollower
from allegro_twin.surfaces.teleop.session import replay
from allegro_twin.surfaces.teleop.targets import FingertipTargets
from allegro_twin.surfaces.teleop.tracks import HandTrack
from allegro_twin.types import Array, Vector


def sim_config(side: Side = "right", **blocks: Any) -> RunConfig:
    return RunConfig.model_validate(
        {"hand": {"side": side}, "backend": {"kind": "sim"}, "controller": {"kind": "pid"}} | blocks
    )


def closed_form(spec: HandSpec) -> Callable[[Array], Vector]:
    """To each target from the palm its finger's nearest posture; what begins at the thumb is not looked at."""
    solvers = [ClosedFormFinger(spec, finger.name) for finger in spec.fingers]

    def retarget(targets: Array) -> Vector:
        posture = np.zeros(spec.n_joints)
        for finger, solver, target in zip(spec.fingers, solvers, targets, strict=False):
            middle = (solver.lower + solver.upper) / 2.0
            posture[list(finger.joints)] = solver.ik(target, near=middle).best(middle).posture
        return posture

    return retarget


class Led:
    """A hand that is led, what was said, and the joints' set-points and positions of every period."""

    def __init__(self, hand: Hand, follower: HandFollower, targets: FingertipTargets, said: list[str]) -> None:
        self.hand, self.follower, self.targets, self.said = hand, follower, targets, said
        self.rows: list[tuple[float, Vector]] = []
        hand.listen(lambda sample: self.rows.append((sample.state.t, sample.state.position)))

    def play(self, times: Vector, frames: Array) -> None:
        replay(self.hand, HandTrack(times, frames), self.follower)

    def at(self, t: float) -> Vector:
        """Where the joints were, (n,), rad, at a time since the track began."""
        return self.rows[int(np.searchsorted([row[0] for row in self.rows], t))][1]


@contextmanager
def led(config: RunConfig, tracked: Side = "right", **habits: Any) -> Iterator[Led]:
    """In the foreground: time passes as fast as it is computed, and repeats itself."""
    said: list[str] = []
    with Hand.open(config) as hand:
        targets = FingertipTargets(hand.spec, tracked)
        retarget = habits.pop("retarget", None) or closed_form(hand.spec)
        yield Led(hand, HandFollower(hand, targets, retarget, said.append, **habits), targets, said)
