"""Whatever goes wrong on a bus has a defined outcome: a skipped tick, a counted warning, or one error that names it.

After an error the hand is limp, everything raises that error until `reset`, and reset leads out once the cause is gone.
"""

from __future__ import annotations

import errno
from collections.abc import Callable

import can
import numpy as np
import pytest

from allegro_twin.drivers.can.codec.frames import Frame, JointFrames, single
from allegro_twin.drivers.can.codec.messages import StatusBits
from allegro_twin.drivers.can.config import BusFaultEvent, FaultSettings
from allegro_twin.drivers.can.driver.backend import PATIENCE
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, LinkTimeout
from allegro_twin.hands.description.calibration import Version
from allegro_twin.types import TorqueCommand
from tests.drivers.can.rigs import PERIOD, Bench, frame, half_count

VERSIONS: tuple[Version, ...] = ("v1", "v2", "v3", "v4", "v5", "v5plus")
FULL = can.CanOperationError("transmit buffer full", errno.ENOBUFS)


def follow(bench: Bench, periods: int) -> list[int]:
    """Drive the hand and compare every state with what the hand truly was in that tick, within half a count."""
    bench.reset()
    ticks = []
    for _ in range(periods):
        state = bench.step()
        off = np.abs(bench.firmware.state.position - state.position).max()
        assert off <= half_count(bench.firmware.codec.version) * 1.000001, f"tick {state.tick} is of no period"
        ticks.append(state.tick)
    return ticks


def ends(bench: Bench, kind: type[HandError], message: str, periods: int = 800) -> None:
    """Drive until this error; the hand is limp and every call repeats it."""
    with pytest.raises(kind, match=message) as caught:
        for _ in range(periods):
            bench.step()
    assert bench.limp()
    with pytest.raises(HandError) as again:
        bench.backend.read()
    assert again.value is caught.value
    with pytest.raises(HandError) as again:
        bench.backend.write(TorqueCommand(np.zeros(16)))
    assert again.value is caught.value


ANEW = [0, 1, 2, 3, 4, 5]
"""Reset leads out, as if nothing had been."""


def ticks_after_reset(bench: Bench) -> list[int]:
    """Of six states, the first that of the reset, of a hand that serves."""
    ticks = [bench.reset().tick, *(bench.step().tick for _ in range(5))]
    return ticks if bench.firmware.serving else []


@pytest.mark.parametrize("version", VERSIONS)
def test_on_a_quiet_bus_every_period_is_a_state(version: Version) -> None:
    assert follow(Bench(version), 100) == list(range(1, 101))


@pytest.mark.parametrize(
    ("plan", "share"),
    [
        (FaultSettings(drop=0.02, seed=1), 0.75),
        (FaultSettings(duplicate=0.02, seed=2), 0.75),
        (FaultSettings(reorder=0.05, seed=3), 0.75),
        (FaultSettings(delay=0.02, seed=4), 0.75),
        (FaultSettings(delay=0.02, delay_by=0.0045, seed=4), 0.7),
    ],
    ids=["lost", "doubled", "reordered", "delayed", "delayed into the next period"],
)
def test_lost_and_late_frames_cost_periods_and_never_tear_a_state(plan: FaultSettings, share: float) -> None:
    bench = Bench(plan=plan, settings=CanHostSettings(gravity=(0.0, 0.0, -9.81)))
    ticks = follow(bench, 400)
    assert ticks == sorted(set(ticks))
    assert share <= 400 / ticks[-1] < 1.0
    health = bench.backend.health
    assert health.states == 401
    assert health.missed == ticks[-1] - 400
    assert health.incomplete > 0


def test_ticks_count_the_hands_periods_through_losses() -> None:
    bench = Bench(plan=FaultSettings(drop=0.05, seed=1), settings=CanHostSettings(gravity=(0.0, 0.0, -9.81)))
    bench.reset()
    begin = bench.firmware.state.tick
    for _ in range(300):
        state = bench.step()
        assert abs(state.tick - (bench.firmware.state.tick - begin)) <= 1
        assert state.t == pytest.approx(state.tick * PERIOD, abs=PERIOD * 1.01)


