"""Hands that answer when they are asked, of both languages: what the backend promises, and what goes wrong."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from allegro_twin.drivers.base.lockstep import LockstepLine
from allegro_twin.drivers.base.serial_line import SerialLine
from allegro_twin.drivers.dynamixel.codec.packet import status
from allegro_twin.drivers.polled.config import PolledFaultEvent, PolledFaultSettings
from allegro_twin.drivers.polled.device import VirtualPolledHand
from allegro_twin.drivers.polled.exchange import Exchange
from allegro_twin.drivers.polled.host_settings import PolledHostSettings
from allegro_twin.drivers.qb.codec import Command, QbPacket
from allegro_twin.drivers.qb.device import QbDevice
from allegro_twin.drivers.schunk.codec import Question, Who
from allegro_twin.drivers.schunk.device import SchunkDevice
from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, LinkTimeout, ProtocolError
from allegro_twin.types import HandState, PositionCommand
from tests.drivers.serial.polled_rigs import (
    BAUD,
    ID,
    KINDS,
    KT,
    MOTORS,
    TICKS,
    Kind,
    Polled,
    boot_of,
    scale_of,
    virtual,
)
from tests.drivers.serial.rigs import PERIOD, Joints, small_spec

HALF_TICK = {kind: 2.0 / TICKS[kind] for kind in KINDS}
"""rad, of ranges of 4 rad."""


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> Kind:
    found: Kind = request.param
    return found


@pytest.fixture
def bench(kind: Kind) -> Polled:
    return Polled(kind)


def driven(bench: Polled, periods: int = 30) -> list[HandState]:
    return [bench.backend.reset()] + [bench.go(0.5 * np.sin(0.2 * k + np.arange(bench.n))) for k in range(periods)]


def until_fault(bench: Polled, periods: int = 200) -> HandError:
    bench.backend.reset()
    with pytest.raises(HandError) as caught:
        bench.go(0.4, periods)
    assert "\n" not in str(caught.value)
    return caught.value


def test_a_state_is_of_encoders_and_currents_and_nothing_else(bench: Polled) -> None:
    for before, after in pairwise(driven(bench)):
        assert (after.tick, after.t) == (before.tick + 1, (before.tick + 1) * PERIOD)
        change = (after.position - before.position) / PERIOD
        np.testing.assert_allclose(after.velocity, change, atol=1e-9)
    state, limit = bench.hand.state, 0.51 * (1e-2 if bench.kind == "schunk" else 1e-3) * KT
    np.testing.assert_allclose(after.position, state.position, atol=HALF_TICK[bench.kind] + 1e-9)
    np.testing.assert_allclose(after.torque, state.torque, atol=limit)
    assert np.isnan(after.temperature).all()
    assert np.isnan(after.gravity).all()


def test_a_second_session_and_a_second_instance_repeat_the_first_bit_for_bit(bench: Polled) -> None:
    first, second, third = driven(bench), driven(bench), driven(Polled(bench.kind))
    for one, two, three in zip(first, second, third, strict=True):
        for name in ("t", "position", "velocity", "torque"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
            np.testing.assert_array_equal(getattr(one, name), getattr(three, name))


def test_the_hand_is_limp_from_reset_to_the_first_command_that_is_not(bench: Polled) -> None:
    bench.backend.reset()
    for _ in range(3):
        bench.backend.read()
    assert bench.hand.limp
    limp = PositionCommand(np.zeros(bench.n), effort=np.zeros(bench.n))
    bench.backend.write(limp)
    assert bench.hand.limp
    for let_go in (lambda: bench.backend.write(limp), bench.backend.reset, bench.backend.close):
        bench.backend.reset()
        bench.go(0.1)
        assert not bench.hand.limp
        let_go()
        assert bench.hand.limp


def test_a_goal_is_reached_and_held_without_another_word(bench: Polled) -> None:
    bench.backend.reset()
    bench.go(0.7)
    for _ in range(200):
        state = bench.backend.read()
    np.testing.assert_allclose(state.position, 0.7, atol=0.01)


def test_a_timed_move_takes_its_way_through_the_speed(bench: Polled) -> None:
    """T = Δ / v: from 0 to 0.8 at 0.5 rad/s, in a straight line. The joints follow a tenth of a second behind."""
    bench.backend.reset()
    duration, way = 0.8 / 0.5, 0.8
    rows = [bench.go(way, duration=duration).position[0] for _ in range(220)]
    crossed = [next(k for k, row in enumerate(rows) if row > share * way) * PERIOD for share in (0.25, 0.75)]
    assert crossed[1] - crossed[0] == pytest.approx(0.5 * duration, rel=0.05)
    assert rows[-1] == pytest.approx(way, abs=0.01)


def test_a_stop_is_the_present_position_without_a_duration(bench: Polled) -> None:
    bench.backend.reset()
    state = bench.go(1.5, 60, duration=3.0)
    for _ in range(100):
        bench.backend.write(PositionCommand(state.position, duration=0.0))
        after = bench.backend.read()
    np.testing.assert_allclose(after.position, state.position, atol=0.06)
    assert 0.1 < state.position[0] < 0.5


def test_a_goal_that_was_lost_on_its_way_is_said_again(bench: Polled) -> None:
    bench.backend.reset()
    bench.go(0.2, 5)
    wanted, electronics = bench.hand.electronics.wants, bench.hand.electronics
    if isinstance(electronics, QbDevice):
        electronics.goal = 5
    elif isinstance(electronics, SchunkDevice):
        electronics.targets = (5,) * bench.n
    bench.backend.read()
    assert bench.hand.electronics.wants == wanted


def test_garbled_and_lost_bytes_cost_time_and_never_a_wrong_state(kind: Kind) -> None:
    bench = Polled(kind, PolledFaultSettings(lose=3e-4, garble=3e-4, seed=5))
    ended, resets = 0, 1
    bench.backend.reset()
    for k in range(1500):
        try:
            state = bench.go(0.3 * np.sin(0.1 * k))
        except HandError:
            ended += 1
            bench.backend.reset()
            continue
        np.testing.assert_allclose(state.position, bench.hand.state.position, atol=HALF_TICK[kind] + 1e-9)
    assert bench.backend.warnings()
    assert ended < 6 * resets


@pytest.mark.parametrize("which", [0, 3])
def test_a_dead_motor_is_seen_by_what_it_does_not_do(which: int) -> None:
    bench = Polled("schunk", PolledFaultSettings(script=(PolledFaultEvent(at=0.0, what="dead_motor", which=which),)))
    bench.backend.reset()
    state = bench.go(0.5, 100)
    moved = np.delete(np.arange(5), which)
    np.testing.assert_allclose(state.position[moved], 0.5, atol=0.01)
    assert (state.position[which], state.torque[which]) == (pytest.approx(0.0, abs=1e-3), 0.0)


def test_a_torn_tendon_is_a_motor_that_arrives_without_drawing_anything(bench: Polled) -> None:
    """The encoder sits at the motor: it goes where it is told, and the finger does not."""
    there = virtual(
        bench.kind, PolledFaultSettings(script=(PolledFaultEvent(at=0.3, what="torn_tendon", which=bench.n - 1),))
    )
    bench = Polled(bench.kind, there=there)
    bench.backend.reset()
    bench.go(0.5, 60)
    state = bench.go(1.2, 100)
    last = bench.n - 1
    assert state.position[last] == pytest.approx(1.2, abs=0.01)
    assert state.torque[last] == 0.0
    assert there.state.position[last] < 0.8
    np.testing.assert_allclose(there.state.position[:last], 1.2, atol=0.01)


def test_a_plug_that_is_out_is_said_so_and_the_hand_lets_go_by_itself(kind: Kind) -> None:
    bench = Polled(kind, PolledFaultSettings(script=(PolledFaultEvent(at=0.05, what="silence"),)))
    error = until_fault(bench)
    assert isinstance(error, LinkTimeout)
    assert str(error).startswith("small_right on virtual small_right is silent; is it powered and plugged in?")
    assert "the hand has not confirmed that it is limp" in str(error)
    assert bench.backend.unconfirmed
    for _ in range(25):
        bench.hand.step()
    assert bench.hand.limp  # Its watchdog.


def test_a_power_cut_is_said_so_and_reset_leads_out_when_power_is_back(kind: Kind) -> None:
    bench = Polled(
        kind,
        PolledFaultSettings(
            script=(PolledFaultEvent(at=0.05, what="power_cut"), PolledFaultEvent(at=0.2, what="recover"))
        ),
    )
    assert isinstance(until_fault(bench), LinkTimeout)
    with pytest.raises(LinkError):
        bench.backend.reset()
    for _ in range(30):
        bench.hand.step()
    bench.backend.reset()
    bench.go(0.4, 10)
    assert not bench.backend.unconfirmed


def test_a_short_power_cut_that_nobody_saw_is_noticed_by_the_motors_being_off(kind: Kind) -> None:
    bench = Polled(
        kind,
        PolledFaultSettings(
            script=(PolledFaultEvent(at=0.05, what="power_cut"), PolledFaultEvent(at=0.05, what="recover"))
        ),
    )
    if kind == "schunk":  # Every frame says that its motors shall be on.
        bench.backend.reset()
        bench.go(0.4, 50)
        return
    assert "its motor was switched off, by its watchdog or somebody else" in str(until_fault(bench))


def test_a_program_that_pauses_finds_that_the_hand_has_let_go(bench: Polled) -> None:
    bench.backend.reset()
    bench.go(0.5, 10)
    for _ in range(22):
        bench.hand.step()  # Time in which nobody calls.
    assert bench.hand.limp
    with pytest.raises(HandFault, match=r"nobody called for 0.22 s, so the hand let go by itself; reset"):
        bench.go(0.6)
    bench.backend.reset()
    bench.go(0.6, 10)
    assert not bench.hand.limp


def test_a_hand_that_says_what_is_wrong_is_a_fault() -> None:
    bench = Polled("schunk")
    bench.backend.reset()
    bench.go(0.5, 5)
    for _ in range(22):
        bench.hand.step()
    bench.backend._spoken = bench.backend._opened.now()  # As if the clock of this program had stood still.
    with pytest.raises(HandFault, match="small_right: it heard nobody in time and let go; reset to go on"):
        bench.backend.read()


def test_a_mode_that_the_hand_does_not_have_switches_it_off() -> None:
    device = SchunkDevice()
    answer = device.receive(Question(1, on=True, mode=2).encoded())
    assert answer[3] == 4
    assert device.wants is None


def test_at_another_speed_it_says_which_one_answers(kind: Kind) -> None:
    with pytest.raises(LinkTimeout, match=f"at 115200 baud; it answers at {BAUD[kind]}: set backend.baud so"):
        Polled(kind, baud=115_200)


def test_nobody_at_all_is_said_so(kind: Kind) -> None:
    there = virtual(kind)
    there.off = True
    with pytest.raises(LinkTimeout, match="nor at any other speed: check power and cable"):
        Polled(kind, there=there)


def test_a_device_with_another_id_is_told() -> None:
    with pytest.raises(
        LinkTimeout, match=f"no answer from small_right on .*; a qb device answers as {ID}: set backend.id so"
    ):
        Polled("qb", identifier=9)


STRANGERS = {
    "a DYNAMIXEL servo": status(1, 0, bytes(10)).encoded(),
    "a Schunk SVH": b"\x4c\xaa" + bytes(70),
    "a qb device": QbPacket(1, Command.PING).encoded(),
    "a hand of our Schunk layout": bytes.fromhex("5a19") + bytes(22),
}


@pytest.mark.parametrize("who", STRANGERS)
def test_another_hands_answer_is_named(who: str, kind: Kind) -> None:
    """Whatever is asked, it answers so."""
    own = {"qb": "a qb device", "schunk": "a hand of our Schunk layout"}[kind]
    there = virtual(kind)
    there.receive = lambda data, baud: STRANGERS[who]  # type: ignore[method-assign]  # Somebody else is there.
    wanted = ProtocolError if who == own else ConfigError
    if (kind, who) == ("qb", own):  # Of which one with another id is a finding of its own.
        with pytest.raises(HandError, match="comes what small_right does not say|answers as 1"):
            Polled(kind, there=there)
        return
    with pytest.raises(wanted) as caught:
        Polled(kind, there=there)
    assert (who == own) != (f"speaks {who}" in str(caught.value))
    assert "\n" not in str(caught.value)


def test_what_came_too_late_is_no_answer_to_the_next_question() -> None:
    port, ping = LockstepLine(virtual("qb"), BAUD["qb"]), QbPacket(ID, Command.PING).encoded()
    exchange = Exchange(port, "it", 0.02, 1)
    port._came = b"an answer to what was asked before"
    assert exchange(ping, lambda heard: heard or None, len(ping)) == ping


def test_a_hand_of_another_layout_is_refused_before_anything_moves() -> None:
    there = virtual("schunk")

    def later(data: bytes, baud: int) -> bytes:
        return Who(data[2], layout=2).encoded()

    there.receive = later  # type: ignore[method-assign]  # A firmware that is newer than this program.
    with pytest.raises(ConfigError, match="has 5 actuators and speaks layout 2; here are 5 and layout 1"):
        Polled("schunk", there=there)


def test_a_hand_that_would_be_where_it_cannot_be_is_refused() -> None:
    bench = Polled("qb")
    bench.hand.state.position.setflags(write=True)
    bench.hand.backend._q = np.array([0.0])  # type: ignore[attr-defined]
    sense = bench.hand.electronics.sense
    bench.hand.electronics.sense = lambda ticks, current: sense(ticks + 26_000, current)  # type: ignore[method-assign]
    with pytest.raises(ConfigError, match=r"joint_0 would be at 4.90 rad, far outside \[-2.00, 2.00\]: its zero"):
        bench.backend.reset()
    assert bench.hand.limp


def test_the_line_being_gone_is_a_link_error_and_reset_opens_it_again(bench: Polled) -> None:
    bench.backend.reset()
    bench.go(0.3, 5)

    def unplugged(data: bytes) -> None:
        raise LinkError("cannot write to it: unplugged")

    bench.backend._opened.send = unplugged  # type: ignore[method-assign]  # Somebody pulls the plug.
    with pytest.raises(LinkError, match="unplugged; the hand has not confirmed that it is limp"):
        bench.backend.read()
    with pytest.raises(HandError):
        bench.backend.read()
    opened = bench.opened
    assert bench.backend.reset().tick == 0
    assert bench.opened == opened + 1
    assert bench.hand.limp
    assert not bench.backend.unconfirmed


def test_motors_that_somebody_else_keeps_switching_off_are_an_error(kind: Kind) -> None:
    class Meddled(LockstepLine):
        def send(self, data: bytes) -> None:
            super().send(data)
            assert isinstance(self.hand, VirtualPolledHand)
            electronics = self.hand.electronics
            if isinstance(electronics, QbDevice):
                electronics.active = 0

    def wrap(port: SerialLine) -> SerialLine:
        assert isinstance(port, LockstepLine)
        return Meddled(port.hand, port.baud)

    if kind == "schunk":  # Its answer to "on" is of the same frame.
        return
    bench = Polled(kind, wrap=wrap)
    bench.backend.reset()
    with pytest.raises(LinkError, match="does not switch on; is something else driving it"):
        bench.go(0.2)


@pytest.mark.parametrize(
    ("wrong", "names"),
    [
        ({"period": 0.0}, "period"),
        ({"watchdog": 6.0}, "from 0.02 to 5 s"),
        ({"period": 0.05, "watchdog": 0.06}, "two periods of 0.05"),
        ({"tries": 0}, "tries must be 1 or more"),
        ({"latency": 0.0}, "latency must be above 0"),
    ],
)
def test_settings_that_no_hand_can_keep_are_refused(wrong: dict[str, float], names: str) -> None:
    with pytest.raises(ConfigError, match=names):
        PolledHostSettings(**wrong)  # type: ignore[arg-type]  # What is wrong is the point.


def test_a_virtual_hand_of_which_no_motor_could_be_dead_alone_is_refused(kind: Kind) -> None:
    joints = Joints(small_spec(MOTORS[kind], ("position",)))
    with pytest.raises(ConfigError, match="needs physics that take a limited_position; small_right: position"):
        VirtualPolledHand(joints, boot_of(kind), scale_of(kind), BAUD[kind])


def test_a_fault_of_a_motor_that_is_not_there_is_refused() -> None:
    for kind in KINDS:
        with pytest.raises(ConfigError, match=f"which is 9; this hand has {MOTORS[kind]} actuators"):
            virtual(kind, PolledFaultSettings(script=(PolledFaultEvent(at=0.0, what="dead_motor", which=9),)))


def test_switching_off_is_asked_for_three_times_before_it_counts_as_failed(
    bench: Polled, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.backend.reset()
    bench.go(0.3, 3)
    wire = bench.backend._driver._wire  # type: ignore[attr-defined]
    stop, lost = wire.stop, [LinkTimeout("lost"), ProtocolError("garbled")]

    def stumbling() -> None:
        if lost:
            raise lost.pop()
        stop()

    monkeypatch.setattr(wire, "stop", stumbling)
    bench.backend.close()
    assert bench.hand.limp
    assert not bench.backend.unconfirmed


class Scripted(SerialLine):
    """A line on which each question has the next of some answers."""

    lockstep = True

    def __init__(self, *answers: bytes) -> None:
        super().__init__("scripted", 1_000_000)
        self.answers, self._came, self.asked = list(answers), b"", 0

    def now(self) -> float:
        return 0.0

    def wait(self, until: float) -> None: ...

    def begin(self) -> None: ...

    def rebaud(self, baud: int) -> None: ...

    def close(self) -> None: ...

    def clear(self) -> None:
        self._came = b""

    def send(self, data: bytes) -> None:
        self.asked += 1
        self._came = self.answers.pop(0) if self.answers else b""

    def receive(self, most: int, seconds: float) -> bytes:
        came, self._came = self._came, b""
        return came


def test_answers_that_were_asked_for_again_are_counted_one_by_one() -> None:
    def read(heard: bytes) -> bytes | None:
        return heard if heard == b"yes" else None

    exchange = Exchange(Scripted(b"yes", b"", b"yes", b"mud", b"", b"yes"), "it", 0.01, tries=3)
    assert (exchange.silent, exchange.garbled, exchange.warnings()) == (0, 0, [])
    for counted in ((0, 0), (1, 0), (2, 1)):
        assert exchange(b"?", read, 3) == b"yes"
        assert (exchange.silent, exchange.garbled) == counted
    assert exchange.warnings() == [
        "2 answers did not come and were asked for again", "1 answers were garbled and were asked for again",
    ]  # fmt: skip


def test_it_is_asked_as_often_as_it_is_told_to_and_no_more() -> None:
    for tries in (1, 3):
        line = Scripted(b"mud", b"mud", b"mud", b"yes")
        exchange = Exchange(line, "it", 0.01, tries)
        with pytest.raises(ProtocolError, match="it on scripted answers what nobody understands: 6d 75 64"):
            exchange(b"?", lambda heard: heard if heard == b"yes" else None, 3)
        assert (line.asked, exchange.garbled) == (tries, tries - 1)
    with pytest.raises(LinkTimeout, match="it on scripted is silent"):
        Exchange(Scripted(), "it", 0.01, 2)(b"?", lambda heard: None, 3)
