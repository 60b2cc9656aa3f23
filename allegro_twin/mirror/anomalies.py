"""What is wrong with a hand, by name: pure functions of a second and a half of what its mirror saw.

Each fault of physics leaves a disturbance of its own shape x on a finger's joints, times one unknown c: a weak motor
minus its own torque, friction the sign of the speed, a payload the weight of its link as every joint before it carries
it. Of the shapes of all joints that counts which takes away most of the squares, G = (Σ x d)² / Σ x², with a c that
can be. Only joints that move are looked at: at rest dry friction hides all of it. An encoder that jumps, a joint that
stays where its motor pushes, and a hot motor are seen more directly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

Name: TypeAlias = Literal[
    "weak", "stuck", "encoder_step", "payload", "friction", "hot", "wrong_file", "encoder_drift", "loose", "slip"
]  # fmt: skip
NAMES: tuple[Name, ...] = (
    "weak", "stuck", "encoder_step", "payload", "friction", "hot", "wrong_file", "encoder_drift", "loose", "slip",
)  # fmt: skip
ROW = 10
"""Periods whose means make a row of a window."""
MOVING = 0.03  # rad/s
CREEP = 0.02  # rad/s over which friction turns round.
JUMP = 0.01  # rad in a period, 3.3 rad/s out of nothing: no joint moves so.
STILL, PUSHED = 0.003, 0.03  # rad that a stuck joint moves at most; N·m that its motor must push in the mean.
SINGLE = 0.75  # Of a finger's squares that the joint has: what touches a finger pushes the joints before it, too.
HOT = 70.0  # °C. The manufacturer's driver throttles from there on; docs/protocol.md.
SHARE = 0.5  # Of the squares that one shape must take away.
LEAST = {"weak": 0.1, "friction": 0.008, "payload": 0.002}  # 1, N·m, kg: smaller ones are not named.
MANY, FINGERS = 5, 3  # Joints with something wrong, on so many fingers: then it is the file.


class Window(NamedTuple):
    """Rows of a mirror, k of them, in the mean over ROW periods each."""

    disturbance: Array
    """(k, n), N·m."""
    torque: Array
    """Of the motors, as the mirror's file says, (k, n), N·m."""
    velocity: Array
    """(k, n), rad/s."""
    side: Array
    """To which side friction acts, (k, n), -1 to 1: tanh(speed / CREEP) of every period."""
    position: Array
    """(k, n), rad."""
    jump: Array
    """The largest difference of what was reported and expected in a row's periods, (k, n), rad."""
    pull: Array
    """What a kilogram at each link's centre of mass would weigh on each joint, (k, links, n), N·m."""
    temperature: Array
    """(k, n), °C; NaN where it is not known."""
    holds: NDArray[np.bool_]
    """Fingers that rest and press on something, (k, fingers)."""


class Anomaly(NamedTuple):
    """Something that is wrong."""

    name: Name
    joint: int
    """Which; the first that is found where it is of the whole hand."""
    amount: float
    """Missing share of a motor, N·m of friction, kg, rad, °C, rad/s; of a slip a share; of a file the number of fingers."""
    margin: float = 1.0
    """By what share the next likely name explains less."""
    gain: float = np.inf
    """Squares of disturbances that it takes away, N²m²; infinite where it is seen directly."""


def words(found: Anomaly, spec: HandSpec) -> str:
    """For a person."""
    joint = spec.readable[found.joint]
    match found.name:
        case "weak":
            return f"the motor of {joint} gives {100 * (1 - found.amount):.0f} % of its torque"
        case "stuck":
            return f"{joint} is stuck"
        case "encoder_step":
            return f"the encoder of {joint} jumped by {1000 * found.amount:.0f} mrad"
        case "payload":
            return f"{joint} carries {1000 * found.amount:.0f} g too much"
        case "friction":
            return f"{joint} has {1000 * found.amount:.0f} mN·m of friction too much"
        case "hot":
            return f"the motor of {joint} is at {found.amount:.0f} °C"
        case "encoder_drift":
            return f"the encoder of {joint} drifts by {60000 * found.amount:+.0f} mrad a minute"
        case "loose":
            return f"the link of {joint} is loose: it fell, {1000 * found.amount:.0f} mrad off what was expected"
        case "slip":
            return f"what the hand holds slips: {joint} lost {100 * found.amount:.0f} % of what pressed on it"
        case "wrong_file":
            return "the file is of another hand, or of this one long ago: identify it again"


class Gain(NamedTuple):
    """What one shape takes away of a finger's disturbances."""

    name: Name
    joint: int
    amount: float
    gain: float
    """Sum of squares, N²m²."""
    share: float


