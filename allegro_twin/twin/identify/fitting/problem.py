"""Least-squares problem of identification: scaled parameters, data rows first, prior rows after them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.sim.open_loop import DriveParameters, OpenLoopPlayer
from allegro_twin.twin.identify.fitting.extra_terms import EXTRA, NO_EXTRAS, ExtraTerms
from allegro_twin.twin.identify.fitting.parameterisation import (
    ALL,
    PLAY,
    PULLED,
    SHAPE,
    TEETH,
    from_scaled,
    index,
    lower_bounds,
    to_scaled,
    units,
)
from allegro_twin.twin.identify.fitting.regress import LOAD
from allegro_twin.twin.identify.fitting.shooting import LONG, SEEN, Shooting, cut_segments
from allegro_twin.twin.identify.motions.motion import RecordedMotion
from allegro_twin.types import Array, Vector

Masses: TypeAlias = Literal["known", "assumed", "weighed"]
"""Link masses: as given; as in the model, for want of better; or found with a known weight at a fingertip."""
MASS_SPREAD, MASS_SCALE = 0.06, 0.16
"""Standard deviations of a link's mass about the model's: each by itself, and all of a finger together. Two sources for
a finger's mass, the drawing's 0.1466 kg and the manual's 0.17 kg, differ by 16 %."""
PRIOR = {
    "torque_constant": 0.6, "armature": 6e-3, "damping": 0.15, "frictionloss": 0.1, "offset": 0.05, "delay": 0.02,
    "stiction": 1.0, "stribeck_speed": 0.15, "bristle": 3e-3,
    "load_friction": LOAD[1], "backlash": 5e-3,
    "bias_torque": 0.03, "stiffness": 0.03, "uneven_damping": 0.05, "cogging_cosine": 0.02, "cogging_sine": 0.02,
    "ripple_cosine": 0.1, "ripple_sine": 0.1, "cold_friction": 0.5, "gear_compliance": 0.1,
}  # fmt: skip
"""Standard deviations about the nominal drive, so wide that any informative data outweigh them."""
TILT_OF_ALL, TILT_OF_EACH = 0.05, 0.02
"""rad: of a palm that is mounted askew, the same in all recordings; and of one that lies otherwise in each."""
_KNOWN = 1e-4  # Of masses that are fixed.


