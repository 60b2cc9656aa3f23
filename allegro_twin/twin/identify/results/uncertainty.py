"""Uncertainty of identified values: which are determined, their intervals, and which motion is missing for the
others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.open_loop import OpenLoopPlayer
from allegro_twin.twin.identify.fitting.extra_terms import EXTRA
from allegro_twin.twin.identify.fitting.fit import DriveFit
from allegro_twin.twin.identify.fitting.parameterisation import PLAY, PULLED, SHAPE, TEETH
from allegro_twin.twin.identify.fitting.regress import smooth_motion
from allegro_twin.twin.identify.fitting.spread import NORMAL, Spread
from allegro_twin.twin.identify.motions.motion import RecordedMotion
from allegro_twin.types import Array, Vector

try:
    from scipy.stats import t  # type: ignore[import-untyped]  # Its types are a package of its own.
except ImportError as error:
    raise ConfigError("a twin needs SciPy: pip install 'allegro-twin[twin]'") from error

BELIEVED = 1.1  # Times the noise that long pieces may leave. A converged fit leaves 0.9 to 1.1 (ours).
LEFT = 3.0
"""Times the noise: with more left over the model does not explain a joint."""
SHORTEST = 10.0  # s of trusted motion, over all recordings.
MOVED = 0.1  # rad
SLOW, FAST = 0.05, 0.5  # rad/s. Friction shows below the one, damping above the other.
PULL = 0.002  # N·m by which gravity must differ between postures to tell a torque constant from friction.
PULL_LOOSE = 0.05  # N·m, likewise, for an offset where links are loose: with less, hidden hands were 10 to 90 mrad off.
TOOTH = (
    0.05  # Share of a backlash by which pieces that begin at the wrong tooth underestimate it. Ours, as the line above.
)
APART = np.radians(30.0)  # Between two directions of gravity that count as two.
WIDEST = {
    "torque_constant": 0.25,
    "armature": 0.3,
    "damping": 0.3,
    "stiction": 0.3,
    "stribeck_speed": 0.6,
    "bristle": 1.0,
}  # Half the 95 % interval as a share of the value.
WIDEST_FRICTION, WIDEST_OFFSET, WIDEST_LOAD, WIDEST_DELAY = (
    0.01,
    0.03,
    0.03,
    0.003,
)  # N·m at 1 N·m of full PWM, rad, 1, s.
WIDEST_PLAY = 0.001  # rad, of backlash.
WIDEST_STRAY, WIDEST_UNEVEN = 0.005, 0.02  # N·m (a rad, of a spring) and N·m·s/rad, at 1 N·m of full PWM.
WIDEST_RIPPLE = 0.03  # Share of a motor's torque.
WIDEST_BEND = 0.03  # rad/(N·m), of teeth.
WIDEST_COLD = 0.2  # Share, of friction when cold.
SOLVED = {"damping": (1.5e-4, 0.0), "frictionloss": (0.0, 1e-5)}
"""Difference between the engine's two ways to solve dry friction, noslip iterations and stiffness: share, and N·m per
N·m at full PWM. From the quietest hidden hands 20 and 22, whose noise is less than that."""
_WIDEST_ABSOLUTE = {
    "frictionloss": (WIDEST_FRICTION, 1000.0, "mN·m"),
    "offset": (WIDEST_OFFSET, 1000.0, "mrad"),
    "load_friction": (WIDEST_LOAD, 100.0, "% of the torque"),
    "backlash": (WIDEST_PLAY, 1000.0, "mrad"),
    "gear_compliance": (WIDEST_BEND, 1000.0, "mrad a N·m"),
    "bias_torque": (WIDEST_STRAY, 1000.0, "mN·m"),
    "stiffness": (WIDEST_STRAY, 1000.0, "mN·m/rad"),
    "uneven_damping": (WIDEST_UNEVEN, 1000.0, "mN·m·s/rad"),
    "cogging_cosine": (WIDEST_STRAY, 1000.0, "mN·m"),
    "cogging_sine": (WIDEST_STRAY, 1000.0, "mN·m"),
    "ripple_cosine": (WIDEST_RIPPLE, 100.0, "% of the torque"),
    "ripple_sine": (WIDEST_RIPPLE, 100.0, "% of the torque"),
    "cold_friction": (WIDEST_COLD, 100.0, "% of the friction"),
}
BY_MODEL = "the model errs, so more of the same motion does not help"
PER_PWM = ("armature", "damping", "frictionloss")
VALUES = ("torque_constant", *PER_PWM, "offset")


class IdentifiedValue(NamedTuple):
    """One kind of value, (n,) each; the delay has one. Armature, damping and friction are per N·m at full PWM."""

    value: Vector
    half: Vector
    """Half the 95 % interval."""
    reason: tuple[str, ...]
    """Why it is not determined; empty where it is."""
    shown: tuple[bool, ...] = ()
    """Whether the motions show it at all, whatever its interval; where nothing is said they do."""

    @property
    def unseen(self) -> NDArray[np.bool_]:
        """Whether the motions do not show each at all, (n,)."""
        return ~np.array(self.shown, dtype=bool) if self.shown else np.zeros(len(self.value), dtype=bool)

    @property
    def identifiable(self) -> NDArray[np.bool_]:
        """Whether each is determined, (n,)."""
        return np.array([not reason for reason in self.reason])

    def absent(self, joint: int) -> bool:
        """Whether a joint's model has none of it: neither value nor interval."""
        return bool(self.value[joint] == 0.0 and self.half[joint] == 0.0)


