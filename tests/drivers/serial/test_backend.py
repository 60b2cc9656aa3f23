"""The backend contract over a virtual hand of servos, and what is this backend's own."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("dynamixel_sdk", reason="pip install 'allegro-twin[dynamixel]'")

from allegro_twin.drivers.base.driver import Answer
from allegro_twin.drivers.base.lockstep import LockstepLine
from allegro_twin.drivers.dynamixel.codec.calibration import Calibration
from allegro_twin.drivers.dynamixel.codec.shafts import Shafts
from allegro_twin.drivers.dynamixel.codec.table import TRIPPED, XC330_M288, XM430_W350
from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
from allegro_twin.drivers.dynamixel.driver.host_settings import ServoHostSettings
from allegro_twin.drivers.dynamixel.virtual.hand import VirtualServoHand
from allegro_twin.errors import CommandError, ConfigError, HandError, HandFault, LinkError, LinkTimeout
from allegro_twin.types import HandState, PositionCommand, TorqueCommand, frozen
from tests.drivers.serial.rigs import BAUD, LIMIT, PERIOD, Bench, Joints, calibrated, small_spec

HALF_TICK = np.pi / 4096


@pytest.fixture
def bench() -> Bench:
    return Bench()


def driven(bench: Bench, periods: int = 30) -> list[HandState]:
    states = [bench.backend.reset()]
    for k in range(periods):
        bench.backend.write(PositionCommand(0.5 * np.sin(0.2 * k + np.arange(4.0))))
        states.append(bench.backend.read())
    return states


def test_time_and_tick_begin_at_zero_and_only_go_forward(bench: Bench) -> None:
    driven(bench, 3)
    states = driven(bench)
    assert (states[0].t, states[0].tick) == (0.0, 0)
    for before, after in pairwise(states):
        assert after.tick == before.tick + 1
        assert after.t == after.tick * PERIOD


def test_a_state_is_whole_read_only_and_the_servos_own(bench: Bench) -> None:
    for state in driven(bench):
        for name in ("position", "velocity", "torque", "temperature"):
            assert getattr(state, name).shape == (4,)
            assert np.isfinite(getattr(state, name)).all()
            with pytest.raises(ValueError, match="read-only"):
                getattr(state, name)[0] = 1.0
        assert np.isnan(state.gravity).all()
    np.testing.assert_allclose(state.position, bench.hand.state.position, atol=HALF_TICK + 1e-9)
    np.testing.assert_allclose(state.velocity, bench.hand.state.velocity, atol=0.5 * 0.02399)
    np.testing.assert_allclose(state.torque, bench.hand.state.torque, atol=0.51 * 2.69e-3 * 1.5)
    np.testing.assert_array_equal(state.temperature, 30.0)


def test_a_second_session_and_a_second_instance_repeat_the_first_bit_for_bit(bench: Bench) -> None:
    first, second, third = driven(bench), driven(bench), driven(Bench())
    for one, two, three in zip(first, second, third, strict=True):
        for name in ("t", "position", "velocity", "torque"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
            np.testing.assert_array_equal(getattr(one, name), getattr(three, name))


def test_the_hand_behind_the_wire_does_what_it_does_alone_but_for_ticks(bench: Bench) -> None:
    """Half a tick of each goal, which joints that swing (L1 gain 1.2) make larger, and half a tick of each answer."""
    alone = Joints(small_spec())
    alone.reset()
    goals = [0.05 * np.sin(0.2 * k + np.arange(4.0)) for k in range(100)]  # Below the current limit.
    bench.backend.reset()
    for goal in goals:
        bench.backend.write(PositionCommand(goal))
        state = bench.backend.read()
        alone.write(PositionCommand(goal))
        np.testing.assert_allclose(state.position, alone.read().position, atol=2.2 * HALF_TICK)


def test_the_hand_is_limp_from_reset_to_the_first_command_that_is_not(bench: Bench) -> None:
    bench.backend.reset()
    for _ in range(3):
        bench.backend.read()
    assert not any(servo.on for servo in bench.hand.servos)
    bench.backend.write(PositionCommand(np.zeros(4), effort=np.zeros(4)))
    bench.backend.read()
    assert bench.hand.limp
    bench.go(0.1)
    assert all(servo.on for servo in bench.hand.servos)
    bench.backend.write(PositionCommand(np.zeros(4), effort=np.zeros(4)))
    assert bench.hand.limp
    bench.go(0.1)
    assert not bench.hand.limp
    bench.backend.reset()
    assert bench.hand.limp


def test_a_goal_is_reached_and_held_without_another_word(bench: Bench) -> None:
    bench.backend.reset()
    bench.go(0.7)
    for _ in range(200):
        state = bench.backend.read()
    np.testing.assert_allclose(state.position, 0.7, atol=0.01)


def test_a_goal_that_was_lost_on_its_way_is_said_again(bench: Bench) -> None:
    bench.backend.reset()
    bench.go(0.2, 5)
    for servo in bench.hand.servos:
        servo.memory.put("goal_position", 2048)  # As if the last one had not come.
    bench.backend.read()
    assert bench.hand.servos[0].wants.goal == bench.calibration.ticks(np.full(4, 0.2))[0]


def test_an_effort_limits_the_current_and_none_is_the_hands_own_limit(bench: Bench) -> None:
    bench.backend.reset()
    state = bench.go(2.0, 2, effort=0.1)
    assert (np.abs(state.torque) <= 0.1).all()
    assert (np.abs(state.torque) > 0.09).all()
    state = bench.go(2.0, 2)
    assert {servo.wants.current for servo in bench.hand.servos} == {bench.calibration.current_counts[0]}
    state = bench.go(2.0, 2, effort=1e3)
    assert (np.abs(state.torque) <= LIMIT * 1.5).all()


def test_the_current_limit_is_in_the_servos_so_that_nothing_can_ask_for_more(bench: Bench) -> None:
    bench.backend.reset()
    for servo, counts in zip(bench.hand.servos, bench.calibration.current_counts, strict=True):
        assert servo.memory.get("current_limit") == counts
        assert servo.memory.get("operating_mode") == 5
        assert servo.memory.get("return_delay") == 0


def test_the_eeprom_is_written_only_where_it_differs(bench: Bench) -> None:
    bench.backend.reset()
    written: list[bytes] = []
    receive = bench.hand.receive
    bench.hand.receive = lambda data, baud: written.append(data) or receive(data, baud)  # type: ignore[method-assign,func-returns-value]  # A spy.
    bench.backend.reset()
    assert not [data for data in written if data[7] == 3]


@pytest.mark.parametrize(
    "command",
    [
        TorqueCommand(np.zeros(4)),
        PositionCommand(np.zeros(3)),
        PositionCommand(np.zeros(4), duration=1.0),
    ],
)
def test_a_command_of_the_wrong_kind_or_length_is_refused_and_harms_nothing(
    bench: Bench, command: PositionCommand
) -> None:
    bench.backend.reset()
    with pytest.raises(CommandError, match=r"takes a PositionCommand|4 actuators|timed_position"):
        bench.backend.write(command)
    bench.go(0.1)


def test_a_timed_command_goes_straight_and_arrives_in_time() -> None:
    bench = Bench(commands=("position", "limited_position", "timed_position"))
    bench.backend.reset()
    way = []
    for _ in range(50):
        bench.backend.write(PositionCommand(np.full(4, 1.0), duration=0.4))  # The same again goes on.
        bench.backend.read()
        way.append(bench.hand.servos[0].memory.get("goal_position") - 2048)
    steps = np.diff(way)
    assert way[-1] == pytest.approx(4096 / (2 * np.pi), abs=1)
    assert steps[:38].min() >= 15
    assert steps.max() <= 18
    bench.go(0.0)
    bench.backend.write(PositionCommand(np.full(4, 1.0), duration=0.4))
    for _ in range(41):
        bench.backend.read()
    assert bench.hand.servos[0].memory.get("goal_position") - 2048 == pytest.approx(4096 / (2 * np.pi), abs=1)


def test_it_must_be_reset_first_and_a_closed_hand_is_closed(bench: Bench) -> None:
    with pytest.raises(HandFault, match="has not been reset"):
        bench.backend.read()
    bench.backend.reset()
    bench.go(0.1)
    bench.backend.close()
    bench.backend.close()
    assert bench.hand.limp
    for call in (bench.backend.read, lambda: bench.go(0.1)):
        with pytest.raises(HandFault, match="closed"):
            call()
    assert bench.backend.reset().tick == 0
    assert bench.backend.spec.n_joints == 4


def test_a_program_that_pauses_finds_that_the_servos_have_stopped(bench: Bench) -> None:
    bench.backend.reset()
    bench.go(0.5, 10)
    for _ in range(22):
        bench.hand.step()  # Time in which nobody calls.
    assert bench.hand.servos[0].memory.get("bus_watchdog") == TRIPPED
    with pytest.raises(HandFault, match=r"nobody called for 0.22 s, so the hand let go by itself; reset"):
        bench.go(0.6)
    assert bench.hand.limp
    bench.backend.reset()
    bench.go(0.6, 10)
    assert not bench.hand.limp


def test_at_another_speed_it_says_which_one_answers() -> None:
    with pytest.raises(LinkTimeout, match="no servo answers on .* at 1000000 baud; they answer at 57600: set baud so"):
        Bench(servos_baud=57_600)


def test_servos_that_are_not_there_are_named_and_strangers_too() -> None:
    with pytest.raises(LinkTimeout, match="no answer from id 7 on virtual small_right, and strangers answer: ids 40"):
        bench_with(Bench(5), "other_id", 4, 40)


def bench_with(bench: Bench, what: str, which: int, amount: float) -> DynamixelBackend:
    """Its backend anew, after something has happened to a servo."""
    bench.hand.servos[which].become(int(amount))
    return bench.made()


def test_nobody_at_all_is_said_so() -> None:
    bench = Bench()
    for servo in bench.hand.servos:
        servo.mute = True
    with pytest.raises(LinkTimeout, match="nor at any other speed: check power and cable"):
        bench.made()


def test_servos_of_another_model_are_refused() -> None:
    with pytest.raises(ConfigError, match="id 3 is a XC330-M288; this hand's servos are XM430-W350"):
        Bench(there=calibrated(4, XC330_M288))


def test_a_period_that_the_baud_cannot_carry_is_refused_with_both() -> None:
    with pytest.raises(ConfigError, match=r"period 0.01 s is too short for 4 servos at 57600 baud"):
        Bench(baud=57_600, settings=ServoHostSettings(period=0.01, return_delay=250))
    Bench(baud=57_600, settings=ServoHostSettings(period=0.03))


@pytest.mark.parametrize(
    ("wrong", "names"),
    [
        ({"period": 0.0}, "period"),
        ({"watchdog": 3.0}, "from 0.02 to 2.54 s"),
        ({"period": 0.05, "watchdog": 0.06}, "two periods of 0.05"),
        ({"tries": 0}, "tries must be 1 or more"),
        ({"return_delay": 255}, "return_delay must be 0 to 254"),
    ],
)
def test_settings_that_no_hand_can_keep_are_refused(wrong: dict[str, float], names: str) -> None:
    with pytest.raises(ConfigError, match=names):
        ServoHostSettings(**wrong)  # type: ignore[arg-type]  # What is wrong is the point.


def test_a_hand_that_would_be_where_it_cannot_be_is_refused() -> None:
    turned = Calibration(XM430_W350, tuple(replace(servo, zero=servo.zero - 2048) for servo in calibrated().servos))
    bench = Bench()
    bench.calibration = turned
    with pytest.raises(
        ConfigError, match=r"joint_0 \(id 3\) would be at 3.14 rad, far outside \[-2.00, 2.00\]: its zero"
    ):
        bench.made().reset()
    assert bench.hand.limp


def test_a_hand_with_fewer_servos_than_joints_needs_to_know_how_joints_follow() -> None:
    spec = small_spec(4)
    loose = type(spec)(**{k: getattr(spec, k) for k in spec.__slots__} | {"joints": ("a", "b", "c", "d", "e")})
    with pytest.raises(ConfigError, match="4 actuators for 5 joints: give `joints`"):
        DynamixelBackend(loose, calibrated(4), lambda: LockstepLine(Bench().hand, BAUD))
    with pytest.raises(ConfigError, match="4 actuators for 5 joints: give `shafts`"):
        VirtualServoHand(Joints(loose), calibrated(4), BAUD)

    def pulled(shafts: Shafts) -> Shafts:
        unknown = np.full(1, np.nan)
        return Shafts(*(frozen(np.concatenate([row, unknown])) for row in shafts))

    backend = DynamixelBackend(loose, calibrated(4), lambda: LockstepLine(Bench().hand, BAUD), joints=pulled)
    state = backend.reset()
    assert state.position.shape == state.temperature.shape == (5,)
    assert np.isnan(state.position[4])
    backend.close()


def test_the_line_being_gone_is_a_link_error_and_reset_opens_it_again(bench: Bench) -> None:
    bench.backend.reset()
    bench.go(0.3, 5)
    port = bench.backend._opened

    def unplugged(data: bytes) -> None:
        raise LinkError("cannot write to it: unplugged")

    port.send = unplugged  # type: ignore[method-assign]  # Somebody pulls the plug.
    with pytest.raises(LinkError, match="unplugged; the hand has not confirmed that it is limp"):
        bench.backend.read()
    assert bench.backend.unconfirmed
    with pytest.raises(HandError):
        bench.backend.read()
    opened = bench.opened
    assert bench.backend.reset().tick == 0
    assert bench.opened == opened + 1
    assert bench.hand.limp
    assert not bench.backend.unconfirmed


def test_over_a_limp_hand_a_program_may_pause(bench: Bench) -> None:
    bench.backend.reset()
    for _ in range(50):
        bench.hand.step()
    assert bench.backend.read().tick == 50


def test_after_a_line_that_failed_for_a_moment_reset_opens_it_anew(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever was wrong with it: an adapter that stumbled once may go on stumbling."""
    bench.backend.reset()
    bench.go(0.3, 5)

    def silent() -> Answer:
        raise LinkTimeout("nobody answers")

    with monkeypatch.context() as patch:
        patch.setattr(bench.driver, "ask", silent)
        with pytest.raises(LinkTimeout, match="^nobody answers$"):
            bench.backend.read()
    assert bench.hand.limp
    opened = bench.opened
    bench.backend.reset()
    assert bench.opened == opened + 1


