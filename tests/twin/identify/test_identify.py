"""A hidden hand is found out from its own recordings, with intervals, and what cannot be known is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.calibration import Version, load_wiring
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.environments.posterior import CORE, load_posterior
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.sim.open_loop import BEFORE, OpenLoopPlayer
from allegro_twin.surfaces.cli.twin import identification
from allegro_twin.surfaces.cli.twin.commands import weight_of
from allegro_twin.surfaces.cli.twin.identification import head_lines, lines, table
from allegro_twin.twin.identify import pipeline, report
from allegro_twin.twin.identify.joint_ends import refuse_another_hand
from allegro_twin.twin.identify.motions.motion import LEAST_NOISE, RecordedMotion, _fill_gaps, noise_floor, read_motion
from allegro_twin.twin.identify.pipeline import identify_hand, measure_gaps
from allegro_twin.twin.identify.report import report_page
from allegro_twin.twin.identify.results import hand_file
from allegro_twin.twin.identify.results.findings import describe_prediction
from allegro_twin.twin.identify.results.uncertainty import (
    SOLVED,
    IdentifiedValue,
    identified_values,
    motion_coverage,
    value_correlations,
)
from allegro_twin.twin.mirror.on_recording import recorded_samples
from allegro_twin.types import HandState, Sample, TorqueCommand
from tests.twin.identify import hidden

COUNT = np.radians(333.3 / 65536)


def reasons(motions: list[RecordedMotion], name: str) -> tuple[str, ...]:
    """Why values are not determined by some motions, were the fit as good as that of all."""
    return identified_values(hidden.found().fit, motion_coverage(motions, OpenLoopPlayer(motions[0].spec, 0.003)))[
        name
    ].reason


def motions() -> list[RecordedMotion]:
    return list(hidden.found().motions)


@pytest.mark.slow
def test_a_hidden_hand_is_found_out() -> None:
    drive, late = hidden.found().fit.drive, hidden.found().values["delay"]
    constant = np.abs(drive.torque_constant / hidden.CONSTANT - 1.0)
    assert np.median(constant) < 0.005
    assert constant.max() < 0.05
    assert np.median(np.abs(drive.damping / hidden.DAMPING - 1.0)) < 0.01
    assert np.median(np.abs(drive.armature / hidden.ARMATURE - 1.0)) < 0.02
    assert np.median(np.abs(drive.frictionloss - hidden.FRICTION)) < 0.5e-3
    assert np.median(np.abs(drive.offset - hidden.OFFSET)) < 2e-3
    assert abs(late.value[0] - hidden.DELAY) < 0.3e-3


@pytest.mark.slow
def test_intervals_hold_what_is_hidden() -> None:
    truth = {
        "torque_constant": hidden.CONSTANT,
        "armature": hidden.ARMATURE / hidden.CONSTANT,
        "damping": hidden.DAMPING / hidden.CONSTANT,
        "frictionloss": hidden.FRICTION / hidden.CONSTANT,
        "offset": hidden.OFFSET,
    }
    for name, true in truth.items():
        value = hidden.found().values[name]
        assert (np.abs(value.value - true) <= value.half).mean() >= 0.9, name


@pytest.mark.slow
def test_intervals_of_delay_and_armature_hold_what_is_hidden_where_noise_makes_the_commands() -> None:
    """Noise of 1 mrad in the reports shakes the motors through the controller: that tells a delay from an armature."""
    values = hidden.found_with_noise().values
    late, armature = values["delay"], values["armature"]
    assert abs(late.value[0] - hidden.DELAY) <= late.half[0] < 2e-3
    assert (np.abs(armature.value - hidden.ARMATURE / hidden.CONSTANT) <= armature.half).mean() >= 0.85


@pytest.mark.slow
def test_friction_that_is_not_in_the_model_makes_no_torque_constant_doubtful() -> None:
    constant, damping = (hidden.found().values[name] for name in ("torque_constant", "damping"))
    assert np.median(constant.half / constant.value) < 0.01
    assert (damping.half > SOLVED["damping"][0] * damping.value).all()


@pytest.mark.slow
def test_intervals_hold_what_the_engines_two_ways_to_solve_dry_friction_differ_by(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = hidden.found().values
    monkeypatch.setattr("allegro_twin.twin.identify.results.uncertainty.SOLVED", {})
    alone = identified_values(hidden.found().fit, hidden.found().coverage)
    for name, (share, more) in SOLVED.items():
        wider = told[name].half - alone[name].half
        np.testing.assert_allclose(wider, share * told[name].value + more, rtol=1e-9, atol=1e-15)
        assert wider.min() > 0.0


@pytest.mark.slow
def test_what_is_left_is_the_noise_of_the_encoders() -> None:
    floor = np.hypot(5e-5, COUNT / np.sqrt(12.0))
    np.testing.assert_allclose(hidden.found().fit.floor, floor, rtol=0.25)
    assert hidden.found().fit.spread.residual.max() < 2.5
    assert motions()[0].noise.shape == (16,)


@pytest.mark.parametrize("version", ["v3", "v4", "v5", "v5plus"])
@pytest.mark.parametrize("noise", [0.0, 5e-5, 2e-4, 1e-3, 3e-3])
def test_a_noise_is_what_the_encoder_has_and_what_its_rounding_leaves(version: Version, noise: float) -> None:
    """However many reports repeat the one before: a joint that creeps, one that moves and one that is knocked."""
    grain, t = make_codec(version).rad_per_count, 0.003 * np.arange(4000)
    rng = np.random.default_rng(0)
    path = np.stack([0.02 * t, 0.4 * np.sin(1.5 * t), 0.4 * np.sin(1.5 * t)], axis=1)
    path[1000::1000, 2] += 0.02
    reported = grain * np.rint((path + noise * rng.standard_normal(path.shape)) / grain)
    found = noise_floor(reported, grain)
    np.testing.assert_allclose(found, np.hypot(noise, grain / np.sqrt(12.0)), rtol=0.12)


def test_without_rounding_the_noise_is_that_of_third_differences() -> None:
    white = 1e-4 * np.random.default_rng(0).standard_normal((4000, 2))
    white[:, 0] += np.linspace(0.0, 0.5, 4000)
    np.testing.assert_allclose(noise_floor(white, 0.0)[0], 1e-4, rtol=0.05)
    np.testing.assert_array_equal(noise_floor(np.zeros((50, 2)), 0.0), LEAST_NOISE)


@pytest.mark.slow
def test_a_joint_that_long_pieces_do_not_explain_has_the_interval_of_short_ones_and_keeps_its_value() -> None:
    fit = hidden.found().fit
    left = fit.spread.residual.copy()
    left[3] = 2.0
    wide = replace(fit.spread, covariance=100.0 * fit.spread.covariance)
    doubted = replace(fit, spread=replace(fit.spread, residual=left), shorter=wide)
    plain, found = (identified_values(each, hidden.found().coverage)["damping"] for each in (fit, doubted))
    assert found.half[3] > 3.0 * plain.half[3]
    np.testing.assert_array_equal(found.half[left < 1.0], plain.half[left < 1.0])
    assert found.reason == plain.reason


@pytest.mark.slow
def test_a_misfit_widens_the_interval_of_the_value_that_scatters_between_recordings_and_of_no_other() -> None:
    fit = hidden.found().fit
    left, moved = fit.spread.residual.copy(), fit.spread.by_recording.copy()
    left[3] = 2.0
    moved[:, fit.columns("damping")][:, 3] = [1e-3, -1e-3, 0.0]
    doubted = replace(fit, spread=replace(fit.spread, residual=left, by_recording=moved), shorter=None)
    sure = replace(fit, spread=replace(fit.spread, by_recording=moved), shorter=None)
    wide, narrow = (identified_values(each, hidden.found().coverage) for each in (doubted, sure))
    scatter = np.sqrt(2.0 / 3.0 * 2e-6) / fit.drive.torque_constant[3]
    assert wide["damping"].half[3] == pytest.approx(4.30 * scatter, rel=0.1)  # Student's t of three recordings.
    assert narrow["damping"].half[3] < 0.7 * wide["damping"].half[3]
    for name in ("armature", "frictionloss", "offset"):
        assert wide[name].half[3] < 3.0 * narrow[name].half[3]
    np.testing.assert_array_equal(np.delete(wide["damping"].half, 3), np.delete(narrow["damping"].half, 3))


@pytest.mark.long
def test_friction_that_breaks_away_and_grows_with_the_load_is_recovered_and_is_what_auto_chooses() -> None:
    result = identify_hand(hidden.recordings(breaking=True), (), masses_known=True)
    drive, spread = result.fit.drive, result.fit.spread
    assert result.fit.bristly
    assert not result.fit.loose
    assert np.median(spread.residual) < 1.3
    assert spread.residual.max() < 4.0
    for name, true in hidden.SHAPE.items():
        assert np.median(np.abs(getattr(drive, name) - true)) < 0.1 * true, name
    for name, hid in (("torque_constant", hidden.CONSTANT), ("damping", hidden.DAMPING)):
        off = np.abs(getattr(drive, name) / hid - 1.0)
        assert np.median(off) < 0.02, name
        assert off.max() < 0.15, name
    value = result.values["torque_constant"]
    assert (np.abs(value.value - hidden.CONSTANT) <= value.half).mean() >= 0.8


@pytest.mark.slow
def test_a_hand_without_backlash_is_told_that_none_is_seen() -> None:
    result = hidden.found()
    assert not result.fit.loose
    assert "backlash" not in result.values
    assert "backlash: none seen" in str(table(result).caption)
    assert "backlash none seen" in report_page(result)


@pytest.fixture
def nothing_kept_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """As with recordings too short to keep a part back: only what is determined is written."""
    hidden.found()  # As it is for all other tests.
    monkeypatch.setattr("allegro_twin.twin.identify.results.written_drive.SHORTEST_TRIAL", 1e3)


@pytest.mark.slow
@pytest.mark.usefixtures("nothing_kept_back")
def test_backlash_whose_interval_holds_none_is_not_written(tmp_path: Path) -> None:
    result, file = hidden.found(), tmp_path / "mine.yaml"
    reason = ("",) * 8 + ("its interval is ± 3 mrad: record more",) * 8
    play = IdentifiedValue(np.full(16, 2e-3), np.tile([5e-4, 3e-3], 8), reason)
    loose = replace(result.fit, loose=True, drive=replace(result.fit.drive, backlash=play.value))
    hand_file.write_hand_file(file, loose, {**result.values, "backlash": play}, result.motions, "2026-01-02")
    written = yaml.safe_load(file.read_text())
    assert written["drive"]["backlash"] == [2e-3, 0.0] * 4 + [0.0] * 8
    assert (written["identified"]["backlash"], written["identified"]["value"]["backlash"][1]) == ("seen", 2e-3)
    other = tmp_path / "other.yaml"
    other.write_text("drive: {backlash: 0.004}\n")
    hand_file.write_hand_file(other, result.fit, result.values, result.motions, "2026-01-02")
    assert "backlash" not in yaml.safe_load(other.read_text())["drive"]


@pytest.mark.slow
def test_behind_backlash_only_a_joint_that_carries_weight_tells_its_offset() -> None:
    looked = motion_coverage(motions(), OpenLoopPlayer(motions()[0].spec, 0.003))
    said = identified_values(replace(hidden.found().fit, loose=True), looked)["offset"].reason
    light = looked.pull < 0.05
    assert 4 <= light.sum() <= 12
    assert all("behind backlash 50 tell: `calibrate limits --offsets`" in why for why in np.array(said)[light])
    assert not any("behind backlash" in why for why in np.array(said)[~light])


@pytest.mark.slow
def test_one_pose_tells_weight_from_friction_for_no_joint() -> None:
    for name in ("torque_constant", "offset"):
        assert all("all recordings are in one pose" in reason for reason in reasons(motions()[:1] * 2, name))
    assert not any("pose" in reason for reason in reasons(motions(), "torque_constant"))


@pytest.mark.slow
def test_an_axis_along_gravity_in_all_poses_is_named_with_the_pose_that_is_missing() -> None:
    tilted = [replace(motions()[0], gravity=np.array([0.0, 0.0, -9.81])) for _ in range(2)]
    leaning = replace(tilted[1], gravity=np.array([0.0, 0.0, 9.81]))  # Fingers up, and fingers down.
    said = reasons([tilted[0], leaning], "torque_constant")
    assert "record a pose in which its weight acts across its axis" in said[4]
    assert not said[5]


@pytest.mark.slow
def test_too_short_still_and_slow_joints_are_not_determined_because() -> None:
    short = [replace(m, position=m.position[:900], duty=m.duty[:900], good=m.good[:900]) for m in motions()]
    assert all("s of it can be used: record at least 10 s" in reason for reason in reasons(short, "damping"))
    still = []
    for motion in motions():
        position = motion.position.copy()
        position[:, 2] = position[0, 2]
        position[:, 9] = position[0, 9] + 0.2 * (position[:, 9] - position[0, 9])
        still.append(replace(motion, position=position))
    assert "it moved by 0.00 rad only" in reasons(still, "armature")[2]
    assert "rad/s one way, and damping shows from 0.5 rad/s" in reasons(still, "damping")[9]
    assert not reasons(still, "damping")[5]


@pytest.mark.slow
def test_what_is_determined_goes_into_the_hands_file_and_makes_the_twin(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("# Bought 2019.\nactuation:\n  damping: 0.08  # a guess\nlimits: null\n")
    result = hidden.found()
    hand_file.write_hand_file(file, result.fit, result.values, result.motions, "2026-01-02")
    assert file.read_text().startswith("# Bought 2019.\n")
    spec, wiring = load_spec(serial=str(file)), load_wiring(serial=str(file))
    assert spec.drive is not None
    np.testing.assert_allclose(spec.actuation.damping, hidden.DAMPING, rtol=0.05)
    known = result.values["offset"].identifiable
    assert known.sum() >= 10
    np.testing.assert_allclose(
        np.array(wiring.calibration.encoder_offset)[known] * COUNT, hidden.OFFSET[known], atol=0.01
    )
    assert not np.array(wiring.calibration.encoder_offset)[~known].any()
    basis = yaml.safe_load(file.read_text())["identified"]
    assert (basis["date"], len(basis["recordings"])) == ("2026-01-02", 3)
    assert basis["engine"].startswith("mujoco ")
    assert set(basis["interval"]) == {"torque_constant", "armature", "damping", "frictionloss", "offset", "delay"}
    assert basis["correlation"]["of"] == ["torque_constant", "armature", "damping", "frictionloss", "offset"]
    assert all(len(basis["correlation"][label]) == 10 for label in spec.joint_labels)
    assert load_posterior(str(file), spec.model, spec.side).correlated == (*CORE[:4], "encoder_offset")
    (gap,) = measure_gaps([hidden.recording(hidden.POSES[1])], str(file))
    assert gap.horizons == (0.1, 0.3, 1.0, 5.0)
    assert gap.before.all[3] > 0.05
    assert gap.after.all[3] < gap.before.all[3] / 20.0


@pytest.mark.slow
def test_draws_of_a_posterior_spread_as_the_fit_says_its_values_do_together() -> None:
    fit, names = hidden.found().fit, ("torque_constant", "armature", "damping", "frictionloss", "offset")
    told = value_correlations(fit, names)
    columns = np.array([[fit.columns(name).start + joint for name in names] for joint in range(16)])
    for joint in (0, 5, 15):
        own = fit.covariance[np.ix_(columns[joint], columns[joint])]
        drawn = np.random.default_rng(0).multivariate_normal(np.zeros(5), own, 20_000, method="eigh")
        k = fit.drive.torque_constant[joint]
        drawn[:, 1:4] /= k  # Per torque constant, to first order.
        for part, name in enumerate(names[1:4], start=1):
            drawn[:, part] -= getattr(fit.drive, name)[joint] / k**2 * drawn[:, 0]
        np.testing.assert_allclose(told[joint], np.corrcoef(drawn.T), atol=0.03)
    assert np.median(told[:, 2, 3]) < -0.5  # Who has more friction has less damping.


@pytest.mark.slow
def test_what_is_not_determined_is_not_written(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    result = hidden.found()
    one = identified_values(result.fit, motion_coverage(motions()[:1] * 2, OpenLoopPlayer(motions()[0].spec, 0.003)))
    hand_file.write_hand_file(file, result.fit, one, result.motions[:1], "2026-01-02")
    written = yaml.safe_load(file.read_text())
    assert written["wire"]["torque_constant"] == [1.0] * 16
    assert written["wire"]["encoder_offset"] == [0] * 16
    assert "one pose" in written["identified"]["not_determined"]["torque_constant"]["index_0"]


@pytest.mark.slow
def test_an_identification_that_breaks_off_leaves_the_file_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("actuation: {damping: 0.08}\n")

    def broken(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(hand_file, "set_note", broken)
    with pytest.raises(KeyboardInterrupt):
        hand_file.write_hand_file(file, hidden.found().fit, hidden.found().values, hidden.found().motions, "2026-01-02")
    assert file.read_text() == "actuation: {damping: 0.08}\n"


@pytest.mark.slow
def test_another_hands_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("wire: {version: v3}\n")
    with pytest.raises(ConfigError, match="is of a v3 hand, .* of a v4 one: choose another file"):
        hand_file.check_hand_file(file, yaml.safe_load(file.read_text()), hidden.found().motions)


def test_recordings_that_tell_nothing_of_motors_say_what_to_do(tmp_path: Path, recording_path: Path) -> None:
    with pytest.raises(ConfigError, match="does not say with which torque constant .* record it again"):
        read_motion(recording_path)
    first = load(hidden.recording(hidden.POSES[0]))
    for name, rows, torque, said in (
        ("short", 500, 0.1, r"is 1\.5 s long: record at least 3 s"),
        ("still", 1400, 0.0, "holds positions without torques"),
    ):
        path = tmp_path / f"{name}.arrow"
        columns = first.columns
        samples = (
            Sample(
                HandState(
                    float(columns["t"][k]), int(columns["tick"][k]), columns["position"][k], columns["velocity"][k],
                    np.full(16, torque), columns["temperature"][k], columns["gravity"][k],
                ),
                TorqueCommand(np.zeros(16)),
            )
            for k in range(rows)
        )  # fmt: skip
        for _ in record(samples, path, first.spec, 0.003, meta={"calibration": first.meta["calibration"]}):
            pass
        with pytest.raises(ConfigError, match=said):
            read_motion(path)
    with pytest.raises(RecordingError, match="no recording at"):
        read_motion(tmp_path / "none.arrow")


def test_what_a_log_has_before_the_first_torque_counts_for_nothing(tmp_path: Path) -> None:
    first, none = load(hidden.recording(hidden.POSES[0])), np.full(16, np.nan)
    path = tmp_path / "log.arrow"
    samples = (
        Sample(replace(sample.state, torque=none) if k < 3 else sample.state, sample.command)
        for k, sample in enumerate(recorded_samples(first))
    )
    for _ in record(samples, path, first.spec, first.period, meta=dict(first.meta)):
        pass
    whole, read = read_motion(hidden.recording(hidden.POSES[0])), read_motion(path)
    for name in ("position", "duty", "good"):
        np.testing.assert_array_equal(getattr(read, name), getattr(whole, name)[3:])


def test_a_file_of_another_engine_is_doubted(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("identified: {engine: mujoco 3.1.0}\n")
    assert "was identified under mujoco 3.1.0, and this is mujoco " in hand_file.mismatch_warning(file)
    file.write_text("actuation: {damping: 0.08}\n")
    assert not hand_file.mismatch_warning(file)


@pytest.mark.slow
def test_recordings_of_two_hands_are_not_one() -> None:
    other = replace(motions()[1], spec=load_spec(side="left"), name="b.arrow")
    from allegro_twin.twin.identify.motions.motion import check_same_hand

    with pytest.raises(ConfigError, match=r"b\.arrow is of the hand 'allegro_left', .* of 'allegro_right'"):
        check_same_hand([motions()[0], other])


@pytest.mark.slow
def test_a_gap_in_time_and_a_clipped_command_are_left_out(tmp_path: Path) -> None:
    first, path = load(hidden.recording(hidden.POSES[0])), tmp_path / "gap.arrow"
    columns = {name: np.array(values) for name, values in first.columns.items()}
    columns["torque"][1000, 0] = 0.3125  # What the driver sends at most.
    kept = [k for k in range(1400) if k not in range(500, 510)]
    samples = (
        Sample(
            HandState(float(columns["t"][k]), int(columns["tick"][k]), *(
                columns[name][k] for name in ("position", "velocity", "torque", "temperature", "gravity"))),
            TorqueCommand(np.zeros(16)),
        )
        for k in kept
    )  # fmt: skip
    for _ in record(samples, path, first.spec, 0.003, meta={"calibration": first.meta["calibration"]}):
        pass
    motion, whole = read_motion(path), motions()[0]
    np.testing.assert_array_equal(motion.position[510:], whole.position[510:1400])
    bad = np.flatnonzero(motion.good[:, 5] < whole.good[:1400, 5])
    np.testing.assert_array_equal(bad, np.arange(500, 516))  # And while what was commanded then may still act.
    assert motion.good[1000, 0] == 0.0
    assert motion.good[1000, 1] == 1.0


def test_recordings_of_one_name_are_told_apart_by_their_folders_and_none_is_given_twice() -> None:
    paths = [Path("a/side_1.arrow"), Path("b/side_1.arrow"), Path("b/up_1.arrow")]
    assert pipeline.distinct_names(paths) == ["a/side_1.arrow", "b/side_1.arrow", "up_1.arrow"]
    with pytest.raises(ConfigError, match=r"a/\.\./b/up_1\.arrow is given twice: name every recording once"):
        pipeline.distinct_names([*paths, Path("a/../b/up_1.arrow")])


def test_a_known_mass_hangs_in_the_recording_that_its_path_names_and_in_no_other() -> None:
    paths = [Path("a/side_1.arrow"), Path("b/side_1.arrow"), Path("b/up_1.arrow")]
    for text, number in (("b/side_1.arrow", 1), ("b/side_1", 1), ("a/../a/side_1.arrow", 0), ("up_1", 2)):
        assert pipeline._chosen(text, paths) == number
    with pytest.raises(ConfigError, match=r"may be a/side_1\.arrow and b/side_1\.arrow: give its path"):
        pipeline._chosen("side_1.arrow", paths)
    with pytest.raises(ConfigError, match=r"no recording named 'c/side_1\.arrow'; did you mean"):
        pipeline._chosen("c/side_1.arrow", paths)


def test_a_recording_of_which_hardly_a_piece_can_be_used_is_refused() -> None:
    motion = read_motion(hidden.recording(hidden.POSES[0]))
    pipeline.check_trusted([motion])
    gaps = motion.good * (np.arange(len(motion.good)) % 20 > 5)[:, None]
    with pytest.raises(ConfigError, match=r"late: 0 % of its rows can be used: too few reports .* quieter computer"):
        pipeline.check_trusted([motion, replace(motion, good=gaps, name="late")])
    with pytest.raises(ConfigError, match=r"low: 25 % of the fingers' rows .* at a limit of driver or joint"):
        pipeline.check_trusted([replace(motion, good=motion.good * (np.arange(16) < 4), name="low")])


def test_one_joint_is_one_and_what_a_joint_does_not_have_is_a_dash() -> None:
    source = ("nominal", *["all"] * 15)
    errors = dict.fromkeys(("nominal", "written", "determined", "all"), np.ones(16))
    written: Any = SimpleNamespace(errors=errors, seconds=1.0, is_nominal=False, source=source)
    assert describe_prediction(written).endswith("Of 1 joint nominal is best, and stays.")
    value = IdentifiedValue(np.array([0.0, 0.001]), np.array([0.0, 0.0005]), ("", ""))
    found: Any = SimpleNamespace(values={"bias_torque": value})
    assert [">–<" in report._cell(found, "bias_torque", joint) for joint in (0, 1)] == [True, False]
    assert [identification._cell(value, joint, 1e3) for joint in (0, 1)] == ["–", "1.00 ± 0.50"]


@pytest.mark.slow
def test_a_weight_is_told_with_its_recording() -> None:
    weight = weight_of("tip=0.050@rec/side_1.arrow")
    assert (weight.at, weight.mass, weight.recording) == ("tip", 0.05, "rec/side_1.arrow")
    for wrong in ("tip", "tip=0.05", "tip=x@r", "tip=5@r"):
        with pytest.raises(ConfigError, match="say where, kg below 1, and in which recording"):
            weight_of(wrong)
    with pytest.raises(ConfigError, match="recording"):
        identify_hand(hidden.recordings()[:1], [weight], masses_known=False)


@pytest.mark.slow
def test_offsets_by_weight_stand_beside_those_by_end_stops(tmp_path: Path) -> None:
    nominal, found = load_spec(), hidden.found()
    shift = np.linspace(-0.02, 0.02, 16)
    own = replace(nominal, lower=nominal.lower + shift, upper=nominal.upper + shift)
    stops = pipeline._stops(own, nominal)
    np.testing.assert_allclose(stops, shift, atol=1e-12)
    assert np.isnan(pipeline._stops(nominal, nominal)).all()
    with_stops = replace(found, end_stop_offsets=stops)
    off = found.values["offset"]
    first = int(np.flatnonzero(off.identifiable)[0])
    values = report_page(with_stops).split("<h2>Values</h2>")[1]
    row = values.split(f"<tr><td>{nominal.aliases[first]}</td>")[1].split("</tr>")[0]
    assert f"{1e3 * (off.value[first] - shift[first]):+.1f}</td>" in row
    apart = np.abs(off.value - shift)[off.identifiable]
    said = next(line for line in lines(with_stops) if "end stops" in line)
    assert f"{1e3 * np.median(apart):.1f} mrad apart in the median, {1e3 * apart.max():.1f} at most" in said
    assert "end stops" not in report_page(replace(found, end_stop_offsets=np.full(16, np.nan)))


@pytest.mark.slow
def test_offsets_that_the_file_has_from_calibrate_stay_and_that_is_said(tmp_path: Path) -> None:
    file, result = tmp_path / "mine.yaml", hidden.found()
    offsets = [40 - 5 * joint for joint in range(16)]
    file.write_text(yaml.safe_dump({"wire": {"encoder_offset": offsets}, "mine": {"kept": 1}}))
    said = hand_file.write_hand_file(file, result.fit, result.values, result.motions, "2026-01-02")
    written = yaml.safe_load(file.read_text())
    assert written["wire"]["encoder_offset"] == offsets
    assert written["mine"] == {"kept": 1}
    assert "stay as they were" in said
    assert written["identified"]["encoder_offset"] == "as the file had them"
    file.unlink()
    assert not hand_file.write_hand_file(file, result.fit, result.values, result.motions, "2026-01-02")


@pytest.mark.slow
def test_offsets_from_calibrate_stay_also_when_the_hand_was_recorded_with_them(tmp_path: Path) -> None:
    """Weight tells them worse than the ends of the joints do: hands of the rehearsal were 5 to 17 mrad off by it."""
    file, result = tmp_path / "mine.yaml", hidden.found()
    offsets = [40 - 5 * joint for joint in range(16)]
    motions = [replace(m, calibration=replace(m.calibration, encoder_offset=tuple(offsets))) for m in result.motions]
    file.write_text(yaml.safe_dump({"wire": {"encoder_offset": offsets}}))
    for _ in range(2):  # The second time the file is an identified one.
        said = hand_file.write_hand_file(file, result.fit, result.values, motions, "2026-01-02")
        assert yaml.safe_load(file.read_text())["wire"]["encoder_offset"] == offsets
        assert "stay as they were. By weight they are up to" in said
    file.unlink()
    hand_file.write_hand_file(file, result.fit, result.values, motions, "2026-01-02")
    by_weight = yaml.safe_load(file.read_text())
    assert by_weight["identified"]["encoder_offset"] == "by weight"
    again = [
        replace(m, calibration=replace(m.calibration, encoder_offset=tuple(by_weight["wire"]["encoder_offset"])))
        for m in result.motions
    ]
    hand_file.write_hand_file(file, result.fit, result.values, again, "2026-01-02")
    assert yaml.safe_load(file.read_text())["wire"]["encoder_offset"] != by_weight["wire"]["encoder_offset"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["allegro", "SAH030C033R"])
def test_a_file_that_ships_is_refused_and_a_copy_is_not(name: str, tmp_path: Path) -> None:
    path = data_root() / "conf" / "hands" / f"{name}.yaml"
    before = path.read_bytes()
    with pytest.raises(ConfigError, match=rf"what ships .* is not changed; .*copy it, `cp .* my_{name}\.yaml`"):
        hand_file.check_hand_file(path, {}, hidden.found().motions)
    with pytest.raises(ConfigError, match="what ships .* is not changed"):
        refuse_another_hand(path, hidden.config(), "can_v4", None)
    with pytest.raises(ConfigError, match="is not changed; choose a file of your own; name one elsewhere"):
        hand_file.check_hand_file(path.with_name("mine.yaml"), {}, hidden.found().motions)
    assert path.read_bytes() == before


@pytest.mark.slow
def test_a_strength_that_a_file_has_goes_into_the_torque_constant_and_out_of_the_file(tmp_path: Path) -> None:
    result = hidden.found()
    plain, weak = tmp_path / "plain.yaml", tmp_path / "weak.yaml"
    weak.write_text("drive: {strength: 0.5}\n")
    for path in (plain, weak):
        said = hand_file.write_hand_file(path, result.fit, result.values, result.motions, "2026-01-02")
    assert "drive.strength is out of" in said
    one, other = (yaml.safe_load(path.read_text()) for path in (plain, weak))
    assert "strength" not in other["drive"]
    factor = np.array(other["wire"]["torque_constant"]) / one["wire"]["torque_constant"]
    determined = result.values["torque_constant"].identifiable
    np.testing.assert_allclose(factor[determined], 1.0, rtol=0.2)
    np.testing.assert_allclose(factor[~determined], 0.5, rtol=1e-4)


def test_a_short_gap_is_bridged_and_a_long_one_leaves_out_what_its_commands_move() -> None:
    tick = np.delete(np.arange(100.0, 140.0), [5, 6, 20, 21, 22])
    present, missing = _fill_gaps(tick)
    line = present((3.0 * tick)[:, None])[:, 0]
    known = np.ones(40, bool)
    known[20:23] = False
    np.testing.assert_allclose(line[known], 3.0 * np.arange(100, 140)[known])
    assert line[20:23].tolist() == [3.0 * 119] * 3, "the row before"
    assert np.flatnonzero(missing).tolist() == [5, 6, *range(20, 23 + BEFORE)]


@pytest.mark.slow
@pytest.mark.parametrize("text", ["", "# Mine.\n"])
def test_a_hands_file_without_any_key_is_filled(text: str, tmp_path: Path) -> None:
    file, result = tmp_path / "mine.yaml", hidden.found()
    file.write_text(text)
    hand_file.check_hand_file(file, {}, result.motions)
    hand_file.write_hand_file(file, result.fit, result.values, result.motions, "2026-01-02")
    assert file.read_text().startswith(text)
    assert "torque_constant" in yaml.safe_load(file.read_text())["wire"]


@pytest.mark.slow
def test_backlash_that_the_model_does_not_explain_is_not_determined_nor_is_the_delay_beside_it() -> None:
    """Play with other laws than the model's was said to be 1.6 ± 0.6 mrad, and was 4."""
    result = hidden.found()
    looked = motion_coverage(motions(), OpenLoopPlayer(motions()[0].spec, 0.003))
    left = np.where(np.arange(16) < 10, 8.0, 1.0)
    play = replace(result.fit.drive, backlash=np.full(16, 1.6e-3))
    loose = replace(result.fit, loose=True, drive=play, spread=replace(result.fit.spread, residual=left))
    found = identified_values(loose, looked)
    why = "the model leaves 8 times the noise, and no interval covers what else looks like backlash"
    assert found["backlash"].reason[:10] == (why,) * 10
    assert why not in found["backlash"].reason[10:]
    assert found["delay"].reason == (why,)
    assert identified_values(replace(loose, loose=False), looked)["delay"].reason == result.values["delay"].reason
    said = replace(result, fit=loose, values={**found, "backlash": found["backlash"]._replace(reason=(why,) * 16)})
    assert str(table(said).caption).startswith("delay not determined; ")
    assert str(table(said).caption).endswith("backlash: seen, not determined")
    assert next(head_lines(said)).startswith("Backlash behind the motors; how much is not determined.")
    assert "Delay not determined." in report_page(said)
