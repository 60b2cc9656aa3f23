"""Choice of the drive for a hand's file: the one that best predicts the part of the motions kept back from the
fit.

Candidates are the nominal drive, the one in which only determined values are changed, and the one in which all are as
found that the motions show at all, however wide their intervals. Of every finger the best counts, then of every joint,
as long as its finger's error falls. Where two are as good, the earlier one of SOURCES counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.hands.description.specs import load_actuation
from allegro_twin.sim.open_loop import DriveParameters, OpenLoopPlayer
from allegro_twin.twin.identify.fitting.extra_terms import EXTRA
from allegro_twin.twin.identify.fitting.fit import DriveFit
from allegro_twin.twin.identify.fitting.parameterisation import (
    from_scaled,
    index,
    lower_bounds,
    scaling_jacobian,
    to_scaled,
)
from allegro_twin.twin.identify.fitting.shooting import UNSEEN, MotionSegments, cut_segments
from allegro_twin.twin.identify.motions.motion import RecordedMotion
from allegro_twin.twin.identify.results.gap import SHORTEST, leaning, piece_weights
from allegro_twin.twin.identify.results.uncertainty import IdentifiedValue
from allegro_twin.types import Vector

KeptValues = Mapping[str, NDArray[np.bool_]]
"""Values that stay as they were, (n,) for each kind; one for the delay."""
Source: TypeAlias = Literal["nominal", "determined", "all"]
"""What of a fit a joint has: nothing, the determined values, or all."""
SOURCES: tuple[Source, ...] = ("nominal", "all", "determined")
"""In the order in which they count where two are as good: in poses that were not recorded a value that is not known
well is nearer to the truth than none."""
BETTER = 0.95
"""Times the error: a later candidate must be this much better."""
LIKELY_OFFSET = 0.02
"""rad: an encoder offset that is not determined is written up to this. Ours."""
LONGEST = 5.0
"""s of open loop, at most."""

_ZERO = ("bristle", "load_friction", "backlash", "gear_compliance", *EXTRA)
NONE = {"stiction": 1.0, "stribeck_speed": 0.1} | dict.fromkeys(_ZERO, 0.0)
"""Values of a joint in which none was found."""
_TOGETHER = ("stiction", "stribeck_speed", "bristle")
"""Friction breaks away by all three, or by none."""


class WrittenDrive(NamedTuple):
    """Drive for a hand's file, and its source for each joint."""

    drive: DriveParameters
    source: tuple[Source, ...]
    """Source of each joint's values."""
    errors: Mapping[str, Vector]
    """Open-loop error on what the fit has not seen, with each candidate and as `written`: rms of each joint, (n,), rad;
    nothing where the motions are too short."""
    seconds: float
    """How long the open loop is, s."""
    guesses: KeptValues = MappingProxyType({})
    """Which values are written though they are not determined, (n,) for each kind: what the fit has not seen is
    predicted as well with them, or better."""

    @property
    def is_nominal(self) -> bool:
        """Whether the nominal drive is the best of every joint."""
        return set(self.source) == {"nominal"}

    def guessed(self, name: str, joint: int) -> bool:
        """Whether a joint's value is written though it is not determined."""
        return name in self.guesses and bool(self.guesses[name][joint])


