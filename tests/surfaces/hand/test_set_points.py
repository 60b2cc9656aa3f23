"""What programs and people outside ask of a hand: clipped and counted at a joint's stop, refused by name beyond it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from allegro_twin.app.config import load_config
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import posture_entry, trajectory_entry
from allegro_twin.spec.hand import GIVE
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.hand.bounds import JointBounds
from allegro_twin.surfaces.hand.external_setpoints import ExternalSetpoints
from allegro_twin.types import Vector

HANDS = ("sim_right", "sim_left", "can_virtual", "sim_leap", "sim_model_o", "sim_sih", "sim_qb_softhand")


@pytest.mark.parametrize("config", HANDS)
def test_a_resting_hand_may_stay_where_it_is_whoever_asks(config: str) -> None:
    with Hand.open(load_config(config)) as hand:
        outside = ExternalSetpoints(hand)
        for seconds in (0.05, 0.6, 1.5):
            hand.set_controller(hand.controllers[0])
            hand.wait(seconds)
            read, times = hand.state.position, np.array([0.5])
            outside.track(read)
            outside.follow(times, read[None])
            outside.follow(times, read[None], np.zeros((1, hand.spec.n_joints)))
            hand.direct.steer(read)
            hand.move_to(read)
            assert np.abs(hand.state.position - np.clip(read, hand.spec.lower, hand.spec.upper)).max() <= GIVE
            posture_entry(read, hand.spec)
            trajectory_entry([0.0, 1.0], np.array([read, read]), hand.spec)


def test_a_joint_gives_no_more_than_the_band_where_it_meets_its_stop_with_all_its_torque() -> None:
    read: list[Vector] = []
    with Hand.open("sim_right") as hand:
        spec = hand.spec
        hand.listen(lambda sample: read.append(sample.state.position))
        for sign in (1.0, -1.0):
            hand.set_controller("torque", torque=sign * spec.actuation.torque_limit)
            hand.wait(0.8)
    over = [np.maximum(spec.lower - each, each - spec.upper).max() for each in read]
    assert 0.4 * GIVE < max(over) < 0.8 * GIVE
    bounds = JointBounds(spec)
    for each in read:
        np.testing.assert_array_equal(bounds.admit(each, "it"), np.clip(each, spec.lower, spec.upper))
    assert bounds.clipped == sum(each > 1e-9 for each in over)


def test_what_is_clipped_is_counted_and_what_is_inside_is_not() -> None:
    bounds = JointBounds(spec := load_spec())
    middle = (spec.lower + spec.upper) / 2
    np.testing.assert_array_equal(bounds.admit(middle, "it"), middle)
    assert bounds.clipped == 0
    for count, beyond in enumerate((1e-6, 0.001, GIVE - 1e-6), 1):
        asked = middle.copy()
        asked[3] = spec.upper[3] + beyond
        assert bounds.admit(asked, "it")[3] == spec.upper[3]
        assert bounds.clipped == count


@pytest.mark.parametrize("beyond", [GIVE + 1e-6, 0.05, 1.0])
def test_what_lies_further_beyond_is_refused_by_name_and_with_the_digits_that_show_it(beyond: float) -> None:
    bounds = JointBounds(spec := load_spec())
    asked = (spec.lower + spec.upper) / 2
    asked[14] = spec.lower[14] - beyond
    with pytest.raises(ConfigError, match=r"joint_cmd: thumb_2 = .* rad is .* rad outside its limits") as error:
        bounds.admit(asked, "joint_cmd")
    numbers = [float(each) for each in re.findall(r"-?\d+\.\d+", str(error.value))]
    assert numbers[0] < numbers[2]
    assert numbers[1] == pytest.approx(beyond, rel=0.01)
    assert bounds.clipped == 0


@pytest.mark.parametrize("excess", [3e-9, 4e-7, 2e-5, 0.0003, 0.4])
def test_an_excess_is_never_shown_as_zero(excess: float) -> None:
    spec = load_spec()
    posture = np.array(spec.upper)
    posture[1] += excess
    with pytest.raises(ConfigError, match="index_1") as error:
        spec.posture(posture)
    value, over, _, most = (float(each) for each in re.findall(r"-?\d+\.\d+", str(error.value)))
    assert over == pytest.approx(excess, rel=0.1)
    assert value > most


def test_a_margin_is_kept_by_as_much() -> None:
    bounds = JointBounds(spec := load_spec())
    bounds.set_margin(0.1, None, None)
    lower, upper = bounds.limits
    assert (bounds.admit(upper + 0.019, "it") == upper).all()
    with pytest.raises(ConfigError, match=r"0\.0300 rad inside the margin of its limits"):
        bounds.admit(lower - 0.03, "it")
    with pytest.raises(ConfigError, match="outside its limits"):
        bounds.admit(spec.lower - 0.03, "it")


def test_a_joint_that_rests_inside_a_margin_can_be_led_out_of_it_by_a_trajectory() -> None:
    with Hand.open("sim_right") as hand:
        hand.wait(2.0)
        hand.set_margin(0.1)
        home = np.clip(np.zeros(16), *hand.limits)
        assert (hand.state.position < hand.limits[0]).any()
        ExternalSetpoints(hand).follow(np.array([1.5]), home[None])


def test_degrees_are_refused_with_the_way_out() -> None:
    spec = load_spec()
    with pytest.raises(ConfigError, match=r"positions are in radians: 45° is 0\.7854 rad"):
        spec.posture([0.0, 45.0, *[0.5] * 10, 0.5, 0.5, 0.5, 0.5])
    with pytest.raises(ConfigError) as error:
        spec.posture(np.full(16, 200.0))
    assert "radians" not in str(error.value)  # It would be beyond the limit in degrees, too.
