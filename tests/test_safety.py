"""The guard limits what goes down, trips on what comes up, and leaves the hand limp."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from allegro_twin.errors import CommandError, ConfigError, HandFault, LinkError, LinkTimeout, TooFast
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.loop import run
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.safety import HISTORY, Guard, Limits, clamp, violation
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Command, HandState, TorqueCommand, frozen

SPEC = load_spec()
LIMITS = Limits(SPEC.actuation.torque_limit, frozen(np.full(16, 12.0)), SPEC.lower, SPEC.upper)
MIDDLE = (SPEC.lower + SPEC.upper) / 2


def state(tick: int = 0, **changes: Any) -> HandState:
    values: dict[str, Any] = {
        "position": MIDDLE, "velocity": np.zeros(16), "torque": np.zeros(16), "temperature": np.full(16, math.nan),
        "gravity": np.zeros(3),
    } | changes  # fmt: skip
    return HandState(tick * 0.003, tick, **values)


class ScriptedHand:
    """Gives the states it was told to and keeps what was written."""

    period = 0.003

    def __init__(self, *states: HandState | Exception) -> None:
        self.script, self.closed = list(states), False
        self.spec: HandSpec = SPEC
        self.commands: list[Command] = []

    def reset(self) -> HandState:
        return state()

    def write(self, command: Command) -> None:
        self.commands.append(command)

    def read(self) -> HandState:
        following = self.script.pop(0)
        if isinstance(following, Exception):
            raise following
        return following

    def close(self) -> None:
        self.closed = True

    @property
    def torque(self) -> Array:
        last = self.commands[-1]
        assert isinstance(last, TorqueCommand)
        return last.torque


class Push:
    """Asks for the same torque on every joint."""

    def __init__(self, torque: float) -> None:
        self.torque = torque

    def start(self, state: HandState) -> None:
        return None

    def __call__(self, state: HandState, memory: None) -> tuple[Command, None]:
        return TorqueCommand(np.full(16, self.torque)), None


@given(arrays(float, 16, elements=st.floats(-1e6, 1e6)), arrays(float, 16, elements=st.floats(-3, 3)))
def test_no_torque_passes_the_ceiling_or_changes_sign(torque: Array, position: Array) -> None:
    limited = clamp(torque, state(position=position), LIMITS)
    assert (np.abs(limited) <= LIMITS.torque).all()
    assert (limited * torque >= 0).all()


@given(arrays(float, 16, elements=st.floats(-0.2, 0.2)))
def test_in_the_middle_of_the_range_a_small_torque_passes_untouched(torque: Array) -> None:
    np.testing.assert_array_equal(clamp(torque, state(), LIMITS), torque)


def test_no_torque_pushes_beyond_a_soft_stop_and_every_torque_may_lead_back() -> None:
    beyond = state(position=SPEC.upper + 0.01)
    assert (clamp(np.full(16, 0.2), beyond, LIMITS) == 0.0).all()
    np.testing.assert_array_equal(clamp(np.full(16, -0.2), beyond, LIMITS), np.full(16, -0.2))
    halfway = state(position=SPEC.lower + LIMITS.zone / 2)
    np.testing.assert_allclose(clamp(np.full(16, -0.2), halfway, LIMITS), np.full(16, -0.1))


def test_torque_fades_from_warm_to_hot_and_an_unreported_temperature_limits_nothing() -> None:
    temperature = np.full(16, math.nan)
    temperature[:3] = [LIMITS.warm, (LIMITS.warm + LIMITS.hot) / 2, LIMITS.hot]
    limited = clamp(np.full(16, 0.2), state(temperature=temperature), LIMITS)
    np.testing.assert_allclose(limited[:4], [0.2, 0.1, 0.0, 0.2])


def test_too_fast_and_too_hot_are_faults_that_name_the_joint_and_the_limit() -> None:
    velocity = np.zeros(16)
    velocity[6] = -13.0
    fast = violation(state(velocity=velocity), LIMITS, SPEC)
    assert str(fast) == "middle_2 moves at -13.00 rad/s, over its limit of 12.00 rad/s"
    temperature = np.full(16, math.nan)
    temperature[2] = 80.0
    hot = violation(state(temperature=temperature), LIMITS, SPEC)
    assert str(hot) == "index_2 is at 80 °C, over its limit of 75 °C"
    assert [isinstance(each, TooFast) for each in (fast, hot)] == [True, False]
    assert violation(state(), LIMITS, SPEC) is None


def test_a_speed_that_is_unknown_trips_nothing_and_hides_no_other() -> None:
    velocity = np.zeros(16)
    velocity[2], velocity[6] = math.nan, -13.0
    assert "middle_2 moves at -13.00 rad/s" in str(violation(state(velocity=velocity), LIMITS, SPEC))
    assert isinstance(violation(state(velocity=velocity), LIMITS, SPEC), TooFast)
    velocity[6] = 0.0
    assert violation(state(velocity=velocity), LIMITS, SPEC) is None


@pytest.mark.parametrize("position", [math.nan, math.inf])
def test_a_position_that_is_no_number_is_a_fault_and_what_came_before_is_kept(position: float, tmp_path: Path) -> None:
    lost = MIDDLE.copy()
    lost[6] = position
    hand = ScriptedHand(state(1), state(2), state(3, position=lost))
    file = tmp_path / "kept.arrow"
    with pytest.raises(HandFault, match=f"stopped: middle_2 reports the position {position}: see to its encoder"):
        for _ in record(run(Guard(hand, LIMITS), Push(0.1)), file, SPEC, 0.003):
            pass
    assert (hand.torque == 0.0).all()
    assert len(load(file)) == 3


def test_after_a_trip_the_hand_is_limp_and_only_reset_leads_out() -> None:
    fast = state(1, velocity=np.full(16, 20.0))
    hand = ScriptedHand(fast, state(1))
    guard = Guard(hand, LIMITS)
    samples = run(guard, Push(0.1))
    next(samples)
    with pytest.raises(HandFault, match="reset to go on"):
        next(samples)
    assert (hand.torque == 0.0).all()
    for again in (lambda: guard.write(TorqueCommand(np.ones(16))), guard.read):
        with pytest.raises(HandFault):
            again()
    assert (hand.torque == 0.0).all()
    guard.reset()
    guard.write(TorqueCommand(np.full(16, 0.1)))
    assert guard.read().tick == 1


def test_an_error_of_the_link_leaves_the_hand_limp_and_carries_the_samples_that_led_there() -> None:
    hand = ScriptedHand(*[state(k) for k in range(1, 700)], LinkError("unplugged"))
    samples = run(Guard(hand, LIMITS), Push(0.1))
    with pytest.raises(LinkError, match="unplugged") as caught:
        for _ in samples:
            pass
    assert (hand.torque == 0.0).all()
    history = caught.value.history
    assert len(history) == HISTORY
    assert [sample.state.tick for sample in history[-2:]] == [698, 699]


def test_a_refused_command_leaves_the_hand_limp() -> None:
    hand = ScriptedHand()
    guard = Guard(hand, LIMITS)
    guard.reset()
    with pytest.raises(CommandError):
        guard.write(TorqueCommand(np.zeros(3)))
    assert (hand.torque == 0.0).all()


def test_a_hand_that_was_never_reset_is_not_driven() -> None:
    guard = Guard(ScriptedHand(), LIMITS)
    with pytest.raises(HandFault, match="call reset"):
        guard.write(TorqueCommand(np.zeros(16)))
    with pytest.raises(HandFault, match="call reset"):
        guard.read()


def test_the_guard_closes_what_it_guards() -> None:
    hand = ScriptedHand()
    Guard(hand, LIMITS).close()
    assert hand.closed


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"zone": 0.0}, "zone 0 rad: a torque fades over it, so it must be positive"),
        ({"zone": -0.1}, "zone -0.1 rad"),
        ({"zone": math.nan}, "zone nan rad"),
        ({"warm": 75.0}, "warm 75 °C must be below hot 75 °C"),
        ({"hot": math.nan}, "must be below hot nan °C"),
        ({"velocity": np.zeros(16)}, "velocity 0 rad/s stops every motion"),
        ({"velocity": np.full(16, math.nan)}, "velocity nan rad/s"),
        ({"lower": SPEC.upper, "upper": SPEC.lower}, "joint 0 has its lower soft stop .* rad above its upper one"),
    ],
)
def test_limits_that_would_make_no_number_of_a_torque_or_limit_nothing_are_refused(
    changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        replace(LIMITS, **changes)


@pytest.mark.parametrize("beyond", [-1.0, 0.0, 1.0])
def test_a_torque_at_and_beyond_a_stop_is_a_number_however_thin_the_zone(beyond: float) -> None:
    limits = replace(LIMITS, zone=1e-9)
    for torque in (-0.1, 0.1):
        assert np.isfinite(clamp(np.full(16, torque), state(position=SPEC.upper + beyond), limits)).all()


class FrozenClock(ScriptedHand):
    """Tells the same state for so many reads, or for good."""

    def __init__(self, t: float, tick: int, reads: float = math.inf) -> None:
        super().__init__()
        self.last, self.left = replace(state(), t=t, tick=tick), reads

    def read(self) -> HandState:
        self.left -= 1
        return self.last if self.left >= 0 else state(self.last.tick + 1)


@pytest.mark.parametrize(("t", "tick"), [(0.0, 0), (0.003, 0), (0.0, 1)])
def test_a_hand_whose_time_stands_still_ends_as_a_silent_one_and_is_left_limp(t: float, tick: int) -> None:
    hand = FrozenClock(t, tick)
    guard = Guard(hand, LIMITS)
    guard.reset()
    guard.write(TorqueCommand(np.full(16, 0.1)))
    said = rf"^no new state from allegro_right for 0\.05 s: it tells t {t:g} s, tick {tick} again and again"
    with pytest.raises(LinkTimeout, match=said):
        guard.read()
    assert not hand.torque.any()
    with pytest.raises(LinkTimeout):
        guard.write(TorqueCommand(np.full(16, 0.1)))
    assert not hand.torque.any()


def test_a_state_that_comes_twice_is_passed_over() -> None:
    guard = Guard(FrozenClock(0.0, 0, reads=3), LIMITS)
    guard.reset()
    assert guard.read().tick == 1


@pytest.mark.parametrize(
    ("t", "tick", "said"),
    [(0.003, 3, "t is 0.003 after 0.006"), (0.009, 1, "tick is 1 after 2"), (math.nan, 3, "t is nan after 0.006")],
)
def test_time_that_goes_back_is_a_fault_that_names_the_state_and_both_values(t: float, tick: int, said: str) -> None:
    hand = ScriptedHand(state(1), state(2), replace(state(), t=t, tick=tick))
    guard = Guard(hand, LIMITS)
    guard.reset()
    for _ in range(2):
        guard.write(TorqueCommand(np.full(16, 0.1)))
        guard.read()
    where = "^allegro_right: state 3 after reset: "
    with pytest.raises(HandFault, match=f"{where}{said}; it must increase: see to the backend's clock$"):
        guard.read()
    assert not hand.torque.any()
