"""Grasp types of the GRASP taxonomy, from the contacts that carry the load.

The cells are those of Feix et al. 2016 (`library.taxonomy`): opposition, virtual finger 2, power or precision, thumb.
Where types share a cell, the object's shape and size decide, as the paper says; its figure shows which, and gives no
numbers: the thresholds here are this project's own.

1. **Carries**: a part of the hand that bears at least `CARRIES` of the hand's normal force on the object, averaged
   over the phase in which it is held up. What carries less takes no part.
2. **Opposition**: *palm*, where the palm carries, or fingers alone do with their inner links (a hook: the palm's part
   is the load's); else *side*, where a finger bears mostly with a side; else *pad*. A thumb's own side counts as its
   pad: the paper's side opposition is about the sides of fingers. A digit that bears with its back is of no type.
3. **Virtual finger 2**: palm, every finger but the index, or all of them; pad, how many fingers; side, whose sides. A
   robot's fingers are alike, so pads are counted and not named: thumb against middle is a pinch as thumb against
   index is. All that a hand has stand for 2-5 where figure 4 has no cell for just so many.
4. **Power or precision** in pad opposition: power from `INNER` of the digits' force on inner links.
5. **Thumb**: abducted where it stands `ABDUCTED` or more out of the palm's plane; adducted below, and where it does
   not carry in palm opposition. In pad opposition a thumb is opposed, which is abducted, but for Parallel Extension:
   a low thumb along stretched fingers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from allegro_twin.hands.library.taxonomy import GRASP_TYPES, NONE, Control, ObservedType, Opposition
from allegro_twin.types import Array

CARRIES = 0.05
"""Share of the hand's normal force on the object from which a part of the hand carries."""
INNER = 0.25
"""Share of the digits' normal force on inner links from which more than fingertips hold."""
ABDUCTED = 45.0
"""Degrees. Between the palm's plane, where an adducted thumb lies, and its normal, along which one opposes."""
STRAIGHT = 0.9
"""Distance from root to tip over the length along the links: two joints bent by 35° each come to it."""
APART = 30.0
"""Degrees across the palm between the directions in which two fingers press: around an object, not side by side."""
MOSTLY = 0.5
"""Share of a digit's force on one kind of surface from which it bears mostly with that."""
SMALL, LARGE = 0.25, 0.55
"""Shares of the longest finger: thickness of an object below which the hand closes around it, and above which it does
not get around. 25 and 55 mm of a human's finger of 100 mm."""
FLAT, LONG, EQUAL, ROUND = 0.5, 2.0, 1.3, 0.65
"""Shape limits of an object: thickness over width of a plate or disk, length over width of a rod, width over thickness
up to which it is as wide as thick, and how much of its box it fills as a ball (π/6 = 0.52; a cylinder π/4 = 0.79)."""


class ObjectShape(NamedTuple):
    """An object: the edges of its bounding box, m, sorted, and how much of the box it fills."""

    short: float
    middle: float
    long: float
    fill: float = 1.0

    @property
    def ball(self) -> bool:
        return self.long <= EQUAL**2 * self.short and self.fill <= ROUND

    @property
    def disk(self) -> bool:
        return self.flat and self.long <= EQUAL * self.middle and self.fill < 0.9

    @property
    def flat(self) -> bool:
        return self.short <= FLAT * self.middle

    @property
    def rod(self) -> bool:
        return self.long >= LONG * self.middle and not self.flat


class SurfaceLoad(NamedTuple):
    """Load on one surface of one part of the hand."""

    part: str
    """A digit's name, or `palm`."""
    surface: str
    """`tip`, `pad`, `inner`, `side`, `back`; of the palm `palm`."""
    force: float
    """Mean normal force on the object, N."""
    normal: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Its mean direction, into the object, in the palm's frame."""


@dataclass(frozen=True, slots=True)
class GraspObservation:
    """Observation of a grasp while it holds."""

    bearings: Sequence[SurfaceLoad]
    fingers: tuple[str, ...]
    """All of the hand's but the thumb, from its side outward: index first."""
    shape: ObjectShape
    thumb: str | None = "thumb"
    """None: a hand whose digits are alike; then the one that all others press against is."""
    elevation: float = 90.0
    """Elevation of the thumb out of the palm's plane, degrees."""
    straight: Mapping[str, float] = field(default_factory=dict)
    """Straightness of each digit: root to tip over its length; 0 where unknown."""
    reach: float = 0.1
    """Length of the longest finger, m."""