@dataclass(frozen=True, slots=True)
class MotionCoverage:
    """Coverage of the recordings: how far and how fast each joint moved."""

    seconds: Vector
    """Trusted motion, (n,)."""
    travel: Vector
    """rad."""
    fastest: Array
    """Downwards and upwards, (2, n), rad/s, positive."""
    creeping: Array
    """s slower than SLOW while moving, downwards and upwards, (2, n)."""
    pull: Vector
    """Difference of gravity's torque between postures and poses, (n,), N·m."""
    poses: int
    """Directions of gravity."""
    unfollowed: tuple[str, ...] = ()
    """Why nothing is to be told of a joint, or empty, (n,): it, or another of its finger, did not follow."""


def motion_coverage(motions: list[RecordedMotion], player: OpenLoopPlayer) -> MotionCoverage:
    """Coverage of speeds and postures by some motions."""
    n = player.spec.n_joints
    smooth = [smooth_motion(motion) for motion in motions]
    good = [motion.good > 0 for motion in motions]
    v = np.concatenate([np.where(g, s.velocity, 0.0) for g, s in zip(good, smooth, strict=True)])
    q = np.concatenate([s.position for s in smooth])
    weights = []
    for motion, s in zip(motions, smooth, strict=True):
        player.links_only(np.ones(n), np.zeros(n))
        weights += [player.link_torque(row, np.zeros(n), np.zeros(n), motion.gravity) for row in s.position[::20]]
    span = np.percentile(np.array(weights), (5, 95), axis=0)
    period = motions[0].period
    slow = [((sign * v > 0.2 * SLOW) & (sign * v < SLOW)).sum(axis=0) * period for sign in (-1.0, 1.0)]
    return MotionCoverage(
        seconds=np.concatenate(good).sum(axis=0) * period,
        travel=np.percentile(q, 99, axis=0) - np.percentile(q, 1, axis=0),
        fastest=np.maximum(np.stack([-v.min(axis=0), v.max(axis=0)]), 0.0),
        creeping=np.array(slow),
        pull=span[1] - span[0],
        poses=_directions(motions),
        unfollowed=_unfollowed(motions),
    )


def _unfollowed(motions: Sequence[RecordedMotion]) -> tuple[str, ...]:
    """Why nothing is to be told of each joint, (n,); empty where something is."""
    spec, period = motions[0].spec, motions[0].period
    said = [""] * spec.n_joints
    for motion in motions:
        for joint, how in motion.unfollowed:
            said[joint] = said[joint] or f"it did not follow what it was told ({motion.name}): {how}"
    for finger in spec.fingers:
        own = [joint for joint in finger.joints if said[joint]]
        seconds = period * sum(float((motion.good[:, list(finger.joints)] > 0).all(axis=1).sum()) for motion in motions)
        for joint in finger.joints:
            if own and not said[joint] and seconds < SHORTEST:
                said[joint] = f"{spec.joint_labels[own[0]]} of its finger did not follow what it was told"
    return tuple(said)


