"""conf/hands: the published hands, and what a hand's own file may say of its electronics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.calibration import HandCalibration, load_wiring
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.spec.thermal import ThermalData
from allegro_twin.types import Vector

SERIALS = sorted(path.stem for path in (data_root() / "conf" / "hands").glob("SAH*.yaml"))


def test_every_published_hand_is_there_right_and_left_of_each_version_that_has_encoders_to_calibrate() -> None:
    assert len(SERIALS) == 26
    kinds = {load_wiring(serial=serial)[:2] for serial in SERIALS}
    assert kinds == {(version, side) for version in ("v1", "v2", "v3") for side in ("right", "left")}


def seen(serial: str, count: int) -> Vector:
    """What the hand's 16 encoders mean at one raw count, rad."""
    wiring = load_wiring(serial=serial)
    assert wiring.version is not None
    codec = make_codec(wiring.version, wiring.calibration)
    position: list[float] = []
    for finger in range(4):
        report = codec.decode(Frame(0x3D3 + finger, count.to_bytes(2, "little") * 4))
        assert isinstance(report, m.FingerPosition)
        position += report.position
    return np.array(position)


@pytest.mark.parametrize("serial", SERIALS)
def test_a_published_hands_encoders_can_read_every_angle_that_its_joints_reach(serial: str) -> None:
    wiring = load_wiring(serial=serial)
    assert wiring.side is not None
    spec = load_spec("allegro", wiring.side, serial)
    ends = np.array([seen(serial, 0), seen(serial, 0xFFFF)])
    assert (ends.min(axis=0) < spec.lower).all()
    assert (ends.max(axis=0) > spec.upper).all()


@pytest.mark.parametrize("serial", SERIALS)
def test_a_published_hands_encoders_were_mounted_near_mid_range_of_a_plausible_posture(serial: str) -> None:
    """Within 0.1 rad of the joint limits, but for two joints at most: the odd encoder was mounted elsewhere, and the
    thumb's first joint reads 0 where its range begins at 0.26. SAH030H061L has five such joints."""
    spec, middle = load_spec(side=load_wiring(serial=serial).side or "right"), seen(serial, 0x8000)
    plausible = (middle > spec.lower - 0.1) & (middle < spec.upper + 0.1)
    assert plausible.sum() >= (11 if serial == "SAH030H061L" else 14)


def test_a_hands_own_file_overrides_the_nominal_one_key_by_key(tmp_path: Path) -> None:
    nominal = load_wiring()
    assert nominal == (None, None, HandCalibration(torque_constant=(1.0,) * 16))
    own = tmp_path / "mine.yaml"
    own.write_text(f"actuation: {{damping: 0.1}}\nwire: {{version: v4, torque_constant: {[0.5] * 15 + [0.7]}}}\n")
    assert load_wiring(serial=str(own)) == ("v4", None, HandCalibration(torque_constant=(*(0.5,) * 15, 0.7)))
    assert load_spec(serial=str(own)).actuation.damping[0] == 0.1


def test_a_hand_without_a_wire_block_is_wired_like_the_nominal_one(tmp_path: Path) -> None:
    own = tmp_path / "mine.yaml"
    own.write_text("actuation: {damping: 0.1}\n")
    assert load_wiring(serial=str(own)) == load_wiring()


@pytest.mark.parametrize(
    ("block", "complaint"),
    [
        (f"encoder_offset: {[0] * 15}", "wire.encoder_offset needs 16 values, one a joint; it has 15"),
        ("encoder_ofset: 0", "wire: no key named 'encoder_ofset'; did you mean 'encoder_offset'"),
        ("3: 0", "wire: no key named '3'; there are: convention, encoder_direction"),
        (f"motor_direction: {[1] * 15 + [2]}", "wire.motor_direction must be 1 or -1 for every joint"),
        ("encoder_offset: 1.5", "wire.encoder_offset needs a whole number for every joint, not 1.5"),
        ("encoder_direction: true", "wire.encoder_direction needs a whole number for every joint, not True"),
        ("torque_constant: strong", "wire.torque_constant needs a number for every joint, not 'strong'"),
        ("torque_constant: 0", "wire.torque_constant must be positive"),
        ("torque_constant: .inf", "wire.torque_constant must be positive"),
        ("torque_constant: .nan", "wire.torque_constant must be positive"),
        ("version: v6", "wire.version must be one of v1, v2, v3, v4, v5, v5plus, not 'v6'"),
        ("side: [left]", "wire.side must be one of right, left, not ['left']"),
        (
            "version: v4\n  encoder_direction: -1",
            "wire.encoder_direction means nothing to a v4 hand, only to v1, v2, v3",
        ),
        ("pwm_limit: 0", "wire.pwm_limit must be positive"),
        ("pwm_limit: 0.5", "wire.pwm_limit needs a whole number for every joint, not 0.5"),
        ("version: v4\n  convention: c", "wire.convention means nothing to a v4 hand, only to v1, v2, v3"),
        ("convention: d", "wire.convention must be one of ros, c, not 'd'"),
        ("version: v2\n  torque_order: straight", "wire.torque_order means nothing to a v2 hand, only to v1"),
    ],
)
def test_a_mistake_in_a_hands_file_is_named_with_its_file_and_key(tmp_path: Path, block: str, complaint: str) -> None:
    own = tmp_path / "mine.yaml"
    own.write_text(f"wire:\n  {block}\n")
    with pytest.raises(ConfigError) as caught:
        load_wiring(serial=str(own))
    assert str(caught.value).startswith(f"{own}: {complaint}")


