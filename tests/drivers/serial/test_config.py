"""A hand of servos from a config: assembled, run, and refused with the way out."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("dynamixel_sdk", reason="pip install 'allegro-twin[dynamixel]'")

from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.app.rig import assemble
from allegro_twin.app.session import recording_meta
from allegro_twin.drivers.dynamixel.config import DynamixelSettings
from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
from allegro_twin.drivers.dynamixel.driver.prepare import check_place
from allegro_twin.drivers.dynamixel.opening import calibration_of
from allegro_twin.errors import ConfigError, HandFault, LinkError
from allegro_twin.files.schema import parse_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.loop import run, until
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.twin.branch.what_if import branch_recording
from tests.drivers.serial.rigs import MODEL_O, config_of


def test_a_virtual_leap_hand_goes_home_through_its_servos() -> None:
    config = load_config("leap_virtual")
    rig = assemble(config)
    assert isinstance(rig.driver, DynamixelBackend)
    assert not rig.live
    samples = list(until(2.0, run(rig.backend, rig.controller)))
    rig.backend.close()
    assert len(samples) == 101
    home = [0.6, 0.0, 0.5, 0.5] * 3 + [1.2, 0.6, 0.3, 0.3]
    np.testing.assert_allclose(samples[-1].state.position, home, atol=0.04)  # What a spring gives way to gravity.
    np.testing.assert_array_less(np.abs(samples[-1].state.torque), 0.26)


def test_through_the_servos_it_goes_where_it_goes_without_them() -> None:
    wired = assemble(config_of())
    alone = assemble(
        parse_settings(RunConfig, config_of().model_dump(exclude={"backend"}) | {"backend": {"kind": "sim"}}, "test")
    )
    pairs = zip(until(0.5, run(wired.backend, wired.controller)), run(alone.backend, alone.controller), strict=False)
    for there, here in pairs:
        np.testing.assert_allclose(there.state.position, here.state.position, atol=0.01)
    wired.backend.close()


@pytest.mark.slow
def test_a_leap_hand_picks_a_cube_up_through_its_servos_turns_it_and_shakes_it() -> None:
    content = config_of().model_dump(exclude_unset=True, exclude={"seconds"})
    rig = assemble(parse_settings(RunConfig, content | {"task": {"scenario": "leap_rubiks_cube"}}, "test"))
    assert rig.trial is not None
    assert rig.seconds is not None
    for sample in until(rig.seconds, run(rig.backend, rig.controller)):
        rig.trial.see(sample.state)
    rig.backend.close()
    assert rig.trial.report().held


def test_a_hand_of_four_servos_on_tendons_runs_as_one_of_sixteen_on_joints() -> None:
    rig = assemble(config_of("model_o", servos=MODEL_O))
    *_, last = until(0.5, run(rig.backend, rig.controller))
    rig.backend.close()
    assert last.state.position.shape == (4,)
    assert rig.device.calibration["servos"][0]["current_limit"] == 0.03


def test_a_recording_says_what_its_ticks_were_worth(tmp_path: Path) -> None:
    config = config_of()
    rig = assemble(config)
    meta = recording_meta(rig, config)
    for _ in record(until(0.2, run(rig.backend, rig.controller)), tmp_path / "r.arrow", rig.spec, 0.02, meta=meta):
        pass
    rig.backend.close()
    table = load(tmp_path / "r.arrow").meta["calibration"]
    assert table["model"] == "XC330-M288"
    assert [servo["id"] for servo in table["servos"]][:4] == [1, 0, 2, 3]


def test_a_recording_of_a_virtual_hand_goes_on_as_it_did(tmp_path: Path) -> None:
    script = [{"at": 9.0, "what": "overheat", "which": 5}]
    servos = {"ids": list(range(16)), "model": "XC330-M288", "current_limit": 0.5}
    config = config_of(servos=servos, faults={"lose": 0.0, "script": script})
    rig = assemble(config)
    samples = until(0.3, run(rig.backend, rig.controller))
    for _ in record(samples, tmp_path / "r.arrow", rig.spec, 0.02, meta=recording_meta(rig, config)):
        pass
    rig.backend.close()
    both = branch_recording(tmp_path / "r.arrow", 0.1, {})
    np.testing.assert_array_equal(both.branched, both.recorded)


def test_faults_of_a_config_happen() -> None:
    script = [{"at": 0.1, "what": "overheat", "which": 5}]
    rig = assemble(config_of(faults={"script": script}))
    with pytest.raises(HandFault, match=r"\(id 4\): overheating; reset reboots it"):
        for _ in run(rig.backend, rig.controller):
            pass
    rig.backend.close()


def test_gains_are_written_where_a_file_gives_them() -> None:
    spec, config = load_spec("leap"), config_of()
    assert isinstance(config.backend, DynamixelSettings)
    servos = calibration_of(config.backend, config.hand, spec).servos
    assert [servo.gains for servo in servos[:2]] == [(600, 0, 200), (450, 0, 150)]
    rig = assemble(config)
    rig.backend.reset()
    assert isinstance(rig.driver, DynamixelBackend)
    line: Any = rig.driver._port
    assert [servo.memory.get("position_p_gain") for servo in line.hand.servos[:2]] == [600, 450]
    rig.backend.close()


@pytest.mark.parametrize(
    ("hand", "backend", "names"),
    [
        ("leap", {"servos": {"ids": [1, 2], "current_limit": 0.5}}, "leap_right has 16 actuators; 2 servos"),
        ("leap", {"servos": {"ids": list(range(16))}}, "servos.current_limit"),
        ("leap", {"servos": {"ids": list(range(16)), "current_limit": [0.5, 0.5]}}, "needs one value or 16"),
        ("leap", {"servos": {"ids": [1] * 16, "current_limit": 0.5}}, "two servos of this hand have the id 1"),
        ("leap", {"servos": {"ids": list(range(16)), "current_limit": 0.5, "model": "XC330"}}, "no servo model named"),
        ("leap", {"servos": {"ids": list(range(16)), "current_limit": 0.5, "direction": 2}}, "direction"),
        ("leap", {"baud": 123}, "backend.baud is 123; a XC330-M288 has 9600"),
        ("leap", {"baud": 57_600}, "period 0.02 s is too short for 16 servos at 57600 baud"),
        ("leap", {"latency": 0.1}, "backend.latency: the wire of a virtual hand is inside this program and has none"),
        ("leap", {"watchdog": 9.0}, "watchdog 9 s must be from 0.02 to 2.54 s"),
        ("leap", {"faults": {"script": [{"at": 0, "what": "overheatt"}]}}, "overheatt|what"),
        ("leap", {"faults": {"script": [{"at": 0, "what": "silence", "which": 16}]}}, "this hand has 16 servos"),
        ("qb_softhand", {}, "backend.servos is missing, and no file of qb_softhand in conf/hands describes its servos"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(hand: str, backend: dict[str, Any], names: str) -> None:
    with pytest.raises(ConfigError, match=names) as caught:
        assemble(config_of(hand, **backend))
    assert "\n" not in str(caught.value)


def test_a_hand_that_takes_torques_has_no_servos() -> None:
    servos = {"ids": list(range(16)), "current_limit": 0.5}
    content = {"backend": {"kind": "dynamixel", "port": "virtual", "servos": servos}, "controller": {"kind": "pd"}}
    with pytest.raises(
        ConfigError, match="servos need a hand that takes a limited_position; allegro_right takes torque"
    ):
        assemble(parse_settings(RunConfig, content, "test"))


def test_a_port_that_is_not_there_is_one_line() -> None:
    with pytest.raises(LinkError, match="cannot open /dev/nowhere"):
        assemble(config_of(port="/dev/nowhere"))


def test_without_the_sdk_it_says_which_extra_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "dynamixel_sdk", None)
    with pytest.raises(ConfigError, match=r"pip install 'allegro-twin\[dynamixel\]'"):
        assemble(config_of())


def test_a_model_o_closes_through_its_four_servos_and_says_what_57600_baud_can_carry() -> None:
    pytest.importorskip("dynamixel_sdk")
    config = load_config("model_o_virtual")
    rig = assemble(config)
    with closing(rig.backend):
        last = list(until(3.0, run(rig.backend, rig.controller)))[-1].state
    assert last.position[1] > 1.5
    assert last.position[1] == pytest.approx(last.position[2], abs=0.02)
    slow = config.model_dump() | {"backend": {"kind": "dynamixel", "port": "virtual", "baud": 57600}}
    with pytest.raises(ConfigError, match="period 0.02 s is too short for 4 servos at 57600 baud"):
        assemble(RunConfig.model_validate(slow))


def test_the_ticks_of_a_model_os_servos_are_those_of_its_authors_program() -> None:
    """openhand_node's hands.py: 0.37 of 4095 ticks bring the pair from facing each other to facing the thumb. Fingers
    close by 0.7, the reverse one downwards from 0.13 + 0.7."""
    config, spec = load_config("model_o_virtual"), load_spec("model_o")
    assert isinstance(config.backend, DynamixelSettings)
    calibration = calibration_of(config.backend, config.hand, spec)
    facing_the_thumb, facing_each_other = calibration.ticks(spec.lower), calibration.ticks(spec.upper)
    assert facing_the_thumb[0] - facing_each_other[0] == pytest.approx(0.37 * 4095, abs=1)
    assert facing_each_other[0] >= 0
    assert facing_the_thumb[1:] == [round(part * 4095) for part in (0.22, 0.83, 0.27)]
    assert facing_each_other[1:] == pytest.approx([part * 4095 for part in (0.92, 0.13, 0.97)], abs=3)
    np.testing.assert_allclose(
        calibration.effort(np.array(calibration.current_counts)), spec.actuation.torque_limit, rtol=0.03
    )


@pytest.mark.parametrize(("servo", "tick"), [(0, 4090), (2, 5)])
def test_a_model_o_whose_servo_woke_up_a_turn_away_is_not_moved(servo: int, tick: int) -> None:
    """A hair beyond the end of a servo's one turn; its authors ask before they move it, lest it shear its gears."""
    config, spec = load_config("model_o_virtual"), load_spec("model_o")
    assert isinstance(config.backend, DynamixelSettings)
    calibration = calibration_of(config.backend, config.hand, spec)
    ticks = np.array(calibration.ticks(spec.rest))
    check_place(spec, calibration.position(ticks), calibration)
    ticks[servo] = tick
    with pytest.raises(ConfigError, match=f"{spec.joints[servo]} .* or it lost a turn"):
        check_place(spec, calibration.position(ticks), calibration)
