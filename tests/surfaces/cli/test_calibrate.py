"""`allegro-twin calibrate` writes what it found into a hand's own file, and the hand that uses the file is right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from allegro_twin.app import assemble
from allegro_twin.app.config import load_config
from allegro_twin.drivers.can import opening
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.calibration import Version, load_wiring
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.settings import HandSettings
from allegro_twin.loop import run, until
from allegro_twin.plugins import BackendContext
from allegro_twin.spec import HandSpec, Side
from allegro_twin.surfaces.cli.hand_override import block_with_file
from allegro_twin.twin.identify import joint_ends
from allegro_twin.twin.identify.joint_ends import refuse_another_hand, store_limits
from allegro_twin.twin.identify.motions.limits import BEYOND, FoundLimits, check_both_ends, encoder_offsets
from allegro_twin.types import frozen
from tests.surfaces.cli.conftest import Run

COUNT = np.radians(333.3 / 65536)  # rad, v1 to v4.
MINE = "# My hand, bought 2019.\nactuation:\n  damping: 0.08  # measured\n"


def config_file(path: Path, version: Version, side: Side, serial: Path | None) -> Path:
    hand = {"side": side} | ({} if serial is None else {"serial": str(serial)})
    backend = {"kind": "can", "version": version, "interface": "allegro-virtual", "gravity": [0, 0, -9.81]}
    path.write_text(
        yaml.safe_dump({"hand": hand, "backend": backend, "task": {"posture": "home"}, "controller": {"kind": "pid"}})
    )
    return path


@pytest.fixture
def hide(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[int], tuple[int, ...]]:
    """Have the encoders of the virtual hand at the far end of the bus be off by up to so many counts, by how many
    each; its user does not know."""
    path, real = tmp_path / "hidden.yaml", opening.firmware_of

    def firmware_of(settings: CanSettings, context: BackendContext, *, step: float, restart: bool) -> Firmware:
        hand = context.hand.model_copy(update={"serial": str(path)})
        return real(settings, replace(context, hand=hand), step=step, restart=restart)

    def hidden(most: int) -> tuple[int, ...]:
        offset = np.random.default_rng(4).integers(-most, most, 16).tolist()
        path.write_text(yaml.safe_dump({"wire": {"encoder_offset": offset}}))
        monkeypatch.setattr(opening, "firmware_of", firmware_of)
        return tuple(offset)

    return hidden


def misread(config: Path) -> float:
    """How wrong the hand's positions are once it is home, rad, the worst joint."""
    rig = assemble(load_config(config))
    assert rig.sim is not None
    *_, last = until(2.0, run(rig.backend, rig.controller))
    rig.backend.close()
    return float(np.abs(last.state.position - rig.sim.read().position).max())


def calibrated(command: Run, config: Path, target: Path) -> tuple[int, ...]:
    """Calibrate, and what the file then says of the encoders."""
    code, shown, errors = command("calibrate", "limits", "-c", config, "--into", target, "--offsets")
    assert (code, errors) == (0, "")
    assert f"Limits and encoder offsets are in {target}" in shown
    return load_wiring(serial=str(target)).calibration.encoder_offset


@pytest.mark.slow
def test_a_hand_whose_encoders_are_off_is_right_once_it_was_calibrated(
    hide: Callable[[int], tuple[int, ...]], command: Run, tmp_path: Path
) -> None:
    target, hidden = tmp_path / "mine.yaml", hide(1100)  # 0.1 rad.
    target.write_text(MINE)
    before = config_file(tmp_path / "before.yaml", "v2", "left", None)
    after = config_file(tmp_path / "after.yaml", "v2", "left", target)
    assert misread(before) > 0.05
    assert np.abs(np.subtract(calibrated(command, before, target), hidden)).max() < 0.005 / COUNT
    assert misread(after) < 0.005
    wiring, spec, model = (
        load_wiring(serial=str(target)),
        load_spec("allegro", "left", str(target)),
        load_spec(side="left"),
    )
    assert (wiring.version, wiring.side) == ("v2", "left")
    np.testing.assert_allclose([spec.lower, spec.upper], [model.lower, model.upper], atol=0.01)
    text = target.read_text()
    assert text.startswith(MINE)
    note = f"# Measured by `allegro-twin calibrate limits`, {datetime.now(UTC).date()}, {before}, pressed with at most "
    assert text.count(note) == 2


