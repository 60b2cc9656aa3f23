"""Fault signatures: faults recognised by the shape of their disturbances, as pure functions of a window of 1.5 s.

Each physical fault disturbs a finger's joints with a shape x of its own, times one unknown c. A weak motor: minus its
own torque. Friction: the sign of the speed. A payload: the weight of its link, as every joint before it carries it. No
file's dry friction is exact, so the sign of each joint's speed, s, counts as noise, too. Products are therefore

    x · y = Σ x y − ρ (Σ x s) (Σ y s) / (1 + ρ Σ s²),    ρ = RUB.

Of the shapes of all joints the one that explains most squares wins, G = (x · d)² / (x · x), with a possible c. Where a
file does not fit a joint, free motion leaves more than noise. There d and x are divided by that, in units of NOISE
(`MirrorWindow.weight`), so that the joint hides nothing of its neighbours. Only joints that move, and have moved the
same way for a row, count: at rest dry friction hides everything.

A touch that resembles a fault for a while differs in two ways: the shape leaves more unexplained, and once the touch is
over, no amount is left. So a name needs a shape that explains nearly everything in every part of the window.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec
from allegro_twin.twin.mirror.faults import (
    KNOWN,
    MOVING,
    SINGLE,
    Fault,
    FaultName,
    MirrorWindow,
    finger_share,
    holds_object,
)
from allegro_twin.types import Array, Vector

NOISE = 4e-4
"""N·m: noise of a row's disturbance with a correct file. On the joints of hands 40, 41, 84 and 85: 0.24 to 0.5 mN·m."""
RUB = 1.5
"""In NOISE²: variance of dry friction about the file in a healthy hand, half a count of torque and more; on the same
hands 0.43 mN·m."""
USUAL = {"weak": 1.0, "friction": 0.1, "payload": 0.05}
"""1, N·m, kg. Ours: where two shapes explain equally well, the less unusual amount is likelier, by its share of this,
squared."""
MOST = {"weak": 1.0, "friction": np.inf, "payload": np.inf}
SHARE = 0.5  # Share of the squares beyond noise that one shape must explain.
PARTS, EVEN = 3, 2.0
"""Parts of a window, alike in what the shape predicts, and the factor by which the amount may differ between them: a
touch that ended is in the first ones alone."""
LEFT, QUIETS = 0.1, 5.0
"""Squares that may remain, as a share of what the shape explains, and in gains that free motions do not reach. Of 24
faults on hands 40 and 41 nothing more remained, of most touches a quarter and more (docs/results/mirror.md)."""
LEAST = {"weak": 0.1, "friction": 0.008, "payload": 0.002}  # 1, N·m, kg: smaller faults are not named.
LATEST, HIDDEN, MISSING = 8, 0.08, 0.5
"""Rows at a window's end; N·m that friction hides in a finger at rest (`slip_detection.PRESSED`); share of a fault's
effect that may lack there: twice what a size may be wrong by, and the disturbance follows its cause."""
AS_WELL = 20.0
"""Squares, in those that remain per row, by which friction or a weak motor must explain more than a steady push on the
same finger: e¹⁰ times as likely."""
BETTER = 0.25
"""Share of what a payload leaves of the squares that a steady push must leave to be the likelier one. Ours."""
_TINY = 1e-12
MANY, FINGERS = 5, 3  # Joints with a fault, on this many fingers: then the file is wrong.


BENT, BREAKS = 3, 1.02
"""Rows until bristles are bent, 0.1 s, and the ratio of breakaway friction to friction in fast motion. With these,
friction was told from weakness in 47 of 48 windows of hands 200-202 (13 without)."""


class SignatureGain(NamedTuple):
    """Gain of one shape: its share in a finger's disturbances."""

    name: FaultName
    joint: int
    amount: float
    gain: float
    """Sum of squares, N²m²."""
    share: float
    """Share of all squares beyond noise."""
    left: float
    """Mean of the remaining squares, N²m²."""


def signature_fault(window: MirrorWindow, quiet: Vector, spec: HandSpec) -> Fault | None:
    """The fault whose shape a disturbance has, or None. `quiet`: gains that free motions do not reach, (fingers,)."""
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
    if most.name == "payload" and not carries(window, most.joint, most.amount, spec):
        return None
    if most.name == "friction" and not overcomes(most.joint, most.amount, spec):
        return None
    if _is_push(window, most, spec):
        return None
    finger = next(f.name for f in spec.fingers if most.joint in f.joints)
    others = max((each.gain for each in found[finger] if each is not most), default=0.0)
    return Fault(most.name, most.joint, most.amount, (most.gain - others) / max(most.left, NOISE**2), most.gain)


