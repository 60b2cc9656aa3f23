"""Which values the recordings determine, how far they may be off, and which motion is missing for the others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.sim.open_loop import OpenLoopPlayer
from allegro_twin.twin.identify.fitting.fit import Fit
from allegro_twin.twin.identify.fitting.parameterisation import PLAY, SHAPE
from allegro_twin.twin.identify.fitting.regress import smoothed
from allegro_twin.twin.identify.fitting.spread import Spread
from allegro_twin.twin.identify.motions.motion import Motion
from allegro_twin.types import Array, Vector

BELIEVED = 1.1  # Times the noise that long pieces may leave. A fit that arrived leaves 0.9 to 1.1 (ours).
NORMAL = 1.96  # Standard deviations on either side of 95 %.
SHORTEST = 10.0  # s of motion that can be trusted, over all recordings.
MOVED = 0.1  # rad
SLOW, FAST = 0.05, 0.5  # rad/s. Friction shows below the one, damping above the other.
PULL = 0.002  # N·m that gravity must differ by between postures to tell a torque constant from friction.
PULL_LOOSE = 0.05  # N·m, likewise, for an offset where links are loose: with less hidden hands were 10 to 90 mrad off.
TOOTH = 0.05  # Of a backlash: how much too small pieces make it that begin at the wrong tooth. Ours, as the line above.
APART = np.radians(30.0)  # Between two directions of gravity that count as two.
WIDEST = {
    "torque_constant": 0.25,
    "armature": 0.3,
    "damping": 0.3,
    "stiction": 0.3,
    "stribeck_speed": 0.6,
    "bristle": 1.0,
}  # Of the value, half the 95 % interval.
WIDEST_FRICTION, WIDEST_OFFSET, WIDEST_LOAD, WIDEST_DELAY = (
    0.01,
    0.03,
    0.03,
    0.003,
)  # N·m at 1 N·m of full PWM, rad, 1, s.
WIDEST_PLAY = 0.001  # rad, of backlash.
SOLVED = {"damping": (1.5e-4, 0.0), "frictionloss": (0.0, 1e-5)}
"""What the engine's two ways to solve dry friction, noslip iterations and stiffness, are apart by: share, and N·m per
N·m at full PWM. Of the quietest hidden hands 20 and 22, whose noise tells less than that."""
_WIDEST_ABSOLUTE = {
    "frictionloss": (WIDEST_FRICTION, 1000.0, "mN·m"),
    "offset": (WIDEST_OFFSET, 1000.0, "mrad"),
    "load_friction": (WIDEST_LOAD, 100.0, "% of the torque"),
    "backlash": (WIDEST_PLAY, 1000.0, "mrad"),
}
PER_PWM = ("armature", "damping", "frictionloss")
VALUES = ("torque_constant", *PER_PWM, "offset")


class Value(NamedTuple):
    """One kind of value, (n,) each; the delay has one. Armature, damping and friction are per N·m at full PWM."""

    value: Vector
    half: Vector
    """Half the 95 % interval."""
    reason: tuple[str, ...]
    """Why it is not determined; empty where it is."""

    @property
    def determined(self) -> NDArray[np.bool_]:
        """(n,)."""
        return np.array([not reason for reason in self.reason])


@dataclass(frozen=True, slots=True)
class Seen:
    """What the recordings show of every joint."""

    seconds: Vector
    """That can be trusted, (n,)."""
    travel: Vector
    """rad."""
    fastest: Array
    """Downwards and upwards, (2, n), rad/s, positive."""
    creeping: Array
    """s slower than SLOW while moving, downwards and upwards, (2, n)."""
    pull: Vector
    """By how much gravity's torque differs between postures and poses, (n,), N·m."""
    poses: int
    """Directions of gravity."""


def seen(motions: list[Motion], player: OpenLoopPlayer) -> Seen:
    """Looks at speeds and postures, not at torques."""
    n = player.spec.n_joints
    smooth = [smoothed(motion) for motion in motions]
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
    return Seen(
        seconds=np.concatenate(good).sum(axis=0) * period,
        travel=np.percentile(q, 99, axis=0) - np.percentile(q, 1, axis=0),
        fastest=np.maximum(np.stack([-v.min(axis=0), v.max(axis=0)]), 0.0),
        creeping=np.array(slow),
        pull=span[1] - span[0],
        poses=_directions(motions),
    )


def values(found: Fit, looked: Seen) -> dict[str, Value]:
    """Every value with its interval and whether it is determined; also `delay`."""
    k = found.drive.torque_constant
    result = {}
    for name in (*VALUES, *(SHAPE if found.bristly else ()), *(PLAY if found.loose else ())):
        own = getattr(found.drive, name)
        value = own / k if name in PER_PWM else own
        share, more = SOLVED.get(name, (TOOTH if name in PLAY else 0.0, 0.0))
        half = _half(found, name, found.covariance) + share * value + more
        # Masses that are only assumed make all N·m doubtful, and a model that is not quite the hand all of a joint,
        # but the twin moves no worse for it.
        covariance = found.covariance if name == "offset" else found.spread.covariance
        sure = _linear(found.spread, _per_pwm(found, name), covariance, apart=name not in PLAY)
        reasons = tuple(_reason(name, j, value, sure, looked, loose=found.loose) for j in range(len(k)))
        result[name] = Value(value, half, reasons)
    late, half = found.drive.delay[:1], _half(found, "delay", found.covariance)
    short = "" if half[0] < WIDEST_DELAY else f"its interval is ± {1000 * half[0]:.1f} ms: record more fast motion"
    return result | {"delay": Value(late, half, (short,))}


