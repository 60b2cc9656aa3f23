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
from allegro_twin.twin.identify.fitting.extra_terms import EXTRA, PERIODS, ExtraTerms, _agree, _Joint, screen_terms
from allegro_twin.twin.identify.fitting.regress import regress
from allegro_twin.twin.identify.motions.excitation import G
from allegro_twin.twin.identify.motions.motion import read_motion
from allegro_twin.twin.identify.pipeline import identify_hand, measure_gaps
from allegro_twin.twin.identify.record_excitation import pose_config, record_run, remaining_run
from allegro_twin.twin.identify.report import report_page
from allegro_twin.twin.identify.results.findings import describe_rest, describe_terms
from allegro_twin.twin.identify.results.hand_file import write_hand_file
from allegro_twin.twin.identify.results.uncertainty import BY_MODEL, IdentifiedValue, _misfit, _wide
from tests.twin.identify import hidden

BIAS = np.tile([0.012, -0.01, 0.008, -0.006], 4)
HANDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "cable": {"bias_torque": BIAS.tolist()},
    "direction": {"uneven_damping": np.tile([0.015, -0.02, 0.015, -0.02], 4).tolist()},
    "cogging": {"cogging_sine": 0.005, "cogging_cosine": -0.003, "cogging_periods": 8.0},
    "warmth": {"cold_friction": 0.5, "warm_up": 3.0},
    "ripple": {"ripple_sine": 0.08, "ripple_cosine": -0.05, "ripple_periods": 9.0},
    "spring": {"stiffness": np.tile([0.015, 0.01, 0.02, 0.006], 4).tolist(), "bias_torque": BIAS.tolist()},
    "lean": {"tilt": [0.04, -0.03, 0.02]},
}
TERMS = {
    "plain": set(), "lean": set(), "cable": {"bias_torque"}, "direction": {"uneven_damping"},
    "cogging": {"cogging_cosine", "cogging_sine"}, "warmth": {"cold_friction"},
    "spring": {"stiffness", "bias_torque"}, "ripple": {"ripple_cosine", "ripple_sine"},
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


def left_over(torque: Any) -> _Joint:
    """A joint of which a torque by its angle is left over, with the cogging taken that suits it best."""
    rng = np.random.default_rng(3)
    q = 0.8 * np.sin(np.linspace(0.0, 60.0, 3000)) + 0.1
    columns = {f"cogging:{count:g}": np.stack([np.cos(count * q), np.sin(count * q)], axis=1) for count in PERIODS}
    columns["angle"] = np.stack([q**power for power in range(4)], axis=1)
    u = torque(q) + 1e-3 * rng.standard_normal(len(q))
    joint = _Joint(u, rng.standard_normal((len(q), 7)), columns, np.zeros((len(q), 3)))
    joint.weigh()
    joint.take(joint.best()["cogging"][0])
    return joint


def with_line(torque: Any) -> _Joint:
    """A joint of which a torque by its angle is left over, with constant torque and spring taken, then cogging."""
    rng = np.random.default_rng(4)
    q = 0.8 * np.sin(np.linspace(0.0, 60.0, 3000)) + 0.1
    columns = {f"cogging:{count:g}": np.stack([np.cos(count * q), np.sin(count * q)], axis=1) for count in PERIODS}
    columns |= {"bias": np.ones((len(q), 1)), "spring": -q[:, None], "angle": np.stack([q**0, q], axis=1)}
    columns["bias:spring"] = np.concatenate([columns["bias"], columns["spring"]], axis=1)
    u = torque(q) + 1e-3 * rng.standard_normal(len(q))
    joint = _Joint(u, rng.standard_normal((len(q), 7)), columns, np.zeros((len(q), 3)))
    joint.take("bias:spring")
    assert "spring" not in joint.gains
    joint.take("cogging:8")
    joint.settle()
    return joint


def test_a_spring_goes_again_where_the_cogging_that_comes_later_explains_as_much() -> None:
    wave = with_line(lambda q: 0.01 + 0.006 * np.cos(8.0 * q))
    assert wave.taken == ["bias", "cogging:8"]
    np.testing.assert_allclose(wave.value("bias"), 0.01, rtol=0.02)
    both = with_line(lambda q: 0.01 - 0.004 * q + 0.006 * np.cos(8.0 * q))
    assert both.taken == ["bias:spring", "cogging:8"]
    np.testing.assert_allclose(both.value("bias:spring"), [0.01, 0.004], rtol=0.05)


def test_a_ripple_comes_again_as_often_as_suits_all_joints_unless_a_joint_knows_better() -> None:
    own = [
        {"ripple:9": 60.0, "ripple:10": 66.0, "ripple:30": 0.0},
        {"ripple:9": 55.0, "ripple:10": 40.0, "ripple:30": 1.0},
        {"ripple:9": 10.0, "ripple:10": 9.0, "ripple:30": 90.0},
    ]
    joints: Any = [SimpleNamespace(gains=dict(gains), usual=set[str](), taken=[]) for gains in own]
    _agree(joints)
    assert [max(each.gains, key=each.gains.get) for each in joints] == ["ripple:9", "ripple:9", "ripple:30"]


def test_torque_that_bends_with_the_angle_is_no_cogging_and_what_comes_again_is_or_stays() -> None:
    bends = left_over(lambda q: 0.01 * q + 0.005 * q**3)
    assert bends.taken == ["cogging:7"]  # What a ramp looks like.
    assert bends.is_smooth()
    assert not left_over(lambda q: 0.01 * np.cos(8.0 * q + 0.4)).is_smooth()
    assert not left_over(lambda q: np.full_like(q, 0.01)).is_smooth()


SPEC = load_spec()
UPRIGHT = SimpleNamespace(drive=SimpleNamespace(tilt=np.zeros((0, 3))))


def described(
    values: dict[str, tuple[float, float, str]], smooth: Any = None, *, bristly: bool = False, far: bool = False,
    tilt: Any = None, told: Any = None,
    written: Any = UPRIGHT, **fixed: float,
) -> list[str]:  # fmt: skip
    """What is said of values, each with half its interval and why it is not determined; recordings of 16 s."""
    told = {name: IdentifiedValue(np.full(16, v), np.full(16, half), (why,) * 16)
            for name, (v, half, why) in values.items()} | (told or {})  # fmt: skip
    rows = dict.fromkeys((*EXTRA, "cogging_periods", "ripple_periods", "warm_up"), 0.0) | {
        name: v for name, (v, *_) in values.items()
    }
    drive = SimpleNamespace(**{name: np.full(16, v) for name, v in (rows | fixed).items()}, tilt=tilt)
    extras = SimpleNamespace(tilted=tilt is not None, smooth=smooth)
    fit: Any = SimpleNamespace(drive=drive, extras=extras, bristly=bristly, far=far, loose=False, elastic=False)
    motion: Any = SimpleNamespace(spec=SPEC, seconds=16.0, gravity=np.array([0.0, 0.0, -9.81]))
    return list(describe_terms(fit, told, [motion, motion], written))


def test_cogging_is_named_only_by_periods_inside_those_tried_and_where_no_bend_explains_more() -> None:
    waves = {"cogging_sine": (0.005, 1e-4, "")}
    (said,) = described(waves, np.zeros(16, dtype=bool), cogging_periods=8.0)
    assert said.startswith("Cogging, 5.0 mN·m in the median of 16 joints")
    assert described(waves, cogging_periods=5.0) == described(waves, cogging_periods=120.0) == []
    (said,) = described(waves, np.ones(16, dtype=bool), cogging_periods=7.0)
    assert said.startswith("Torque that bends with the angle, in 16 joints")
    some, rest = described(waves, np.arange(16) < 12, cogging_periods=7.0)
    assert "in 12 joints" in some
    assert "median of 4 joints" in rest
    assert len(described(waves, np.arange(16) < 1, cogging_periods=7.0)) == 1  # One is not worth a sentence.


def test_friction_that_gives_far_is_named_by_how_far_and_not_as_one_that_breaks_away() -> None:
    (said,) = described({"stiction": (1.4, 0.05, "")}, bristly=True, far=True, bristle=0.015)
    assert said.startswith("Friction gives before it slides, by 15.0 mrad in the median of 16 joints")


def test_ripple_is_named_by_its_share_and_periods() -> None:
    (said,) = described({"ripple_sine": (0.08, 0.01, ""), "ripple_cosine": (0.06, 0.01, "")}, ripple_periods=9.0)
    assert said.startswith("Torque ripple, 10.0 % in the median of 16 joints")
    assert ", 9 times a turn" in said
    assert described({"ripple_sine": (0.08, 0.01, "")}, ripple_periods=5.0) == []


def test_a_spring_resists_and_is_named_where_it_is_sure() -> None:
    (said,) = described({"stiffness": (0.012, 0.001, "")})
    assert said.startswith("Torque that grows with the angle, 12.0 mN·m/rad in the median of 16 joints")
    assert described({"stiffness": (-0.012, 0.001, "")}) == []  # What pushes on is none.
    assert described({"stiffness": (0.012, 0.007, "")}) == []
    assert described({"stiffness": (0.012, 0.001, "wide")}) == []
    one = IdentifiedValue(np.where(np.arange(16) == 5, 0.012, 0.0), np.full(16, 1e-4), ("",) * 16)
    assert described({}, told={"stiffness": one}, stiffness=0.012) == []  # What something else may look like.


@pytest.mark.parametrize(
    ("half", "why", "falls", "named"),
    [(0.1, "", 8.0, True), (0.4, "", 8.0, False), (0.1, "its interval is wide", 8.0, False),
     (0.1, "", 48.0, False), (0.1, "", 22.0, False), (0.1, "", 2.0, False)],
)  # fmt: skip
def test_warmth_is_named_where_it_is_sure_and_falls_within_the_recordings(
    half: float, why: str, falls: float, named: bool
) -> None:
    said = described({"cold_friction": (0.577, half, why)}, warm_up=falls)
    assert [line.endswith("falls in 8 s: warmth.") for line in said] == [True] * named


def test_of_friction_that_breaks_away_only_what_is_determined_is_said() -> None:
    sure, open_ = (1.4, 0.05, ""), (1.4, 1.3, "its interval is ± 92 %")
    (both,) = described({"stiction": sure, "load_friction": (0.05, 0.01, "")}, bristly=True)
    assert "it is larger at rest, by 40.0 % in the median" in both
    assert "and it grows with the motor's torque, by 5.0" in both
    (two,) = described({"stiction": (1.02, 0.001, ""), "load_friction": (0.05, 0.01, "")}, bristly=True)
    assert "at rest" not in two  # Two per cent nobody notices.
    (one,) = described({"stiction": sure, "load_friction": (0.05, 0.41, "wide")}, bristly=True)
    assert "at rest" in one
    assert "torque" not in one
    (none,) = described({"stiction": open_, "load_friction": (0.05, 0.41, "wide")}, bristly=True)
    assert none.startswith("Friction is not Coulomb's")
    assert none.endswith("what the cause is stays open.")


def test_a_lean_that_is_not_written_is_said_not_to_be_with_what_the_file_lacks() -> None:
    tilt = np.array([[0.05, 0.0, 0.0], [-0.05, 0.0, 0.0]])
    (said,) = described({}, tilt=tilt)
    assert "another way in each recording" in said
    assert "It is not written: one lean for all recordings predicts what was kept back no better than none" in said
    assert said.endswith("In the file the palm is upright, so its twin lacks that torque.")
    leaning = SimpleNamespace(drive=SimpleNamespace(tilt=np.full((1, 3), 0.02)))
    assert described({}, tilt=tilt, written=leaning)[0].endswith("Their mean is written.")
    assert "written" not in described({}, tilt=tilt[[0, 0]], written=leaning)[0]


def test_a_finger_that_touched_something_is_the_cause_of_two_fingers_at_most() -> None:
    for bad, touched in (((2, 3, 6), True), ((2, 6, 15), False), (tuple(range(16)), False)):
        left = np.where(np.isin(np.arange(16), bad), 20.0, 1.0)
        said = describe_rest(SimpleNamespace(spread=SimpleNamespace(residual=left)), SPEC)  # type: ignore[arg-type]
        assert said.startswith(f"Not explained, {len(bad)} of 16 joints: index_2 (20)" if touched else "Not explained")
        assert ("touched something" in said) == touched


def test_more_recordings_are_asked_for_only_where_noise_makes_an_interval_wide() -> None:
    assert _wide("torque_constant", 1.0, 0.4, 1.0) == "its interval is ± 40 %: record more of `excite`"
    assert _wide("torque_constant", 1.0, 0.4, 50.0) == f"its interval is ± 40 %: {BY_MODEL}"
    assert _wide("offset", 0.0, 0.1, 4.0) == f"its interval is ± 100 mrad: {BY_MODEL}"
    assert _wide("offset", 0.0, 0.37, 4.0).endswith("record more")  # Were there noise alone it would be too wide.
    assert not _wide("offset", 0.0, 0.02, 4.0)
    np.testing.assert_allclose(_misfit(np.array([0.9, 1.0])), 1.0)
    np.testing.assert_allclose(_misfit(np.array([1.0, 7.0])), [5.0, 7.0])


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
    if kind == "ripple":
        assert set(found.values["ripple_periods"][found.of_joints("ripple_sine", 16)]) == {9.0}
    if kind == "cogging":
        assert set(found.values["cogging_periods"][found.of_joints("cogging_sine", 16)]) == {8.0}  # Motors are alike.


@pytest.mark.long
@pytest.mark.parametrize("kind", ["cable", "cogging", "lean", "ripple", "spring", "warmth"])
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
    first = {
        "spring": "Constant torque",
        "ripple": "Torque ripple",
        "cable": "Constant torque",
        "cogging": "Cogging",
        "lean": "The palm leans",
        "warmth": "Friction that is",
    }
    said = list(head_lines(found))
    assert said[0].startswith(first[kind])
    if kind == "spring":
        assert said.pop(1).startswith("Torque that grows with the angle")
    assert said[1].startswith("Kept back")  # And of nothing else.
    assert ("the same way in all recordings" in said[0]) == (kind == "lean")
    assert "What the fit has not seen" in report_page(found)


@pytest.mark.long
def test_friction_that_gives_far_is_found_named_and_predicts_an_unseen_motion(tmp_path: Path) -> None:
    HANDS["presliding"] = {"bristle": 0.012, "stiction": 1.01, "stribeck_speed": 0.1}
    found = identify_hand([recorded("presliding", pose) for pose in hidden.POSES], (), masses_known=True)
    assert found.fit.far
    np.testing.assert_allclose(np.median(found.fit.drive.bristle), 0.012, rtol=0.2)
    assert next(iter(head_lines(found))).startswith("Friction gives before it slides")
    file = tmp_path / "mine.yaml"
    write_hand_file(file, found.fit, found.values, found.motions, "2026-01-02")
    (gap,) = measure_gaps([recorded("presliding", "palm-down")], str(file))
    assert gap.after.all[-1] < 0.02  # 13 mrad of three times 8 s.
    assert gap.after.all[-1] < gap.before.all[-1] / 5.0
