"""The verdict can be had again from a recording, and is the one that was given."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.app import assemble, scenario_config
from allegro_twin.app.session import Outputs, perform
from allegro_twin.grasping.evaluation.rejudge import (
    limits_left,
    phase_results,
    rejudge,
    report_markdown,
    stalled_joints,
)
from allegro_twin.grasping.verdict import faulted
from allegro_twin.recording.reader import load


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> tuple[object, Path]:
    path = tmp_path_factory.mktemp("again") / "lemon.arrow"
    config = scenario_config("lemon", "right")
    return perform(assemble(config), config, Outputs(record=path)).report, path


@pytest.mark.slow
def test_a_recorded_trial_has_the_same_verdict_again(trial: tuple[object, Path]) -> None:
    report, path = trial
    recording = load(path)
    again = rejudge(recording.spec, recording.columns, recording.meta)
    assert again == report
    assert again is not None
    assert phase_results(again) == {"hold": True, "turn": True, "shake": True}
    assert report_markdown(again, recording.spec.thermal).startswith("**held**\n")


@pytest.mark.slow
def test_a_trial_that_was_cut_short_or_none_at_all_has_no_verdict(trial: tuple[object, Path]) -> None:
    recording = load(trial[1])
    short = {name: column[:-1] for name, column in recording.columns.items()}
    assert rejudge(recording.spec, short, recording.meta) is None
    assert rejudge(recording.spec, recording.columns, {}) is None


@pytest.mark.slow
def test_the_contact_vectors_of_a_held_object_carry_its_weight(trial: tuple[object, Path]) -> None:
    recording = load(trial[1])
    begin, end = next((b, e) for name, b, e in recording.meta["phases"] if name == "hold")
    rows = (recording.columns["t"] > (begin + end) / 2) & (recording.columns["t"] < end)
    total = recording.columns["contact_vector"][rows].reshape(rows.sum(), -1, 3).sum(axis=1).mean(axis=0)
    np.testing.assert_allclose(total, [0.0, 0.0, 0.029 * 9.81], atol=0.02)
    points = recording.columns["contact_point"][rows].reshape(rows.sum(), -1, 3)
    away = np.linalg.norm(points - recording.columns["object"][rows][:, None, :3], axis=2)
    assert np.nanmax(away) < 0.036  # Half the lemon's length, and a little.
    assert (np.isnan(away) == (recording.columns["contact_force"][rows] == 0)).all()


def test_a_part_of_the_limits_is_only_told_where_some_is_left() -> None:
    assert limits_left(0.784) == ", 78 % of the drift limits left"
    assert limits_left(-32.17) == limits_left(float("nan")) == ""


def test_every_joint_at_its_torque_limit_is_named_with_its_share_of_the_time() -> None:
    report = replace(faulted(""), at_limit={"thumb 1": 0.397, "ring 2": 0.004, "index 3": 0.0})
    assert stalled_joints(report) == "at the torque limit, of the time: thumb 1 40 %"
    assert stalled_joints(faulted("")) == "no joint at its torque limit"