def test_corrupt_frames_that_a_crc_would_have_caught_stay_inside_the_tree() -> None:
    """Some are read as commands of another program, some as reports: no defence is possible against those."""
    noticed = stopped = 0
    for seed in range(20):
        bench = Bench(plan=FaultSettings(corrupt=0.01, seed=seed), settings=CanHostSettings(gravity=(0.0, 0.0, -9.81)))
        try:
            bench.reset()
            for _ in range(100):
                bench.step()
        except HandError:
            stopped += 1
        health = bench.backend.health
        noticed += health.malformed + health.unknown + health.doubtful + health.incomplete > 0
    assert noticed >= 5  # A bit turned over in a position is a position: 4 of 5 corrupt frames cannot be told.
    assert stopped <= 5


@pytest.mark.parametrize(("which", "finger"), list(enumerate(["index", "middle", "ring", "thumb"])))
def test_a_finger_that_falls_silent_is_named(which: int, finger: str) -> None:
    bench = Bench(
        plan=FaultSettings(
            script=(BusFaultEvent(at=1.0, what="silence", which=which), BusFaultEvent(at=1.5, what="recover"))
        )
    )
    bench.reset()
    ends(bench, LinkTimeout, f"no report from {finger} for 0.05 s on allegro-virtual")
    wait(bench, 1.6)
    assert ticks_after_reset(bench) == ANEW


def wait(bench: Bench, until: float) -> None:
    """Let the hand's time pass without its host."""
    while bench.hands.now < until:
        bench.bus.recv(PERIOD)


def test_a_hand_without_power_is_silent_and_comes_back() -> None:
    bench = Bench(
        plan=FaultSettings(script=(BusFaultEvent(at=1.0, what="power_cut"), BusFaultEvent(at=2.5, what="recover")))
    )
    bench.reset()
    ends(bench, LinkTimeout, "no report from the hand for 0.05 s on .*powered")
    with pytest.raises(LinkTimeout, match="no v4 hand answers on allegro-virtual .* check power, cable, bitrate"):
        bench.reset()
    wait(bench, 2.6)
    assert ticks_after_reset(bench) == ANEW


def test_a_bus_that_is_off_says_so_and_comes_back() -> None:
    bench = Bench(
        plan=FaultSettings(script=(BusFaultEvent(at=1.0, what="bus_off"), BusFaultEvent(at=3.0, what="recover")))
    )
    bench.reset()
    # Nobody can tell the hand: it keeps its last torque. docs/explanation/safety.md
    with pytest.raises(LinkError, match=r"is bus-off; check the wiring, then restart it: ip link set"):
        for _ in range(800):
            bench.step()
    with pytest.raises(LinkError, match="bus-off"):
        bench.reset()
    wait(bench, 3.1)
    assert ticks_after_reset(bench) == ANEW


def test_an_overheated_joint_is_a_fault_that_ends_when_it_is_cool() -> None:
    bench = Bench(
        plan=FaultSettings(
            script=(BusFaultEvent(at=0.5, what="overheat", which=6), BusFaultEvent(at=3.0, what="recover"))
        )
    )
    bench.reset()
    ends(bench, HandFault, "the hand says JOINT_HOT: a joint is too hot; let it cool down, then reset")
    assert bench.firmware.motors.temperature.argmax() == 6
    with pytest.raises(HandFault, match="JOINT_HOT"):
        bench.reset()
    assert bench.limp()
    wait(bench, 3.1)
    assert ticks_after_reset(bench) == ANEW


@pytest.mark.parametrize("bit", [StatusBits.JOINT_HOT, StatusBits.JOINT_TIMEOUT, StatusBits.PALM_HOT])
def test_reset_refuses_a_hand_that_must_not_be_driven_before_its_motors_go_on(bit: StatusBits) -> None:
    bench = Bench()
    bench.firmware.failed = bit
    with pytest.raises(HandFault, match=f"the hand says {bit.name}: .*then reset"):
        bench.reset()
    assert not any(message.arbitration_id == 0x100 for message in bench.bus.sent)
    assert bench.limp()
    bench.firmware.failed = StatusBits(0)
    assert ticks_after_reset(bench) == ANEW


def test_a_hand_that_says_that_its_motors_are_still_on_is_told_apart_from_one_that_is_silent() -> None:
    bench = Bench()
    bench.reset()
    hear = bench.firmware.receive
    bench.firmware.receive = lambda frame: [] if frame == Frame(0x104) else hear(frame)  # type: ignore[method-assign]
    bench.backend.close()
    assert "not confirmed that it is limp (it says that its motors are still on)" in bench.backend.unconfirmed