class Problem:
    """The problem of some motions, with every `every`-th piece of `length` periods."""

    x_of = staticmethod(to_scaled)
    """Scaled parameters of a drive."""

    def __init__(
        self,
        motions: list[RecordedMotion],
        player: OpenLoopPlayer,
        floor: Vector,
        nominal: DriveParameters,
        masses: Masses,
        every: int = 1,
        length: int = LONG,
        extras: ExtraTerms = NO_EXTRAS,
        *,
        elastic: bool = False,
        far: bool = False,
        residual: Vector | None = None,
    ) -> None:
        """`nominal`: the center of the prior; `extras`: terms that some joints have besides; `elastic`: teeth bend;
        `far`: friction gives far before it slides. `residual`, (n,): how many times the noise is left of each joint,
        where the model errs; 1 where it does not. Such an error is one a piece and not one a residual, and tells that
        much less beside what was known before."""
        self.elastic = elastic
        self.player, self.motions, self._masses = player, motions, masses
        self.n, self.fingers = player.spec.n_joints, [list(f.joints) for f in player.spec.fingers]
        self.cuts = cut_segments(motions, player.spec, length, every * length, SEEN)
        give = float(np.median(nominal.bristle)) if far else 0.0
        self.shooting = Shooting(player, self.cuts, floor, give)
        self.extras, tilted = extras, len(motions) if extras.tilted else 0
        self._like = extras.begin(nominal, len(motions))
        self.unit, self.least = units(self.n, tilted), lower_bounds(self.n, tilted)
        moving = [name for name in (*ALL, "delay", "tilt") if self._moves(name)]
        free = np.zeros(len(self.unit), dtype=bool)
        for name in moving:
            free[index(name, self.n)] = extras.of_joints(name, self.n) if name in EXTRA else True
        self.active = np.flatnonzero(free)
        """Indices of free parameters."""
        self.shared = np.arange(len(ALL) * self.n, len(self.unit))
        """Indices of what all fingers share: the delay, then the tilt if the palm leans."""
        self._center = to_scaled(self._like)
        self.known = self._prior_rows(np.ones(self.n))
        """What was known before, as rows of residuals in standard deviations."""
        self.prior = self.known
        """Rows of `known` with the weight that they have beside the data."""
        if residual is not None:
            self.prior = self._prior_rows(np.where(residual > 1.0, residual * np.sqrt(self.shooting.moments), 1.0))

    def drive_of(self, x: Vector) -> DriveParameters:
        """Inverse of `x_of`."""
        return from_scaled(x, self._like)

    def residuals(self, x: Vector) -> Vector:
        return np.concatenate(
            [self.flat(self.shooting.residuals(self.drive_of(x)), start=True), self.prior @ (x - self._center)]
        )

    def jacobian(self, x: Vector) -> Array:
        """Derivatives of `residuals`; those by fixed masses are zero."""
        drive = self.drive_of(x)
        base = self.shooting.residuals(drive)
        found = np.zeros((self.flat(base).size + len(self.prior), len(x)))
        for name in ALL:
            if self._moves(name):
                self.write_derivatives(drive, base, name, found)
        data = len(found) - len(self.prior)
        late = index("delay", self.n)
        found[:data, late] = (self.flat(self.shooting.delay_derivative(drive, base)) * self.unit[late])[:, None]
        if len(drive.tilt):
            tilts = index("tilt", self.n)
            for column, change in enumerate(self.shooting.tilt_derivatives(drive, base), tilts.start):
                found[:data, column] = self.flat(change) * self.unit[column]
        found[:data, index("torque_constant", self.n)] /= 1.0 - drive.load_friction
        for name in PULLED:
            found[:data, index(name, self.n)] *= drive.torque_constant * (1.0 - drive.load_friction)
        found[:data, np.setdiff1d(np.arange(len(x)), self.active)] = 0.0
        found[data:] = self.prior
        return found

    def _moves(self, name: str) -> bool:
        if name in SHAPE:
            return self.player.bristly
        if name in TEETH:
            return self.elastic
        if name in PLAY:
            return self.player.loose
        if name in EXTRA:
            return bool(self.extras.of_joints(name, self.n).any())
        if name == "tilt":
            return self.extras.tilted
        return name != "mass_scale" or self._masses == "weighed"

    def write_derivatives(self, drive: DriveParameters, base: Array, name: str, into: Array) -> None:
        """Write the derivatives by one kind of parameter into their rows and columns."""
        for place, change in enumerate(self.shooting.derivatives(drive, base, name)):
            for finger, rows in self.parts():
                if place < len(self.fingers[finger]):
                    column = index(name, self.n).start + self.fingers[finger][place]
                    into[rows, column] = self.shooting.project(change, finger).ravel() * self.unit[column]

    def columns(self, finger: int) -> NDArray[np.int_]:
        """A finger's own parameters, all but the delay."""
        return np.concatenate([index(name, self.n).start + np.array(self.fingers[finger]) for name in ALL])

    def flat(self, values: Array, *, start: bool = False) -> Vector:
        """Residuals (w, rows, n) in the order of `residuals`: all pieces of the first finger, of the second, …"""
        parts = [self.shooting.project(values, f, start=start).ravel() for f in range(len(self.fingers))]
        return np.concatenate(parts)

    def parts(self) -> Iterator[tuple[int, slice]]:
        """Every finger with its rows."""
        first, w = 0, len(self.cuts.recording)
        for number, finger in enumerate(self.fingers):
            size = w * self.shooting.rows(finger)
            yield number, slice(first, first + size)
            first += size

    def _prior_rows(self, residual: Vector) -> Array:
        """L⁻¹ of the prior's covariance, in scaled parameters; `residual`, (n,): what it is multiplied with."""
        covariance = np.zeros((len(self.unit), len(self.unit)))
        for name, sd in PRIOR.items():
            own = np.arange(len(self.unit))[index(name, self.n)]
            covariance[own, own] = sd**2 / (np.square(residual) if len(own) == self.n else np.median(residual) ** 2)
        tilts = np.arange(len(self.unit))[index("tilt", self.n)]
        together = np.kron(np.ones((len(tilts) // 3,) * 2), np.eye(3)) * TILT_OF_ALL**2
        covariance[np.ix_(tilts, tilts)] = together + np.eye(len(tilts)) * TILT_OF_EACH**2
        part = index("mass_scale", self.n)
        covariance[part, part] = mass_covariance(self) if self._masses == "weighed" else np.eye(self.n) * _KNOWN**2
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance / np.outer(self.unit, self.unit))))


def mass_covariance(problem: Problem) -> Array:
    """Covariance of the links' masses, as factors, (n, n)."""
    found = np.eye(problem.n) * MASS_SPREAD**2
    for finger in problem.fingers:
        found[np.ix_(finger, finger)] += MASS_SCALE**2
    return found


def prior_center(nominal: DriveParameters, start: DriveParameters) -> DriveParameters:
    """Center of the prior: the nominal drive, with the masses and the friction shape of the start, and no offsets."""
    shape = {name: getattr(start, name) for name in ("mass_scale", *SHAPE)}
    return replace(nominal, offset=np.zeros(len(start.offset)), **shape)