def _is_push(window: MirrorWindow, found: SignatureGain, spec: HandSpec) -> bool:
    """Whether steady torques on a finger's joints explain its disturbances as well as a fault: friction in strokes of
    one direction is one; a weight turns with its link, and a motor's share changes with its torque."""
    own = list(spec.fingers[spec.finger_of(found.joint)].joints)
    moving = _moving(window)[:, own]
    count, window = moving.sum(), _weighted(window)
    side, d = np.where(moving, _delay(window.side)[:, own], 0.0), np.where(moving, window.disturbance[:, own], 0.0)
    steady = np.broadcast_to(window.weight, window.disturbance.shape[1:])[own] * moving
    size = _product(steady, steady, side)
    push = float((np.square(_product(steady, d, side)) / np.maximum(size, _TINY)).sum())
    noise, left = NOISE**2, count * found.left
    if found.name != "payload":
        return found.gain - push < AS_WELL * max(found.left, noise)
    return push - found.gain > AS_WELL * noise and left - (push - found.gain) < BETTER * left


def carries(window: MirrorWindow, joint: int, mass: float, spec: HandSpec) -> bool:
    """Whether the motors before a link carry a mass on it, kg: what is too heavy for them is a contact's force."""
    own = list(spec.fingers[spec.finger_of(joint)].joints)
    heaviest = mass * np.abs(window.pull[:, joint, own]).max(axis=0)
    return bool((heaviest < spec.actuation.torque_limit[own]).all())


def overcomes(joint: int, friction: float, spec: HandSpec) -> bool:
    """Whether a joint's motor overcomes a friction, N·m. What moves in spite of more is pushed, or misread: an encoder
    that counts the wrong way shows friction of any size."""
    return friction < float(spec.actuation.torque_limit[joint])


def still_shows(window: MirrorWindow, name: FaultName, joint: int, amount: float, spec: HandSpec) -> bool:
    """Whether a disturbance at the end of a window is what a fault of this size makes: within half of it, and what
    friction hides of it in a joint at rest. What is over was a contact."""
    if name not in ("weak", "payload"):
        return True
    own, last = list(spec.fingers[spec.finger_of(joint)].joints), slice(-LATEST, None)
    shape = -window.torque[last, own] * (np.array(own) == joint) if name == "weak" else window.pull[last, joint, own]
    expected, found = amount * shape.mean(axis=0), window.disturbance[last, own].mean(axis=0)
    return bool((np.abs(found - expected) < HIDDEN + MISSING * np.abs(expected)).all())


class SignatureFit(NamedTuple):
    """One shape's amount in a window, of either sign, and how well it explains the finger's disturbances."""

    amount: float
    gain: float
    """Sum of squares, N²m²."""
    left: float
    """Remaining squares beyond noise, N²m²."""
    parts: Vector
    """Amounts in parts of the window one after the other, (PARTS,)."""

    def convinces(self, quiet: float) -> bool:
        """Whether the shape explains nearly everything, all the time. `quiet`: gain that free motions do not reach."""
        share = self.parts / self.amount if self.amount else np.zeros(PARTS)
        even = share.min() > 0.0 and share.max() < EVEN * share.min()
        return bool(self.gain > quiet and even and self.left < LEFT * self.gain + QUIETS * quiet)


def fit_signature(window: MirrorWindow, name: FaultName, joint: int, spec: HandSpec) -> SignatureFit:
    """Fit the shape of one of weak, friction and payload to the disturbances of its joint's finger."""
    own = list(spec.fingers[spec.finger_of(joint)].joints)
    moving = _moving(window)[:, own]
    window = _weighted(window)
    side, torque = (np.where(moving, _delay(each)[:, own], 0.0) for each in (window.side, window.torque))
    d, only = np.where(moving, window.disturbance[:, own], 0.0), np.array(own) == joint
    shape = {"weak": -torque * only, "friction": -side * only, "payload": window.pull[:, joint, own] * moving}[name]
    return _fit(shape, d, side, int(moving.sum()))


def fit_supply(window: MirrorWindow) -> SignatureFit:
    """Fit one missing share of their torque to the motors of all joints that move."""
    moving, window = _moving(window), _weighted(window)
    side, torque, d = (np.where(moving, each, 0.0) for each in (_delay(window.side), _delay(window.torque), window[0]))
    return _fit(-torque, d, side, int(moving.sum()))


def _fit(shape: Array, d: Array, side: Array, count: int) -> SignatureFit:
    """Fit a shape to disturbances beside friction of unknown size, all weighted, (k, joints); `count`: how many of them
    are of joints that move."""
    grows = np.cumsum(np.square(shape).sum(axis=1))
    cuts = np.searchsorted(grows, grows[-1] * np.arange(1, PARTS) / PARTS) + 1

    def products(x: Array, y: Array, rows: slice) -> float:
        return float(_product(x[rows], y[rows], side[rows]).sum())

    whole = slice(None)
    size, along = products(shape, shape, whole), products(shape, d, whole)
    amount = along / size if size > _TINY else 0.0
    gain = amount * along
    left = max(products(d, d, whole) - gain - count * NOISE**2, 0.0)
    ends = [slice(*each) for each in pairwise((0, *cuts.tolist(), len(d)))]
    parts = [products(shape, d, rows) / max(products(shape, shape, rows), _TINY) for rows in ends]
    return SignatureFit(amount, gain, left, np.array(parts))


