"""docs/reference/hand_values.md says what models, cards and codecs have, and every joint of every hand is in it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest

from allegro_twin.drivers.can.codec.v4 import V4
from allegro_twin.drivers.qb import codec as qb_codec
from allegro_twin.files.assets import data_root, read_yaml
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
    deviation: str
    source: str
    why: str


class Convention(NamedTuple):
    hand: str
    quantity: str
    maker: str
    ours: str
    source: str
    why: str


def rows_of(part: str) -> list[list[str]]:
    """Cells of the rows of hands in a part of the page."""
    lines = [line for line in part.splitlines() if line.startswith(tuple(f"| {hand} |" for hand in HANDS))]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


SOURCES, LIMITS, CONVENTIONS = re.split(r"^\| hand \| .*$", PAGE.read_text(), flags=re.MULTILINE)
"""The page before its tables, and each of its two tables."""


@cache
def table() -> tuple[Value, ...]:
    return tuple(Value(row[0], tuple(row[1].split(", ")), *row[2:]) for row in rows_of(LIMITS))


@cache
def model_of(hand: str) -> tuple[HandSpec, mujoco.MjModel]:
    spec = load_spec(hand)
    return spec, hand_spec(spec).compile()


def numbers(text: str) -> list[float]:
    return [float(each) for each in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)]


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
    assert value.deviation == deviation(value)
    assert bool(value.why) != (value.deviation == "0"), "a difference without a reason, or a reason without one"
    assert all(f"| {source} |" in SOURCES for source in value.source.split(", "))


def deviation(value: Value) -> str:
    """How far ours is from the maker's: rad at the end that differs more, or % of the maker's; –: in another unit."""
    maker, ours = numbers(value.maker), numbers(value.ours)
    if len(maker) != len(ours) or re.search("counts|ticks", value.maker):
        return "–"
    if np.allclose(maker, ours, rtol=0.0, atol=FINE[value.kind]):
        return "0"
    if value.kind == "limit":
        return f"{np.abs(np.subtract(maker, ours)).max():.3f}"
    return f"{100.0 * (ours[0] / maker[0] - 1.0):+.0f} %"


def card(hand: str) -> dict[str, Any]:
    return read_yaml(data_root() / "conf" / "hands" / f"{hand}.yaml")


def facts(name: str) -> dict[str, Any]:
    return read_yaml(data_root() / "models" / f"{name}.yaml")


def servos(hand: str, key: str) -> Any:
    return card(hand)["servos"][key]


def beside(hand: str) -> list[str]:
    """The finger whose knuckle is on the thumb's side of the palm and next to it."""
    _, model = model_of(hand)
    across = {name: float(model.body(name).pos[1]) for name in ("index", "middle", "ring", "little", "thumb")}
    return [min(across.keys() - {"thumb"}, key=lambda name: abs(across[name] - across["thumb"]))]


SOFT, ALLEGRO = "tendons/qb_softhand", "allegro"
FOUND: dict[tuple[str, str], Callable[[], Sequence[float] | Sequence[str]]] = {
    ("allegro", "rad a count, position"): lambda: [V4.rad_per_count],
    ("allegro", "counts at full torque"): lambda: [V4.count_limit],
    ("allegro", "torque at full counts, N·m"): lambda: [card("allegro")["wire"]["torque_constant"]],
    ("allegro", "period, s"): lambda: [read_yaml(data_root() / "conf" / "can_v4_right.yaml")["period"]],
    ("allegro", "base of index, middle, ring along z"): lambda: [
        facts(ALLEGRO)["fingers"][name]["xyz"][2] for name in ("index", "middle", "ring")
    ],
    ("allegro", "speed at no load, rad/s"): lambda: [round(0.70 / card("allegro")["actuation"]["damping"], 2)],
    ("allegro", "first finger on the wire"): lambda: [load_spec("allegro").fingers[0].name],
    ("leap", "tick at 0"): lambda: [servos("leap", "zero")],
    ("leap", "servo ids, finger by finger"): lambda: servos("leap", "ids"),
    ("leap", "direction"): lambda: [card("leap")["servos"].get("direction", 1)],
    ("leap", "current cap"): lambda: [servos("leap", "current_limit")],
    ("leap", "P of a servo, sideways"): lambda: [servos("leap", "gains")[1][0]],
    ("leap", "baud"): lambda: [read_yaml(data_root() / "conf" / "leap_usb.yaml")["backend"]["baud"]],
    ("leap", "speed at no load, rad/s"): lambda: [round(0.93 / card("leap")["actuation"]["damping"], 2)],
    ("model_o", "servo ids: spread, forward, reverse, thumb"): lambda: servos("model_o", "ids"),
    ("model_o", "open, in parts of 4095: forward, reverse, thumb"): lambda: [
        round(ticks / 4095, 2) for ticks in servos("model_o", "zero")[1:]
    ],
    ("model_o", "direction"): lambda: servos("model_o", "direction"),
    ("model_o", "current cap of the spread"): lambda: servos("model_o", "current_limit")[:1],
    ("qb_softhand", "ticks of a closure"): lambda: [qb_codec.CLOSED],
    ("qb_softhand", "spread by the synergy: index, middle, ring, little"): lambda: [
        facts(SOFT)["fingers"][name].get("rows", {}).get(0, {}).get("goes", 0.0)
        for name in ("index", "middle", "ring", "little")
    ],
    ("qb_softhand", "length of the middle phalanx"): lambda: [facts(SOFT)["chains"]["finger"][4]["long"]],
    ("qb_softhand", "knuckle of the thumb, x y z"): lambda: facts(SOFT)["fingers"]["thumb"]["at"],
    ("qb_softhand", "weight of the hand, kg"): lambda: [round(float(model_of("qb_softhand")[1].body_mass.sum()), 2)],
    ("sih", "thumb beside which finger"): lambda: beside("sih"),
    ("sih", "knuckle of the thumb, from the middle of the palm"): lambda: [model_of("sih")[1].body("thumb").pos[1]],
    ("sih", "turn of the thumb"): lambda: found("sih", "limit", "thumb_rotation"),
}
"""How each `ours` of the second table is read."""


@pytest.mark.parametrize(
    "row", [Convention(*row) for row in rows_of(CONVENTIONS)], ids=lambda r: f"{r.hand}-{r.quantity}"
)
def test_a_convention_is_what_the_card_and_the_codec_have(row: Convention) -> None:
    there = FOUND[row.hand, row.quantity]()
    if isinstance(there[0], str):
        assert row.ours == " ".join(map(str, there))
    else:
        np.testing.assert_allclose(np.array(there, dtype=float), numbers(row.ours), rtol=1e-4, atol=1e-9)
    assert row.why or row.maker == row.ours
    assert all(f"| {source} |" in SOURCES for source in row.source.split(", "))


def test_every_convention_that_is_read_is_on_the_page() -> None:
    assert {(row[0], row[1]) for row in rows_of(CONVENTIONS)} == set(FOUND)


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