@pytest.mark.parametrize("unplugged", [False, True])
def test_the_keeper_speaks_where_nobody_confirms_and_else_is_dismissed(bench: Bench, *, unplugged: bool) -> None:
    class Watching:
        alive, said = True, ""

        def take_over(self, *, wait: bool) -> None:
            self.said = "limp"

        def dismiss(self) -> None:
            self.said = "nothing"

    bench.backend.reset()
    bench.go(0.3, 5)
    keeper = Watching()
    bench.backend._keeper = keeper  # type: ignore[assignment]

    def gone(data: bytes) -> None:
        raise LinkError("unplugged")

    if unplugged:
        bench.backend._opened.send = gone  # type: ignore[method-assign]
    bench.backend.close()
    assert keeper.said == ("limp" if unplugged else "nothing")


def test_a_line_on_which_time_passes_keeps_the_computer_awake_and_one_in_lockstep_does_not(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    from allegro_twin.drivers.base import backend as module

    asked: list[str] = []

    class Awake:
        def __init__(self) -> None:
            asked.append("held")

        def close(self) -> None:
            asked.append("let go")

    monkeypatch.setattr(module, "Inhibitor", Awake)
    bench.backend.reset()
    assert asked == []
    bench.backend.close()
    monkeypatch.setattr(LockstepLine, "lockstep", False)
    bench.backend.reset()
    assert asked == ["held"]
    bench.backend.reset()
    assert asked.count("held") - asked.count("let go") == 1
    bench.backend.close()
    assert asked[-1] == "let go"
    assert asked.count("held") == asked.count("let go")
