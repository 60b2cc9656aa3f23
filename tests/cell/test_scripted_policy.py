"""The script for `ArmPick` goes where it should as fast as it says, closes, squeezes, waits and lifts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.pick.scripted_policy import ScriptedPick, _there
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Vector

PERIOD = 0.05
THING = np.array([0.3, 0.1, 0.2])


def about_z(angle: float) -> Any:
    return np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])


def above(x: float, y: float, z: float) -> Vector:
    """Beside the thing by so much, m."""
    return np.asarray(THING + np.array([x, y, z]))


class Desk:
    """A pick whose palm is wherever the test puts it."""

    def __init__(self, control: str = "grasp") -> None:
        grasp = SimpleNamespace(
            speed=2.0, preshape=np.zeros(2), close=np.array([0.5, 1.0]), squeeze=np.array([0.5, 1.2])
        )
        way = SimpleNamespace(before=Pose(above(0.0, 0.0, 0.1), np.eye(3)), palm=Pose(THING, np.eye(3)))
        here = Pose(np.array([0.3, 0.1, 0.4]), np.eye(3))
        path = SimpleNamespace(goal=np.zeros(2))
        self.scene = SimpleNamespace(palm=here, aim=here, path=path)
        self.now = SimpleNamespace(candidate=way, scene=self.scene, grasp=grasp, seconds=PERIOD, closed=0.0)
        self.settings = SimpleNamespace(step=0.05, turn=0.5, close=0.25, control=control)
        self.script = ScriptedPick(SimpleNamespace(episodes=self.now, settings=self.settings))  # type: ignore[arg-type]

    def be(self, position: Vector, rotation: Any = None) -> None:
        self.scene.palm = self.scene.aim = Pose(position, np.eye(3) if rotation is None else rotation)

    def asks(self) -> Vector:
        return np.asarray(self.script(), float)


def test_one_is_there_within_six_millimetres_and_sixty_milliradians() -> None:
    goal = Pose(THING, np.eye(3))
    assert _there(Pose(above(0.0059, 0.0, 0.0), about_z(0.059)), goal)
    assert not _there(Pose(above(0.0061, 0.0, 0.0), np.eye(3)), goal)
    assert not _there(Pose(THING, about_z(-0.061)), goal)


def test_the_palm_goes_first_to_before_the_thing_at_a_quarter_of_a_metre_a_second() -> None:
    desk = Desk()
    np.testing.assert_allclose(desk.asks(), [0.0, 0.0, -0.25 * PERIOD / 0.05, 0.0, 0.0, 0.0, 0.0], atol=1e-6)
    desk.be(above(0.0, 0.0, 0.11), about_z(0.1))  # Nearer than a step is: all of the way, and turned back.
    np.testing.assert_allclose(desk.asks(), [0.0, 0.0, -0.2, 0.0, 0.0, -0.2, 0.0], atol=1e-6)
    desk.be(above(0.0, 0.0, 0.1))
    assert desk.asks()[2] == pytest.approx(-0.25)
    desk.be(above(0.5, 0.0, 0.0), about_z(2.0))
    np.testing.assert_allclose(desk.asks()[[0, 5]], [-0.25, -1.0], atol=1e-6)  # No more than it may ask for.


def test_at_the_thing_it_closes_squeezes_rests_a_fifth_of_a_second_and_lifts() -> None:
    desk = Desk()
    desk.be(above(0.0, 0.0, 0.1))
    desk.asks()
    desk.be(THING)
    closing = []
    for _ in range(200):
        action = desk.asks()
        closing.append(desk.script._closed)
        desk.now.closed = desk.script._closed
        if action[2] != 0.0:
            break
        np.testing.assert_allclose(action[:6], 0.0, atol=1e-12)
    steps = np.diff([0.0, *closing])
    # Twice a radian a second of one radian: a tenth a step. The squeeze takes 0.6 s of a peak of 15/8 of its mean.
    np.testing.assert_allclose(steps[:11], 0.1)
    np.testing.assert_allclose(steps[11:16], 15.0 / 8.0 / 0.6 * PERIOD)
    assert closing[16] == 2.0
    assert 17 + 4 <= len(closing) <= 17 + 5  # 0.05 s four times is 0.2 s, but for rounding.
    assert action[2] == pytest.approx(0.25)
    desk.be(above(0.0, 0.0, 0.145))
    assert desk.asks()[2] == pytest.approx(0.1)  # 15 cm up, of which 5 mm are left.


def test_with_grasp_control_it_asks_for_what_is_not_closed_yet_in_parts_of_what_a_step_may() -> None:
    desk = Desk()
    desk.settings.close = 0.05
    desk.be(above(0.0, 0.0, 0.1))
    desk.asks()
    desk.be(THING)
    assert desk.asks()[6] == pytest.approx(1.0)
    assert desk.script._closed == pytest.approx(0.05)
    desk.now.closed = 0.08
    assert desk.asks()[6] == pytest.approx((0.1 - 0.08) / 0.05)


def test_with_joints_it_asks_for_their_postures() -> None:
    desk = Desk("joints")
    desk.be(above(0.0, 0.0, 0.1))
    assert desk.asks().shape == (8,)
    desk.be(THING)
    desk.scene.path.goal = np.array([0.02, 0.0])
    np.testing.assert_allclose(desk.asks()[6:], (np.array([0.05, 0.1]) - [0.02, 0.0]) / 0.5, atol=1e-6)
