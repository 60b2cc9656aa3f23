"""Inverse kinematics of one target on plain numbers, and the chain that one target and many are solved with."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from math import inf, nan, pi
from typing import Generic, NamedTuple

import numpy as np

from allegro_twin.kinematics.closed_form.forms.finger import FingerForms
from allegro_twin.kinematics.closed_form.forms.thumb import ThumbForms
from allegro_twin.kinematics.closed_form.forms.two_links import TOLERANCE, Branch
from allegro_twin.kinematics.closed_form.geometry import BaseFrame
from allegro_twin.kinematics.closed_form.nearest.finger import FingerNearest
from allegro_twin.kinematics.closed_form.nearest.thumb import ThumbNearest
from allegro_twin.kinematics.closed_form.redundancy.curve import Posture
from allegro_twin.kinematics.closed_form.redundancy.finger import FingerRedundancy
from allegro_twin.kinematics.closed_form.redundancy.thumb import ThumbRedundancy
from allegro_twin.kinematics.closed_form.targets import IkTarget, Mode
from allegro_twin.kinematics.maths import FLOATS, Maths, T
from allegro_twin.kinematics.solutions import Flags, Nearest, Solutions
from allegro_twin.types import Vector, frozen

Point = tuple[float, float, float]
_NONE: Posture = (nan, nan, nan, nan)


class BaseTarget(NamedTuple, Generic[T]):
    """A target in the base frame of a chain."""

    x: T
    y: T
    z: T
    view: tuple[T, ...] | None
    """The orientation asked for, as the forms take it."""


class Chain:
    """A finger with one set of limits, as it is solved: a right hand's, in its base frame."""

    def __init__(
        self,
        forms: FingerForms | ThumbForms,
        frame: BaseFrame,
        fk: Callable[[float, float, float, float], Point],
        limits: tuple[Vector, Vector],
        signs: Vector,
    ) -> None:
        """`fk`: from the hand's joints, rad, to the tip in the palm, m; `limits`: the hand's, (4,) each, rad; `signs`:
        -1 for joints that turn the other way in the right hand."""
        self.forms, self.frame, self._fk, self.sign = forms, frame, fk, float(signs[0])
        self.lower, self.upper = map(frozen, limits)
        rows = zip(self.lower.tolist(), self.upper.tolist(), signs.tolist(), strict=True)
        ends = [sorted((low * sign, high * sign)) for low, high, sign in rows]
        self._low, self._high = [low for low, _ in ends], [high for _, high in ends]
        self._ranges = tuple((low - TOLERANCE, high + TOLERANCE) for low, high in ends)

    def in_base(self, m: Maths[T], target: IkTarget[T]) -> BaseTarget[T]:
        """A target, which is in the palm frame, in the base frame."""
        x, y, z = self.frame.from_palm(*target.position)
        if target.rotation is None:
            return BaseTarget(x, y, z, None)
        return BaseTarget(x, y, z, self.forms.view(m, self.frame.rotation_from_palm(target.rotation)))

    def branches(self, m: Maths[T], target: IkTarget[T], base: BaseTarget[T]) -> tuple[list[Branch[T]], list[T]]:
        """All closed-form branches, NaN where there is none, and the angle left to the rotation asked for, rad.

        None for a position alone.
        """
        x, y, z, view = base
        if view is not None:
            return self.forms.at_rotation(m, x, y, z, view)
        if target.mode == "position":
            return [], []
        found: list[Branch[T]] = getattr(self.forms, f"at_{target.mode}")(m, x, y, z, target.angle)
        return found, [x * 0.0] * len(found)

    def within(self, q: Branch[T]) -> object:
        """Which postures are inside the limits, to 1e-9 rad: a flag, or one for each."""
        (a, b), (c, d), (e, f), (g, h) = self._ranges
        q0, q1, q2, q3 = q
        return (q0 >= a) & (q0 <= b) & (q1 >= c) & (q1 <= d) & (q2 >= e) & (q2 <= f) & (q3 >= g) & (q3 <= h)

    def turned_nearer(self, m: Maths[T], base: BaseTarget[T], angle: T) -> tuple[Branch[T], T, object]:
        """`ThumbForms.turned_nearer`; a finger's branches are turned nearest as they are."""
        x, y, z, view = base
        assert isinstance(self.forms, ThumbForms)
        assert view is not None
        return self.forms.turned_nearer(m, (x, y, z), view, angle)

    def nearest_orientation(self, base: BaseTarget[float], best: float) -> tuple[Posture, float] | None:
        """The posture inside the limits that reaches a target and is turned nearest to its orientation, and the angle
        left, rad; None if no posture is turned nearer than by the angle `best`."""
        assert base.view is not None
        q = self._redundancy.nearest_orientation(base.x, base.y, base.z, base.view, best)
        if q is None:
            return None
        angle = self.forms.angle_to(FLOATS, q, base.view)
        return (q, angle) if angle < best else None

    def preferred(self, base: BaseTarget[float], near: tuple[float, ...] | None) -> Posture | None:
        """The posture inside the limits that reaches a target nearest to the hand's posture `near`, rad, or else
        furthest from every limit; None where none reaches it."""
        wanted = None if near is None else (near[0] * self.sign, *near[1:])
        return self._redundancy.preferred(base.x, base.y, base.z, wanted)

    def nearest(
        self, base: BaseTarget[float], mode: Mode, angle: float, *, limited: bool
    ) -> tuple[Posture, Point, float]:
        """The hand's posture that comes nearest to a target, inside the limits or anywhere, with the angle of the mode
        held, rad; where its tip then is in the palm, and how far from the target, m."""
        search = self._nearest if limited else self._nearest_anywhere
        distance, q = search.nearest(base.x, base.y, base.z, mode, angle)
        if q is None:
            return _NONE, (nan, nan, nan), inf
        posture = q[0] * self.sign, q[1], q[2], q[3]
        return posture, self._fk(*posture), distance

    @cached_property
    def _redundancy(self) -> FingerRedundancy | ThumbRedundancy:
        if isinstance(self.forms, FingerForms):
            return FingerRedundancy(self.forms.links, self._low, self._high)
        return ThumbRedundancy(self.forms.links, self.forms.aside, self.forms.up, self._low, self._high)

    @cached_property
    def _nearest(self) -> FingerNearest | ThumbNearest:
        if isinstance(self._redundancy, FingerRedundancy):
            return FingerNearest(self.forms.links, self._low, self._high, self._redundancy)
        return self._nearest_thumb(self._low, self._high)

    @cached_property
    def _nearest_anywhere(self) -> FingerNearest | ThumbNearest:
        """Every joint turns once about the middle of its range."""
        middles = [(low + high) / 2 for low, high in zip(self._low, self._high, strict=True)]
        low, high = [middle - pi for middle in middles], [middle + pi for middle in middles]
        if isinstance(self.forms, FingerForms):
            return FingerNearest(self.forms.links, low, high, None)
        return self._nearest_thumb(low, high)

    def _nearest_thumb(self, low: list[float], high: list[float]) -> ThumbNearest:
        assert isinstance(self.forms, ThumbForms)
        return ThumbNearest(self.forms.links, self.forms.aside, self.forms.up, low, high)


