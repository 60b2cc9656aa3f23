"""Joints, banners and pictures are of the hand that there is, and text in them is text."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from html import unescape
from typing import Any

import numpy as np
import pytest
from PIL import Image

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp, load_posture
from allegro_twin.spec import Finger, HandSpec
from allegro_twin.surfaces.panel.page.html import banner, health, joint_groups, joint_states, units
from allegro_twin.surfaces.panel.stream import StreamFrame
from allegro_twin.types import Vector
from allegro_twin.viewing.thumbnails import Thumbnails


def frame(spec: HandSpec, position: Vector, temperature: float = np.nan, torque: float = 0.0) -> StreamFrame:
    warm = np.full(spec.n_joints, temperature)
    goal, torques = np.full(spec.n_joints, np.nan), torque * spec.actuation.torque_limit
    return StreamFrame(1, 2.0, position, torques, warm, goal, {}, "pd", False, 3, ("<b>",), -1.0, False)


def joints_in(text: str) -> list[Any]:
    found = re.search('data-joints="([^"]*)"', text)
    assert found is not None
    return list(json.loads(unescape(found[1])))


def test_a_joint_has_its_place_between_its_limits_its_numbers_and_its_torque(spec: HandSpec) -> None:
    middle = (spec.lower + spec.upper) / 2
    found = joints_in(joint_states(spec, frame(spec, middle, torque=-0.25)))
    assert [row[0] for row in found] == list(spec.joint_labels)
    for joint, (_, _, part, position, effort, torque) in enumerate(found):
        assert (part, effort) == (0.5, -0.25)
        assert position == f"{middle[joint]:+.3f}"
        assert torque == f"{-0.25 * spec.actuation.torque_limit[joint]:+.3f}"


def test_a_joint_beyond_its_limits_has_a_bar_within_them_and_an_unknown_torque_has_none(spec: HandSpec) -> None:
    found = joints_in(joint_states(spec, frame(spec, spec.upper + 0.1, torque=np.nan)))
    assert all(row[2] == 1.0 and row[4] is None for row in found)


def test_a_hand_of_two_fingers_with_three_joints_has_its_rows_as_well(spec: HandSpec) -> None:
    fingers = (Finger("a", (0, 1, 2), "x"), Finger("b", (4, 5, 6), "y"))
    other = replace(spec, fingers=fingers)
    assert [group.name for group in joint_groups(other)] == ["a", "b", "the rest"]
    assert len(joints_in(joint_states(other, frame(other, spec.lower)))) == spec.n_joints


def picture(content: bytes) -> Any:
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGBA"))


@pytest.mark.slow
@pytest.mark.parametrize("hand", ["allegro", "leap", "model_o", "sih", "qb_softhand"])
def test_every_hand_has_pictures_of_its_postures_without_surroundings(hand: str) -> None:
    spec = load_spec(hand)
    grasp = load_grasp("pinch_index" if hand == "allegro" else f"{hand}_mug", spec)
    render = Thumbnails(spec, 48).open()
    drawn = [picture(render(posture)) for posture in (grasp.preshape, grasp.close)]
    assert all(each.shape == (48, 48, 4) for each in drawn)
    for each in drawn:
        assert 0.08 < (each[..., 3] > 128).mean() < 0.9
        assert (each[0, 0, 3], each[-1, -1, 3]) == (0, 0) or hand == "model_o"
    assert np.abs(drawn[0].astype(int) - drawn[1]).max() > 100


def test_pictures_of_different_postures_differ_and_of_the_same_do_not(spec: HandSpec) -> None:
    render = Thumbnails(spec, 32).open()
    home, fist = (load_posture(name, spec) for name in ("home", "fist"))
    assert render(home) == render(home) != render(fist)


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
    made = joint_groups(spec)
    assert {group.name: len(group.joints) for group in made} == found
    assert sorted(joint for group in made for joint in group.joints) == list(range(spec.n_joints))
    assert units(spec) == ("rad" if hand == "leap" else "of the motor")
    assert sorted(row[0] for row in joints_in(joint_states(spec, frame(spec, spec.lower)))) == sorted(spec.joint_labels)