def identified_values(found: DriveFit, coverage: MotionCoverage) -> dict[str, IdentifiedValue]:
    """Every value with its interval and whether it is determined; also `delay`."""
    k = found.drive.torque_constant
    result = {}
    errs = _misfit(found.spread.residual)
    strays = tuple(name for name in EXTRA if found.extras.of_joints(name, len(k)).any())
    bent = TEETH if found.elastic else ()
    for name in (*VALUES, *(SHAPE if found.bristly else ()), *(PLAY if found.loose else ()), *bent, *strays):
        own = getattr(found.drive, name)
        value = own / k if name in PULLED else own
        share, more = SOLVED.get(name, (TOOTH if name in PLAY else 0.0, 0.0))
        half = _half(found, name, found.covariance) + share * value + more
        # Masses that are only assumed make all N·m uncertain, and so does a model that differs from the hand, but the
        # twin moves no worse for it.
        covariance = found.covariance if name == "offset" else found.spread.covariance
        sure = _linear(found.spread, _per_pwm(found, name), covariance, apart=name not in PLAY)
        if name in EXTRA:  # A joint without the term has none, for sure.
            has = found.extras.of_joints(name, len(k))
            half, sure = np.where(has, half, 0.0), np.where(has, sure, 0.0)
        unseen = [_unseen(name, j, coverage, loose=found.loose) for j in range(len(k))]
        left = found.spread.residual if name in PLAY else np.zeros(len(k))
        reasons = tuple(
            why or _unexplained(left[j]) or _wide(name, value[j], sure[j], errs[j]) for j, why in enumerate(unseen)
        )
        result[name] = IdentifiedValue(value, half, reasons, tuple(not why for why in unseen))
    late, half = found.drive.delay[:1], _half(found, "delay", found.covariance)
    size, usual = f"± {1000 * half[0]:.1f} ms", float(np.median(errs))
    # Play that the model does not explain is delay to it.
    short = _unexplained(float(np.median(found.spread.residual))) if found.loose else ""
    short = short or (
        "" if half[0] < WIDEST_DELAY else _advise(size, "record more fast motion", half[0] < WIDEST_DELAY * usual)
    )
    return result | {"delay": IdentifiedValue(late, half, (short,))}


def value_correlations(found: DriveFit, names: Sequence[str]) -> Array:
    """Correlations between a joint's own values, (n, m, m), of m kinds that every joint has; 0 with what is fixed.
    Intervals say nothing of them: a joint with more friction has less damping, when both are found in one motion."""
    rows = np.stack([_per_pwm(found, name) for name in names], axis=1)
    covariance = rows @ found.covariance @ rows.transpose(0, 2, 1)
    deviation = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    scale = deviation[:, :, None] * deviation[:, None, :]
    correlation = np.divide(covariance, scale, out=np.zeros_like(covariance), where=scale > 0.0)
    correlation[:, np.arange(len(names)), np.arange(len(names))] = 1.0
    return np.asarray(np.clip(correlation, -1.0, 1.0))


def _half(found: DriveFit, name: str, covariance: Array) -> Vector:
    """Half the interval. Of a joint that the model leaves more of than noise the model's error counts as well, for each
    value as far as that value shows it: what shorter pieces say of it, which slips mislead less, and how it
    scatters between the recordings, with Student's t of as few as these are."""
    transform, apart = _per_pwm(found, name), name not in PLAY
    half = _linear(found.spread, transform, covariance, apart=apart)
    residual = found.spread.residual
    left = np.array([np.median(residual)]) if name == "delay" else residual
    wider = half
    if found.shorter is not None:
        wider = np.maximum(half, _linear(found.shorter, transform, found.shorter.covariance, apart=apart))
    if apart and len(found.spread.by_recording) > 1:
        wider = np.maximum(wider, _student(found.spread, transform))
    return wider if found.loose else np.where(left > BELIEVED, wider, half)


def _student(spread: Spread, transform: Array) -> Vector:
    """Half of a 95 % interval by the scatter between recordings, of as few as there are."""
    moved = spread.by_recording @ transform.T
    return np.asarray(t.ppf(0.975, len(moved) - 1) * _between(moved))


def _between(moved: Array) -> Vector:
    """Standard deviation by leaving each recording out (jackknife)."""
    m = len(moved)
    return np.asarray(np.sqrt((m - 1) / m * np.square(moved - moved.mean(axis=0)).sum(axis=0)))


def _linear(spread: Spread, transform: Array, covariance: Array, *, apart: bool) -> Vector:
    """1.96 standard deviations, over pieces or (`apart`) over recordings, whichever is larger. Not over recordings for
    backlash: one in which a link never leaves its tooth says nothing of it. Plus the effect of the time step, twice
    that of halving it, which is its limit for an error of first order. Plus the remaining step. At least the distance
    from the rough solution."""
    variance = np.einsum("ip,pq,iq->i", transform, covariance, transform)
    moved = spread.by_recording @ transform.T
    if apart and len(moved) > 1:
        variance = np.maximum(variance, np.square(_between(moved)))
    linear = NORMAL * np.sqrt(variance) + 2.0 * np.abs(transform @ spread.step)
    linear += np.abs(transform @ spread.rest)
    return np.asarray(np.maximum(linear, np.abs(transform @ spread.path)))


