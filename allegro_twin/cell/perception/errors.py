"""Why there is nothing to grasp: one word for a program, one sentence for a person."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Reason = Literal[
    "stale", "empty", "no_plane", "table", "no_object", "small", "cut_off", "unclear", "outside", "in_table", "jump",
    "unsteady"
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class PerceptionRefusal:
    """Refusal of perception: a picture that an arm should not move for."""

    reason: Reason
    sentence: str
    """What, with its values, and what to do."""

    def __str__(self) -> str:
        return self.sentence


def check_age(taken: float, now: float, most: float, recorded: bool = False) -> PerceptionRefusal | None:
    """Whether a picture is too old to act on: taken at one time, looked at at another, s of one clock.
    `recorded`: it is of a recording, which has no cable."""
    if now - taken <= most:
        return None
    if recorded:
        age = f"{now - taken:.2f} s old, more than {most} s"
        said = f"camera: the recording's newest picture is {age}: it has ended, or pauses"
        return PerceptionRefusal("stale", f"{said}; record until the last look, or set `decide.retries` to 0")
    said = (
        f"camera: the newest picture is {now - taken:.2f} s old, more than {most} s: it is frozen, or its cable is out"
    )
    return PerceptionRefusal("stale", f"{said}; stand still and switch it off and on")


def position_text(values: Iterable[float]) -> str:
    """A place for a sentence."""
    return "(" + ", ".join(f"{value:.3f}" for value in values) + ")"
