"""Trials with the arm in the loop: what moves is what the protocol says, and none depends on those before it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.planning.stored_grasps import table_object
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.grasping.scenario import ScenarioObject
from allegro_twin.grasping.timeline import place_object
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Array
from studies.preemption.arm import grasps
from studies.preemption.arm.grasps import PreparedGrasp, placed_content, read_prepared, write_prepared
from studies.preemption.arm.prepare import solid_of
from studies.preemption.arm.trial import ArmBench, ClosingPath, Leg, Swing
from studies.preemption.draws import case
from studies.preemption.jobs import made
from studies.preemption.protocol import load_study, study_of
from studies.preemption.scenes import Job
from tests.studies.small import arm_study, content

POSE = Pose(np.array([0.5, 0.1, 0.3]), np.eye(3))
LEG = Leg(POSE, np.array([0.0, 0.02, -0.1]), 0.4, 1.2)
SWING = Swing(POSE, 3.0, 4.0, 0.4, 1.5)
STUDY = load_study("preemption_arm")


@pytest.mark.parametrize("path", [LEG, SWING])
def test_the_motion_that_is_fed_forward_is_that_of_the_set_point(path: Leg | Swing) -> None:
    h = 1e-5
    for t in np.random.default_rng(0).uniform(0.4, 0.4 + path.seconds, 40):
        here, motion = path.at(t), path.motion(t)
        before, after = path.at(t - h).position, path.at(t + h).position
        np.testing.assert_allclose(motion.twist[:3], (after - before) / (2.0 * h), atol=2e-3)
        if np.abs(path.motion(t - h).acceleration - path.motion(t + h).acceleration).max() < 0.5:
            np.testing.assert_allclose(
                motion.acceleration[:3], (after - 2.0 * here.position + before) / h**2, atol=0.05
            )  # fmt: skip
        np.testing.assert_array_equal(motion.twist[3:], 0.0)


def test_a_leg_ends_where_it_leads_and_a_shake_where_it_began_within_its_stroke() -> None:
    np.testing.assert_allclose(LEG.at(9.0).position, POSE.position + LEG.way)
    np.testing.assert_array_equal(LEG.at(0.0).position, POSE.position)
    np.testing.assert_array_equal(LEG.motion(9.0).twist, 0.0)
    times = np.linspace(0.4, 1.9, 2000)
    moved = np.array([SWING.at(t).position - POSE.position for t in times])
    assert np.abs(moved).max(axis=0) == pytest.approx(2.0 * 3.0 / (2.0 * np.pi * 4.0) ** 2, rel=1e-3)
    assert np.count_nonzero(np.abs(moved) > 1e-9, axis=1).max() == 1  # One axis at a time.
    np.testing.assert_allclose(SWING.at(1.9).position, POSE.position, atol=1e-12)


def test_fingers_wait_close_and_squeeze_in_their_time_and_frozen_ones_never_do() -> None:
    ready = PreparedGrasp("one", np.zeros(7), (POSE.position, POSE.rotation), *np.array([[0.1], [0.5], [0.7]]))
    path = ClosingPath(ready, 0.8, 0.4)
    assert path(5.0).position == 0.1
    path.begun = 1.0
    assert [round(float(path(t).position[0]), 9) for t in (1.0, 1.4, 1.8, 2.2, 9.0)] == [0.1, 0.3, 0.5, 0.7, 0.7]
    assert path(1.4).velocity[0] == pytest.approx(0.4 / 0.8 * 15.0 / 8.0)
    assert (path.done(2.1), path.done(2.2)) == (False, True)
    path.frozen = True
    assert path(9.0).position == 0.1


@pytest.mark.parametrize("name", STUDY.objects)  # type: ignore[attr-defined]  # It has objects.
def test_what_is_planned_for_is_the_object_of_the_trial(name: str) -> None:
    one = STUDY.objects[name]  # type: ignore[attr-defined]
    body = table_object(solid_of(one))
    placed = place_object(ScenarioObject(**placed_content(name, one)))
    turned = np.abs(matrix_from_quaternion(np.array(placed.quaternion))) @ placed.grasp_object.half_extents()
    np.testing.assert_allclose(one.extents, 2.0 * turned)
    np.testing.assert_allclose(body.extents, (*sorted(2.0 * turned[:2], reverse=True), 2.0 * turned[2]))
    assert placed.position[2] == pytest.approx(body.position[2] + 1e-4)


def test_prepared_grasps_are_read_as_they_were_written_and_a_broken_file_or_none_is_one_line(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grasps, "FOLDER", tmp_path)
    random = np.random.default_rng(3)

    def few(*shape: int) -> Array:
        return np.round(random.normal(size=shape), 9)

    one = PreparedGrasp("adapted egg", few(7), (few(3), few(3, 3)), few(16), few(16), few(16))
    write_prepared(tmp_path, "allegro", {"egg": one})
    read = read_prepared("allegro")["egg"]
    for was, now in zip(one[1:2] + one[2] + one[3:], read[1:2] + read[2] + read[3:], strict=True):
        np.testing.assert_array_equal(was, now)
    (tmp_path / "allegro.json").write_text('{"egg": {"grasp": "adapted')
    with pytest.raises(RecordingError, match=r"allegro.json: no prepared grasps can be read"):
        read_prepared("allegro")
    with pytest.raises(ConfigError, match="no grasps are prepared for leap: python -m studies.preemption prepare"):
        read_prepared("leap")


def test_a_protocol_with_the_arm_names_what_it_does_not_have_and_the_old_one_is_what_it_was() -> None:
    assert load_study("preemption").digest == "315ed18d76deadc9"
    plain = STUDY.model_dump(mode="json")
    for changed, said in (
        ({"learned": plain["learned"] | {"options": ["P99"]}}, "P99"),
        ({"learned": plain["learned"] | {"name": "A"}}, "different names"),
        ({"test": ["anvil"]}, "anvil"),
        ({"versus": [["P75", "Q"]]}, "Q"),
    ):
        with pytest.raises(ConfigError, match=said):
            study_of(plain | changed, "mine")
    assert study_of(content(), "mine").compared == ()


def test_contact_models_are_drawn_alike_for_every_policy_and_all_of_them_are() -> None:
    drawn = [case(STUDY, "test", number).contact for number in range(60)]
    assert set(drawn) == {"elliptic", "pyramidal", "soft"}
    assert drawn == [case(STUDY, "test", number).contact for number in range(60)]
    assert {case(load_study("preemption"), "test", number).contact for number in range(9)} == {""}


@pytest.fixture(scope="module")
def table() -> list[dict[str, Any]]:
    of = arm_study()
    asked = [(trial, policy, control) for trial in (0, 1) for policy, control in
             (("A", ""), ("P50", ""), ("F0", ""), ("R10", ""), ("A", "frozen"))]  # fmt: skip
    items = [{"hand": "allegro", "set": "test", "trial": trial, "policy": policy, "control": control}
             for trial, policy, control in asked]  # fmt: skip
    return made({"study": of.model_dump(mode="json")}, items)


def row(table: list[dict[str, Any]], policy: str, trial: int = 0, control: str = "") -> dict[str, Any]:
    return next(r for r in table if (r["policy"], r["trial"], r["control"]) == (policy, trial, control))


@pytest.mark.slow
def test_the_arm_brings_the_hand_which_closes_lifts_and_shakes_a_ball(table: list[dict[str, Any]]) -> None:
    one = row(table, "A")
    assert (one["held"], one["why"]) == (True, "")
    of = arm_study()
    error = of.check.noise * np.sqrt(2.0 / of.check.samples) * case(of, "test", 0).felt / 9.81
    assert one["felt_g"] - 1e3 * error == pytest.approx(50.0, abs=5.0)  # What the ball weighs, at the flange.
    assert one["slip_mm"] < 10.0
    frozen = row(table, "A", control="frozen")
    assert (frozen["held"], frozen["why"]) == (False, "not lifted")


@pytest.mark.slow
def test_a_policy_begins_when_it_says_and_a_faster_hand_and_an_earlier_one_save_their_time(
    table: list[dict[str, Any]],
) -> None:
    plain, early, fast, waits = (row(table, name) for name in ("A", "P50", "F0", "R10"))
    assert plain["begun_s"] == pytest.approx(0.8)
    assert early["begun_s"] == pytest.approx(0.4)
    assert early["cycle_s"] == pytest.approx(plain["cycle_s"] - 0.4, abs=0.0081)
    assert fast["cycle_s"] == pytest.approx(plain["cycle_s"] - 0.4, abs=0.0081)
    assert plain["begun_s"] < waits["begun_s"] < plain["begun_s"] + 0.6


@pytest.mark.slow
def test_a_trial_is_the_same_alone_and_after_others(table: list[dict[str, Any]]) -> None:
    of = arm_study()
    alone = ArmBench(of, "allegro").rows([Job(of.policy("P50"), case(of, "test", 1))])[0]
    after = {key: value for key, value in row(table, "P50", 1).items() if key in alone}
    for key, value in alone.items():
        np.testing.assert_equal(after[key], value, err_msg=key)
