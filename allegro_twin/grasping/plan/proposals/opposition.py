"""Pre-shapes of any hand: fingertips that oppose each other across a ball between them.

For a ball of diameter d at c in the palm frame, over the motors q and c, least squares of

    (‖tᵢ − c‖ − d/2) / 5 mm     every fingertip tᵢ is on the ball,
    3 Σ wᵢ uᵢ                   pushes balance; uᵢ = (tᵢ − c)/‖tᵢ − c‖, w = ½ of one finger, the others share ½,
    (1 + pᵢ·uᵢ) / 2             pads look at the centre; pᵢ: where the last joint moves the tip as it bends,
    (sᵢⱼ − (tᵢ − tⱼ)·eᵢⱼ)₊ / 5 mm those of one side stay apart and in their order: eᵢⱼ as in the flat hand,
    0.15 (q − q₀)/range         joints are in the middle of their ranges, where nothing else says so.

Fingers that have no part in it are bent by a quarter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.metrics.quality import import_scipy
from allegro_twin.grasping.plan.candidate import round_posture
from allegro_twin.grasping.plan.proposals.close_in_geometry import motor_scale
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.taxonomy import claim_type
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.sim.contact.self_clearance import SelfClearance
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

MIDDLING, OTHERS = 0.065, ((0.085,), (0.045, 0.025))
"""m: the ball that a hand is shown first, and those to which its posture is led from there."""
NEAR, BALANCED = 0.015, 0.35
"""A posture whose fingertips are further from the ball, m, or leave more of their push over, is no pre-shape."""
TOWARDS = 0.5
"""A motor closes if it moves fingertips toward the centre within 60°, as a cosine."""
GATHERS = 0.3
"""Least share of the fingertips' motion that must bring them nearer to the centre for the hand to close."""
OPENED, SQUEEZED = 0.5, 0.3
"""rad, of the joints that close, from the ball: back for the pre-shape, further for the squeeze."""
EXACT, BALANCE, PADS, MIDDLE = 0.005, 3.0, 0.5, 0.15
"""m of a fingertip beside the ball that count as one; weights of balance, of where pads look, of the middle."""
APART, WIDE, ASIDE = 0.9, 0.025, 0.25
"""Share of their distance in the flat hand, and at most m, that fingertips of one side keep; share of its range by
which an uninvolved joint bends."""
ONE_SIDED = 0.2
"""Share of a range's width: a range whose middle is further than half of that from zero bends one way."""
THUMB = "thumb"
"""Name of the finger that opposes the others, in a hand that has one."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OpposingGrasp(Grasp):
    """A grasp that has room for a ball between fingertips."""

    centre: Vector
    """Centre of the ball in the palm frame, (3,), m."""
    diameter: float
    """m."""
    fingers: tuple[str, ...]
    """Those on the ball; the first opposes the others."""


def opposing_grasps(spec: HandSpec) -> list[OpposingGrasp]:
    """One for each of some diameters, and for all fingers, three of them or two. Raises ConfigError for a hand without
    two fingertips, and for one whose fingertips cannot oppose each other."""
    if len(spec.fingers) < 2:
        raise ConfigError(f"{spec.name} has fewer than two fingertips: name them in its card")
    hand = _Opposition(spec)
    found = [grasp for group in hand.groups(hand.opposer()) for grasp in hand.family(group)]
    if not found:
        raise ConfigError(
            f"{spec.name}: no posture has its fingertips opposite each other: store a grasp of it in the library"
        )
    return found


def card_postures(spec: HandSpec) -> tuple[dict[str, Vector], list[str]]:
    """Postures for the card of a hand, (n,), rad, and notes on what touches in them. `flat`: every motor as near to
    zero as it can be. `home`: fingertips on a ball, as many and as near to 65 mm as no parts of the hand touch; else
    `flat`. `open`: the flat hand, its thumb, if it has one, turned to as many fingers as can have a ball. All three are
    `flat` for a hand whose fingertips cannot oppose each other. Raises ConfigError without SciPy."""
    import_scipy("optimize")
    flat, notes, touching = round_posture(spec.rest, spec), list[str](), _Touching(spec)
    postures = dict.fromkeys(("home", "open", "flat"), flat)
    try:
        grasps = opposing_grasps(spec)
    except ConfigError:
        grasps = []
    grasps.sort(key=lambda grasp: (-len(grasp.fingers), abs(grasp.diameter - MIDDLING)))
    home = next((grasp for grasp in grasps if not touching(round_posture(grasp.close, spec))), None)
    if grasps and home is not grasps[0]:
        instead = "is `flat`" if home is None else f"has {_on_ball(home)}"
        met = touching(round_posture(grasps[0].close, spec))
        notes.append(f"`home` {instead}: with {_on_ball(grasps[0])}, {met}")
    if home is not None:
        postures["home"] = round_posture(home.close, spec)
    if grasps and grasps[0].fingers[0] == THUMB:
        best, opened = grasps[0], flat.copy()
        turned = [joint for joint in spec.finger(THUMB).joints if best.preshape[joint] == best.squeeze[joint]]
        opened[turned] = best.close[turned]
        postures["open"] = round_posture(opened, spec)
    notes += [f"in the posture `{name}` {met}" for name in ("open", "flat") if (met := touching(postures[name]))]
    return postures, notes


def _on_ball(grasp: OpposingGrasp) -> str:
    return f"{', '.join(grasp.fingers)} on a ball of {round(grasp.diameter * 1000)} mm"


class _Touching:
    """The parts of a hand that are deepest in each other in a posture, in words; empty where they are apart."""

    def __init__(self, spec: HandSpec) -> None:
        self._clearance = SelfClearance(spec)

    def __call__(self, posture: Vector) -> str:
        apart = self._clearance(posture[None])[0]
        deepest = int(np.argmin(apart))
        if apart[deepest] >= 0.0:
            return ""
        one, other = self._clearance.pairs[deepest]
        return f"{one} and {other} would be {-1000.0 * apart[deepest]:.1f} mm inside each other"


class _Opposition:
    """The least squares of one hand."""

    def __init__(self, spec: HandSpec) -> None:
        self.spec, self.model = spec, hand_kinematics(spec)
        self.names = [finger.name for finger in spec.fingers]
        self.moving = np.unique([joint for finger in spec.fingers for joint in finger.joints])
        self.lower, self.upper = spec.lower[self.moving], spec.upper[self.moving]
        total, span = spec.lower + spec.upper, spec.upper - spec.lower
        self.sign = np.where(np.abs(total) > ONE_SIDED * span, np.sign(total), 0.0)
        """Which way each motor bends its finger, (n,): away from zero; 0 where its range is alike on both sides."""
        self.bends = [self._bend(finger) for finger in range(len(spec.fingers))]
        """Last motor of each finger, and the direction in which it bends the finger."""
        tips = self._tips(np.asarray(spec.rest))
        apart = tips[:, None] - tips
        far = np.maximum(np.linalg.norm(apart, axis=2), 1e-6)
        self.sides = apart / far[:, :, None]
        """From one fingertip to another in the flat hand, (fingers, fingers, 3)."""
        self.spaces = np.minimum(APART * far, WIDE)
        """That they keep between each other in that direction, (fingers, fingers), m."""

    def preferred(self, group: Sequence[int]) -> Array:
        """Where moving motors are if nothing else says so."""
        span, sign = self.upper - self.lower, self.sign[self.moving]
        own = np.isin(self.moving, [joint for each in group for joint in self.spec.fingers[each].joints])
        part = np.where(own | (sign == 0.0), 0.5, ASIDE)
        preferred: Array = np.where(sign < 0.0, self.upper - part * span, self.lower + part * span)
        return preferred

    def posture(self, x: Array) -> Vector:
        posture = np.array(self.spec.rest, dtype=float)
        posture[self.moving] = x[: len(self.moving)]
        return posture

    def opposer(self) -> int:
        """The thumb; of a hand without one, the finger that has the others against it best."""
        if THUMB in self.names:
            return self.names.index(THUMB)
        groups = [[k, *(j for j in range(len(self.names)) if j != k)] for k in range(len(self.names))]
        return int(np.argmin([self._first(group).cost for group in groups]))

    def groups(self, opposer: int) -> list[list[int]]:
        """The opposer first: with all fingers, with the one that it opposes best and the better one beside that, with
        the one."""
        others = [k for k in range(len(self.names)) if k != opposer]
        costs = [self._first([opposer, k]).cost for k in others]
        best = int(np.argmin(costs))
        beside = [k for k in (best - 1, best + 1) if 0 <= k < len(others)]
        found = [others, [others[best]]]
        if len(others) > 2:
            second = min(beside, key=lambda k: costs[k])
            found.insert(1, [others[k] for k in sorted((best, second))])
        return [[opposer, *each] for each in found if len(others) > 1 or each is others]

    def family(self, group: Sequence[int]) -> list[OpposingGrasp]:
        """A group's grasps of balls of all sizes that it can hold: the same motors close for all of them, those which
        close on the largest."""
        first = self._first(group)
        found = {MIDDLING: first}
        for sizes in OTHERS:
            last = first
            for diameter in sizes:
                found[diameter] = last = self._solve(group, diameter, last.x)
        held = sorted(each for each, solved in found.items() if self._opposes(solved, group, each))
        if not held:
            return []
        closing = self._closing(found[held[-1]], group)
        return [self._grasp(group, found[diameter], diameter, closing) for diameter in held] if closing.any() else []

    def _first(self, group: Sequence[int]) -> _Solved:
        """For the middling ball, from half bent, less and more."""
        span, sign, solved = self.upper - self.lower, self.sign[self.moving], []
        for part in (0.35, 0.5, 0.65):
            bent = np.where(sign < 0.0, self.upper - part * span, self.lower + np.where(sign > 0.0, part, 0.5) * span)
            middle = self._tips(self.posture(bent))[list(group)].mean(axis=0)
            solved.append(self._solve(group, MIDDLING, np.append(bent, middle)))
        return min(solved, key=lambda each: each.cost)

    def _solve(self, group: Sequence[int], diameter: float, begin: Array) -> _Solved:
        box = np.append(self.lower, np.full(3, -1.0)), np.append(self.upper, np.full(3, 1.0))
        scale = np.append(np.maximum(self.upper - self.lower, 1e-3), np.full(3, 0.05))
        state = _Residuals(self, list(group), diameter)
        solved = import_scipy("optimize").least_squares(
            state.values, np.clip(begin, box[0] + 1e-6, box[1] - 1e-6), state.slopes, box, x_scale=scale, max_nfev=80
        )
        return _Solved(np.asarray(solved.x), float(solved.cost))

    def _opposes(self, solved: _Solved, group: Sequence[int], diameter: float) -> bool:
        away = self._tips(self.posture(solved.x))[list(group)] - solved.x[-3:]
        far = np.linalg.norm(away, axis=1)
        left = np.linalg.norm(_weights(len(group)) @ (away / far[:, None]))
        return bool(np.abs(far - diameter / 2.0).max() < NEAR and left < BALANCED)

    def _grasp(self, group: Sequence[int], solved: _Solved, diameter: float, closing: Array) -> OpposingGrasp:
        """What opens from there, and squeezes."""
        spec, close = self.spec, self.posture(solved.x)
        by = motor_scale(spec) * closing
        preshape, squeeze = (np.clip(close + far * by, spec.lower, spec.upper) for far in (-OPENED, SQUEEZED))
        fingers = tuple(self.names[each] for each in group)
        name = "_".join([*fingers, f"{round(diameter * 1000)}mm"])
        speed = float((spec.upper - spec.lower).max())
        return OpposingGrasp(
            name, claim_type(None), speed, "minimum_jerk", preshape, close, squeeze,
            centre=solved.x[-3:], diameter=diameter, fingers=fingers,
        )  # fmt: skip

    def _closing(self, solved: _Solved, group: Sequence[int]) -> Array:
        """Which way each motor moves fingertips toward the centre, (n,): 1, -1, or 0 for one that does not; 0 for all
        where they would not come nearer to it together."""
        tips, jacobians = self.tips_and_slopes(self.posture(solved.x), group)
        towards = solved.x[-3:] - tips
        towards /= np.linalg.norm(towards, axis=1)[:, None]
        gain = np.einsum("fim,fi->m", jacobians, towards)
        most = np.linalg.norm(jacobians, axis=1).sum(axis=0)
        closing: Array = np.where(np.abs(gain) > TOWARDS * np.maximum(most, 1e-6), np.sign(gain), 0.0)
        spread = self.sign == 0.0
        spread[list(self.spec.fingers[group[0]].joints)] = False
        closing[spread] = 0.0  # Fingers of one side bend; what spreads them stays.
        for finger in group:  # One that meets the ball across its way closes by its last joint.
            if not closing[list(self.spec.fingers[finger].joints)].any():
                motor, sign = self.bends[finger]
                closing[motor] = sign
        moved = jacobians @ closing
        nearer, all_of_it = np.sum(moved * towards), np.linalg.norm(moved, axis=1).sum()
        return closing if nearer > GATHERS * all_of_it else np.zeros_like(closing)

    def tips_and_slopes(self, posture: Vector, group: Sequence[int]) -> tuple[Array, Array]:
        """Fingertips (k, 3), m, and their Jacobians by all motors, (k, 3, n)."""
        return self.model.fingertip_jacobians(posture, [self.names[k] for k in group])

    def _bend(self, finger: int) -> tuple[int, float]:
        """The last motor of a finger, and which way it bends: by its range, or toward the other fingertips."""
        spec = self.spec
        motor = spec.fingers[finger].joints[-1]
        if self.sign[motor]:
            return motor, float(self.sign[motor])
        middle = (spec.lower + spec.upper) / 2.0
        tips, jacobians = self.model.fingertip_jacobians(middle, self.names)
        others = np.delete(tips, finger, axis=0).mean(axis=0)
        return motor, float(np.sign(jacobians[finger, :, motor] @ (others - tips[finger])) or 1.0)

    def _tips(self, posture: Vector) -> Array:
        return self.model.fingertip_jacobians(posture, self.names)[0]


def _weights(count: int) -> Array:
    return np.append(0.5, np.full(count - 1, 0.5 / (count - 1)))


class _Solved(NamedTuple):
    x: Array
    """Moving motors, then the ball's centre."""
    cost: float