def classify_grasp(observation: GraspObservation) -> ObservedType:
    """The type; `ObservedType.number` is None for none of the 33."""
    return _Classifier(observation).type()


class _Classifier:
    """The contacts that carry, sorted by what they do."""

    def __init__(self, observation: GraspObservation) -> None:
        self.observation, self.shape = observation, observation.shape
        total = sum(b.force for b in observation.bearings)
        parts = {b.part: sum(c.force for c in observation.bearings if c.part == b.part) for b in observation.bearings}
        self.share = {part: force / total for part, force in parts.items() if force >= CARRIES * total > 0.0}
        self.bearings = [b for b in observation.bearings if b.part in self.share]
        self.total = total
        self.palm = "palm" in self.share
        self.thumb = observation.thumb if observation.thumb is not None else self._opposed()
        self.opposes = self.thumb in self.share
        digits = [f for f in observation.fingers if f != self.thumb]
        self.hand = digits
        self.fingers = [f for f in digits if f in self.share]
        self.sides = [f for f in self.fingers if self._part_of(f, "side") >= MOSTLY]
        self.faces = [f for f in self.fingers if f not in self.sides]
        self.abducted = observation.elevation >= ABDUCTED

    def type(self) -> ObservedType:
        """What it is, or why it is none."""
        if not self.share:
            return ObservedType(number=None, name=NONE, why="nothing of the hand carries the object")
        back = [part for part in self.share if self._part_of(part, "back") >= MOSTLY]
        if back:
            return self._none("on its back: " + _list(back))
        if self.palm:
            return self._palm()
        if not self.opposes:
            return self._without_thumb()
        if not self.fingers:
            return self._none("the thumb alone carries")
        return self._side() if self.sides else self._pad()

    def _palm(self) -> ObservedType:
        if not self.hand:
            return self._none("a hand without fingers", "palm")
        missing = [f for f in self.hand if f not in self.fingers]
        if self.opposes and self.abducted:
            return self._without(missing) if missing else self._is(self._wrapped())
        index, others = self.hand[0], self.hand[1:]
        if others and all(f in self.fingers for f in others) and self._extended(index):
            return self._is(17)
        if missing:
            return self._without(missing)
        if self.opposes:
            return self._is(5 if self.shape.middle < SMALL * self.observation.reach else 4)
        return self._is(30 if self.shape.flat else 15)

    def _wrapped(self) -> int:
        if self.shape.ball:
            return 11
        if self.shape.disk:
            return 10
        thick = self.shape.middle / self.observation.reach
        return 2 if thick < SMALL else 1 if thick > LARGE else 3

    def _without_thumb(self) -> ObservedType:
        one, *others = self.fingers
        if self.sides == self.fingers and len(self.fingers) == 2 and self._neighbours():
            return self._is(23)
        if not others or len(self.fingers) < len(self.hand):
            return self._none("neither thumb nor palm carries" if others else f"{one} alone carries")
        if self._inner() >= INNER and not self.sides:
            return self._is(15)
        return self._none("neither thumb nor palm carries")

    def _side(self) -> ObservedType:
        sides, faces, hand = self.sides, self.faces, self.hand
        if sides == hand[:1]:
            if self.abducted:
                return self._none("the thumb is abducted", "side")
            if not self.shape.rod:
                return self._none("no rod, and carried as well by " + _list(faces), "side") if faces else self._is(16)
            return self._is(32 if faces else 29)
        if sides == hand[1:2] and faces == hand[:1]:
            return self._is(20 if self.abducted else 25)
        if sides == hand[1:3] and faces == hand[:1]:
            return self._is(21) if self.abducted else self._none("the thumb is adducted", "side")
        return self._none(f"the side of {_list(sides)} with {_list(faces) or 'no other finger'}", "side")

    def _pad(self) -> ObservedType:
        count, power = len(self.fingers), self._inner() >= INNER
        stretched = all(self._extended(f) for f in self.fingers)
        if not self.abducted and not power and stretched and count == len(self.hand) > 2:
            return self._is(22)
        around = self.shape.ball or self.shape.disk or self._apart() >= APART
        if power:
            return self._power(count, around=around, stretched=stretched)
        if count == 1:
            tips = all(self._part_of(d, "tip") >= MOSTLY for d in (self.thumb, *self.fingers) if d is not None)
            return self._is(24 if tips else 33 if self.shape.ball else 9)
        if count in (2, 3):
            return self._is({2: (8, 14), 3: (7, 27)}[count][around])
        if count == 4:
            return self._is(13 if self.shape.ball else 12 if around else 6)
        return self._none(f"{count} fingers", "pad")

    def _power(self, count: int, *, around: bool, stretched: bool) -> ObservedType:
        if count == 1:
            return self._is(31)
        if count in (2, 3) and around:
            return self._is(28 if count == 2 else 26)
        if count == 3 and stretched:
            return self._is(18)
        if count == 4:
            return self._is(19)
        return self._none("inner links hold what is no ball or disk" + (", with bent fingers" * (count == 3)), "pad")

    def _is(self, number: int) -> ObservedType:
        kind = GRASP_TYPES[number]
        return ObservedType(
            number=number, name=kind.name, type=kind.type, opposition=kind.opposition,
            virtual_fingers=self._against(), carries=self._carries(),
        )  # fmt: skip

    def _without(self, missing: Sequence[str]) -> ObservedType:
        return self._none(f"{_list(missing)} {'do' if len(missing) > 1 else 'does'} not carry", "palm")

    def _none(self, why: str, opposition: Opposition | None = None) -> ObservedType:
        control: Control | None = {"palm": "power", "side": "intermediate"}.get(opposition or "")  # type: ignore[assignment]
        if opposition == "pad":
            control = "power" if self._inner() >= INNER else "precision"
        return ObservedType(
            number=None,
            name=NONE,
            type=control,
            opposition=opposition,
            virtual_fingers=self._against(),
            carries=self._carries(),
            why=why,
        )

    def _against(self) -> str:
        thumb = [self.thumb] if self.opposes and self.thumb is not None else []
        fingers = [f"the side of {f}" if f in self.sides and not self.palm else f for f in self.fingers]
        first = ["palm"] if self.palm else thumb
        second = [*fingers, *thumb] if self.palm else fingers
        if not first:
            first, second = second[:1], second[1:]
        return f"{_list(first)} against {_list(second)}" if second else _list(first)

    def _carries(self) -> str:
        found = [(b.force / self.total, b) for b in self.bearings if b.force >= CARRIES * self.total]
        rows = sorted(found, key=lambda row: -row[0])
        return ", ".join(
            f"{b.part} {100 * share:.0f} %" if b.part == "palm" else f"{b.part} {b.surface} {100 * share:.0f} %"
            for share, b in rows
        )

    def _part_of(self, part: str, surface: str) -> float:
        """How much of a part's force is on one kind of its surfaces."""
        of = [b for b in self.bearings if b.part == part]
        return sum(b.force for b in of if b.surface == surface) / sum(b.force for b in of) if of else 0.0

    def _inner(self) -> float:
        digits = [b for b in self.bearings if b.part != "palm"]
        return sum(b.force for b in digits if b.surface == "inner") / sum(b.force for b in digits)

    def _extended(self, finger: str) -> bool:
        """Whether a finger is stretched."""
        return self.observation.straight.get(finger, 0.0) >= STRAIGHT

    def _neighbours(self) -> bool:
        one, other = (self.hand.index(f) for f in self.fingers)
        return other - one == 1

    def _direction(self, part: str) -> Array:
        rows = [b.force * np.array(b.normal) for b in self.bearings if b.part == part]
        total: Array = np.sum(rows, axis=0)
        return total / max(float(np.linalg.norm(total)), 1e-9)

    def _apart(self) -> float:
        """Largest angle across the palm, along its y, between the directions in which two fingers press, degrees."""
        across = [np.degrees(np.arcsin(np.clip(self._direction(f)[1], -1.0, 1.0))) for f in self.fingers]
        return float(max(across) - min(across))

    def _opposed(self) -> str | None:
        """Digit without a name that all others press against; None where there is none."""
        digits = [f for f in self.observation.fingers if f in self.share]
        ways = {f: self._direction(f) for f in digits}
        found = [f for f in digits if len(digits) > 1 and all(ways[f] @ ways[g] < 0.0 for g in digits if g != f)]
        return found[-1] if found else None


def _list(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)