@pytest.mark.long
def test_encoders_that_are_far_off_are_right_after_the_second_time(
    hide: Callable[[int], tuple[int, ...]], command: Run, tmp_path: Path
) -> None:
    """The first time the fingers are not out of each other's way where they should be, and some meet. What was written
    then is used and replaced: nothing is applied twice, and no line is added."""
    target, hidden = tmp_path / "mine.yaml", hide(2000)  # 0.18 rad.
    config = config_file(tmp_path / "c.yaml", "v4", "right", None)
    calibrated(command, config, target)
    lines = len(target.read_text().splitlines())
    config_file(config, "v4", "right", target)
    assert np.abs(np.subtract(calibrated(command, config, target), hidden)).max() < 0.005 / COUNT
    assert misread(config) < 0.005
    assert len(target.read_text().splitlines()) == lines


@pytest.mark.parametrize("version", ["v1", "v3", "v4", "v5", "v5plus"])
def test_what_is_written_reads_the_middle_of_what_was_found_as_the_models(version: Version, side: Side) -> None:
    model, generator = load_spec(side=side), np.random.default_rng(0)
    shift = generator.uniform(-0.2, 0.2, 16)
    found = FoundLimits(frozen(model.lower + shift - 0.01), frozen(model.upper + shift + 0.01))
    old = make_codec(version)
    right = encoder_offsets(found, model, old)
    new = make_codec(version, type(old.calibration)(encoder_offset=right.offset))
    report = bytes(generator.integers(0, 64, 32, dtype=np.uint8))
    moved = new.positions.values(report) - old.positions.values(report)
    np.testing.assert_allclose(moved, -shift, atol=8e-4)  # Half a count of the coarsest encoder, v5.
    np.testing.assert_allclose(right.limits.lower, found.lower + moved, atol=1e-12)
    assert encoder_offsets(right.limits, model, new).offset == right.offset
    np.testing.assert_allclose(right.limits.upper + right.limits.lower, model.upper + model.lower, atol=1.6e-3)


def test_a_joint_that_was_not_at_both_its_ends_gets_no_offset(spec: HandSpec) -> None:
    upper = spec.upper.copy()
    upper[1] = spec.lower[1] + 0.3
    with pytest.raises(ConfigError, match=r"index_1 was seen from -0\.196 to \+0\.104 rad, the model's ends are"):
        encoder_offsets(FoundLimits(spec.lower, frozen(upper)), spec, make_codec("v4"))
    upper = spec.upper.copy()
    upper[6] += BEYOND  # No stop: it went as far as it was sent.
    with pytest.raises(ConfigError, match="middle_2 was seen"):
        encoder_offsets(FoundLimits(spec.lower, frozen(upper)), spec, make_codec("v4"))


