"""docs/reference/hand_values.md, the models and the cards say the same, and every joint of every hand is in it."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.model.scene import hand_spec
from allegro_twin.spec import HandSpec

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "hand_values.md"
HANDS = ("allegro", "leap", "model_o", "qb_softhand", "sih")
FINE = {"limit": 1e-3, "effort": 1e-3, "mass": 1e-4}
"""rad, N·m and kg to which values are written down."""


class Value(NamedTuple):
    hand: str
    names: tuple[str, ...]
    kind: str
    maker: str
    ours: str
    source: str
    why: str


@cache
def table() -> tuple[Value, ...]:
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith(tuple(f"| {hand} |" for hand in HANDS))]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return tuple(Value(row[0], tuple(row[1].split(", ")), *row[2:]) for row in rows)


@cache
def model_of(hand: str) -> tuple[HandSpec, mujoco.MjModel]:
    spec = load_spec(hand)
    return spec, hand_spec(spec).compile()


def numbers(text: str) -> list[float]:
    return [float(each) for each in re.findall(r"-?\d+\.?\d*", text)]


def found(hand: str, kind: str, name: str) -> list[float]:
    """What card and model say."""
    spec, model = model_of(hand)
    if kind == "mass":
        return [float(model.body(name).mass[0])]
    if name in spec.joints:
        k = spec.joints.index(name)
        low_high = [float(spec.lower[k]), float(spec.upper[k])]
        return low_high if kind == "limit" else [float(spec.actuation.torque_limit[k])]
    return [float(value) for value in model.joint(name).range]


@pytest.mark.parametrize("value", table(), ids=lambda v: f"{v.hand}-{v.kind}-{v.names[0]}")
def test_a_row_is_what_card_and_model_say_and_a_difference_has_its_reason(value: Value) -> None:
    for name in value.names:
        np.testing.assert_allclose(found(value.hand, value.kind, name), numbers(value.ours), atol=FINE[value.kind])
    maker, ours = numbers(value.maker), numbers(value.ours)
    same = len(maker) == len(ours) and np.allclose(maker, ours, atol=FINE[value.kind]) and "counts" not in value.maker
    assert bool(value.why) != same, "a difference without a reason, or a reason without a difference"
    assert f"| {value.source} |" in PAGE.read_text().partition("| hand |")[0]


@pytest.mark.parametrize("hand", HANDS)
def test_every_driven_joint_has_a_limit_and_an_effort_and_every_body_a_mass(hand: str) -> None:
    spec, model = model_of(hand)
    rows = [value for value in table() if value.hand == hand]
    for kind, names in (
        ("limit", spec.joints),
        ("effort", spec.joints),
        ("mass", [model.body(k).name for k in range(1, model.nbody) if model.body_mass[k] > 0.0]),
    ):
        there = [name for value in rows if value.kind == kind for name in value.names]
        assert sorted(set(there) & set(names)) == sorted(names)
        assert len(set(there)) == len(there), "a name is in two rows"


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_leap_hand_is_sent_no_further_than_its_makers_program_sends_it(side: str) -> None:
    """LEAP_Hand_API b0d00c8, leap_hand_utils.py, LEAPsim_limits: in the order of its motors."""
    lower = [-1.047, -0.314, -0.506, -0.366] * 3 + [-0.349, -0.47, -1.20, -1.34]
    upper = [1.047, 2.23, 1.885, 2.042] * 3 + [2.094, 2.443, 1.90, 1.88]
    spec = load_spec("leap", side)  # type: ignore[arg-type]  # Either side.
    motors = [1, 0, 2, 3, 5, 4, 6, 7, 9, 8, 10, 11, 12, 13, 14, 15]  # conf/hands/leap.yaml: here a finger bends first.
    np.testing.assert_allclose(spec.lower, np.array(lower)[motors], atol=1e-9)
    np.testing.assert_allclose(spec.upper, np.array(upper)[motors], atol=1e-9)
