"""What goes into a hand's file is what predicts best the part of the motions that the fit has not seen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from allegro_twin.kinematics.orientation import rotate_vector
from allegro_twin.sim.open_loop import DriveParameters
from allegro_twin.surfaces.cli.twin.identification import GUESSED, gap_table, head_lines, lines, table
from allegro_twin.twin.identify import report
from allegro_twin.twin.identify.fitting.fit import DriveFit
from allegro_twin.twin.identify.fitting.regress import smooth_motion
from allegro_twin.twin.identify.fitting.shooting import LONG, SEEN, UNSEEN, cut_segments
from allegro_twin.twin.identify.pipeline import Identification
from allegro_twin.twin.identify.results import written_drive
from allegro_twin.twin.identify.results.gap import measure_gap
from allegro_twin.twin.identify.results.hand_file import NOTHING_WRITTEN, drive_to_write, write_hand_file
from allegro_twin.twin.identify.results.uncertainty import VALUES, IdentifiedValue
from tests.twin.identify import hidden

JOINT = 6
pytestmark = pytest.mark.slow  # They begin with a whole identification.


def with_drive(drive: DriveParameters) -> DriveFit:
    return replace(hidden.found().fit, drive=drive)


def wrecked(joints: slice) -> DriveParameters:
    """The drive that was found, but for joints whose friction is ten times too large."""
    friction = hidden.found().fit.drive.frictionloss.copy()
    friction[joints] = 10.0 * friction[joints] + 0.1
    return replace(hidden.found().fit.drive, frictionloss=friction)


def test_what_is_kept_back_is_the_end_of_every_motion_and_no_fit_sees_it() -> None:
    motions = list(hidden.found().motions)
    seen, unseen = (cut_segments(motions, motions[0].spec, LONG, LONG, part) for part in (SEEN, UNSEEN))
    assert hidden.found().fit.segments == len(seen.position)
    last = 0.8 * len(motions[0].position) * motions[0].period
    assert seen.segments.time.max() + LONG * motions[0].period <= last + 1e-6
    assert unseen.segments.time.min() >= last - 0.004
    assert len(unseen.position) >= 3


def test_a_piece_brings_the_speeds_that_came_before_it() -> None:
    motion = hidden.found().motions[0]
    cuts, smooth = cut_segments([motion], motion.spec, LONG, LONG, SEEN), smooth_motion(motion)
    for number in (0, 3):
        first = round(float(cuts.segments.time[number]) / motion.period)
        came = cuts.segments.past[number]
        np.testing.assert_array_equal(came[-1], smooth.velocity[first - 1])
        np.testing.assert_array_equal(came[-5], smooth.velocity[first - 5])
    assert not cuts.segments.past[0, 0].any()  # Nothing is known from before the recording.


def test_a_drive_that_was_found_out_is_written_for_every_joint_and_proves_itself() -> None:
    written = hidden.found().written
    assert "nominal" not in written.source
    assert np.median(written.errors["written"]) < 0.1 * np.median(written.errors["nominal"])
    best = min(float(np.square(written.errors[name]).sum()) for name in ("nominal", "determined", "all"))
    assert float(np.square(written.errors["written"]).sum()) <= best / 0.95**2


def test_a_joint_that_nominal_predicts_better_stays_nominal_and_the_others_do_not() -> None:
    found = hidden.found()
    made = drive_to_write(
        Path("new.yaml"), {}, with_drive(wrecked(slice(JOINT, JOINT + 1))), found.values, found.motions
    )
    assert made.source[JOINT] == "nominal"
    assert made.source.count("nominal") <= 4  # Its finger, at most.
    assert made.drive.frictionloss[JOINT] < 0.1
    assert made.errors["written"][JOINT] < made.errors["all"][JOINT]


def test_where_nominal_is_best_nothing_is_written_and_that_is_said(tmp_path: Path) -> None:
    found, file = hidden.found(), tmp_path / "mine.yaml"
    file.write_text("actuation: {damping: 0.08}\n")
    fit = with_drive(wrecked(slice(0, 16)))
    assert write_hand_file(file, fit, found.values, found.motions, "2026-01-02") == NOTHING_WRITTEN
    assert file.read_text() == "actuation: {damping: 0.08}\n"
    made = drive_to_write(file, {}, fit, found.values, found.motions)
    told: Identification = replace(found, fit=fit, written=made)
    assert any("Nominal is best: nothing is to be written" in line for line in head_lines(told))


def test_a_wide_interval_does_not_keep_a_value_that_predicts_out_of_the_file_but_a_motion_that_does_not_show_it_does(
    tmp_path: Path,
) -> None:
    found, file = hidden.found(), tmp_path / "mine.yaml"
    friction = found.values["frictionloss"]
    wide = IdentifiedValue(friction.value, friction.half, ("its interval is wide",) * 16, (True,) * 16)
    blind = IdentifiedValue(friction.value, friction.half, ("it never crept",) * 16, (False,) * 16)
    for value, close in ((wide, True), (blind, False)):
        made = drive_to_write(file, {}, found.fit, {**found.values, "frictionloss": value}, found.motions)
        assert (np.abs(made.drive.frictionloss - hidden.FRICTION) < 1e-3).all() == close
    write_hand_file(file, found.fit, {**found.values, "frictionloss": wide}, found.motions, "2026-01-02")
    kept = yaml.safe_load(file.read_text())["identified"]
    assert kept["written"]["index_1"] == "all"
    assert len(kept["kept_back"]["rms_rad"]["written"]) == 16


def test_a_recording_that_is_wrong_about_gravity_is_found_to_lean_and_one_that_is_right_is_not() -> None:
    found, motion = hidden.found(), hidden.found().motions[1]
    twin = (found.fit.player(motion), found.fit.drive)
    honest = measure_gap(motion, twin, twin)
    assert not honest.lean.any()
    np.testing.assert_array_equal(honest.upright.joint, honest.after.joint)
    lied = replace(motion, gravity=rotate_vector(motion.gravity, [0.02, -0.03, 0.025]))
    gap = measure_gap(lied, twin, twin)
    np.testing.assert_allclose(rotate_vector(lied.gravity, gap.lean), motion.gravity, atol=0.03)
    assert gap.upright.all[-1] < 0.5 * gap.after.all[-1]
    assert "In this recording the palm leans by" in str(gap_table(gap).caption)
    assert gap_table(honest).caption is None


@pytest.mark.parametrize("large", [True, False])
def test_a_large_encoder_offset_that_is_not_determined_stays_out_of_the_file_however_well_it_predicts(
    *, large: bool
) -> None:
    """A hidden hand of the rehearsal had offsets of up to 0.3 rad written, whose intervals were wider than that."""
    found = hidden.found()
    offset = found.values["offset"]
    doubtful = tuple("its interval is ± 328 mrad: record more" if k == JOINT else "" for k in range(16))
    value = np.where(large & (np.arange(16) == JOINT), 0.3, offset.value)
    values = {**found.values, "offset": IdentifiedValue(value, offset.half, doubtful, (True,) * 16)}
    made = drive_to_write(Path("new.yaml"), {}, found.fit, values, found.motions)
    others = np.arange(16) // 4 != JOINT // 4  # Of its finger the others follow it.
    assert made.drive.offset[JOINT] == (0.0 if large else found.fit.drive.offset[JOINT])
    np.testing.assert_allclose(made.drive.offset[others], hidden.OFFSET[others], atol=4e-3)


def test_what_cannot_be_trusted_decides_nothing() -> None:
    """A finger that is pushed away, in one recording, from where its commands would move it: its rows say so."""
    found, motions = hidden.found().fit, list(hidden.found().motions)
    alone = written_drive._Trial(found, motions).errors(found.drive)
    position, good = motions[0].position.copy(), motions[0].good.copy()
    position[len(position) // 2 :, :4] += 0.3
    good[len(position) // 2 :, :4] = 0.0
    pushed = [replace(motions[0], position=position, good=good), *motions[1:]]
    assert (written_drive._Trial(found, pushed).errors(found.drive)[:4] < 2.0 * alone[:4] + 1e-3).all()
    trusted = [replace(pushed[0], good=np.ones_like(good)), *motions[1:]]
    assert (written_drive._Trial(found, trusted).errors(found.drive)[:4] > 0.005).all()


@pytest.mark.parametrize("large", [True, False])
def test_what_is_written_though_it_is_not_determined_stands_in_brackets(*, large: bool) -> None:
    found = hidden.found()
    offset = found.values["offset"]
    doubtful = tuple("its interval is ± 40 mrad: record more" if k == JOINT else "" for k in range(16))
    value = np.where(large & (np.arange(16) == JOINT), 0.3, offset.value)
    values = {**found.values, "offset": IdentifiedValue(value, offset.half, doubtful, (True,) * 16)}
    made = drive_to_write(Path("new.yaml"), {}, found.fit, values, found.motions)
    told: Identification = replace(found, values=values, written=made)
    assert made.guessed("offset", JOINT) == (not large)
    assert not any(made.guessed(name, joint) for name in VALUES for joint in range(16) if joint != JOINT)
    cells = list(table(told).columns[5].cells)
    assert str(cells[JOINT]).startswith("–" if large else "(")
    assert (GUESSED in lines(told)) == (not large)
    assert "± 40 mrad" in report._cell(told, "offset", JOINT)
    assert (">–<" in report._cell(told, "offset", JOINT)) == large