def test_a_stuck_joint_is_refused_by_name_and_nothing_is_written(
    command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec, target = load_spec(), tmp_path / "mine.yaml"
    lower, upper = spec.lower.copy(), spec.upper.copy()
    lower[5], upper[5] = 0.2, 0.2016
    upper[8] = lower[8] + 0.6  # Of 0.94 rad: something is in its way.
    found = FoundLimits(frozen(lower), frozen(upper))
    monkeypatch.setattr(joint_ends, "find_limits", lambda *_: (spec, found))
    for arguments in ([], ["--into", target]):
        code, shown, errors = command("calibrate", "limits", *arguments)
        assert (code, errors.count("\n")) == (2, 1)
        assert "middle_1 was seen from +0.200 to +0.202 rad" in errors
        assert "ring_0 was seen" in errors
        assert "+0.202" in shown
        assert "Next:" not in shown
    assert not target.exists()
    with pytest.raises(ConfigError, match="not at both ends: middle_1 .*ring_0"):
        joint_ends.store_limits(target, found, spec, ", today")
    assert not target.exists()


STOOD = np.ones((2, 16), dtype=bool)


def test_limits_may_differ_from_the_models_as_those_of_published_hands_do(spec: HandSpec) -> None:
    spare = np.minimum(BEYOND, 0.25 * (spec.upper - spec.lower)) - 1e-9
    check_both_ends(FoundLimits(frozen(spec.lower + spare), spec.upper, STOOD), spec)
    check_both_ends(FoundLimits(spec.lower, frozen(spec.upper - spare), STOOD), spec)
    shifted = FoundLimits(frozen(spec.lower + 0.3), frozen(spec.upper + 0.3), ~STOOD)  # Encoders that are off.
    check_both_ends(shifted, spec)
    with pytest.raises(ConfigError, match="index_2 was seen .*; nor were index_3, middle_0, .*thumb_3. Free it"):
        check_both_ends(FoundLimits(spec.rest, spec.rest), spec)
    with pytest.raises(ConfigError, match="thumb_3 was seen"):
        check_both_ends(FoundLimits(spec.lower, frozen([*spec.upper[:-1], np.nan])), spec)


def test_a_range_that_is_not_the_models_is_taken_only_where_the_torque_tells_of_stops(spec: HandSpec) -> None:
    lower, stood = spec.lower.copy(), STOOD.copy()
    lower[5] += 0.008
    check_both_ends(FoundLimits(frozen(lower), spec.upper, stood), spec)
    stood[0, 5] = False
    with pytest.raises(ConfigError, match=r"middle_1 was seen .*, with no sign of a stop at the lower end"):
        check_both_ends(FoundLimits(frozen(lower), spec.upper, stood), spec)


def test_a_joint_that_a_person_left_short_of_a_stop_is_refused_with_the_way_out(spec: HandSpec) -> None:
    lower = spec.lower.copy()
    lower[5] += 0.2
    with pytest.raises(ConfigError, match=r"middle_1 was seen from \+0\.004 .* press it against both its stops"):
        check_both_ends(FoundLimits(frozen(lower), spec.upper), spec)


def test_ends_that_are_shifted_by_different_amounts_tell_no_encoder_offset(spec: HandSpec) -> None:
    found = FoundLimits(frozen(spec.lower + 0.1), frozen(spec.upper + 0.06), STOOD)
    check_both_ends(found, spec)
    with pytest.raises(ConfigError, match="no encoder offset can be told: index_0 was seen .* shifts both ends alike"):
        encoder_offsets(found, spec, make_codec("v4"))


def stiff(joint: int, friction: float) -> dict[str, object]:
    return {"actuation": {"frictionloss": [friction if k == joint else 0.02 for k in range(16)]}}


STAYED = "with no sign of a stop at the lower"
CREPT = "and still moved at the lower end, at 0.4"


def weak(joint: int, strength: float) -> dict[str, object]:
    return {"drive": {"strength": [strength if k == joint else 1.0 for k in range(16)]}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "end", "why"),
    [
        (stiff(9, 0.24), "ring_1 was seen from +0.000", STAYED),
        (weak(9, 0.15), "ring_1 was seen from +0.000", STAYED),
        (stiff(5, 0.22), "middle_1 was seen from -0.18", CREPT),  # It has not arrived when it is called back.
    ],
)
def test_a_joint_that_friction_or_a_weak_motor_held_short_of_its_stop_gets_no_offset(
    truth: dict[str, object], end: str, why: str, command: Run, tmp_path: Path
) -> None:
    config, target = tmp_path / "c.yaml", tmp_path / "mine.yaml"
    backend = {"kind": "can", "version": "v4", "interface": "allegro-virtual", "imu": 0.1}
    backend["scene"] = {"kind": "sim", "truth": truth}
    config.write_text(yaml.safe_dump({"backend": backend, "task": {"posture": "home"}, "controller": {"kind": "pid"}}))
    code, _, errors = command("calibrate", "limits", "-c", config, "--into", target, "--offsets")
    assert (code, errors.count("\n")) == (2, 1)
    assert end in errors
    assert why in errors
    assert not target.exists()


@pytest.mark.parametrize("arguments", [["--offsets"], ["--offsets", "--into", "mine.yaml"]])
def test_offsets_need_encoders_and_a_file(
    arguments: list[str], command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, errors = command("calibrate", "limits", *arguments)
    assert (code, errors.count("\n")) == (2, 1)
    assert ("backend sim, which has no encoders" if "--into" in arguments else "name it with --into") in errors
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("file", "written", "side", "block"),
    [
        ("wire: {side: left}\n", {}, "left", "hand: {{serial: {0}}}"),
        ("wire: {side: left}\n", {"side": "left"}, "left", "hand: {{serial: {0}}}"),
        ("actuation: {}\n", {}, "right", "hand: {{side: left, serial: {0}}}"),
        ("actuation: {}\n", {"side": "left"}, "left", "hand: {{side: left, serial: {0}}}"),
    ],
)
def test_a_config_has_the_side_of_the_hands_own_file_and_says_it_where_the_file_does_not(
    file: str, written: dict[str, str], side: str, block: str, tmp_path: Path
) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text(file)
    assert HandSettings.model_validate({"serial": str(mine)} | written).side == side
    assert block_with_file(mine, "left") == block.format(mine)


def test_what_was_measured_on_one_hand_does_not_go_into_the_file_of_another(tmp_path: Path) -> None:
    target = tmp_path / "mine.yaml"
    config = str(config_file(tmp_path / "c.yaml", "v4", "right", None))
    target.write_text("wire: {version: v2, encoder_offset: 7}\n")
    with pytest.raises(ConfigError, match="is of a v2 hand, .* of a v4 one"):
        refuse_another_hand(target, load_config(config), config, make_codec("v4"))
    with pytest.raises(ConfigError, match="has encoder offsets that .* does not use"):
        refuse_another_hand(target, load_config(config), config, None)
    target.write_text("wire: {side: left}\n")
    with pytest.raises(ConfigError, match="is of a left hand, .* of a right one"):
        refuse_another_hand(target, load_config(config), config, make_codec("v4"))
    refuse_another_hand(target, load_config(config), config, None)


