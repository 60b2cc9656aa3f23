"""What is wrong with a hand, by name: pure functions of a second and a half of what its mirror saw.

Each fault of physics leaves a disturbance of its own shape x on a finger's joints, times one unknown c: a weak motor
minus its own torque, friction the sign of the speed, a payload the weight of its link as every joint before it carries
it. No file's dry friction is exact: of every joint the sign of its speed, s, counts as noise, too, so that products are

    x · y = Σ x y − ρ (Σ x s) (Σ y s) / (1 + ρ Σ s²),    ρ = RUB,

and of the shapes of all joints that counts which takes away most squares, G = (x · d)² / (x · x), with a c that can be.
Only joints that move are looked at, and have moved that way for a row: at rest dry friction hides all of it. An encoder
that jumps, a joint that stays where its motor pushes, and a hot motor are seen more directly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

Name: TypeAlias = Literal[
    "weak", "stuck", "encoder_step", "payload", "friction", "hot", "wrong_file", "encoder_drift", "loose"
]  # fmt: skip
NAMES: tuple[Name, ...] = (
    "weak", "stuck", "encoder_step", "payload", "friction", "hot", "wrong_file", "encoder_drift", "loose",
)  # fmt: skip
ROW = 10
"""Periods whose means make a row of a window."""
MOVING = 0.03  # rad/s
CREEP = 0.02  # rad/s over which friction turns round.
FOLLOWS, TAKES = 0.9, 0.3
"""Of a joint that is stuck: correlation of disturbance and torque, and how much of the torque the disturbance takes
back. Of 80 on hands 40-44 and 200-209: 0.96 and more, 0.4 to 1.1."""
JUMP = 0.01  # rad in a period, 3.3 rad/s out of nothing: no joint moves so.
STILL, PUSHED = 0.003, 0.03  # rad that a stuck joint moves at most; N·m that its motor must push in the mean.
HOT = 70.0  # °C. The manufacturer's driver throttles from there on; docs/protocol.md.
NOISE = 4e-4
"""N·m: of a row's disturbance, where the file is right. Of the joints of hands 40, 41, 84 and 85: 0.24 to 0.5 mN·m."""
RUB = 1.5
"""In NOISE², how much dry friction differs from the file of a hand with nothing wrong: half a count of torque and more,
of the same hands 0.43 mN·m."""
USUAL = {"weak": 1.0, "friction": 0.1, "payload": 0.05}
"""1, N·m, kg. Ours: where two shapes explain alike the less odd amount is likelier, by its share of this squared."""
MOST = {"weak": 1.0, "friction": np.inf, "payload": np.inf}
SHARE = 0.5  # Of the squares that are not noise, what one shape must take away.
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


class Anomaly(NamedTuple):
    """Something that is wrong."""

    name: Name
    joint: int
    """Which; the first that is found where it is of the whole hand."""
    amount: float
    """Missing share of a motor, N·m of friction, kg, rad, °C, rad/s; of a file the number of fingers."""
    lead: float = np.inf
    """By how many squares of what is left over in a row the next likely explanation falls short: of fault and joint."""
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
    """Of all squares but those of noise."""
    left: float
    """Over, in the mean of what counts, N²m²."""


def direct(window: Window) -> Anomaly | None:
    """What is seen without any shape."""
    hot = np.argwhere(np.nan_to_num(window.temperature[-1:]) > HOT)
    if len(hot):
        joint = int(hot[0][1])
        return Anomaly("hot", joint, float(window.temperature[-1, joint]))
    if window.jump.max() > JUMP:
        joint = int(window.jump.max(axis=0).argmax())
        return Anomaly("encoder_step", joint, float(window.jump[:, joint].max()))
    stuck = _stuck(window)
    return None if stuck is None else Anomaly("stuck", stuck, float(np.abs(window.disturbance[:, stuck]).max()))


def shaped(window: Window, quiet: Vector, spec: HandSpec) -> Anomaly | None:
    """What a disturbance has the shape of, or None. `quiet`: for each finger a gain that free motions do not reach,
    (fingers,)."""
    found = gains(window, spec)
    best = [max(found[finger.name], key=lambda each: each.gain, default=None) for finger in spec.fingers]
    odd = [each for each, above in zip(best, quiet, strict=True) if each is not None and each.gain > above]
    if len(odd) >= FINGERS and _odd_joints(found, quiet, spec) >= MANY:
        return Anomaly("wrong_file", odd[0].joint, float(len(odd)))
    sure = [each for each in odd if each.share > SHARE and each.amount > LEAST[each.name]]
    if not sure:
        return None
    most = max(sure, key=lambda each: each.gain)
    finger = next(f.name for f in spec.fingers if most.joint in f.joints)
    others = max((each.gain for each in found[finger] if each is not most), default=0.0)
    return Anomaly(most.name, most.joint, most.amount, (most.gain - others) / max(most.left, NOISE**2), most.gain)