def test_a_wire_block_that_is_no_mapping_is_refused(tmp_path: Path) -> None:
    own = tmp_path / "mine.yaml"
    own.write_text("wire: v4\n")
    with pytest.raises(ConfigError, match=r"mine\.yaml: wire must hold keys and values, not str"):
        load_wiring(serial=str(own))


@pytest.mark.parametrize("constant", [0.5, 0.8, 1.0, 1.6])
def test_the_torque_limit_is_what_the_counts_that_the_driver_lets_through_are_worth(
    constant: float, tmp_path: Path
) -> None:
    """375 of 1200 counts for the fingers' first joints: the same PWM, whatever a count is worth."""
    own = tmp_path / "mine.yaml"
    own.write_text(f"wire: {{version: v4, torque_constant: {constant}}}\n")
    spec, codec = load_spec(serial=str(own)), make_codec("v4", load_wiring(serial=str(own)).calibration)
    assert spec.actuation.torque_limit[:4] == pytest.approx(np.array([375, 675, 450, 285]) / 1200 * constant)
    frames, applied = codec.torques.frames(spec.actuation.torque_limit, codec.pwm_limits)
    counts = np.frombuffer(frames.data, "<i2")
    assert counts.tolist() == 3 * [375, 675, 450, 285] + [525, 405, 270, 270]
    assert applied == pytest.approx(spec.actuation.torque_limit)


def test_more_than_the_limit_is_never_sent_whatever_is_asked_for(tmp_path: Path) -> None:
    own = tmp_path / "mine.yaml"
    own.write_text("wire: {version: v4, pwm_limit: 100}\n")
    codec = make_codec("v4", load_wiring(serial=str(own)).calibration)
    frames, _ = codec.torques.frames(np.full(16, -9.0), codec.pwm_limits)
    assert np.frombuffer(frames.data, "<i2").tolist() == [-100] * 16
    assert load_spec(serial=str(own)).actuation.torque_limit.max() == pytest.approx(100 / 1200)


def test_an_old_file_with_a_torque_limit_of_its_own_lowers_it_and_cannot_raise_it(tmp_path: Path) -> None:
    own = tmp_path / "mine.yaml"
    own.write_text("actuation: {torque_limit: 0.3}\n")
    limit = load_spec(serial=str(own)).actuation.torque_limit
    assert limit.max() == 0.3
    assert limit.tolist() == np.minimum(load_spec().actuation.torque_limit, 0.3).tolist()


def test_a_hands_own_thermal_data_take_the_place_of_those_of_its_model(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("thermal: {rise: 30.0, time_constant: 200.0, source: measured}\n")
    assert load_spec(serial=str(own)).thermal == ThermalData(30.0, 200.0, "measured")
    nominal = load_spec().thermal
    assert nominal is not None
    assert (nominal.rise, nominal.time_constant) == (70.0, 90.0)
    own.write_text("thermal: {rise: 30.0}\n")
    with pytest.raises(ConfigError, match="own.yaml: thermal: time_constant: missing"):
        load_spec(serial=str(own))


def test_a_v4_hand_takes_encoder_offsets() -> None:
    codec = make_codec("v4", HandCalibration(encoder_offset=(100,) * 16))
    plain = make_codec("v4")
    report = plain.encode(m.FingerPosition(1, (0.5, 0.6, 0.7, 0.8)))
    read, without = codec.decode(report), plain.decode(report)
    assert isinstance(read, m.FingerPosition)
    assert isinstance(without, m.FingerPosition)
    count = np.radians(333.3 / 65536)
    assert np.array(read.position) == pytest.approx(np.array(without.position) - 100 * count, abs=1e-12)
