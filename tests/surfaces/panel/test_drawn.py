"""Bars, banners and drawings are of the hand that there is, and text in them is text."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp, load_posture
from allegro_twin.spec import Finger, HandSpec
from allegro_twin.surfaces.panel.page.bars import banner, group_bars, health
from allegro_twin.surfaces.panel.page.groups import groups, units
from allegro_twin.surfaces.panel.page.pictures import pictures
from allegro_twin.surfaces.panel.stream import Frame
from allegro_twin.types import Vector
from allegro_twin.viewing.scenery import scenery


def frame(spec: HandSpec, position: Vector, temperature: float = np.nan) -> Frame:
    nothing = np.zeros(spec.n_joints)
    warm = np.full(spec.n_joints, temperature)
    goal = np.full(spec.n_joints, np.nan)
    return Frame(1, 2.0, position, nothing, warm, goal, {}, "pd", False, 3, ("<b>",), -1.0, False)


def test_a_bar_says_where_a_joint_is_between_its_limits(spec: HandSpec) -> None:
    middle = (spec.lower + spec.upper) / 2
    text = group_bars(spec, groups(spec)[0], frame(spec, middle))
    assert text.count("left:0.0%;width:50.0%") == len(spec.fingers[0].joints)
    assert f"{middle[0]:+.3f}" in text


def test_a_hand_of_two_fingers_with_three_joints_has_bars_and_drawings_as_well(spec: HandSpec) -> None:
    fingers = (Finger("a", (0, 1, 2), "x"), Finger("b", (4, 5, 6), "y"))
    other = replace(spec, fingers=fingers)
    assert group_bars(other, groups(other)[1], frame(spec, spec.lower)).count("index_") == 0
    drawn = pictures(other, scenery(spec, {}), {"home": load_posture("home", spec)})
    assert drawn["home"].count("<polyline") == 2


def test_every_posture_has_a_drawing_of_its_own_that_is_well_formed(spec: HandSpec) -> None:
    postures = {name: load_posture(name, spec) for name in ("home", "fist", "rock")}
    drawn = pictures(spec, scenery(spec, {}), postures)
    assert len(set(drawn.values())) == 3
    for text in drawn.values():
        assert ElementTree.fromstring(text).tag.endswith("svg")
    assert pictures(spec, scenery(spec, {}), {}) == {}


def test_what_comes_from_elsewhere_is_shown_as_text_and_not_as_a_page() -> None:
    assert "<b>" not in banner([("red", "<b>bold</b>")])


def test_temperatures_are_shown_where_there_are_any(spec: HandSpec) -> None:
    cold, hot = (health(spec, frame(spec, spec.lower, value), 30.0) for value in (np.nan, 61.0))
    assert "no temperatures" in cold
    assert "&lt;b&gt;" in cold
    assert hot.count(">61<") == spec.n_joints
    assert "#c8102e" in hot


@pytest.mark.parametrize(
    ("hand", "found"),
    [
        ("leap", {"index": 4, "middle": 4, "ring": 4, "thumb": 4}),
        ("model_o", {"forward, reverse": 1, "forward": 1, "reverse": 1, "thumb": 1}),
        ("sih", {"index": 1, "middle": 1, "ring, little": 1, "thumb": 2}),
        ("qb_softhand", {"all fingers": 1}),
    ],
)
def test_a_motor_of_several_fingers_has_one_slider(hand: str, found: dict[str, int]) -> None:
    spec = load_spec(hand)
    made = groups(spec)
    assert {group.name: len(group.joints) for group in made} == found
    assert sorted(joint for group in made for joint in group.joints) == list(range(spec.n_joints))
    assert units(spec) == ("rad" if hand == "leap" else "of the motor")
    bars = "".join(group_bars(spec, group, frame(spec, spec.lower)) for group in made)
    assert all(bars.count(f">{name}<") == 1 for name in spec.joint_labels)


@pytest.mark.parametrize(("hand", "fingers"), [("leap", 4), ("model_o", 3), ("sih", 5), ("qb_softhand", 5)])
def test_a_hand_on_tendons_is_drawn_with_every_finger_and_closes(hand: str, fingers: int) -> None:
    spec = load_spec(hand)
    grasp = load_grasp(f"{hand}_mug", spec)
    drawn = pictures(spec, scenery(spec, {}), {"open": grasp.preshape, "closed": grasp.close})
    for text in drawn.values():
        assert ElementTree.fromstring(text) is not None
        assert text.count("<polyline") == fingers
    assert drawn["open"] != drawn["closed"]
