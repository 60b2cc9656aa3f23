"""What a hand has beyond friction is found by the shape of the torque that is left over, and by nothing else."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.orientation import rotate_vector
from allegro_twin.sim.open_loop import OpenLoopPlayer
from allegro_twin.surfaces.cli.twin.identification import head_lines
from allegro_twin.twin.identify.fitting.extra_terms import EXTRA, ExtraTerms, _agree, screen_terms
from allegro_twin.twin.identify.fitting.regress import regress
from allegro_twin.twin.identify.motions.excitation import G
from allegro_twin.twin.identify.motions.motion import read_motion
from allegro_twin.twin.identify.pipeline import identify_hand, measure_gaps
from allegro_twin.twin.identify.record_excitation import pose_config, record_run, remaining_run
from allegro_twin.twin.identify.report import report_page
from allegro_twin.twin.identify.results.hand_file import write_hand_file
from tests.twin.identify import hidden

BIAS = np.tile([0.012, -0.01, 0.008, -0.006], 4)
HANDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "cable": {"bias_torque": BIAS.tolist()},
    "direction": {"uneven_damping": np.tile([0.015, -0.02, 0.015, -0.02], 4).tolist()},
    "cogging": {"cogging_sine": 0.005, "cogging_cosine": -0.003, "cogging_periods": 8.0},
    "warmth": {"cold_friction": 0.5, "warm_up": 3.0},
    "lean": {"tilt": [0.04, -0.03, 0.02]},
}
TERMS = {
    "plain": set(), "lean": set(), "cable": {"bias_torque"}, "direction": {"uneven_damping"},
    "cogging": {"cogging_cosine", "cogging_sine"}, "warmth": {"cold_friction"},
}  # fmt: skip


@cache
def recorded(kind: str, pose: str, seconds: float = 8.0) -> Path:
    """A hidden hand of a kind in a pose."""
    own = hidden.config(drive=HANDS[kind])
    task = remaining_run(own, pose, seconds, 3, Path(mkdtemp()))
    assert task is not None
    record_run(pose_config(own, task.pose), task, lambda t: None)
    return task.file


def screened(kind: str) -> ExtraTerms:
    motions = [read_motion(recorded(kind, pose)) for pose in hidden.POSES]
    player = OpenLoopPlayer(motions[0].spec, motions[0].period)
    return screen_terms(motions, player, regress(motions, player, np.ones(16)))


def test_motors_of_a_hand_are_alike_so_the_number_of_periods_that_suits_all_counts_more() -> None:
    own = [{"cogging:8": 60.0, "cogging:9": 40.0}, {"cogging:8": 50.0, "cogging:9": 55.0, "bias": 3.0}]
    joints: Any = [SimpleNamespace(gains=dict(gains), usual=set[str](), taken=[]) for gains in own]
    for _ in range(2):  # Again and again it stays the same.
        _agree(joints)
        assert [max(each.gains, key=each.gains.get) for each in joints] == ["cogging:8", "cogging:8"]
        assert joints[1].gains == {"cogging:8": 60.0, "cogging:9": 55.0, "bias": 3.0}


@pytest.mark.slow
def test_a_joint_that_never_moves_has_no_term_and_hides_none_of_the_others() -> None:
    motions = []
    for pose in hidden.POSES:
        motion = read_motion(recorded("lean", pose))
        position, good = motion.position.copy(), motion.good.copy()
        position[:, 3], good[:, 9] = position[0, 3], 0.0
        motions.append(replace(motion, position=position, good=good))
    player = OpenLoopPlayer(motions[0].spec, motions[0].period)
    found = screen_terms(motions, player, regress(motions, player, np.ones(16)))
    assert found.tilted
    assert not any(found.of_joints(name, 16)[[3, 9]].any() for name in EXTRA)


@pytest.mark.slow
@pytest.mark.parametrize("kind", HANDS)
def test_a_term_is_named_by_the_shape_of_what_is_left_over_and_no_other_is(kind: str) -> None:
    found = screened(kind)
    most = {name for name in EXTRA if found.of_joints(name, 16).sum() >= 8}
    assert most == TERMS[kind]
    few = {name for name in set(EXTRA) - most if found.of_joints(name, 16).sum() > 2}
    assert not few
    assert found.tilted == (kind == "lean")
    if kind == "lean":
        for pose, lean in zip(hidden.POSES, found.tilt, strict=True):
            down = read_motion(recorded(kind, pose)).gravity / G
            np.testing.assert_allclose(rotate_vector(down, lean), rotate_vector(down, HANDS[kind]["tilt"]), atol=0.025)
    if kind == "cogging":
        assert set(found.values["cogging_periods"][found.of_joints("cogging_sine", 16)]) == {8.0}  # Motors are alike.


@pytest.mark.long
@pytest.mark.parametrize("kind", ["cable", "cogging", "lean", "warmth"])
def test_what_is_found_is_written_and_predicts_a_motion_in_a_pose_that_nothing_has_seen(
    kind: str, tmp_path: Path
) -> None:
    found = identify_hand([recorded(kind, pose) for pose in hidden.POSES], (), masses_known=True)
    file = tmp_path / "mine.yaml"
    write_hand_file(file, found.fit, found.values, found.motions, "2026-01-02")
    (gap,) = measure_gaps([recorded(kind, "palm-down")], str(file))
    assert gap.after.all[-1] < 5e-3
    assert gap.after.all[-1] < gap.before.all[-1] / 20.0
    drive = load_spec(serial=str(file)).drive
    assert drive is not None
    assert {name for name in EXTRA if np.median(np.abs(getattr(drive, name))) > 1e-4} == TERMS[kind]
    assert drive.tilt.any() == (kind == "lean")
    kept = yaml.safe_load(file.read_text())["identified"]["kept_back"]["rms_rad"]
    assert np.median(kept["written"]) < 0.1 * np.median(kept["nominal"])
    first = {"cable": "Constant torque", "cogging": "Cogging", "lean": "The palm leans", "warmth": "Friction that is"}
    said = list(head_lines(found))
    assert said[0].startswith(first[kind])
    assert said[1].startswith("Kept back")  # And of nothing else.
    assert ("the same way in all recordings" in said[0]) == (kind == "lean")
    assert "What the fit has not seen" in report_page(found)
