"""The verdict follows from what was seen: drift, turn, table and touch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.drivers.can.virtual.motor_heat import MotorHeat
from allegro_twin.grasping.evaluation.rejudge import motor_load, report_markdown, write_reports
from allegro_twin.grasping.verdict import Observations, PhaseWindow, Rule, TrialReport, judge, relative_motion
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.spec.thermal import ThermalData
from allegro_twin.surfaces.cli.console import phases, summary
from allegro_twin.types import Vector

ALLEGRO = load_spec().thermal

WINDOWS = (
    PhaseWindow("squeeze", 0.0, 1.0, False),
    PhaseWindow("hold", 1.0, 2.0, True),
    PhaseWindow("shake", 2.0, 3.0, True),
)
T = np.arange(0, 3001) * 0.001
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
LIMIT = np.full(16, 0.5)


def observations(**changes: Any) -> Observations:
    """An object that is lifted with the palm and never moves in it."""
    lifted = 0.15 * np.clip(T - 1.0, 0, 1)
    pose = np.zeros((len(T), 7))
    pose[:, 2], pose[:, 3:] = lifted, IDENTITY
    values: dict[str, Any] = {
        "t": T, "palm": pose.copy(), "object_pose": pose.copy(), "contact_force": np.ones((len(T), 2)),
        "on_table": (T < 1.0).astype(float), "contacts": np.full(len(T), 4.0),
        "penetration": np.where(T < 1.5, 0.0003, 0.0002), "torque": np.full((len(T), 16), 0.1),
    }  # fmt: skip
    return Observations(**(values | changes))


def verdict(seen: Observations, *, throughout: bool = False, limit: Vector = LIMIT) -> TrialReport:
    return judge(
        seen,
        WINDOWS,
        Rule("squeeze", drift=0.01, rotation=15.0, lift=0.15, throughout=throughout),
        parts=("index", "thumb"),
        joints=[f"joint_{number}" for number in range(16)],
        torque_limit=limit,
    )


def moved(distance: float, at: float) -> Observations:
    seen = observations()
    seen.object_pose[seen.t >= at, 1] += distance
    return seen


def test_an_object_that_stays_is_held_with_its_margins() -> None:
    report = verdict(observations())
    assert report.held
    assert report.reason == ""
    assert report.peak_torque == pytest.approx(0.2)
    assert report.lift == pytest.approx(0.15)
    assert [phase.name for phase in report.phases] == ["hold", "shake"]
    assert report.phases[0].contact_force == {"index": 1.0, "thumb": 1.0}
    assert (report.phases[0].contacts, report.margin) == (4.0, 1.0)
    assert (report.penetration, report.phases[1].penetration) == (0.0003, 0.0002)


def test_the_margin_is_what_the_worst_check_leaves_of_the_nearest_limit() -> None:
    assert verdict(moved(0.004, 1.5)).margin == pytest.approx(0.6)
    assert verdict(moved(0.012, 2.5)).margin == pytest.approx(-0.2)


def test_a_joint_at_its_limit_is_named_with_its_share_of_the_time() -> None:
    torque = np.full((len(T), 16), 0.1)
    torque[T > 2.0, 3], torque[T <= 1.0, 4] = -0.499, 0.5
    report = verdict(observations(torque=torque))
    assert report.at_limit["joint_3"] == pytest.approx(0.5, abs=0.001)
    assert report.at_limit["joint_4"] == 0.0  # Before the reference it does not count.


def test_the_joint_that_warms_most_is_named_with_its_root_mean_square_and_how_long_it_bears_that() -> None:
    torque = np.full((len(T), 16), 0.1)
    torque[T > 2.0, 3], torque[:, 7] = -0.5, 0.3
    report = verdict(observations(torque=torque))
    joint, share = report.hottest
    assert joint == "joint_3"  # Half of the time all, and a fifth in the other half: more than 60 % all the time.
    assert share == pytest.approx(np.sqrt((1.0 + 0.04) / 2.0), abs=0.002)
    source = "(estimated; thermal data assumed, for nothing is published)"
    assert motor_load(report, ALLEGRO)[1] == f"joint_3 sustains 72 % of its limit: 60 °C after 293 s {source}"
    eased = verdict(observations(torque=np.full((len(T), 16), 0.3)))
    assert motor_load(eased, ALLEGRO)[1].endswith(f"sustains 60 % of its limit: never 60 °C {source}")


def test_of_a_hand_without_thermal_data_only_the_share_is_said() -> None:
    said = motor_load(verdict(observations()), None)
    assert said == ["no joint at its torque limit", "joint_0 sustains 20 % of its limit (no thermal data of this hand)"]


def test_of_an_object_that_left_the_table_no_millimetres_are_said() -> None:
    seen = observations()
    seen.object_pose[T > 1.0, 2] = -7.9
    report = verdict(seen)
    assert report.fell
    table = phases("cube", report, None)
    assert str(table.caption).startswith("it left the table and fell, ")
    assert list(table.columns[1].cells) == ["gone", "gone"]
    assert not verdict(observations()).fell


def test_where_no_effort_is_known_nothing_is_said_of_load_or_heat(tmp_path: Path) -> None:
    report = verdict(observations(), limit=np.full(16, np.inf))
    assert report.held
    assert np.isnan([report.peak_torque, report.stall, report.hottest[1], *report.at_limit.values()]).all()
    assert motor_load(report, ALLEGRO) == ["effort unknown: nothing can be said of load or heat"]
    for text in (report_markdown(report, ALLEGRO), str(phases("ball", report, ALLEGRO).caption)):
        assert "effort unknown" in text
        assert "%" not in text.replace("100 % of the drift limits left", "")
    assert list(summary({("ball", "right"): report}, {"ball": "pinch"}, "").columns[-1].cells) == ["–"]
    write_reports(tmp_path / "report.json", {"ball": report})
    text = (tmp_path / "report.json").read_text()
    assert "NaN" not in text
    trial = json.loads(text)["trials"]["ball"]
    assert (trial["peak_torque"], set(trial["at_limit"].values()), set(trial["sustained"].values())) == (
        None, {None}, {None}
    )  # fmt: skip


def test_a_joint_of_unknown_effort_is_named_and_the_others_are_judged() -> None:
    torque, limit = np.full((len(T), 16), 0.1), LIMIT.copy()
    torque[:, 3], limit[3] = 5.0, np.inf
    report = verdict(observations(torque=torque), limit=limit)
    assert [report.peak_torque, report.stall] == pytest.approx([0.2, 0.0])
    joint, share = report.hottest
    assert joint == "joint_0"
    assert share == pytest.approx(0.2)
    assert motor_load(report, None)[-1] == "effort of joint_3 unknown: nothing can be said of its load"


@pytest.mark.parametrize("share", [0.75, 0.9, 1.0])
def test_the_time_to_a_temperature_is_that_of_the_motor_that_is_simulated(share: float) -> None:
    thermal = ThermalData(70.0, 90.0, "a test")
    motor = MotorHeat(np.array([2.0]), thermal, 0.01)
    seconds = 0.0
    while motor.temperature[0] < 60.0:
        motor.warm([np.array([2.0 * share])] * motor.steps)
        seconds += 0.01 * motor.steps
    assert seconds == pytest.approx(thermal.seconds_until(60.0, share), abs=0.3)
    assert np.isinf(thermal.seconds_until(60.0, 0.7))


def test_a_slip_that_comes_back_counts_where_limits_hold_throughout() -> None:
    seen = observations()
    seen.object_pose[(T > 1.4) & (T < 1.6), 1] += 0.02
    assert verdict(seen).held
    assert not verdict(seen, throughout=True).held


@pytest.mark.parametrize(("distance", "held"), [(0.0099, True), (0.0101, False)])
def test_a_centimetre_is_the_limit(distance: float, held: bool) -> None:
    assert verdict(moved(distance, 1.5)).held is held


def test_the_first_phase_that_fails_is_named_with_its_numbers() -> None:
    assert verdict(moved(0.02, 2.5)).reason == "moved 20.0 mm and 0.0° in the hand by the end of shake"


def test_what_happens_before_the_reference_does_not_count() -> None:
    assert verdict(moved(0.05, 0.5)).held


@pytest.mark.parametrize(("degrees", "held"), [(14.9, True), (15.1, False)])
def test_fifteen_degrees_is_the_limit(degrees: float, held: bool) -> None:
    seen = observations()
    half = np.radians(degrees) / 2
    seen.object_pose[seen.t >= 1.5, 3:] = [np.cos(half), 0.0, np.sin(half), 0.0]
    assert verdict(seen).held is held


def test_motion_of_the_whole_hand_is_no_motion_of_the_object_in_it() -> None:
    seen = observations()
    half = np.pi / 4
    turn = np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
    seen.palm[1500:, 3:] = turn
    seen.object_pose[:, :2] = [0.1, 0.0]
    seen.object_pose[1500:, :2] = [0.0, 0.1]
    seen.object_pose[1500:, 3:] = turn
    distance, angle = relative_motion(seen.palm, seen.object_pose, 1000)
    assert distance.max() < 1e-12
    assert angle.max() < 1e-4


def test_a_dropped_object_is_not_held_even_when_it_did_not_move_far() -> None:
    report = verdict(observations(contact_force=np.zeros((len(T), 2))))
    assert report.reason == "dropped by the end of hold"


def test_an_object_that_still_touches_the_table_is_not_held() -> None:
    assert verdict(observations(on_table=np.ones(len(T)))).reason == "still on the table at the end of hold"


def test_an_object_that_did_not_rise_is_not_held() -> None:
    seen = observations()
    seen.palm[:, 2] = seen.object_pose[:, 2] = 0.0
    why = "rose 0 mm of 150 mm, as the palm did (0 mm): it was pushed up before the lift, or held down in it"
    assert verdict(seen).reason == why


@pytest.mark.parametrize(("share", "held"), [(0.94, True), (0.92, False)])
def test_it_must_rise_as_the_wrist_does_but_for_the_drift_that_is_allowed(share: float, held: bool) -> None:
    seen = observations()
    seen.palm[:, 2] *= share
    seen.object_pose[:, 2] *= share
    assert verdict(seen).held is held
