"""Output error: the drive with which the model, given the recorded commands, moves as the hand did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from allegro_twin.identify.motion import Motion, noise_floor
from allegro_twin.identify.shooting import PIECE, Shooting, cut
from allegro_twin.sim.windows import Parameters, Player
from allegro_twin.types import Array, Vector

MASS_SPREAD, MASS_SCALE = 0.06, 0.16
"""Standard deviations of a link's mass about the model's: each by itself, and all of a finger together. Two sources for a
finger's mass, the drawing's 0.1466 kg and the manual's 0.17 kg, are 16 % apart."""
_KNOWN = 1e-4  # Of masses that are known.
_UNITS = {
    "torque_constant": 0.1, "armature": 3e-4, "damping": 5e-3, "frictionloss": 5e-3, "offset": 0.01, "mass_scale": 0.05,
    "delay": 1e-3,
}  # fmt: skip
"""About how far each may change: N·m, kg·m², N·m·s/rad, N·m, rad, 1, s."""
_PRIOR = {"torque_constant": 0.6, "armature": 6e-3, "damping": 0.15, "frictionloss": 0.1, "offset": 0.1, "delay": 0.02}
"""Standard deviations about the nominal drive, so wide that data which say anything outweigh them."""
_LEAST = {"torque_constant": 0.05, "armature": 1e-5, "damping": 0.0, "frictionloss": 0.0, "offset": -0.5, "mass_scale": 0.3,
          "delay": 0.0}  # fmt: skip