def choose_drive(
    found: DriveFit, values: Mapping[str, IdentifiedValue], motions: Sequence[RecordedMotion], before: DriveParameters,
    kept: KeptValues,
) -> WrittenDrive:  # fmt: skip
    """The drive that predicts best. `before`: what the file has; `kept`: what stays in any case."""
    unseen = {name: value.unseen for name, value in values.items()}
    # An encoder offset is where a hand is said to be. In motion one that is 0.3 rad off can look like a cable; at rest
    # every posture is that far off. A small one is nearer to the truth than none.
    doubted = ~values["offset"].identifiable & (np.abs(values["offset"].value) > LIKELY_OFFSET)
    unseen["offset"] = unseen["offset"] | doubted
    candidates: dict[Source, DriveParameters] = {
        "nominal": _upright(before),
        "determined": _leaning(select_values(found, {**unwritten(values), **kept}, before)),
        "all": _leaning(select_values(found, {**unseen, **kept}, before)),
    }
    trial = _Trial(found, motions)
    if not trial.pieces:
        sure: Source = "determined"
        return WrittenDrive(candidates[sure], (sure,) * len(found.floor), {}, 0.0)
    for name in SOURCES[1:]:
        upright = _upright(candidates[name])
        if trial.total(upright) <= trial.total(candidates[name]) / BETTER:
            candidates[name] = upright
    errors: dict[str, Vector] = {name: trial.errors(each) for name, each in candidates.items()}
    best = _first_of_best([float(np.square(errors[name]).sum()) for name in SOURCES])
    made, now, source = candidates[SOURCES[best]], errors[SOURCES[best]], np.full(len(found.floor), best)
    for finger in trial.fingers:
        one = _first_of_best([float(np.square(errors[name][finger]).sum()) for name in SOURCES])
        if one == best:
            continue
        # With the delay and the lean of the whole hand's best it may be worse than it was with its own.
        tried = _swapped(made, candidates[SOURCES[one]], finger)
        left = trial.errors(tried)
        most = np.square(now[finger]).sum() * (BETTER**-2 if one < best else BETTER**2)
        if np.square(left[finger]).sum() <= most:
            made, now, source[finger] = tried, left, one
    for finger in trial.fingers:
        for joint in finger:
            for other in range(len(SOURCES)):
                if errors[SOURCES[other]][joint] > BETTER * now[joint] or other == source[joint]:
                    continue
                tried = _swapped(made, candidates[SOURCES[other]], [joint])
                left = trial.errors(tried)
                if np.square(left[finger]).sum() < BETTER**2 * np.square(now[finger]).sum():
                    made, now, source[joint] = tried, left, other
    errors["written"] = now
    # A joint of which the motions show nothing has what it had before, whatever its finger has.
    source[np.logical_and.reduce([mask for mask in unseen.values() if len(mask) == len(source)])] = 0
    taken, stays = source == SOURCES.index("all"), {**unseen, **kept}
    guesses = {
        name: ~value.identifiable & ~stays[name] & (taken if len(value.value) == len(taken) else taken.any())
        for name, value in values.items()
    }
    return WrittenDrive(made, tuple(SOURCES[each] for each in source), errors, trial.seconds, guesses)


