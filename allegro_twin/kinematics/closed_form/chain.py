"""A finger as it is solved: its closed forms, the frame that they are in, and the mirror."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, NamedTuple

from allegro_twin.kinematics.closed_form.forms.finger import ImaFinger
from allegro_twin.kinematics.closed_form.forms.frame import Frame
from allegro_twin.kinematics.closed_form.forms.maths import Maths, T
from allegro_twin.kinematics.closed_form.forms.planar import Branch
from allegro_twin.kinematics.closed_form.forms.thumb import Thumb
from allegro_twin.kinematics.closed_form.target import Target

Point = tuple[float, float, float]


class Asked(NamedTuple, Generic[T]):
    """A target in the frame of the chain."""

    x: T
    y: T
    z: T
    turn: tuple[T, ...] | None
    """An orientation as the forms take it."""


@dataclass(frozen=True, slots=True)
class Chain:
    """What both ways to solve, one target or a batch, need of a finger besides its limits."""

    forms: ImaFinger | Thumb
    frame: Frame
    sign: float
    """-1 where joint 0 of the hand turns the other way than the one that is solved, else +1."""
    fk: Callable[[float, float, float, float], Point]
    """From the hand's joints, rad, to the tip in the palm, m."""

    def asked(self, m: Maths[T], target: Target[T]) -> Asked[T]:
        x, y, z = self.frame.into(*target.position)
        if target.rotation is None:
            return Asked(x, y, z, None)
        return Asked(x, y, z, self.forms.view(m, self.frame.turned_into(target.rotation)))

    def branches(self, m: Maths[T], target: Target[T], asked: Asked[T]) -> tuple[list[Branch[T]], list[T]]:
        """All closed-form branches, NaN where there is none, and the angle left to the rotation asked for, rad.

        None of a position alone.
        """
        x, y, z, turn = asked
        if turn is not None:
            return self.forms.at_rotation(m, x, y, z, turn)
        if target.mode == "position":
            return [], []
        found: list[Branch[T]] = getattr(self.forms, f"at_{target.mode}")(m, x, y, z, target.angle)
        return found, [x * 0.0] * len(found)

    def nearer(self, m: Maths[T], asked: Asked[T], angle: T) -> tuple[Branch[T], T, object]:
        """As `Thumb.nearer`: the branches of a finger are turned nearest as they are."""
        x, y, z, turn = asked
        assert isinstance(self.forms, Thumb)
        assert turn is not None
        return self.forms.nearer(m, (x, y, z), turn, angle)
