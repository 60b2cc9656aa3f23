"""Multiple shooting: plays recorded commands into the model from many starts, and compares with the measurement.

A piece lasts some periods. Its start (positions and speeds) is unknown and is eliminated linearly, finger by finger.
Let r be the residuals of one finger in one piece, S their derivative by its start and Λ the uncertainty of a start.
Then Q from [S; Λ] = QR removes what a better start would explain, r ← r − QQᵀr, and the same from the derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from allegro_twin.kinematics.orientation import rotate_vector
from allegro_twin.sim.open_loop import BEFORE, HISTORY, DriveParameters, OpenLoopPlayer, Segments
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.fitting.parameterisation import PULLED
from allegro_twin.twin.identify.fitting.regress import smooth_duty, smooth_motion
from allegro_twin.twin.identify.motions.motion import RecordedMotion
from allegro_twin.types import Array, Vector


class Sensitivities:
    """Derivatives by finite differences, joint by joint the first time, then all joints at once.

    A joint responds mostly to its own parameters. What it takes from its finger's other joints, through the links,
    hardly changes on a descent. So the second time all joints are changed together, and the others' part of the first
    time is subtracted: one play of the model instead of four.
    """

    def __init__(self, fingers: list[list[int]]) -> None:
        longest = max(map(len, fingers))
        self._places = [[finger[place] for finger in fingers if place < len(finger)] for place in range(longest)]
        self._known: dict[str, list[Array]] = {}

    def derivatives(self, name: str, nudged: Callable[[list[int]], Array]) -> Iterator[Array]:
        """Yield derivatives (w, rows, n) by the parameter `name` of the first joint of each finger, of the second, …
        `nudged` gives the derivative by some joints together."""
        known = self._known.get(name)
        if known is None:
            self._known[name] = [nudged(joints) for joints in self._places]
        else:
            together = nudged([joint for joints in self._places for joint in joints])
            self._known[name] = [self._update(known, place, together) for place in range(len(known))]
        yield from self._known[name]

    def _update(self, known: list[Array], place: int, together: Array) -> Array:
        """Derivative by one place of all fingers: its own joints' part anew, the others' as it was."""
        own = self._places[place]
        others = sum((known[other][:, :, own] for other in range(len(known)) if other != place), np.float64(0.0))
        found = known[place].copy()
        found[:, :, own] = together[:, :, own] - others
        return found


LONG, SHORT = 99, 33
"""Periods of a piece. 0.3 s is long enough, since a wrong start is forgotten after armature / damping = 40 ms. In 0.1 s
a joint whose model is still wrong has hardly slipped where it should have stuck."""
MEAN = 3  # Periods whose residuals are averaged.
TRUSTED = 0.85  # Share of a piece's rows: with a frame in 33 lost one report in nine is.
START = {"position": 1e-3, "velocity": 0.2, "bend": 5e-4}
"""rad, rad/s, rad: standard deviation of a smoothed start; the last where friction has bristles."""
UNKNOWN = 0.15
"""Share of a far presliding displacement that its bend at a start is uncertain by, likewise. Ours."""
FURTHEST = 4.0
"""Times START: otherwise a model that is still wrong would explain itself by its starts."""
SHARES = (1.0, 0.4, 0.15)
"""Shares of a step of the starts, tried one after the other: friction is not linear."""
NUDGE = {
    "torque_constant": 0.02, "armature": 1e-4, "damping": 1.5e-3, "frictionloss": 5e-4, "offset": 5e-3, "delay": 3e-4,
    "mass_scale": 0.03,
    "stiction": 0.05, "stribeck_speed": 0.01, "bristle": 1e-4, "position": 5e-4, "velocity": 0.02, "bend": 1e-4,
    "load_friction": 0.01, "backlash": 2e-4,
    "bias_torque": 5e-4, "stiffness": 5e-4, "uneven_damping": 1.5e-3, "cogging_cosine": 5e-4, "cogging_sine": 5e-4,
    "ripple_cosine": 0.01, "ripple_sine": 0.01, "tilt": 2e-3,
    "cold_friction": 0.05, "gear_compliance": 0.005,
}  # fmt: skip
"""Steps of the finite differences: N·m, kg·m², N·m·s/rad, N·m, rad, s, 1, 1, rad/s, rad, rad, rad/s,
rad, 1, rad, N·m, N·m/rad, N·m·s/rad, N·m, N·m, 1, 1, rad, 1, rad/(N·m)."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionSegments:
    """Motions cut into pieces, w in all."""

    position: Array
    """Where each starts, as reported and smoothed, (w, n), rad."""
    velocity: Array
    """(w, n), rad/s."""
    segments: Segments
    measured: Array
    """(w, k, n), rad."""
    trust: Array
    """1 for fingers whose joints can all be trusted during a piece, (w, fingers)."""
    recording: Array
    """Index of each piece's motion, (w,)."""