def named(window: Window, quiet: Vector, spec: HandSpec) -> Anomaly | None:
    """What is wrong, or None. `quiet`: for each finger a gain that free motions do not reach, (fingers,)."""
    hot = np.argwhere(np.nan_to_num(window.temperature[-1:]) > HOT)
    if len(hot):
        joint = int(hot[0][1])
        return Anomaly("hot", joint, float(window.temperature[-1, joint]))
    if window.jump.max() > JUMP:
        joint = int(window.jump.max(axis=0).argmax())
        return Anomaly("encoder_step", joint, float(window.jump[:, joint].max()))
    stuck = None if _holding(window) else _stuck(window, spec)
    if stuck is not None:
        return Anomaly("stuck", stuck, float(np.abs(window.disturbance[:, stuck]).max()))
    if _holding(window):
        return None
    found, alone = gains(window, spec), _alone(window, spec)
    for finger, holds in zip(spec.fingers, window.holds.any(axis=0), strict=True):
        if holds and alone[list(finger.joints)].max() < SINGLE:
            found[finger.name] = []
    best = [max(found[finger.name], key=lambda each: each.gain, default=None) for finger in spec.fingers]
    odd = [each for each, above in zip(best, quiet, strict=True) if each is not None and each.gain > above]
    if len(odd) >= FINGERS and _odd_joints(found, quiet, spec) >= MANY:
        return Anomaly("wrong_file", odd[0].joint, float(len(odd)))
    sure = [each for each in odd if each.share > SHARE and each.amount > LEAST[each.name]]
    if not sure:
        return None
    most = max(sure, key=lambda each: each.gain)
    finger = next(f.name for f in spec.fingers if most.joint in f.joints)
    others = [each.gain for each in found[finger] if each.name != most.name]
    margin = 1.0 - max(others, default=0.0) / most.gain
    return Anomaly(most.name, most.joint, most.amount, margin, most.gain)


def gains(window: Window, spec: HandSpec) -> dict[str, list[Gain]]:
    """Of every shape of every joint, by finger."""
    moving = np.abs(window.velocity) > MOVING
    d = np.where(moving, window.disturbance, 0.0)
    found: dict[str, list[Gain]] = {finger.name: [] for finger in spec.fingers}
    same = np.zeros((spec.n_joints, spec.n_joints))
    for finger in spec.fingers:
        same[np.ix_(finger.joints, finger.joints)] = 1.0
    sums = np.square(d).sum(axis=0)
    carried = window.pull * (same * moving[:, None, :])
    shapes: dict[Name, tuple[Vector, Vector]] = {
        "weak": _along(np.where(moving, -_late(window.torque), 0.0), d),
        "friction": _along(np.where(moving, -_late(window.side), 0.0), d),
        "payload": (np.einsum("klj,kj->l", carried, d), np.square(carried).sum(axis=(0, 2))),
    }
    for finger in spec.fingers:
        whole = max(float(sums[list(finger.joints)].sum()), 1e-12)
        for name, (along, size) in shapes.items():
            for joint in finger.joints:
                if size[joint] > 1e-12 and along[joint] > 0.0:
                    gain = float(along[joint] ** 2 / size[joint])
                    found[finger.name].append(Gain(name, joint, float(along[joint] / size[joint]), gain, gain / whole))
    return found


def largest(window: Window, spec: HandSpec) -> Vector:
    """The largest gain of every finger, (fingers,): of free motions, to set `quiet`."""
    found = gains(window, spec)
    return np.array([max((each.gain for each in found[finger.name]), default=0.0) for finger in spec.fingers])


def _along(x: Array, d: Array) -> tuple[Vector, Vector]:
    """Σ x d and Σ x² of every joint, (n,) each."""
    return np.asarray((x * d).sum(axis=0)), np.asarray(np.square(x).sum(axis=0))


def _late(rows: Array) -> Array:
    """As a disturbance follows what makes it: a third of a row later."""
    return np.asarray((2.0 * rows + np.concatenate([rows[:1], rows[:-1]])) / 3.0)


def _holding(window: Window) -> bool:
    """Whether several fingers pressed on something at once: no single joint's fault does that, and of a finger that
    something touches nobody knows what is its own."""
    return bool((window.holds.sum(axis=1) > 1).any())


def _alone(window: Window, spec: HandSpec) -> Vector:
    """Each joint's share of the squares of its finger's disturbances, (n,)."""
    square, share = np.square(window.disturbance).sum(axis=0), np.zeros(spec.n_joints)
    for finger in spec.fingers:
        own = list(finger.joints)
        share[own] = square[own] / max(float(square[own].sum()), 1e-12)
    return share


def _stuck(window: Window, spec: HandSpec) -> int | None:
    still = np.ptp(window.position, axis=0) < STILL
    push = np.abs(window.disturbance)
    held: NDArray[np.bool_] = still & (push.mean(axis=0) > PUSHED) & (np.ptp(window.torque, axis=0) > PUSHED)
    against = (window.disturbance * window.torque).sum(axis=0) < 0.0
    found = np.flatnonzero(held & against & (_alone(window, spec) > SINGLE))
    return int(found[push[:, found].mean(axis=0).argmax()]) if len(found) else None


def _odd_joints(found: Mapping[str, Sequence[Gain]], quiet: Vector, spec: HandSpec) -> int:
    pairs = zip(spec.fingers, quiet, strict=True)
    return sum(len({g.joint for g in found[f.name] if g.gain > above and g.name != "payload"}) for f, above in pairs)
