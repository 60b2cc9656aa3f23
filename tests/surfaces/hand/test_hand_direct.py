"""A person who drives a hand live: a stop that is at once and stays, a goal that moves, and a hand that is left."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from allegro_twin.errors import CommandError, ConfigError, SelfCollision
from allegro_twin.surfaces.hand import Hand
from allegro_twin.types import Sample, TorqueCommand


@pytest.fixture
def hand() -> Iterator[Hand]:
    with Hand.open("sim_right") as found:
        yield found


def test_a_stop_sends_no_torque_from_the_next_period_on_whatever_drove(hand: Hand) -> None:
    seen: list[Sample] = []
    hand.listen(seen.append)
    hand.move_to("fist", wait=False)
    hand.wait(0.3)
    assert isinstance(seen[-1].command, TorqueCommand)
    assert np.abs(seen[-1].command.torque).max() > 0.05
    seen.clear()
    hand.direct.limp()
    hand.wait(0.03)
    commands = np.array([sample.command.torque for sample in seen if isinstance(sample.command, TorqueCommand)])
    np.testing.assert_array_equal(commands, np.zeros_like(commands))


def test_after_a_stop_every_wish_is_refused_until_it_is_released(hand: Hand) -> None:
    hand.direct.limp()
    for wish in (lambda: hand.move_to("home"), hand.stop, lambda: hand.grasp("grasp_3"),
                 lambda: hand.set_controller("gravity"), lambda: hand.play("ripple"), hand.direct.perform,
                 lambda: hand.direct.steer(hand.state.position)):  # fmt: skip
        with pytest.raises(CommandError, match="release the stop first"):
            wish()
    assert hand.controller == "torque"
    hand.direct.release()
    hand.move_to("home")
    assert np.abs(hand.errors).max() < 0.02


def test_a_wish_that_was_being_planned_when_the_stop_came_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with Hand.open("sim_right", background=True) as hand:
        planning, go_on = threading.Event(), threading.Event()
        legs = hand._mover.paths.legs

        def slowly(*given: object) -> object:
            planning.set()
            go_on.wait(10.0)
            return legs(*given)  # type: ignore[arg-type]  # As it was called.

        monkeypatch.setattr(hand._mover.paths, "legs", slowly)
        raised: list[BaseException] = []

        def wish() -> None:
            try:
                hand.move_to("fist", wait=False)
            except CommandError as error:
                raised.append(error)

        thread = threading.Thread(target=wish)
        thread.start()
        assert planning.wait(10.0)
        hand.direct.limp()
        told: list[Sample] = []
        with hand.listening(told.append):
            go_on.set()
            thread.join(10.0)
            assert raised
            hand.wait(0.3)
        assert hand.controller == "torque"
        assert len(told) > 50
        assert all(isinstance(each.command, TorqueCommand) and not each.command.torque.any() for each in told[2:])


def test_steering_follows_a_goal_that_moves_and_refuses_one_that_cannot_be(hand: Hand) -> None:
    goal = hand.state.position.copy()
    for k in range(20):
        goal[1] = 0.05 * k
        hand.direct.steer(goal)
        hand.wait(0.03)
    hand.wait()
    assert abs(hand.state.position[1] - 0.95) < 0.02
    with pytest.raises(ConfigError, match="outside its limits"):
        hand.direct.steer(np.full(16, 9.0))
    assert abs(hand.direct.target[1] - 0.95) < 1e-6


def test_steering_does_not_lead_one_finger_through_another(hand: Hand) -> None:
    hand.move_to("fist")
    with pytest.raises(SelfCollision):
        hand.direct.steer(hand.spec.posture(_rock(hand)))


def _rock(hand: Hand) -> np.ndarray:
    from allegro_twin.hands.library.library import load_posture

    return load_posture("rock", hand.spec)


def test_a_hand_that_is_left_ends_its_motion_and_keeps_what_has_arrived(hand: Hand) -> None:
    hand.move_to("fist", wait=False)
    hand.wait(0.3)
    hand.direct.stay()
    hand.wait(0.5)
    left = hand.state.position
    hand.wait(0.5)
    assert np.abs(hand.state.position - left).max() < 0.02
    hand.move_to("home")
    hand.grasp("grasp_3")
    hand.direct.stay()
    assert hand.controller == "grasp grasp_3"


def test_a_limp_hand_that_is_left_stays_limp(hand: Hand) -> None:
    hand.direct.stay()
    assert hand.controller == "torque"


def test_other_gains_are_those_of_the_library(hand: Hand) -> None:
    hand.direct.use_gains("v4")
    hand.move_to("home", wait=False)
    with pytest.raises(ConfigError, match="no gains named 'v5'"):
        hand.direct.use_gains("v5")