NAMES = ("torque_constant", "armature", "damping", "frictionloss", "offset", "mass_scale")
COARSE = 3
"""First only every third piece."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """What came out. Rows of `derivative` are whitened residuals, one piece and finger after the other."""

    drive: Parameters
    start: Parameters
    """Of the regression."""
    covariance: Array
    """Of the parameters in the order of `index`, in their own units, from the spread over the pieces."""
    information: Array
    """What the data alone say, JᵀJ in whitened units."""
    by_recording: Array
    """What each recording, left out, would change, (recordings, p)."""
    step: Array
    """What halving the time step would change, (p,)."""
    residual: Vector
    """Root mean square of the residuals of every joint in standard deviations of the noise, (n,)."""
    floor: Vector
    """Noise of the reported positions, (n,), rad."""
    pieces: int

    def sd(self, name: str) -> Vector:
        """Standard deviations of one kind of parameter, (n,) or (1,) for the delay."""
        return np.sqrt(np.diag(self.covariance))[index(name, len(self.residual))]


def index(name: str, n: int) -> slice:
    """Where one kind of parameter stands: n values each, the delay last."""
    if name == "delay":
        return slice(len(NAMES) * n, len(NAMES) * n + 1)
    first = NAMES.index(name) * n
    return slice(first, first + n)


def fit(motions: list[Motion], player: Player, start: Parameters, nominal: Parameters, *, known: bool) -> Fit:
    """`known`: the masses of `start` are right. Otherwise they may be off, all joints of a finger together, too."""
    floor = np.median([noise_floor(motion) for motion in motions], axis=0)
    drive = start
    for every in (COARSE, 1):
        problem = _Problem(motions, player, floor, drive, nominal, every, known=known)
        problem.shooting.prepare(drive)
        problem.shooting.better_starts(drive)
        jacobian = problem.jacobian if every > 1 else cache(problem.jacobian, problem.x_of(drive))
        found = least_squares(
            problem.residuals, problem.x_of(drive), jacobian, bounds=(problem.least, np.inf), max_nfev=4, xtol=1e-4,
            ftol=1e-6,
        )  # fmt: skip
        drive = problem.drive_of(found.x)
    return problem.conclude(drive, start, found.jac, found.fun, floor)


def cache(jacobian: Callable[[Vector], Array], x: Vector) -> Callable[[Vector], Array]:
    """The derivatives at one point for all: near the solution they hardly change, and cost all the time."""
    found = jacobian(x)
    return lambda _: found


class _Problem:
    """The least-squares problem in scaled parameters: data rows first, prior rows after them."""

    def __init__(
        self,
        motions: list[Motion],
        player: Player,
        floor: Vector,
        start: Parameters,
        nominal: Parameters,
        every: int,
        *,
        known: bool,
    ) -> None:
        self._player, self._motions = player, motions
        self._n, self._fingers = player.spec.n_joints, [list(f.joints) for f in player.spec.fingers]
        self._cuts = cut(motions, player.spec, stride=every * PIECE)
        self._names = tuple(name for name in NAMES if name != "mass_scale" or not known)
        self.shooting = Shooting(player, self._cuts, floor)
        self._unit = np.concatenate([np.full(self._n, _UNITS[name]) for name in NAMES] + [[_UNITS["delay"]]])
        self.least = np.concatenate([np.full(self._n, _LEAST[name]) for name in NAMES] + [[0.0]]) / self._unit
        self._center = self.x_of(replace(nominal, mass_scale=start.mass_scale, offset=np.zeros(self._n)))
        self._prior = self._prior_rows(known)

    def x_of(self, drive: Parameters) -> Vector:
        values = [getattr(drive, name) for name in NAMES] + [drive.delay[:1]]
        return np.asarray(np.concatenate(values) / self._unit)

    def drive_of(self, x: Vector) -> Parameters:
        values = x * self._unit
        rows = {name: values[index(name, self._n)] for name in NAMES}
        return Parameters(**rows, delay=np.full(self._n, values[-1]))

    def residuals(self, x: Vector) -> Vector:
        raw = self.shooting.raw(self.drive_of(x))
        data = [self.shooting.projected(raw, f, start=True).ravel() for f in range(len(self._fingers))]
        return np.concatenate([*data, self._prior @ (x - self._center)])

    def jacobian(self, x: Vector) -> Array:
        drive = self.drive_of(x)
        base = self.shooting.raw(drive)
        places = max(map(len, self._fingers))
        rows = [self.shooting.projected(base, f).size for f in range(len(self._fingers))]
        found = np.zeros((sum(rows) + len(self._prior), len(x)))
        first = np.concatenate([[0], np.cumsum(rows)])
        for name in self._names:
            for place in range(places):
                change = self.shooting.derivative(drive, base, name, place)
                for f, finger in enumerate(self._fingers):
                    if place < len(finger):
                        column = index(name, self._n).start + finger[place]
                        own = self.shooting.projected(change, f).ravel()
                        found[first[f] : first[f + 1], column] = own * self._unit[column]
        change = self.shooting.late(drive, base)
        for f in range(len(self._fingers)):
            found[first[f] : first[f + 1], -1] = self.shooting.projected(change, f).ravel() * self._unit[-1]
        found[first[-1] :] = self._prior
        return found

    def conclude(self, drive: Parameters, start: Parameters, jac: Array, fun: Vector, floor: Vector) -> Fit:
        """From the last derivatives: spreads over pieces and recordings, and what the time step does."""
        data = len(fun) - len(self._prior)
        J, r, w = jac[:data], fun[:data], len(self._cuts.recording)
        information = J.T @ J
        inverse = np.linalg.inv(information + self._prior.T @ self._prior)
        gradient = self._by_piece(J, r)  # (w, p)
        noise = max(float(r @ r) / max(data - len(inverse), 1), 1e-12)
        clustered = inverse @ (gradient.T @ gradient) @ inverse * w / max(w - 1, 1)
        naive = inverse * max(noise, 1.0)
        covariance = np.maximum(np.sqrt(np.diag(clustered)), np.sqrt(np.diag(naive)))
        scale = covariance / np.sqrt(np.diag(naive))
        left = np.array([self._without(J, r, inverse, k) for k in np.unique(self._cuts.recording)])
        finer = Player(self._player.spec, self._motions[0].period, timestep=0.0005)
        raw, fine = self.shooting.raw(drive), self.shooting.raw(drive, finer)
        change = np.concatenate([self.shooting.projected(fine - raw, f).ravel() for f in range(len(self._fingers))])
        step = -inverse @ (J.T @ change)
        residual = np.sqrt(np.array([self._rms(r, joint) for joint in range(self._n)]))
        return Fit(
            drive, start, naive * np.outer(scale, scale) * np.outer(self._unit, self._unit), information,
            left * self._unit, step * self._unit, residual, floor, w,
        )  # fmt: skip

    def _by_piece(self, J: Array, r: Vector) -> Array:
        w, first = len(self._cuts.recording), 0
        total = np.zeros((w, J.shape[1]))
        for finger in range(len(self._fingers)):
            rows = self.shooting.projected(np.zeros((w, 33, self._n)), finger).size
            part = slice(first, first + rows)
            total += np.einsum("wmp,wm->wp", J[part].reshape(w, -1, J.shape[1]), r[part].reshape(w, -1))
            first += rows
        return total

    def _without(self, J: Array, r: Vector, inverse: Array, number: int) -> Vector:
        """The change of the parameters when one recording is left out, to first order."""
        w = len(self._cuts.recording)
        chosen, H, g, first = self._cuts.recording == number, np.linalg.inv(inverse), np.zeros(J.shape[1]), 0
        for finger in range(len(self._fingers)):
            rows = self.shooting.projected(np.zeros((w, 33, self._n)), finger).size
            part = slice(first, first + rows)
            own = J[part].reshape(w, -1, J.shape[1])[chosen].reshape(-1, J.shape[1])
            H = H - own.T @ own
            g += own.T @ r[part].reshape(w, -1)[chosen].ravel()
            first += rows
        return np.asarray(np.linalg.solve(H, g))

    def _rms(self, r: Vector, joint: int) -> float:
        w, first = len(self._cuts.recording), 0
        for finger in self._fingers:
            rows = 33 * len(finger) + 2 * len(finger)
            if joint in finger:
                own = r[first : first + w * rows].reshape(w, rows)[:, : 33 * len(finger)]
                return float(np.square(own.reshape(w, 33, len(finger))[:, :, finger.index(joint)]).mean())
            first += w * rows
        return float("nan")

    def _prior_rows(self, known: bool) -> Array:
        """L⁻¹ of the prior's covariance, in scaled parameters."""
        n, size = self._n, len(self._unit)
        covariance = np.zeros((size, size))
        for name in (*NAMES, "delay"):
            part = index(name, n)
            if name != "mass_scale":
                covariance[part, part] = np.eye(part.stop - part.start) * _PRIOR[name] ** 2
        masses = index("mass_scale", n)
        covariance[masses, masses] = np.eye(n) * (_KNOWN if known else MASS_SPREAD) ** 2
        if not known:
            for finger in self._fingers:
                rows = np.array(finger) + masses.start
                covariance[np.ix_(rows, rows)] += MASS_SCALE**2
        whole = covariance / np.outer(self._unit, self._unit)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(whole)))