def gains(window: Window, spec: HandSpec) -> dict[str, list[Gain]]:
    """Of every shape of every joint, by finger; the smaller of two that are alike has the larger gain."""
    moving = _moving(window)
    side, torque, d = (np.where(moving, each, 0.0) for each in (_late(window.side), _late(window.torque), window[0]))
    known = RUB / (1.0 + RUB * np.square(side).sum(axis=0))

    def product(x: Array, y: Array) -> Array:
        """Of shapes (..., k, n), joint by joint, (..., n)."""
        apart = (x * side).sum(axis=-2) * (y * side).sum(axis=-2)
        return np.asarray((x * y).sum(axis=-2) - known * apart)

    same = np.zeros((spec.n_joints, spec.n_joints))
    for finger in spec.fingers:
        same[np.ix_(finger.joints, finger.joints)] = 1.0
    carried = np.moveaxis(window.pull, 1, 0) * moving
    fits: dict[Name, tuple[Vector, Vector]] = {
        "weak": (product(-torque, d), product(torque, torque)),
        "friction": (product(-side, d), product(side, side)),
        "payload": ((product(carried, d) * same).sum(axis=1), (product(carried, carried) * same).sum(axis=1)),
    }
    squares, counts, found = same @ product(d, d), same @ moving.sum(axis=0), {}
    for finger in spec.fingers:
        joints = [(name, joint) for name in fits for joint in finger.joints]
        each = [_gain(name, j, fits[name][0][j], fits[name][1][j], squares[j], counts[j]) for name, j in joints]
        found[finger.name] = [gain for gain in each if gain is not None]
    return found


def _gain(name: Name, joint: int, along: float, size: float, whole: float, count: float) -> Gain | None:
    """`whole`: squares of what is to be explained; `count`: of how many rows of joints."""
    if size < 1e-12 or along <= 0.0:
        return None
    amount = min(along / size, MOST[name])
    gain = amount * (2.0 * along - amount * size) - (NOISE * amount / USUAL[name]) ** 2
    share = gain / max(whole - count * NOISE**2, gain, 1e-12)
    return Gain(name, joint, float(amount), float(gain), float(share), float((whole - gain) / count))


def _moving(window: Window) -> NDArray[np.bool_]:
    """Where a joint moves, and did so in the row before, the same way, (k, n): until then a disturbance is on its
    way."""
    way = np.sign(window.velocity) * (np.abs(window.velocity) > MOVING)
    return np.asarray((way != 0.0) & (way == np.concatenate([np.zeros_like(way[:1]), way[:-1]])))


def largest(window: Window, spec: HandSpec) -> Vector:
    """The largest gain of every finger, (fingers,): of free motions, to set `quiet`."""
    found = gains(window, spec)
    return np.array([max((each.gain for each in found[finger.name]), default=0.0) for finger in spec.fingers])


def _late(rows: Array) -> Array:
    """As a disturbance follows what makes it: a third of a row later."""
    return np.asarray((2.0 * rows + np.concatenate([rows[:1], rows[:-1]])) / 3.0)


def still(window: Window) -> NDArray[np.bool_]:
    """Which joints stay, (n,)."""
    return np.asarray(np.ptp(window.position, axis=0) < STILL)


def _stuck(window: Window) -> int | None:
    """A joint that stays, and whose disturbance takes back what its motor does: of one that friction holds in hand and
    mirror alike it stays as it is."""
    push, torque = np.abs(window.disturbance).mean(axis=0), window.torque - window.torque.mean(axis=0)
    d = window.disturbance - window.disturbance.mean(axis=0)
    along, size = (d * torque).sum(axis=0), np.square(torque).sum(axis=0)
    follows = along < -np.maximum(FOLLOWS * np.sqrt(size * np.square(d).sum(axis=0)), TAKES * size)
    held = still(window) & (push > PUSHED) & (np.ptp(window.torque, axis=0) > PUSHED) & follows
    found = np.flatnonzero(held)
    return int(found[push[found].argmax()]) if len(found) else None


def _odd_joints(found: Mapping[str, Sequence[Gain]], quiet: Vector, spec: HandSpec) -> int:
    pairs = zip(spec.fingers, quiet, strict=True)
    return sum(len({g.joint for g in found[f.name] if g.gain > above and g.name != "payload"}) for f, above in pairs)
