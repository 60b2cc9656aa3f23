"""What is wrong with a hand by the shape of what it disturbs: pure functions of a second and a half of a mirror.

Each fault of physics leaves a disturbance of its own shape x on a finger's joints, times one unknown c: a weak motor
minus its own torque, friction the sign of the speed, a payload the weight of its link as every joint before it carries
it. No file's dry friction is exact: of every joint the sign of its speed, s, counts as noise, too, so that products are

    x · y = Σ x y − ρ (Σ x s) (Σ y s) / (1 + ρ Σ s²),    ρ = RUB,

and of the shapes of all joints that counts which takes away most squares, G = (x · d)² / (x · x), with a c that can be.
Only joints that move are looked at, and have moved that way for a row: at rest dry friction hides all of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec
from allegro_twin.twin.mirror.faults import MOVING, SINGLE, Fault, FaultName, MirrorWindow, finger_share, holds_object
from allegro_twin.types import Array, Vector

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


BENT, BREAKS = 3, 1.02
"""Rows until bristles are bent, 0.1 s, and how much friction that breaks away is more than in fast motion. With that
friction was told from weakness in 47 of 48 windows of hands 200-202 (before in 13)."""


class SignatureGain(NamedTuple):
    """What one shape takes away of a finger's disturbances."""

    name: FaultName
    joint: int
    amount: float
    gain: float
    """Sum of squares, N²m²."""
    share: float
    """Of all squares but those of noise."""
    left: float
    """Over, in the mean of what counts, N²m²."""


def signature_fault(window: MirrorWindow, quiet: Vector, spec: HandSpec) -> Fault | None:
    """What a disturbance has the shape of, or None. `quiet`: for each finger a gain that free motions do not reach,
    (fingers,)."""
    if holds_object(window):
        return None
    found, own = signature_gains(window, spec), finger_share(window, spec)
    for number, each in enumerate(spec.fingers):
        if window.holds[:, number].any() and own[list(each.joints)].max() < SINGLE:
            found[each.name] = []
    best = [max(found[finger.name], key=lambda each: each.gain, default=None) for finger in spec.fingers]
    odd = [each for each, above in zip(best, quiet, strict=True) if each is not None and each.gain > above]
    if len(odd) >= FINGERS and _odd_joints(found, quiet, spec) >= MANY:
        return Fault("wrong_file", odd[0].joint, float(len(odd)))
    sure = [each for each in odd if each.share > SHARE and each.amount > LEAST[each.name]]
    if not sure:
        return None
    most = max(sure, key=lambda each: each.gain)
    finger = next(f.name for f in spec.fingers if most.joint in f.joints)
    others = max((each.gain for each in found[finger] if each is not most), default=0.0)
    return Fault(most.name, most.joint, most.amount, (most.gain - others) / max(most.left, NOISE**2), most.gain)


def signature_gains(window: MirrorWindow, spec: HandSpec) -> dict[str, list[SignatureGain]]:
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
    fits: dict[FaultName, tuple[Vector, Vector]] = {
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


def _gain(name: FaultName, joint: int, along: float, size: float, whole: float, count: float) -> SignatureGain | None:
    """`whole`: squares of what is to be explained; `count`: of how many rows of joints."""
    if size < 1e-12 or along <= 0.0:
        return None
    amount = min(along / size, MOST[name])
    gain = amount * (2.0 * along - amount * size) - (NOISE * amount / USUAL[name]) ** 2
    share = gain / max(whole - count * NOISE**2, gain, 1e-12)
    return SignatureGain(name, joint, float(amount), float(gain), float(share), float((whole - gain) / count))


def _moving(window: MirrorWindow) -> NDArray[np.bool_]:
    """Where a joint moves, and did so in the row before, the same way, (k, n): until then a disturbance is on its
    way. Friction that breaks away bends its bristles for longer."""
    way = np.sign(window.velocity) * (np.abs(window.velocity) > MOVING)
    breaks, moving = (np.abs(window.side) > BREAKS).any(axis=0), way != 0.0
    for back in range(1, BENT + 1):
        before = np.concatenate([np.zeros_like(way[:back]), way[:-back]])[: len(way)]
        moving &= (way == before) | ((back > 1) & ~breaks)
    return np.asarray(moving)


def largest_gains(window: MirrorWindow, spec: HandSpec) -> Vector:
    """The largest gain of every finger, (fingers,): of free motions, to set `quiet`."""
    found = signature_gains(window, spec)
    return np.array([max((each.gain for each in found[finger.name]), default=0.0) for finger in spec.fingers])


def _late(rows: Array) -> Array:
    """As a disturbance follows what makes it: a third of a row later."""
    return np.asarray((2.0 * rows + np.concatenate([rows[:1], rows[:-1]])) / 3.0)


def _odd_joints(found: Mapping[str, Sequence[SignatureGain]], quiet: Vector, spec: HandSpec) -> int:
    pairs = zip(spec.fingers, quiet, strict=True)
    return sum(len({g.joint for g in found[f.name] if g.gain > above and g.name != "payload"}) for f, above in pairs)
