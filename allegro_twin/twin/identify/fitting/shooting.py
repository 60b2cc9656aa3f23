"""Multiple shooting: recorded commands played into the model from many starts, and what is left of the measurement.

A piece lasts some periods; its start (positions and speeds) is unknown and is eliminated linearly, finger by finger:
with r the residuals of one finger in one piece, S their derivative by its start and Λ how far a start may be off,
Q from [S; Λ] = QR takes away what a better start would explain, r ← r − QQᵀr, and the same from the derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from allegro_twin.sim.open_loop.segments import BEFORE, Parameters, Pieces
from allegro_twin.sim.open_loop.windows import Player
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.fitting.regress import pushes, smoothed
from allegro_twin.twin.identify.motions.motion import Motion
from allegro_twin.types import Array, Vector


class Answers:
    """Derivatives by kinds of nudges, as they were found last."""

    def __init__(self, fingers: list[list[int]]) -> None:
        longest = max(map(len, fingers))
        self._places = [[finger[place] for finger in fingers if place < len(finger)] for place in range(longest)]
        self._known: dict[str, list[Array]] = {}

    def of(self, name: str, nudged: Callable[[list[int]], Array]) -> Iterator[Array]:
        """Derivatives (w, rows, n) by what is called `name` of the first joint of each finger, the second, …; `nudged`
        gives the one by that of some joints together."""
        known = self._known.get(name)
        if known is None:
            self._known[name] = [nudged(joints) for joints in self._places]
        else:
            together = nudged([joint for joints in self._places for joint in joints])
            self._known[name] = [self._renewed(known, place, together) for place in range(len(known))]
        yield from self._known[name]

    def _renewed(self, known: list[Array], place: int, together: Array) -> Array:
        """By one place: its own joints' answer anew, the others' as it was."""
        own = self._places[place]
        others = sum((known[other][:, :, own] for other in range(len(known)) if other != place), np.float64(0.0))
        found = known[place].copy()
        found[:, :, own] = together[:, :, own] - others
        return found


LONG, SHORT = 99, 33
"""Periods of a piece: 0.3 s, long enough, since a wrong start is forgotten after armature / damping = 40 ms; and 0.1 s,
in which a joint whose model is still wrong has hardly slipped where it should have stuck: for where that is so."""
MEAN = 3  # Periods whose residuals are averaged.
TRUSTED = 0.9  # Of the rows of a piece.
START = {"position": 1e-3, "velocity": 0.2, "bend": 5e-4}
"""rad, rad/s, rad: how far a smoothed start may be off; the last where friction has bristles."""
FURTHEST = 4.0
"""Times that: a model that is still wrong would explain itself by starts."""
SHARES = (1.0, 0.4, 0.15)
"""Of a step of the starts, tried one after the other: friction is not linear."""
NUDGE = {
    "torque_constant": 0.02, "armature": 1e-4, "damping": 1.5e-3, "frictionloss": 5e-4, "offset": 5e-3, "delay": 3e-4,
    "mass_scale": 0.03,
    "stiction": 0.05, "stribeck_speed": 0.01, "bristle": 1e-4, "position": 5e-4, "velocity": 0.02, "bend": 1e-4,
    "load_friction": 0.01, "backlash": 2e-4,
}  # fmt: skip
"""Steps of the finite differences: N·m, kg·m², N·m·s/rad, N·m, rad, s, 1, 1, rad/s, rad, rad, rad/s,
rad, 1, rad."""


@dataclass(frozen=True, slots=True, eq=False)
class Cuts:
    """Motions cut into pieces, w in all."""

    position: Array
    """Where each starts, as reported and smoothed, (w, n), rad."""
    velocity: Array
    """(w, n), rad/s."""
    pieces: Pieces
    measured: Array
    """(w, k, n), rad."""
    trust: Array
    """1 for fingers whose every joint can be trusted during a piece, (w, fingers)."""
    recording: Array
    """Which motion each is of, (w,)."""


def cut(motions: list[Motion], spec: HandSpec, length: int = LONG, stride: int | None = None) -> Cuts:
    """All whole pieces, `stride` rows apart; by default one after the other."""
    parts: list[list[Array]] = [[] for _ in range(10)]
    for number, motion in enumerate(motions):
        smooth, push = smoothed(motion), pushes(motion)
        for first in range(BEFORE, len(motion.position) - length, stride or length):
            rows = slice(first + 1, first + 1 + length)
            good = motion.good[rows].mean(axis=0)
            trust = np.array([good[list(f.joints)].min() >= TRUSTED for f in spec.fingers], dtype=float)
            found = (
                smooth.position[first], smooth.velocity[first], motion.duty[first + 1 - BEFORE : first + 1 + length],
                motion.gravity, motion.weight, smooth.acceleration[first], push[first - BEFORE : first + 1],
                motion.position[rows], trust, np.array(number),
            )  # fmt: skip
            for part, value in zip(parts, found, strict=True):
                part.append(value)
    arrays = [np.array(part) for part in parts]
    return Cuts(arrays[0], arrays[1], Pieces(*arrays[2:7]), *arrays[7:])


class Shooting:
    """The residuals of some cuts, and their derivatives."""

    def __init__(self, player: Player, cuts: Cuts, sigma: Vector) -> None:
        self._player, self._cuts = player, cuts
        self._fingers = [list(finger.joints) for finger in player.spec.fingers]
        self._sigma = sigma / np.sqrt(MEAN)
        self.moments: int = cuts.measured.shape[1] // MEAN
        """Rows of a piece's residuals."""
        self._states = ("position", "velocity", "bend") if player.bristly else ("position", "velocity")
        self._off = np.zeros((3, *cuts.position.shape))  # How far the starts were moved, as in START.
        self._furthest = FURTHEST * np.array([START[name] for name in START])[:, None, None]
        self._bases: list[Array] = []
        self._answers = Answers(self._fingers)

    def raw(self, drive: Parameters, player: Player | None = None) -> Array:
        """Predicted minus measured, averaged, in standard deviations of the noise, (w, rows, n); 0 where untrusted."""
        return self._means(self._play(drive, self._off, player) - self._cuts.measured)

    def prepare(self, drive: Parameters) -> None:
        """Find out what the starts do, near `drive`."""
        base = self.raw(drive)

        def nudged(which: int, joints: list[int]) -> Array:
            off, name = self._off.copy(), self._states[which]
            off[which][:, joints] += NUDGE[name]
            change = self._means(self._play(drive, off, None) - self._cuts.measured) - base
            return np.asarray(change / NUDGE[name] * START[name])

        each = [self._answers.of(name, partial(nudged, which)) for which, name in enumerate(self._states)]
        starts = [answer for place in zip(*each, strict=True) for answer in place]
        self._bases, self._solvers = [], []
        for finger in self._fingers:
            S = np.stack([each[:, :, finger] for each in starts[: len(self._states) * len(finger)]], axis=-1)
            S = S.reshape(len(S), -1, S.shape[-1])  # (w, rows · joints, starts)
            prior = np.broadcast_to(np.eye(S.shape[-1]), (len(S), S.shape[-1], S.shape[-1]))
            Q, R = np.linalg.qr(np.concatenate([S, prior], axis=1))
            self._bases.append(Q)
            self._solvers.append(np.linalg.inv(R))

    def forget(self) -> None:
        """Derivatives are to be found by one joint of a finger after the other again."""
        self._answers = Answers(self._fingers)

    def better_starts(self, drive: Parameters) -> None:
        """Move the starts to where the residuals are least, each finger's in each piece only as far as that is so."""
        residual, before = self.raw(drive), self._off.copy()
        costs, steps = self._costs(residual), self._steps(residual)
        left = np.ones(costs.shape, dtype=bool)  # Of which pieces and fingers a step is still looked for.
        for share in SHARES:
            for number, finger in enumerate(self._fingers):
                rows = np.ix_(np.arange(3), np.flatnonzero(left[:, number]), np.array(finger))
                self._off[rows] = (before + share * steps)[rows]
            self._off = np.clip(self._off, -self._furthest, self._furthest)
            left &= self._costs(self.raw(drive)) > costs
            if not left.any():
                return
        for number, finger in enumerate(self._fingers):
            rows = np.ix_(np.arange(3), np.flatnonzero(left[:, number]), np.array(finger))
            self._off[rows] = before[rows]

    def _steps(self, residual: Array) -> Array:
        """What linear starts would be moved by, (3, w, n)."""
        found = np.zeros_like(self._off)
        for finger, Q, inverse in zip(self._fingers, self._bases, self._solvers, strict=True):
            step = -np.einsum("wij,wj->wi", inverse, _within(Q, self._augmented(residual, finger)))  # (w, starts)
            for place, joint in enumerate(finger):
                for which, name in enumerate(self._states):
                    found[which][:, joint] = START[name] * step[:, len(self._states) * place + which]
        return found

    def _costs(self, residual: Array) -> Array:
        """Σ r² of every finger in every piece, (w, fingers)."""
        return np.stack([np.square(self._augmented(residual, f)).sum(axis=1) for f in self._fingers], axis=1)

    def projected(self, values: Array, finger: int, *, start: bool = False) -> Array:
        """What no start explains of residuals or of a derivative (w, rows, n), for one finger, (w, m). `start`: the
        distance of the starts from the smoothed ones counts, too."""
        joints, Q = self._fingers[finger], self._bases[finger]
        r = self._augmented(values, joints, start)
        return np.asarray(r - np.matmul(Q, _within(Q, r)[..., None])[..., 0])

    def rows(self, finger: list[int]) -> int:
        """Of a finger's residuals in one piece."""
        return (self.moments + len(self._states)) * len(finger)

    def derivatives(self, drive: Parameters, base: Array, name: str) -> Iterator[Array]:
        """By one parameter of the first joint of every finger at once, (w, rows, n), per unit, of the second, …; by
        `torque_constant` with armature, damping and friction in proportion, by `load_friction` with k (1 − μ) as it
        is. `base`: of the same drive."""
        return self._answers.of(name, lambda joints: (self.raw(_nudged(drive, name, joints)) - base) / NUDGE[name])

    def late(self, drive: Parameters, base: Array) -> Array:
        """By the delay, likewise."""
        everywhere = replace(drive, delay=drive.delay + NUDGE["delay"])
        return (self.raw(everywhere) - base) / NUDGE["delay"]

    def _play(self, drive: Parameters, off: Array, player: Player | None) -> Array:
        cuts = self._cuts
        played = (player or self._player).play
        return played(drive, cuts.position + off[0], cuts.velocity + off[1], cuts.pieces, off[2])

    def _means(self, residual: Array) -> Array:
        w, k, n = residual.shape
        trust = np.zeros((w, n))
        for number, finger in enumerate(self._fingers):
            trust[:, finger] = self._cuts.trust[:, number, None]
        return np.asarray(residual.reshape(w, k // MEAN, MEAN, n).mean(axis=2) / self._sigma * trust[:, None])

    def _augmented(self, values: Array, finger: list[int], start: bool = True) -> Array:
        w = len(values)
        own = values[:, :, finger].reshape(w, -1)
        off = np.zeros((w, len(self._states) * len(finger)))
        if start:
            for place, joint in enumerate(finger):
                for which, name in enumerate(self._states):
                    off[:, len(self._states) * place + which] = self._off[which][:, joint] / START[name]
        return np.concatenate([own, off], axis=1)


def _nudged(drive: Parameters, name: str, joints: list[int]) -> Parameters:
    nudged = drive.changed(name, joints, NUDGE[name])
    if name == "torque_constant":
        by = nudged.torque_constant / drive.torque_constant
        return replace(
            nudged, armature=by * drive.armature, damping=by * drive.damping, frictionloss=by * drive.frictionloss
        )
    if name == "load_friction":
        pulls = drive.torque_constant * (1.0 - drive.load_friction) / (1.0 - nudged.load_friction)
        return replace(nudged, torque_constant=pulls)
    return nudged


def _within(Q: Array, r: Array) -> Array:
    """Qᵀr of every piece, (w, starts)."""
    return np.asarray(np.matmul(r[:, None, :], Q)[:, 0])