def _half(found: Fit, name: str, covariance: Array) -> Vector:
    """Half the interval. Where long pieces leave more than noise of a joint they are misled by when it slips; then what
    shorter ones say counts if it is more, and all of it as often as what is left is of the noise. Where links are loose
    a few pieces that begin at the wrong tooth leave most, and have little weight: there they count once."""
    transform, apart = _per_pwm(found, name), name not in PLAY
    half = _linear(found.spread, transform, covariance, apart=apart)
    if found.shorter is None:
        return half
    residual = found.spread.residual
    left = np.array([np.median(residual)]) if name == "delay" else residual
    wider = np.maximum(half, _linear(found.shorter, transform, found.shorter.covariance, apart=apart))
    if found.loose:
        return wider
    return np.where(left > BELIEVED, left * wider, half)


def _linear(spread: Spread, transform: Array, covariance: Array, *, apart: bool) -> Vector:
    """1.96 standard deviations, over pieces or (`apart`) over recordings, whichever is more: not of backlash, which a
    recording in which a link never leaves its tooth says nothing of; and what the time step may do: twice
    what halving it does, its limit for a step of nothing where the error is of first order; and what is left to go. Not
    less than the way from the rough solution."""
    variance = np.einsum("ip,pq,iq->i", transform, covariance, transform)
    moved = spread.by_recording @ transform.T
    m = len(moved)
    if apart and m > 1:
        between = (m - 1) / m * np.square(moved - moved.mean(axis=0)).sum(axis=0)
        variance = np.maximum(variance, between)
    linear = NORMAL * np.sqrt(variance) + 2.0 * np.abs(transform @ spread.step)
    linear += np.abs(transform @ spread.rest)
    return np.asarray(np.maximum(linear, np.abs(transform @ spread.path)))


def _per_pwm(found: Fit, name: str) -> Array:
    """The derivative of one kind of value by all parameters, (rows, p)."""
    part, size = found.columns(name), len(found.covariance)
    rows = np.arange(part.stop - part.start)
    transform = np.zeros((len(rows), size))
    transform[rows, part.start + rows] = 1.0
    if name in PER_PWM:
        k, constants = found.drive.torque_constant, found.columns("torque_constant")
        transform[rows, part.start + rows] = 1.0 / k
        transform[rows, constants.start + rows] = -getattr(found.drive, name) / k**2
    return transform


def _reason(name: str, joint: int, value: Vector, half: Vector, looked: Seen, *, loose: bool) -> str:
    if loose and name == "offset" and looked.pull[joint] < PULL_LOOSE:
        return (f"gravity's torque on it differs by {1000 * looked.pull[joint]:.1f} mN·m only, and behind backlash "
                f"{1000 * PULL_LOOSE:g} tell: `calibrate limits --offsets` finds it from the end stops")  # fmt: skip
    return next(iter(_reasons(name, joint, value, half, looked)), "")


def _reasons(name: str, joint: int, value: Vector, half: Vector, looked: Seen) -> Iterator[str]:
    if looked.seconds[joint] < SHORTEST:
        yield f"only {looked.seconds[joint]:.0f} s of it can be used: record at least {SHORTEST:g} s"
    if looked.travel[joint] < MOVED:
        yield f"it moved by {looked.travel[joint]:.2f} rad only: `excite` moves it"
    if name in ("torque_constant", "offset"):
        if looked.poses < 2:
            yield "all recordings are in one pose, in which weight, friction and offset look alike: record another pose"
        if looked.pull[joint] < PULL:
            yield (f"gravity's torque on it differs by {1000 * looked.pull[joint]:.1f} mN·m only: record a pose in "
                   "which its weight acts across its axis")  # fmt: skip
    if name in ("damping", "frictionloss") and looked.fastest[:, joint].min() < FAST:
        yield (f"it never moved faster than {looked.fastest[:, joint].min():.2f} rad/s one way, and damping shows from "
               f"{FAST} rad/s: `excite` moves it faster")  # fmt: skip
    if name in ("frictionloss", *SHAPE) and looked.creeping[:, joint].min() <= 0.0:
        yield f"it never crept below {SLOW} rad/s, where friction shows: `excite` does"
    if name in WIDEST:
        if half[joint] > WIDEST[name] * value[joint]:
            yield f"its interval is ± {100 * half[joint] / value[joint]:.0f} %: record more of `excite`"
        return
    widest, by, unit = _WIDEST_ABSOLUTE[name]
    if half[joint] > widest:
        yield f"its interval is ± {by * half[joint]:.0f} {unit}: record more"


def _directions(motions: list[Motion]) -> int:
    found: list[Array] = []
    for motion in motions:
        down = motion.gravity / np.linalg.norm(motion.gravity)
        if all(np.arccos(np.clip(down @ other, -1.0, 1.0)) > APART for other in found):
            found.append(down)
    return len(found)
