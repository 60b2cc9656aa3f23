"""Every finger of both hands, and random postures of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.solutions import Solutions
from allegro_twin.spec import SIDES, Side
from allegro_twin.types import Array

Key = tuple[Side, str]
"""A side and a finger."""
SPECS = {side: load_spec(side=side) for side in SIDES}
FINGERS = {(side, f.name): ClosedFormFinger(SPECS[side], f.name) for side in SIDES for f in SPECS[side].fingers}
EVERY = list(FINGERS)
LONG = [key for key in EVERY if key[1] != "thumb"]
THUMBS = [key for key in EVERY if key[1] == "thumb"]
SHORT: dict[Key, tuple[pytest.MarkDecorator, ...]] = {
    ("right", "index"): (), ("left", "thumb"): (), ("left", "ring"): (pytest.mark.slow,),
}  # fmt: skip
"""The fingers of a test that looks at very many postures, and the tier of each; all others are in the long run."""


def shortly(keys: list[Key]) -> list[Any]:
    """Before each push one long finger, and a thumb of the other hand, which differs in kind; a long finger of that
    hand in the slow tier, and all of them in the long run: for what takes its time to look at very many postures."""
    return [pytest.param(key, marks=SHORT.get(key, (pytest.mark.long,))) for key in keys]


def postures(finger: ClosedFormFinger, n: int, seed: int = 0) -> Array:
    """Random postures inside the limits, shape (n, 4)."""
    return np.random.default_rng(seed).uniform(finger.lower, finger.upper, (n, 4))


def held(finger: ClosedFormFinger, q: Array) -> list[dict[str, Array]]:
    """Everything that can be asked for with a position so that the posture (..., 4) is one of the answers."""
    modes: list[dict[str, Array]] = [{"rotation": finger.fk(q).rotation}]
    if finger.name == "thumb":
        return [*modes, {"q0": q[..., 0]}, {"q1": q[..., 1]}, {"psi": q[..., 2] + q[..., 3]}]
    return [*modes, {"pitch": q[..., 1:].sum(axis=-1)}]


def solve(finger: ClosedFormFinger, position: Array, given: dict[str, Array], margin: float = 0.0) -> Solutions:
    """`ik` with what is to be held given by name."""
    get = given.get
    return finger.ik(
        position,
        pitch=get("pitch"),
        rotation=get("rotation"),
        quaternion=get("quaternion"),
        euler=get("euler"),
        q0=get("q0"),
        q1=get("q1"),
        psi=get("psi"),
        near=get("near"),
        margin=margin,
    )