class _Residuals:
    """Residuals of the least squares, and their slopes; those of the pads as if they kept their direction."""

    def __init__(self, hand: _Opposition, group: list[int], diameter: float) -> None:
        self.hand, self.group, self.radius = hand, group, diameter / 2.0
        self.weights = _weights(len(group))
        self.span = np.maximum(hand.upper - hand.lower, 1e-6)
        self.preferred = hand.preferred(group)
        self.first, self.second = np.triu_indices(len(group) - 1, 1)  # Of those that the opposer opposes.
        self.first, self.second = self.first + 1, self.second + 1
        self.spaces = hand.spaces[np.ix_(group, group)][self.first, self.second]
        self.sides = hand.sides[np.ix_(group, group)][self.first, self.second]

    def values(self, x: Array) -> Array:
        far, unit, pads, _ = self._look(x)
        bent = (x[:-3] - self.preferred) / self.span
        looks = PADS * (1.0 + np.sum(pads * unit, axis=1))
        near = np.maximum(self.spaces - self._between(far, unit), 0.0)
        return np.concatenate(
            [(far - self.radius) / EXACT, BALANCE * self.weights @ unit, looks, near / EXACT, MIDDLE * bent]
        )

    def slopes(self, x: Array) -> Array:
        far, unit, pads, jacobians = self._look(x)
        away = np.concatenate([jacobians, np.tile(-np.eye(3), (len(unit), 1, 1))], axis=2)
        along = np.einsum("fi,fim->fm", unit, away)
        turning = (away - unit[:, :, None] * along[:, None]) / far[:, None, None]
        nearer = -np.einsum("pi,pim->pm", self.sides, away[self.first] - away[self.second])
        return np.concatenate([
            along / EXACT,
            BALANCE * np.einsum("f,fim->im", self.weights, turning),
            PADS * np.einsum("fi,fim->fm", pads, turning),
            np.where(self.spaces > self._between(far, unit), 1.0 / EXACT, 0.0)[:, None] * nearer,
            np.pad(np.diag(MIDDLE / self.span), ((0, 0), (0, 3))),
        ])  # fmt: skip

    def _between(self, far: Array, unit: Array) -> Array:
        """How far fingertips of one side are from each other in the flat hand's direction, (pairs,), m."""
        tips = far[:, None] * unit
        between: Array = np.sum((tips[self.first] - tips[self.second]) * self.sides, axis=1)
        return between

    def _look(self, x: Array) -> tuple[Array, Array, Array, Array]:
        hand = self.hand
        tips, jacobians = hand.tips_and_slopes(hand.posture(x), self.group)
        away = tips - x[-3:]
        far = np.maximum(np.linalg.norm(away, axis=1), 1e-6)
        bends = [hand.bends[finger] for finger in self.group]
        pads = np.array([sign * jacobians[row, :, motor] for row, (motor, sign) in enumerate(bends)])
        pads /= np.maximum(np.linalg.norm(pads, axis=1), 1e-9)[:, None]
        return far, away / far[:, None], pads, jacobians[:, :, hand.moving]