class _Trial:
    """The pieces of the motions that the fit has not seen."""

    def __init__(self, found: DriveFit, motions: Sequence[RecordedMotion]) -> None:
        first = motions[0]
        self.fingers = [list(finger.joints) for finger in first.spec.fingers]
        shortest = min(len(motion.position) for motion in motions)
        length = min(round(LONGEST / first.period), round((UNSEEN[1] - UNSEEN[0]) * shortest) - 2)
        self.seconds = length * first.period
        self._cuts: MotionSegments | None = None
        if self.seconds >= SHORTEST_TRIAL:
            self._cuts = cut_segments(motions, first.spec, length, max(length // 2, 1), UNSEEN)
            # At a stop, or around a gap, no drive is right.
            self._weight = piece_weights(self._cuts, first.spec)
        self._player: OpenLoopPlayer = found.player(first)

    @property
    def pieces(self) -> int:
        return 0 if self._cuts is None else len(self._cuts.position)

    def errors(self, drive: DriveParameters) -> Vector:
        """Root mean square of each joint over the pieces that can be trusted, (n,), rad."""
        assert self._cuts is not None
        cuts = self._cuts
        pieces = cuts.segments._replace(gravity=leaning(cuts.segments.gravity, drive))
        wrong = self._player.play(drive, cuts.position, cuts.velocity, pieces) - cuts.measured
        return np.asarray(np.sqrt(np.average(np.square(wrong).mean(axis=1), axis=0, weights=self._weight)))

    def total(self, drive: DriveParameters) -> float:
        return float(np.square(self.errors(drive)).sum())


SHORTEST_TRIAL = 0.6
"""s of open loop that tell a drive from another."""


def _first_of_best(costs: list[float]) -> int:
    """The least cost; the first one that is nearly as low."""
    return next(k for k, cost in enumerate(costs) if BETTER**2 * cost <= min(costs))


def _swapped(drive: DriveParameters, other: DriveParameters, joints: list[int]) -> DriveParameters:
    """A drive with another's values at some joints; the lean of the palm and the delay are one for all."""
    found = {}
    for field in fields(drive):
        if field.name not in ("tilt", "delay"):
            row = np.array(getattr(drive, field.name))
            row[joints] = getattr(other, field.name)[joints]
            found[field.name] = row
    return replace(drive, **found)


def _upright(drive: DriveParameters) -> DriveParameters:
    return replace(drive, tilt=np.zeros((0, 3)))


def _leaning(drive: DriveParameters) -> DriveParameters:
    """With one lean for all recordings: their mean, as the prior has it for them."""
    return replace(drive, tilt=drive.tilt.mean(axis=0, keepdims=True)) if len(drive.tilt) else drive


def unwritten(values: Mapping[str, IdentifiedValue]) -> KeptValues:
    """Values that are not written: those that are not determined; all three of breakaway friction where one is not; and
    backlash whose interval contains zero."""
    kept_values = {name: ~value.identifiable for name, value in values.items()}
    if "backlash" in values:
        kept_values["backlash"] |= values["backlash"].value <= values["backlash"].half
    if "stiction" in values:
        any_of: NDArray[np.bool_] = np.logical_or.reduce([kept_values[name] for name in _TOGETHER])
        kept_values |= dict.fromkeys(_TOGETHER, any_of)
    return kept_values


def replacements(first: RecordedMotion, delay: float, found: DriveFit) -> DriveParameters:
    """Values that replace those that are not written."""
    n, usual = first.spec.n_joints, load_actuation(first.spec.model, first.spec.n_joints)
    none = {name: np.full(n, value) for name, value in (NONE | SHORTEST).items()}
    return DriveParameters(
        torque_constant=first.torque_constant, armature=usual.armature, damping=usual.damping,
        frictionloss=usual.frictionloss, offset=np.zeros(n), delay=np.full(n, delay),
        mass_scale=found.drive.mass_scale, **none,
    )  # fmt: skip


def select_values(found: DriveFit, kept_values: KeptValues, before: DriveParameters) -> DriveParameters:
    """The drive for a hand's file: values that are not determined stay as `before`, and the others fit them. `before`:
    what is in the file, relative to the calibration of the recordings.

    Values that look alike in the motion are uncertain each and certain together: a torque constant that was found with
    4 % of load friction is 4 % too high in a file without any. With x the scaled values, C their covariance, h those
    that stay as they were (x°) and r the others, the most likely r are

        x_r + C_rh C_hh⁻¹ (x°_h − x_h)
    """
    drive, n = found.drive, len(found.floor)
    stays = {name: np.where(mask, getattr(before, name), getattr(drive, name)) for name, mask in kept_values.items()}
    x, there = to_scaled(drive), to_scaled(replace(drive, **stays))
    fixed = np.zeros(len(x), dtype=bool)
    for name, mask in kept_values.items():
        fixed[index(name, n)] = mask
    inverse = np.linalg.inv(scaling_jacobian(drive))
    C = inverse @ found.spread.covariance @ inverse.T
    moved = np.linalg.solve(C[np.ix_(fixed, fixed)], (there - x)[fixed])
    x = np.where(fixed, there, x + C[:, fixed] @ moved)
    made = from_scaled(np.maximum(x, lower_bounds(n, len(drive.tilt))), drive)
    stays = {name: np.where(mask, getattr(before, name), getattr(made, name)) for name, mask in kept_values.items()}
    return replace(made, **stays)