KEPT_BACK = 0.2
"""Share of every motion, at its end, that a fit does not see: what a drive is worth shows there."""
SEEN, UNSEEN, WHOLE = (0.0, 1.0 - KEPT_BACK), (1.0 - KEPT_BACK, 1.0), (0.0, 1.0)


def cut_segments(
    motions: Sequence[RecordedMotion],
    spec: HandSpec,
    length: int = LONG,
    stride: int | None = None,
    part: tuple[float, float] = WHOLE,
) -> MotionSegments:
    """Cut a part of each motion into all whole pieces, `stride` rows apart; by default one after the other."""
    parts: list[list[Array]] = [[] for _ in range(12)]
    for number, motion in enumerate(motions):
        smooth, push = smooth_motion(motion), smooth_duty(motion)
        came = np.concatenate([np.zeros((HISTORY, spec.n_joints)), smooth.velocity])
        begin, end = (round(share * len(motion.position)) for share in part)
        for first in range(max(begin, BEFORE), end - length, stride or length):
            rows = slice(first + 1, first + 1 + length)
            good = motion.good[rows].mean(axis=0)
            trust = np.array([good[list(f.joints)].min() >= TRUSTED for f in spec.fingers], dtype=float)
            found = (
                smooth.position[first], smooth.velocity[first], motion.duty[first + 1 - BEFORE : first + 1 + length],
                motion.gravity, motion.weight, smooth.acceleration[first], push[first - BEFORE : first + 1],
                np.array(first * motion.period), came[first : first + HISTORY],
                motion.position[rows], trust, np.array(number),
            )  # fmt: skip
            for column, value in zip(parts, found, strict=True):
                column.append(value)
    arrays = [np.array(part) for part in parts]
    return MotionSegments(arrays[0], arrays[1], Segments(*arrays[2:9]), *arrays[9:])


