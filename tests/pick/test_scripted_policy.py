"""The script for `ArmPick` goes where it should as fast as it says, closes, squeezes and lifts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from allegro_twin.kinematics.pose import Pose
from allegro_twin.pick.episode import closed_at, posture_at
from allegro_twin.pick.scripted_policy import ScriptedPick, _there
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


def test_one_is_there_within_nine_millimetres_and_eighty_milliradians() -> None:
    goal = Pose(THING, np.eye(3))
    assert _there(Pose(above(0.0089, 0.0, 0.0), about_z(0.079)), goal)
    assert not _there(Pose(above(0.0091, 0.0, 0.0), np.eye(3)), goal)
    assert not _there(Pose(THING, about_z(-0.081)), goal)


def test_the_palm_goes_to_the_thing_by_the_straight_approach_at_a_quarter_of_a_metre_a_second() -> None:
    desk = Desk()
    step = 0.25 * PERIOD / 0.05
    np.testing.assert_allclose(desk.asks(), [0.0, 0.0, -step, 0.0, 0.0, 0.0, 0.0], atol=1e-6)
    desk.be(above(0.0, 0.0, 0.1))
    np.testing.assert_allclose(desk.asks(), [0.0, 0.0, -step, 0.0, 0.0, 0.0, 0.0], atol=1e-6)
    desk.be(above(0.04, 0.0, 0.05), about_z(0.1))  # Beside it: back to it first, and turned back.
    np.testing.assert_allclose(desk.asks(), [-step, 0.0, 0.0, 0.0, 0.0, -0.2, 0.0], atol=1e-6)
    desk.be(above(0.0, 0.01, 0.01))  # The last part is straight to the thing.
    assert desk.asks()[1:3] == pytest.approx([-0.25 / np.sqrt(2.0)] * 2)
    desk.be(above(0.5, 0.0, 0.1), about_z(2.0))
    np.testing.assert_allclose(desk.asks()[[0, 5]], [-0.25, -1.0], atol=1e-6)  # No more than it may ask for.


def test_at_the_thing_it_closes_squeezes_and_lifts() -> None:
    desk = Desk()
    desk.be(THING)
    closed = [0.0]
    for _ in range(200):
        action = desk.asks()
        if action[2] != 0.0:
            break
        np.testing.assert_allclose(action[:6], 0.0, atol=1e-12)
        desk.now.closed += desk.settings.close * action[6]
        closed.append(desk.now.closed)
    steps = np.diff(closed)
    # Twice a radian a second of one radian: a tenth a step. The squeeze takes 0.6 s of a peak of 15/8 of its mean.
    np.testing.assert_allclose(steps[:10], 0.1, atol=1e-6)
    np.testing.assert_allclose(steps[10:-1], 15.0 / 8.0 / 0.6 * PERIOD, atol=1e-6)
    assert closed[-1] == pytest.approx(2.0)
    assert action[2] == pytest.approx(0.25)
    desk.be(above(0.0, 0.0, 0.145))
    assert desk.asks()[2] == pytest.approx(0.1)  # 15 cm up, of which 5 mm are left.


def test_a_grasp_that_is_closing_goes_on_wherever_the_palm_is_and_one_that_is_not_opens() -> None:
    desk = Desk()
    desk.be(above(0.0, 0.0, 0.03))
    desk.now.closed = 0.35
    action = desk.asks()
    assert action[2] < 0.0
    assert action[6] == pytest.approx(0.1 / 0.25)
    desk.now.closed = 0.2
    assert desk.asks()[6] == pytest.approx(-0.2 / 0.25)


def test_the_same_state_has_the_same_action_whoever_led_there() -> None:
    used = Desk()
    for height in (0.1, 0.05, 0.0, 0.15):
        used.be(above(0.01, 0.0, height))
        used.now.closed = 2.0 - 10.0 * height
        used.asks()
    for height, closed in ((0.1, 0.0), (0.0, 0.5), (0.0, 2.0)):
        new = Desk()
        for desk in (used, new):
            desk.be(above(0.0, 0.005, height))
            desk.now.closed = closed
        np.testing.assert_array_equal(used.asks(), new.asks())


def test_with_joints_it_asks_for_their_postures() -> None:
    desk = Desk("joints")
    desk.be(above(0.0, 0.0, 0.1))
    assert desk.asks().shape == (8,)
    desk.be(THING)
    np.testing.assert_allclose(desk.asks()[6:], np.array([0.05, 0.1]) / 0.5, atol=1e-6)
    desk.scene.path.goal = np.array([0.25, 0.5])
    np.testing.assert_allclose(desk.asks()[6:], np.array([0.05, 0.1]) / 0.5, atol=1e-6)


def test_how_far_a_grasp_is_closed_is_read_off_a_posture() -> None:
    grasp = Desk().now.grasp
    for closed in (0.0, 0.3, 1.0, 1.4, 2.0):
        posture = posture_at(grasp, closed)
        assert closed_at(grasp, posture) == pytest.approx(closed)
        assert closed_at(grasp, posture + np.array([1e-3, -0.5e-3])) == pytest.approx(closed, abs=0.02)
    whole = SimpleNamespace(preshape=np.zeros(2), close=np.ones(2), squeeze=np.ones(2))
    assert closed_at(whole, np.ones(2)) == 2.0  # type: ignore[arg-type]  # Without a squeeze it is squeezed.