def test_a_joint_that_no_longer_answers_is_a_fault() -> None:
    bench = Bench(
        plan=FaultSettings(script=(BusFaultEvent(at=0.5, what="joint_timeout"), BusFaultEvent(at=3.0, what="recover")))
    )
    bench.reset()
    ends(bench, HandFault, "JOINT_TIMEOUT: a joint no longer answers the palm; switch the hand off and on")
    wait(bench, 3.1)
    assert ticks_after_reset(bench) == ANEW


def test_throttling_is_a_warning_and_the_temperature_is_in_the_state() -> None:
    bench = Bench()
    bench.reset()
    bench.firmware.motors.temperature[3] = 75.0
    for _ in range(700):
        state = bench.step()
    assert bench.backend.health.throttled >= 1
    assert "reports of hot motors that throttle themselves" in bench.backend.warnings()[0]
    assert state.temperature[3] == pytest.approx(bench.firmware.motors.temperature[3], abs=1.0)
    assert state.temperature[3] > 70.0 > state.temperature[0]


def test_motors_that_go_off_by_themselves_are_a_fault() -> None:
    bench = Bench()
    bench.reset()
    bench.step()
    bench.firmware.receive(Frame(0x104))
    bench.bus.strange.append(frame(0x040, b"\x00"))  # The status that a hand gives then.
    ends(bench, HandFault, "the hand switched its motors off; reset to go on", 1)
    assert ticks_after_reset(bench) == ANEW


def test_a_v5_hand_that_reports_a_motor_is_a_fault() -> None:
    bench = Bench("v5")
    bench.reset()
    bench.bus.strange.append(frame(0xEE << 2, bytes([7, 0b100100])))
    ends(bench, HandFault, "motor 7 reports overheat and overload; reset to go on", 1)
    assert ticks_after_reset(bench) == ANEW


@pytest.mark.parametrize(
    ("version", "stranger", "name"),
    [
        ("v4", frame(0x180, bytes(8)), "SetTorque, frame 180#0000000000000000"),
        ("v4", frame(0x104), "ServoOff, frame 104#"),
        ("v4", frame(0x204, bytes([2, 0, 0, 0, 0, 0])), "SetPeriod, frame 204#020000000000"),
        ("v4", frame(0x1A0, bytes([1, 2, 0, 0, 0, 0])), "Configure, frame 1A0#"),
        ("v3", frame(0x0CA, bytes([2])), "SetPeriod, frame 0CA#02"),
        ("v5", frame(0x224), "Calibrate, frame 224#"),
        ("v3", frame(0x24A, bytes(8)), "SetTorque, frame 24A"),
        ("v5", frame(0x100), "ServoOn, frame 100#"),
    ],
)
def test_another_program_that_commands_the_hand_is_noticed(version: Version, stranger: can.Message, name: str) -> None:
    bench = Bench(version)
    bench.reset()
    bench.bus.strange.append(stranger)
    ends(bench, LinkError, rf"another program commands this hand \({name}.*; stop one of the two", 1)
    assert ticks_after_reset(bench) == ANEW


def test_strange_frames_are_counted_and_change_nothing() -> None:
    bench = Bench()
    bench.reset()
    for k, strange in enumerate(
        [
            frame(0x7FF, b"\x01"),  # Nobody's.
            frame(0x081, bytes(8)),  # Another v4 hand's on this bus.
            frame(0x200, is_remote_frame=True, dlc=7),  # Somebody asks who this is.
            frame(0x080, b"\x01\x02"),  # A report cut short.
            frame(0x12345, bytes(8), is_extended_id=True),
            frame(0x008, bytes(8), is_error_frame=True),
        ]
    ):
        bench.bus.strange.append(strange)
        assert bench.step().tick == k + 1
    health = bench.backend.health
    assert (health.unknown, health.malformed, health.errors, health.missed) == (1, 1, 1, 0)
    assert bench.backend.warnings() == [
        "1 malformed frames", "1 frames with unknown identifiers", "1 error frames on the bus",
    ]  # fmt: skip
    assert ticks_after_reset(bench) == ANEW
    assert bench.backend.warnings() == []  # Counts are of one session.


def test_a_command_that_a_full_queue_refuses_is_skipped_and_counted() -> None:
    bench = Bench()
    bench.reset()
    before = bench.step().torque
    bench.bus.sending = raising(FULL)
    assert bench.step().tick == 2
    assert bench.backend.health.unsent == 1
    assert bench.backend.warnings() == ["1 commands that the full transmit queue did not take"]
    bench.bus.sending = lambda message: None
    assert (bench.step().torque != before).any()
    assert bench.backend.health.unsent == 1