class Shooting:
    """Residuals of motion pieces, and their derivatives."""

    def __init__(self, player: OpenLoopPlayer, cuts: MotionSegments, sigma: Vector, give: float = 0.0) -> None:
        """`sigma`: noise of the reported positions, (n,), rad; `give`: about how far friction gives before it slides,
        rad, where that is far."""
        self._player, self._cuts = player, cuts
        self._start = START | {"bend": max(START["bend"], UNKNOWN * give)}
        self._fingers = [list(finger.joints) for finger in player.spec.fingers]
        self._sigma = sigma / np.sqrt(MEAN)
        self.moments: int = cuts.measured.shape[1] // MEAN
        """Rows of a piece's residuals."""
        self._states = ("position", "velocity", "bend") if player.bristly else ("position", "velocity")
        self._off = np.zeros((3, *cuts.position.shape))  # Displacement of the starts, as in START.
        self._furthest = FURTHEST * np.array(list(self._start.values()))[:, None, None]
        self._bases: list[Array] = []
        self._answers = Sensitivities(self._fingers)

    def residuals(self, drive: DriveParameters, player: OpenLoopPlayer | None = None) -> Array:
        """Predicted minus measured, averaged, in standard deviations of the noise, (w, rows, n); 0 where untrusted."""
        return self._means(self._play(drive, self._off, player) - self._cuts.measured)

    def prepare(self, drive: DriveParameters) -> None:
        """Derive the residuals by the starts, near `drive`."""
        base = self.residuals(drive)

        def nudged(which: int, joints: list[int]) -> Array:
            off, name = self._off.copy(), self._states[which]
            off[which][:, joints] += NUDGE[name]
            change = self._means(self._play(drive, off, None) - self._cuts.measured) - base
            return np.asarray(change / NUDGE[name] * self._start[name])

        each = [self._answers.derivatives(name, partial(nudged, which)) for which, name in enumerate(self._states)]
        starts = [answer for place in zip(*each, strict=True) for answer in place]
        self._bases, self._solvers = [], []
        for finger in self._fingers:
            S = np.stack([each[:, :, finger] for each in starts[: len(self._states) * len(finger)]], axis=-1)
            S = S.reshape(len(S), -1, S.shape[-1])  # (w, rows · joints, starts)
            prior = np.broadcast_to(np.eye(S.shape[-1]), (len(S), S.shape[-1], S.shape[-1]))
            Q, R = np.linalg.qr(np.concatenate([S, prior], axis=1))
            self._bases.append(Q)
            self._solvers.append(np.linalg.inv(R))

    def reset_sensitivities(self) -> None:
        """Find derivatives joint by joint again, the next time."""
        self._answers = Sensitivities(self._fingers)

    def improve_starts(self, drive: DriveParameters) -> None:
        """Move the starts to where the residuals are least, for each finger and piece only as far as that helps."""
        residual, before = self.residuals(drive), self._off.copy()
        costs, steps = self._costs(residual), self._steps(residual)
        left = np.ones(costs.shape, dtype=bool)  # Pieces and fingers whose step is not found yet.
        for share in SHARES:
            for number, finger in enumerate(self._fingers):
                rows = np.ix_(np.arange(3), np.flatnonzero(left[:, number]), np.array(finger))
                self._off[rows] = (before + share * steps)[rows]
            self._off = np.clip(self._off, -self._furthest, self._furthest)
            left &= self._costs(self.residuals(drive)) > costs
            if not left.any():
                return
        for number, finger in enumerate(self._fingers):
            rows = np.ix_(np.arange(3), np.flatnonzero(left[:, number]), np.array(finger))
            self._off[rows] = before[rows]

    def _steps(self, residual: Array) -> Array:
        """Steps of the starts in the linear model, (3, w, n)."""
        found = np.zeros_like(self._off)
        for finger, Q, inverse in zip(self._fingers, self._bases, self._solvers, strict=True):
            step = -np.einsum("wij,wj->wi", inverse, _within(Q, self._augmented(residual, finger)))  # (w, starts)
            for place, joint in enumerate(finger):
                for which, name in enumerate(self._states):
                    found[which][:, joint] = self._start[name] * step[:, len(self._states) * place + which]
        return found

    def _costs(self, residual: Array) -> Array:
        """Σ r² of every finger in every piece, (w, fingers)."""
        return np.stack([np.square(self._augmented(residual, f)).sum(axis=1) for f in self._fingers], axis=1)

    def project(self, values: Array, finger: int, *, start: bool = False) -> Array:
        """The part of residuals or of a derivative (w, rows, n) that no start explains, for one finger, (w, m).
        `start`: include the distance of the starts from the smoothed ones."""
        joints, Q = self._fingers[finger], self._bases[finger]
        r = self._augmented(values, joints, start)
        return np.asarray(r - np.matmul(Q, _within(Q, r)[..., None])[..., 0])

    def rows(self, finger: list[int]) -> int:
        """Number of a finger's residuals in one piece."""
        return (self.moments + len(self._states)) * len(finger)

    def derivatives(self, drive: DriveParameters, base: Array, name: str) -> Iterator[Array]:
        """Derivatives by one parameter of the first joint of every finger at once, (w, rows, n), per unit, of the
        second, … By `torque_constant`: with what is determined per torque constant in proportion. By `load_friction`:
        with k (1 − μ) constant. `base`: residuals of the same drive."""
        return self._answers.derivatives(
            name, lambda joints: (self.residuals(_nudge(drive, name, joints)) - base) / NUDGE[name]
        )

    def delay_derivative(self, drive: DriveParameters, base: Array) -> Array:
        """Derivative by the delay, likewise."""
        everywhere = replace(drive, delay=drive.delay + NUDGE["delay"])
        return (self.residuals(everywhere) - base) / NUDGE["delay"]

    def tilt_derivatives(self, drive: DriveParameters, base: Array) -> Iterator[Array]:
        """Derivatives by the tilt of each recording, about each axis, likewise: each recording's in its own pieces."""
        axes = []
        for axis in range(3):
            tilt = drive.tilt.copy()
            tilt[:, axis] += NUDGE["tilt"]
            axes.append((self.residuals(replace(drive, tilt=tilt)) - base) / NUDGE["tilt"])
        for number in range(len(drive.tilt)):
            own = (self._cuts.recording == number)[:, None, None]
            yield from (np.where(own, each, 0.0) for each in axes)

    def _play(self, drive: DriveParameters, off: Array, player: OpenLoopPlayer | None) -> Array:
        cuts = self._cuts
        played, pieces = (player or self._player).play, cuts.segments
        if len(drive.tilt):
            pieces = pieces._replace(gravity=rotate_vector(pieces.gravity, drive.tilt[cuts.recording]))
        return played(drive, cuts.position + off[0], cuts.velocity + off[1], pieces, off[2])

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
                    off[:, len(self._states) * place + which] = self._off[which][:, joint] / self._start[name]
        return np.concatenate([own, off], axis=1)


def _nudge(drive: DriveParameters, name: str, joints: list[int]) -> DriveParameters:
    nudged = drive.changed(name, joints, NUDGE[name])
    if name == "torque_constant":
        by = nudged.torque_constant / drive.torque_constant
        return replace(nudged, **{each: by * getattr(drive, each) for each in PULLED})
    if name == "load_friction":
        pulls = drive.torque_constant * (1.0 - drive.load_friction) / (1.0 - nudged.load_friction)
        return replace(nudged, torque_constant=pulls)
    return nudged


def _within(Q: Array, r: Array) -> Array:
    """Qᵀr of every piece, (w, starts)."""
    return np.asarray(np.matmul(r[:, None, :], Q)[:, 0])