@pytest.mark.parametrize(
    "start", ["# mine\n", "# mine", "# mine\r\n# more\r\n", "---\n# mine\n", "# a\nlimits:\n  # b\n"]
)
def test_a_file_of_comments_keeps_them(start: str, spec: HandSpec, tmp_path: Path) -> None:
    target = tmp_path / "mine.yaml"
    target.write_bytes(start.encode())
    for _ in range(2):  # The second time there is more than comments.
        store_limits(target, FoundLimits(spec.lower, spec.upper), spec, ", today")
        text = target.read_bytes().decode()
        assert all(line in text for line in start.splitlines() if "#" in line)
        assert text.count("# Measured by `allegro-twin calibrate limits`, today; rad") == 1
        assert ("\r\n" in start) == (text.count("\r\n") == text.count("\n"))
    np.testing.assert_allclose(load_spec(serial=str(target)).upper, spec.upper, atol=1e-4)


@pytest.mark.parametrize(
    "arguments",
    [
        ["calibrate", "limits", "--into", "conf/hands/SAH030C033R.yaml"],
        ["teach", "mine", "--seconds", "0.1", "--into", "conf/postures/home.yaml"],
        ["hand", "new", "models/mjcf/leap_right.xml", "--name", "home", "--out", "conf/hands", "--force"],
        ["identify", "conf/sim_right.yaml", "--hand", "SAH030C033R"],
        ["panel", "--into", "conf/grasps/rock.yaml"],
    ],
)
def test_no_command_writes_over_a_file_that_ships(command: Run, arguments: list[str]) -> None:
    root = data_root()
    before = {path: path.read_bytes() for path in (root / "conf").rglob("*.*")}
    code, _, err = command(*(str(root / each) if "/" in each else each for each in arguments))
    assert code == 2
    assert "what ships with the package is not changed" in " ".join(err.split())
    assert {path: path.read_bytes() for path in (root / "conf").rglob("*.*")} == before


def test_gravity_of_a_hand_that_reports_none_is_taken_from_the_controller(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    backend = {"kind": "can", "version": "v3", "interface": "allegro-virtual"}
    for controller, refused in (({"kind": "pid"}, True), ({"kind": "pid", "gravity": [0, 0, -9.81]}, False)):
        config.write_text(yaml.safe_dump({"backend": backend, "task": {"posture": "home"}, "controller": controller}))
        if refused:
            with pytest.raises(ConfigError, match="its backend or the controller `gravity`"):
                joint_ends.find_limits(load_config(str(config)), 0.05, lambda t, total: None)
        else:
            joint_ends.find_limits(load_config(str(config)), 0.05, lambda t, total: None)


def test_degrees_a_reversed_sign_and_swapped_joints_are_named_where_the_ends_show_them(spec: HandSpec) -> None:
    with pytest.raises(RecordingError, match=r"go to 98\.\d+, .* in degrees: divide them by 57\.2958"):
        check_both_ends(FoundLimits(np.degrees(spec.lower), np.degrees(spec.upper)), spec)
    lower, upper = spec.lower.copy(), spec.upper.copy()
    lower[1], upper[1] = -spec.upper[1], -spec.lower[1]
    with pytest.raises(ConfigError, match="index_1 was seen .*: the sign of its encoder is reversed"):
        check_both_ends(FoundLimits(lower, upper), spec)
    lower, upper = spec.lower.copy(), spec.upper.copy()
    lower[[0, 1]], upper[[0, 1]] = spec.lower[[1, 0]], spec.upper[[1, 0]]
    with pytest.raises(ConfigError, match="index_0 .*: it and index_1 are swapped; index_1 .* it and index_0 are"):
        check_both_ends(FoundLimits(lower, upper), spec)


@pytest.mark.parametrize("found", [STOOD, None])
def test_swapped_joints_are_refused_though_both_came_to_stops(found: NDArray[np.bool_] | None, spec: HandSpec) -> None:
    lower, upper, offset = spec.lower.copy(), spec.upper.copy(), np.linspace(-0.01, 0.01, 16)
    lower[[1, 2]], upper[[1, 2]] = spec.lower[[2, 1]], spec.upper[[2, 1]]
    with pytest.raises(ConfigError, match=r"index_1 was seen from .*: it and index_2 are swapped"):
        check_both_ends(FoundLimits(frozen(lower + offset), frozen(upper + offset), found), spec)
    shifted = offset.copy()
    shifted[[1, 2]] = 0.06, -0.05  # Encoders alone.
    check_both_ends(FoundLimits(frozen(spec.lower + shifted), frozen(spec.upper + shifted), STOOD), spec)