def test_ten_refused_commands_in_a_row_mean_that_nobody_listens() -> None:
    bench = Bench()
    bench.reset()
    bench.bus.sending = raising(FULL)
    for _ in range(PATIENCE - 1):
        bench.step()
    with pytest.raises(LinkError, match="takes no frames; is the hand powered and on this bus"):
        bench.step()
    with pytest.raises(LinkError, match="takes no frames"):
        bench.reset()
    bench.bus.sending = lambda message: None
    assert ticks_after_reset(bench) == ANEW


@pytest.mark.parametrize(
    "error", [OSError(errno.ENODEV, "No such device"), can.CanOperationError("adapter gone"), can.CanError("?")]
)
@pytest.mark.parametrize("where", ["sending", "receiving"])
def test_an_adapter_that_is_unplugged_is_one_link_error_and_plugging_in_leads_out(error: Exception, where: str) -> None:
    bench = Bench()
    bench.reset()
    bench.step()
    setattr(bench.bus, where, raising(error))
    bench.bus.shutdown = raising(error)  # type: ignore[method-assign]  # A driver's shutdown fails as well.
    with pytest.raises(LinkError, match=f"cannot {'send' if where == 'sending' else 'receive'} on allegro-virtual"):
        bench.step()
    with pytest.raises(LinkError, match="plugged in"):
        bench.step()
    with pytest.raises(LinkError):
        bench.reset()
    bench.backend.close()  # Never raises.
    setattr(bench.bus, where, lambda *_: None)
    assert ticks_after_reset(bench) == ANEW


def raising(error: Exception) -> Callable[..., None]:
    def fail(*_: object) -> None:
        raise error

    return fail


def test_what_an_adapter_says_without_sense_is_a_link_error() -> None:
    """python-can's slcan lets an IndexError out for a line that is cut short, and a ValueError for one that is none."""
    for error in (IndexError("string index out of range"), ValueError("invalid literal for int()")):
        bench = Bench()
        bench.reset()
        bench.bus.receiving = raising(error)
        with pytest.raises(LinkError, match="cannot receive on"):
            bench.step()


@pytest.mark.parametrize(
    ("version", "speaks", "message"),
    [
        ("v4", "v5", "the hand says hardware 0x0500, which is no v4 hand; correct `version`"),
        ("v5", "v4", "the hand says hardware 0x0400, which is no v5 hand"),
        ("v5", "v5plus", "serial 5TBR0001 is a v5plus hand, not v5; correct `version`"),
    ],
)
def test_a_hand_of_another_version_is_refused(version: Version, speaks: Version, message: str) -> None:
    bench = Bench(version, speaks=speaks)
    with pytest.raises(ConfigError, match=message):
        bench.reset()
    assert bench.limp()


@pytest.mark.parametrize("version", ["v3", "v4", "v5", "v5plus"])
def test_a_left_hand_is_no_right_hand(version: Version) -> None:
    bench = Bench(version, is_side="left")
    with pytest.raises(ConfigError, match=r"this is a left hand; the config says right: correct `hand: \{side: …\}`"):
        bench.reset()
    assert bench.limp()


def test_who_else_is_on_the_bus_is_told_when_the_hand_does_not_answer() -> None:
    bench = Bench("v4", speaks="v2")

    told: set[float] = set()

    def chatter() -> None:
        if bench.hands.now not in told:  # Once a period, as a hand does.
            told.add(bench.hands.now)
            bench.bus.strange.extend(frame(0x3D3 + finger, bytes(8)) for finger in range(4))

    bench.bus.receiving = chatter
    with pytest.raises(LinkTimeout, match=r"no v4 hand answers on .* \(but a v1, v2 or v3 hand reports\)"):
        bench.reset()


@pytest.mark.parametrize("identify", [True, False])
def test_a_hand_that_does_not_answer_can_be_driven_when_the_config_says_so(identify: bool) -> None:
    bench = Bench(settings=CanHostSettings(identify=identify, gravity=(0.0, 0.0, -9.81)))
    hear = bench.firmware.receive
    bench.firmware.receive = lambda frame: [] if frame.remote else hear(frame)  # type: ignore[method-assign]
    if identify:
        with pytest.raises(LinkTimeout, match="set `identify: false` for a hand that does not answer"):
            bench.reset()
    else:
        assert ticks_after_reset(bench) == ANEW


