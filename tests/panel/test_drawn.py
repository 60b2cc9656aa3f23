"""Bars, banners and drawings are of the hand that there is, and text in them is text."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from allegro_twin.library.named import load_posture
from allegro_twin.look.scenery import scenery
from allegro_twin.panel.frame import Frame
from allegro_twin.panel.page.bars import banner, finger_bars, health
from allegro_twin.panel.page.pictures import pictures
from allegro_twin.spec import Finger, HandSpec
from allegro_twin.types import Vector


def frame(spec: HandSpec, position: Vector, temperature: float = np.nan) -> Frame:
    nothing = np.zeros(spec.n_joints)
    warm = np.full(spec.n_joints, temperature)
    goal = np.full(spec.n_joints, np.nan)
    return Frame(1, 2.0, position, nothing, warm, goal, {}, "pd", False, 3, ("<b>",), -1.0, False)


def test_a_bar_says_where_a_joint_is_between_its_limits(spec: HandSpec) -> None:
    middle = (spec.lower + spec.upper) / 2
    text = finger_bars(spec, spec.fingers[0], frame(spec, middle))
    assert text.count("left:0.0%;width:50.0%") == len(spec.fingers[0].joints)
    assert f"{middle[0]:+.3f}" in text


def test_a_hand_of_two_fingers_with_three_joints_has_bars_and_drawings_as_well(spec: HandSpec) -> None:
    fingers = (Finger("a", (0, 1, 2), "x"), Finger("b", (4, 5, 6), "y"))
    other = replace(spec, fingers=fingers)
    assert finger_bars(other, fingers[1], frame(spec, spec.lower)).count("index_") == 0
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
