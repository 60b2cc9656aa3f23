"""What goes wrong with servos and their line has one outcome each, and the hand is limp after it."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("dynamixel_sdk", reason="pip install 'allegro-twin[dynamixel]'")

from allegro_twin.drivers.base.faults import FaultEvent, FaultScript, LineNoise, NoisyLine
from allegro_twin.drivers.dynamixel.codec.packet import PacketError, status
from allegro_twin.drivers.dynamixel.config import ServoFaultEvent, ServoFaultSettings
from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, LinkTimeout, ProtocolError
from allegro_twin.files.schema import parse_settings
from tests.drivers.serial.rigs import Bench


def after(*script: ServoFaultEvent) -> Bench:
    bench = Bench(plan=ServoFaultSettings(script=script))
    bench.backend.reset()
    return bench


def until_fault(bench: Bench, periods: int = 900) -> HandError:
    with pytest.raises(HandError) as caught:
        bench.go(0.4, periods)
    return caught.value


def test_a_hot_motor_is_a_fault_that_names_it_and_reset_leads_out_when_it_has_cooled() -> None:
    bench = after(ServoFaultEvent(at=0.05, what="overheat", which=1))
    error = until_fault(bench)
    assert isinstance(error, HandFault)
    assert str(error) == "joint_1 (id 4): overheating; reset reboots it"
    assert bench.hand.limp
    with pytest.raises(HandFault, match="joint_1 .* overheating"):
        bench.backend.read()
    with pytest.raises(HandFault, match="overheating, also after a reboot; let it cool"):
        bench.backend.reset()
    bench.hand.faults.heat[1] = 30.0
    bench.backend.reset()
    bench.go(0.4, 10)


def test_an_overloaded_motor_is_a_fault_and_a_reboot_is_all_it_needs() -> None:
    bench = after(ServoFaultEvent(at=0.05, what="overload", which=3))
    assert "joint_3 (id 6): overload" in str(until_fault(bench))
    bench.backend.reset()
    bench.go(0.4, 10)


def test_a_warm_motor_is_told_within_the_time_in_which_all_are_asked() -> None:
    bench = after(ServoFaultEvent(at=0.05, what="overheat", which=2, amount=55.0))
    state = bench.go(0.1, 410)
    np.testing.assert_array_equal(state.temperature, [30.0, 30.0, 55.0, 30.0])


def test_a_dead_motor_is_seen_by_what_it_does_not_do() -> None:
    bench = after(ServoFaultEvent(at=0.0, what="dead_motor", which=2))
    state = bench.go(0.5, 100)
    np.testing.assert_allclose(state.position, [0.5, 0.5, 0.0, 0.5], atol=0.01)
    assert state.torque[2] == 0.0


def test_a_torn_tendon_is_a_shaft_that_arrives_without_drawing_anything() -> None:
    bench = after(ServoFaultEvent(at=0.3, what="torn_tendon", which=2))
    bench.go(0.5, 60)
    state = bench.go(1.2, 100)
    np.testing.assert_allclose(state.position, 1.2, atol=0.01)
    assert state.torque[2] == 0.0
    assert bench.hand.state.position[2] < 0.8
    np.testing.assert_allclose(np.delete(bench.hand.state.position, 2), 1.2, atol=0.01)


def test_a_servo_whose_watchdog_has_struck_is_named() -> None:
    error = until_fault(after(ServoFaultEvent(at=0.05, what="watchdog", which=0)))
    assert isinstance(error, HandFault)
    assert "joint_0 (id 3) was stopped by its bus watchdog" in str(error)


def test_a_servo_that_answers_as_another_is_missed_by_its_name() -> None:
    bench = after(ServoFaultEvent(at=0.05, what="other_id", which=1, amount=99))
    error = until_fault(bench)
    assert isinstance(error, LinkTimeout)
    assert "no answer from joint_1 (id 4)" in str(error)


def test_a_servo_that_takes_the_id_of_another_garbles_it() -> None:
    bench = after(ServoFaultEvent(at=0.05, what="other_id", which=1, amount=3))
    assert isinstance(until_fault(bench), LinkTimeout | ProtocolError)


def test_a_plug_that_is_out_is_named_and_the_others_go_limp() -> None:
    bench = after(ServoFaultEvent(at=0.05, what="silence", which=2))
    error = until_fault(bench)
    assert isinstance(error, LinkTimeout)
    assert str(error).startswith("no answer from joint_2 (id 5) on virtual small_right; is it powered")
    assert "the hand has not confirmed that it is limp" in str(error)  # One of them cannot.
    assert [servo.on for servo in bench.hand.servos] == [False, False, True, False]


def test_a_power_cut_is_said_so_and_reset_leads_out_when_power_is_back() -> None:
    bench = after(ServoFaultEvent(at=0.05, what="power_cut"), ServoFaultEvent(at=0.2, what="recover"))
    assert "all 4 servos on virtual small_right are silent" in str(until_fault(bench))
    with pytest.raises(LinkError):
        bench.backend.reset()
    for _ in range(30):
        bench.hand.step()
    bench.backend.reset()
    bench.go(0.4, 10)


def test_a_motor_that_was_switched_off_by_somebody_else_is_noticed() -> None:
    bench = after()
    bench.go(0.4, 10)
    bench.hand.servos[1].memory.put("torque_enable", 0)
    assert "joint_1 (id 4) has switched its motor off" in str(until_fault(bench))


def test_garbled_and_lost_bytes_cost_time_and_never_a_wrong_state() -> None:
    bench = Bench(plan=ServoFaultSettings(lose=2e-4, garble=2e-4, seed=5))
    again = ended = 0
    bench.backend.reset()
    for k in range(600):
        try:
            state = bench.go(0.3 * np.sin(0.1 * k))
        except HandError:
            again += len(bench.backend.warnings())
            ended += 1
            bench.backend.reset()
            continue
        np.testing.assert_allclose(state.position, bench.hand.state.position, atol=np.pi / 4096 + 1e-9)
    assert again + len(bench.backend.warnings()) > 0
    assert ended < 6


def test_an_answer_that_is_nothing_but_an_error_is_no_model_number() -> None:
    bench = after()
    for refusal in (PacketError.CRC, PacketError.RESULT):
        bench.hand.receive = lambda data, baud, why=refusal: status(3, why).encoded()  # type: ignore[method-assign,misc]
        assert bench.driver._sdk.ping(3) is None


def test_what_was_asked_for_again_is_a_warning() -> None:
    bench = after()
    assert bench.backend.warnings() == []
    bench.driver._reading.garbled = 3
    assert bench.backend.warnings() == ["3 answers were garbled and were asked for again"]
    bench.backend.reset()
    assert bench.backend.warnings() == []


def test_noise_repeats_itself_and_leaves_alone_what_it_does_not_hit() -> None:
    data = bytes(range(256)) * 4
    assert NoisyLine(LineNoise())(data) == data
    once, again = (
        NoisyLine(LineNoise(lose=0.1, garble=0.1, seed=3))(data),
        NoisyLine(LineNoise(lose=0.1, garble=0.1, seed=3))(data),
    )
    assert once == again != data
    assert 850 < len(once) < 980
    garbled = NoisyLine(LineNoise(garble=0.1))(data)
    turned = [a ^ b for a, b in zip(garbled, data, strict=True) if a != b]
    assert 60 < len(turned) < 150
    assert all(bits.bit_count() == 1 for bits in turned)


def test_faults_that_do_not_exist_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"script.0.what: input should be 'dead_motor'.*, not 'overheatt'"):
        parse_settings(ServoFaultSettings, {"script": [{"at": 0.0, "what": "overheatt"}]}, "test")
    with pytest.raises(ConfigError, match="which is 9; this hand has 4 servos"):
        Bench(plan=ServoFaultSettings(script=(ServoFaultEvent(at=0.0, what="silence", which=9),)))
    with pytest.raises(ConfigError, match=r"lose: input should be less than or equal to 1, not 2.0"):
        parse_settings(LineNoise, {"lose": 2.0}, "test")


def test_events_of_a_script_are_taken_once_each_in_the_order_of_their_times() -> None:
    late, soon, now = (FaultEvent(at=at, what="silence") for at in (2.0, 0.2, 0.1))
    script = FaultScript((late, soon, now), 1, "servos")
    assert list(script.take(0.2)) == [now, soon]
    assert list(script.take(1.0)) == []
    assert list(script.take(3.0)) == [late]