def _per_pwm(found: DriveFit, name: str) -> Array:
    """Derivative of one kind of value by all parameters, (rows, p)."""
    part, size = found.columns(name), len(found.covariance)
    rows = np.arange(part.stop - part.start)
    transform = np.zeros((len(rows), size))
    transform[rows, part.start + rows] = 1.0
    if name in PULLED:
        k, constants = found.drive.torque_constant, found.columns("torque_constant")
        transform[rows, part.start + rows] = 1.0 / k
        transform[rows, constants.start + rows] = -getattr(found.drive, name) / k**2
    return transform


def _unseen(name: str, joint: int, coverage: MotionCoverage, *, loose: bool) -> str:
    """Why the motions do not show a value, whatever its interval; empty where they do."""
    followed = not (coverage.unfollowed and coverage.unfollowed[joint])
    if followed and loose and name == "offset" and coverage.pull[joint] < PULL_LOOSE:
        return (f"gravity's torque on it differs by {1000 * coverage.pull[joint]:.1f} mN·m only, and behind backlash "
                f"{1000 * PULL_LOOSE:g} tell: `calibrate limits --offsets` finds it from the end stops")  # fmt: skip
    return next(_lacks(name, joint, coverage), "")


def _lacks(name: str, joint: int, coverage: MotionCoverage) -> Iterator[str]:
    if coverage.unfollowed and coverage.unfollowed[joint]:
        yield coverage.unfollowed[joint]
    if coverage.seconds[joint] < SHORTEST:
        yield f"only {coverage.seconds[joint]:.0f} s of it can be used: record at least {SHORTEST:g} s"
    if coverage.travel[joint] < MOVED:
        yield f"it moved by {coverage.travel[joint]:.2f} rad only: `excite` moves it"
    if name in ("torque_constant", "offset"):
        if coverage.poses < 2:
            yield "all recordings are in one pose, in which weight, friction and offset look alike: record another pose"
        if coverage.pull[joint] < PULL:
            yield (f"gravity's torque on it differs by {1000 * coverage.pull[joint]:.1f} mN·m only: record a pose in "
                   "which its weight acts across its axis")  # fmt: skip
    if name in ("damping", "frictionloss") and coverage.fastest[:, joint].min() < FAST:
        yield (f"it never moved faster than {coverage.fastest[:, joint].min():.2f} rad/s one way, and damping shows "
               f"from {FAST} rad/s: `excite` moves it faster")  # fmt: skip
    if name in ("frictionloss", *SHAPE) and coverage.creeping[:, joint].min() <= 0.0:
        yield f"it never crept below {SLOW} rad/s, where friction shows: `excite` does"


def _unexplained(residual: float) -> str:
    """Why the size of backlash, or the delay beside it, is not told by its interval; empty where it is."""
    if residual <= LEFT:
        return ""
    return f"the model leaves {residual:.0f} times the noise, and no interval covers what else looks like backlash"


def _wide(name: str, value: float, half: float, errs: float) -> str:
    """Why an interval is too wide; empty where it is not. `errs`: times the noise that the model leaves."""
    if name in WIDEST:
        widest, size, more = WIDEST[name] * value, f"± {100 * half / value:.0f} %", "record more of `excite`"
    else:
        widest, by, unit = _WIDEST_ABSOLUTE[name]
        size, more = f"± {by * half:.0f} {unit}", "record more"
    return _advise(size, more, half <= widest * errs) if half > widest else ""


def _advise(size: str, more: str, by_model: bool) -> str:
    """What narrows an interval that is too wide; `by_model`: noise alone would not make it so."""
    return f"its interval is {size}: {BY_MODEL if by_model else more}"


def _misfit(residual: Vector) -> Vector:
    """Times the noise that the model leaves of each joint, or of all together, which every interval has, (n,); 1 where
    it leaves no more than noise."""
    left = np.maximum(residual, np.sqrt(np.square(residual).mean()))
    return np.asarray(np.where(left > BELIEVED, left, 1.0))


def _directions(motions: list[RecordedMotion]) -> int:
    found: list[Array] = []
    for motion in motions:
        down = motion.gravity / np.linalg.norm(motion.gravity)
        if all(np.arccos(np.clip(down @ other, -1.0, 1.0)) > APART for other in found):
            found.append(down)
    return len(found)