def solve(chain: Chain, target: IkTarget[float]) -> Solutions:
    """All branches of one target; the same as those of a batch of the shape ()."""
    base, sign = chain.in_base(FLOATS, target), chain.sign
    found, left = chain.branches(FLOATS, target, base)
    within = [bool(chain.within(q)) for q in found]
    if target.mode == "position":
        q = chain.preferred(base, target.near)
        found, left, within = [q or _NONE], [0.0], [q is not None]
    elif target.mode == "rotation":
        best = min([angle for angle, ok in zip(left, within, strict=True) if ok], default=inf)
        better = _turned_nearer(chain, base, best)
        if better is not None:
            found[0], left[0], within[0] = *better, True

    def search(missing: Flags, limited: bool) -> Nearest:
        if not missing:
            return Nearest(np.full(4, nan), np.array(target.position), np.zeros(()))
        posture, point, distance = chain.nearest(base, target.mode, target.angle, limited=limited)
        return Nearest(np.array(posture), np.array(point), np.asarray(distance))

    rows = np.array([(sign * q0, q1, q2, q3) for q0, q1, q2, q3 in found])
    return Solutions(rows, np.array(within), np.array(left), chain.lower, chain.upper, search)


def _turned_nearer(chain: Chain, base: BaseTarget[float], best: float) -> tuple[Posture, float] | None:
    """A posture that is turned nearer than the best closed-form branch, where that is not sure to be the nearest."""
    if best <= chain.forms.surely_nearest and best < inf:
        return None
    if best < inf:
        q, angle, sure = chain.turned_nearer(FLOATS, base, best)
        if sure and chain.within(q):
            return (q, angle) if angle < best else None
    return chain.nearest_orientation(base, best)