def signature_gains(window: MirrorWindow, spec: HandSpec) -> dict[str, list[SignatureGain]]:
    """Gains of all shapes of all joints, by finger. Of two similar shapes the smaller has the larger gain."""
    moving, window = _moving(window), _weighted(window)
    side, torque, d = (np.where(moving, each, 0.0) for each in (_delay(window.side), _delay(window.torque), window[0]))

    def product(x: Array, y: Array) -> Array:
        return _product(x, y, side)

    same = np.zeros((spec.n_joints, spec.n_joints))
    for finger in spec.fingers:
        same[np.ix_(finger.joints, finger.joints)] = 1.0
    carried = np.moveaxis(window.pull, 1, 0) * moving
    fits: dict[FaultName, tuple[Vector, Vector]] = {
        "weak": (product(-torque, d), product(torque, torque)),
        "friction": (product(-side, d), product(side, side)),
        "payload": ((product(carried, d) * same).sum(axis=1), (product(carried, carried) * same).sum(axis=1)),
    }
    left = np.where(moving, KNOWN * window.known, 0.0)
    remains: dict[FaultName, Vector] = {
        "weak": product(torque, left),
        "friction": product(side, left),
        "payload": (product(carried, left) * same).sum(axis=1),
    }
    squares, counts, found = same @ product(d, d), same @ moving.sum(axis=0), {}
    for finger in spec.fingers:
        joints = [(name, joint) for name in fits for joint in finger.joints]
        each = [
            _gain(name, j, fits[name][0][j], fits[name][1][j], squares[j], counts[j], remains[name][j])
            for name, j in joints
        ]
        found[finger.name] = [gain for gain in each if gain is not None]
    return found


def _weighted(window: MirrorWindow) -> MirrorWindow:
    """Disturbances and all that explains them, weighted."""
    weight = window.weight
    return window._replace(
        disturbance=weight * window.disturbance, torque=weight * window.torque, side=weight * window.side,
        pull=weight * window.pull, known=weight * window.known,
    )  # fmt: skip


def _product(x: Array, y: Array, side: Array) -> Array:
    """Products of shapes (..., k, n), joint by joint, (..., n); `side`: of friction, (k, n)."""
    known = RUB / (1.0 + RUB * np.square(side).sum(axis=0))
    apart = (x * side).sum(axis=-2) * (y * side).sum(axis=-2)
    return np.asarray((x * y).sum(axis=-2) - known * apart)


def _gain(
    name: FaultName, joint: int, along: float, size: float, whole: float, count: float, remains: float
) -> SignatureGain | None:
    """`whole`: squares to be explained; `count`: number of rows of joints in them; `remains`: what errors in the sizes
    of named faults may add to `along`."""
    if size < _TINY or along <= 0.0:
        return None
    amount = min(along / size, MOST[name])
    gain = amount * (2.0 * along - amount * size) - (NOISE * amount / USUAL[name]) ** 2 - remains**2 / size
    share = gain / max(whole - count * NOISE**2, gain, 1e-12)
    return SignatureGain(name, joint, float(amount), float(gain), float(share), float((whole - gain) / count))


def _moving(window: MirrorWindow) -> NDArray[np.bool_]:
    """Where a joint moves, and moved the same way in the row before, (k, n): until then the disturbance is not
    complete. Friction that breaks away bends its bristles for longer."""
    way = np.sign(window.velocity) * (np.abs(window.velocity) > MOVING)
    breaks, moving = (np.abs(window.side) > BREAKS).any(axis=0), way != 0.0
    for back in range(1, BENT + 1):
        before = np.concatenate([np.zeros_like(way[:back]), way[:-back]])[: len(way)]
        moving &= (way == before) | ((back > 1) & ~breaks)
    return np.asarray(moving)


def largest_gains(window: MirrorWindow, spec: HandSpec) -> Vector:
    """The largest gain of every finger, (fingers,). Those of free motions give `quiet`."""
    found = signature_gains(window, spec)
    return np.array([max((each.gain for each in found[finger.name]), default=0.0) for finger in spec.fingers])


def free_noise(windows: Sequence[MirrorWindow], spec: HandSpec) -> Vector:
    """What free motion leaves of each joint's disturbances while it moves, rms, at least NOISE, (n,), N·m."""
    moving = [_moving(window) for window in windows]
    rows = np.maximum(sum((each.sum(axis=0) for each in moving), np.zeros(spec.n_joints)), 1.0)
    squares = [np.square(np.where(each, window.disturbance, 0.0)) for each, window in zip(moving, windows, strict=True)]
    return np.maximum(np.sqrt(sum((each.sum(axis=0) for each in squares), np.zeros(spec.n_joints)) / rows), NOISE)


def _delay(rows: Array) -> Array:
    """Delay rows by a third, as a disturbance follows its cause."""
    return np.asarray((2.0 * rows + np.concatenate([rows[:1], rows[:-1]])) / 3.0)


def _odd_joints(found: Mapping[str, Sequence[SignatureGain]], quiet: Vector, spec: HandSpec) -> int:
    pairs = zip(spec.fingers, quiet, strict=True)
    return sum(len({g.joint for g in found[f.name] if g.gain > above and g.name != "payload"}) for f, above in pairs)