def deaf(bench: Bench, identifier: int, times: int) -> None:
    """The next frames with this identifier do not reach the hand."""
    left, receive = [times], bench.firmware.receive

    def heard(said: Frame | JointFrames) -> list[Frame]:
        if isinstance(said, Frame) and said.id == identifier and said.data[:1] != b"\x00" and left[0]:
            left[0] -= 1
            return []
        return receive(said)

    bench.firmware.receive = heard  # type: ignore[assignment, method-assign]


SET_PERIOD, SERVO_ON = 0x204, 0x100


@pytest.mark.parametrize("lost", [SET_PERIOD, SERVO_ON])
@pytest.mark.parametrize("times", [1, 2])
def test_a_frame_that_sets_a_hand_up_is_sent_again_when_it_was_lost(lost: int, times: int) -> None:
    bench = Bench()
    deaf(bench, lost, times)
    bench.reset()
    for _ in range(3):
        assert bench.step().tick > 0
    assert bench.firmware.serving


def test_a_hand_that_answers_and_does_not_report_is_not_said_to_be_without_power() -> None:
    bench = Bench()
    deaf(bench, SET_PERIOD, 99)
    with pytest.raises(
        LinkTimeout, match="though it answers there that its motors are on: it was told to report every"
    ):
        bench.reset()
    assert bench.limp()


def test_a_hand_that_reports_and_does_not_switch_its_motors_on_is_a_fault() -> None:
    """Of a firmware that reports without them, as notes on a real hand say."""
    bench = Bench(firmware={"servo": "ignored"}, settings=CanHostSettings(imu_period=0.03, status_period=0.03))
    deaf(bench, SERVO_ON, 99)
    bench.reset()
    ends(bench, HandFault, "the hand was told 3 times to switch its motors on, and does not; reset to go on")


def test_one_lost_servo_on_of_a_hand_that_reports_without_it_ends_nothing() -> None:
    bench = Bench(firmware={"servo": "ignored"}, settings=CanHostSettings(imu_period=0.03, status_period=0.03))
    deaf(bench, SERVO_ON, 1)
    bench.reset()
    assert not bench.firmware.status() & StatusBits.SERVO_ON
    for _ in range(100):
        bench.step()
    assert bench.firmware.status() & StatusBits.SERVO_ON


def test_versions_1_and_2_do_not_identify_and_are_not_asked() -> None:
    for version in ("v1", "v2"):
        bench = Bench(version)
        assert ticks_after_reset(bench) == ANEW
        assert 0x40A not in {message.arbitration_id for message in bench.bus.sent}


def test_a_hand_without_an_imu_says_so_where_gravity_was_expected_of_it() -> None:
    bench = Bench(settings=CanHostSettings(imu_period=0.03))
    answers = bench.firmware.step
    bench.firmware.step = lambda: [f for f in single(answers()) if f.id != 0x0C0]  # type: ignore[method-assign]
    with pytest.raises(LinkTimeout, match="reports positions on .*, but no IMU; give `gravity` instead"):
        bench.reset()
    assert bench.limp()


@pytest.mark.parametrize(
    ("period", "timeout", "message"),
    [
        (0.0025, 0.05, "a hand counts whole milliseconds"),
        (0.3, 1.0, "from 0.001 to 0.255 s"),
        (0.05, 0.05, "timeout 0.05 s must be two periods of 0.05 s or more"),
    ],
)
def test_times_that_no_hand_can_keep_are_refused(period: float, timeout: float, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        CanHostSettings(period=period, timeout=timeout)


def test_close_leaves_the_hand_limp_and_silent() -> None:
    bench = Bench()
    bench.reset()
    for _ in range(5):
        bench.step()
    assert not bench.limp()
    bench.backend.close()
    assert bench.limp()
    assert bench.hands.step() == []


def test_a_hand_whose_answers_are_late_is_known_when_the_settings_allow_for_it() -> None:
    """A virtual hand on a computer that is busy."""
    late = FaultSettings(delay=1.0, delay_by=0.45)
    patient = CanHostSettings(gravity=(0.0, 0.0, -9.81), timeout=1.0)
    assert Bench("v4", late, patient).reset().tick == 0
    with pytest.raises(LinkTimeout, match="no v4 hand answers"):
        Bench("v4", late).reset()
