"""Sessions of a rehearsal: what is measured of a motion, and that a virtual hand stays what it is."""

from __future__ import annotations

import threading
from errno import ENOSPC
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import mujoco
import numpy as np
import pytest
import yaml

from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.errors import ConfigError, WrongPose
from allegro_twin.grasping.trial import make_trial
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_posture
from allegro_twin.recording.reader import load
from allegro_twin.sim.contact.collision_free_paths import CollisionFreePaths
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec, Side
from allegro_twin.twin.identify.motions.excitation import find_pose
from allegro_twin.twin.rehearsal import (
    RehearsedHand,
    RehearsedTwin,
    approach,
    hold_posture,
    rehearsal_trajectory,
    steady_error,
)
from allegro_twin.twin.rehearsal.measures import (
    Following,
    closing_time,
    far_joints,
    oscillating_joints,
    spent_joints,
    tracking_error,
    tracking_lag,
)
from allegro_twin.twin.rehearsal.sessions import close_in_air, follow_trajectory, lead_to_ends
from allegro_twin.types import Array, Command, HandState, TorqueCommand, frozen
from allegro_twin.viewing.films import _Film

SPEC = load_spec()
NOBODY = RehearsedTwin("nominal", "", np.zeros(16))
NEAR = 0.0015
"""m, of each link."""


def following(late: float = 0.0, off: float = 0.0) -> Following:
    """A sine of 1 rad/s of all joints from 1 s on, followed `late` s later and `off` rad beside."""
    t = np.arange(0.0, 5.0, 0.003)

    def path(at: Array) -> Array:
        return np.repeat(np.where(at > 1.0, np.sin(at - 1.0), 0.0)[:, None], 16, axis=1)

    rate = np.repeat(np.where(t > 1.0, np.cos(t - 1.0), 0.0)[:, None], 16, axis=1)
    return Following(SPEC, t, path(t), rate, path(t - late) + off, None, np.array([0.0, 1.0, 5.0]), 0.0 * rate)


@pytest.mark.parametrize("which", ["right", "left"])
def test_the_trajectory_moves_every_joint_and_touches_nothing_on_its_way(which: Side) -> None:
    spec = load_spec(side=which)
    model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
    model.geom_margin[:] = NEAR
    data, places = mujoco.MjData(model), [model.joint(name).qposadr[0] for name in spec.joints]
    path = rehearsal_trajectory(spec, 2.0).begin((spec.lower + spec.upper) / 2.0)
    visited = []
    for t in np.arange(0.0, path.seconds, 0.02):
        data.qpos[places] = path(t).position
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        assert not data.ncon, t
        visited.append(path(t).position)
    assert (np.ptp(visited, axis=0) > 0.3).all()
    assert (np.array(visited) > spec.lower).all()
    assert (np.array(visited) < spec.upper).all()


def test_the_peak_of_the_trajectory_is_the_level_s_speed() -> None:
    path = rehearsal_trajectory(SPEC, 3.0).begin((SPEC.lower + SPEC.upper) / 2.0)
    fastest = max(np.abs(path(t).velocity).max() for t in np.arange(0.0, path.seconds, 0.003))
    assert fastest == pytest.approx(3.0, rel=0.01)


def test_a_hand_that_follows_late_has_that_lag_and_one_beside_the_path_has_none() -> None:
    assert tracking_lag(following(late=0.02), following(late=0.02).known) == pytest.approx(0.02, abs=1e-3)
    beside = following(off=0.01)
    assert abs(tracking_lag(beside, beside.known)) < 0.005
    np.testing.assert_allclose(tracking_error(beside, beside.known), 0.01, atol=1e-9)


def test_the_approach_is_not_judged() -> None:
    found = following()
    astray = found.position.copy()
    astray[found.t < 1.0] += 1.0
    np.testing.assert_array_equal(tracking_error(found, astray), 0.0)


def test_the_steady_error_is_of_the_last_half_second() -> None:
    found = following()
    astray = found.position.copy()
    astray[found.t < 4.4] += 1.0
    astray[found.t > 4.6] += 0.02
    assert 0.01 < steady_error(found, astray)[0] < 0.02


def test_joints_that_oscillate_where_they_should_rest_are_named_with_amplitude_and_frequency() -> None:
    rest, noise = following(), np.random.default_rng(0).normal(0.0, 2e-4, (1667, 16))
    target = np.zeros_like(rest.target)
    assert not oscillating_joints(rest._replace(target=target), target + noise)
    creeping = target + noise
    creeping[:, 5] += 0.02 * rest.t + 0.002 * np.sin(2.0 * np.pi * 2.0 * rest.t)
    assert not oscillating_joints(rest._replace(target=target), creeping)
    shaken = target + noise
    shaken[:, 12] += 0.02 * np.sin(2.0 * np.pi * 24.0 * rest.t)
    shaken[:, 3] += 0.005 * np.sin(2.0 * np.pi * 40.0 * rest.t)
    assert oscillating_joints(rest._replace(target=target), shaken) == (
        "thumb_0 ±19.9 mrad at 24 Hz, index_3 ±5.0 mrad at 40 Hz"
    )


def test_joints_of_which_more_is_asked_than_their_motors_have_are_named_with_the_share_of_the_time() -> None:
    found, limit = following(), SPEC.actuation.torque_limit
    assert spent_joints(found) == {}
    found.torque[found.t < 1.0, 2] = 9.0  # On the approach, which is not judged.
    found.torque[(found.t >= 1.0) & (found.t < 2.0), 12] = -2.0 * limit[12]
    found.torque[found.t >= 1.0, 3] = 0.9 * limit[3]
    found.torque[-5, 7] = 9.0  # For a moment.
    assert spent_joints(found) == {"thumb_0": pytest.approx(0.25, abs=0.002)}


@pytest.mark.slow
def test_a_hand_with_play_oscillates_with_much_damping_and_not_with_less_and_one_without_does_not() -> None:
    play = {"backlash": [0.005] * 16, "gear_compliance": [1.0 / 30.0] * 16, "delay": 0.003}
    said = {}
    for name, drive, gains in (("play", play, "default"), ("less damping", play, "loose"), ("none", {}, "default")):
        config = hidden(scene={"kind": "sim", "truth": {"drive": drive}}).changed(controller={"gains": gains})
        found = hold_posture(RehearsedHand(config), "palm-up", NOBODY, "ok", "pd")
        said[name] = oscillating_joints(found, found.known)
    assert "thumb_0" in said["play"]
    assert not said["less damping"]
    assert not said["none"]


def test_a_grasp_is_closed_when_all_joints_are_there_for_good() -> None:
    found = following()._replace(target=np.zeros((1667, 16)), begins=np.array([0.0, 1.0, 2.0]))
    position = np.zeros((1667, 16))
    position[found.t < 1.6, 3] = 0.5
    assert closing_time(found, position) == pytest.approx(0.6, abs=0.004)
    position[-1, 3] = 0.5
    assert closing_time(found, position) is None


def test_joints_that_are_not_where_they_were_to_be_are_named_furthest_first() -> None:
    error = np.zeros(16)
    error[[1, 14]] = 0.05, -0.4
    found = following()
    assert far_joints(error, found) == f"{SPEC.joint_labels[14]} -0.40, {SPEC.joint_labels[1]} +0.05"
    error[2] = np.nan
    assert "nan" in far_joints(error, found)
    assert far_joints(np.full(16, 0.029), found) == ""


def test_of_joints_that_did_not_arrive_it_is_said_whose_motor_gave_all_it_has_to_the_end() -> None:
    found, error = following(), np.zeros(16)
    error[[1, 12, 14]] = 0.05, -0.48, -0.4
    found.torque[:, 12] = 9.0  # What is asked for may be more than the motor has.
    found.torque[found.t > 4.0, 14] = -SPEC.actuation.torque_limit[14]
    found.torque[-1, 1] = 9.0  # For a moment.
    spent = " (its motor gives all it has)"
    told = zip((12, 14, 1), ("-0.48", "-0.40", "+0.05"), (spent, spent, ""), strict=True)
    assert far_joints(error, found) == ", ".join(f"{SPEC.joint_labels[k]} {off}{why}" for k, off, why in told)


@pytest.mark.parametrize("which", ["right", "left"])
def test_a_joint_that_another_finger_stops_is_not_said_to_lack_torque(which: Side) -> None:
    """The index finger bent into the thumb: what a straight line from `ok` to `fist` ends in."""
    spec = load_spec(side=which)
    ok, fist = (load_posture(name, spec) for name in ("ok", "fist"))
    at, found = fist.copy(), following()._replace(spec=spec)
    at[:4], at[12:] = ok[:4], ok[12:]
    rows = np.repeat(at[None], len(found.t), axis=0)
    found = found._replace(position=rows, torque=np.repeat(-spec.actuation.torque_limit[None], len(found.t), axis=0))
    said = far_joints(at - fist, found).split(", ")
    name = spec.joint_labels[2]
    (blocked,) = [one for one in said if one.startswith(name)]
    assert blocked == f"{name} {at[2] - fist[2]:+.2f} (thumb is in the way of index)"
    assert f"{spec.joint_labels[0]} {at[0] - fist[0]:+.2f} (thumb is in the way of index)" in said
    away = far_joints(fist - at, found)  # It is to go the other way, and no finger stops it there.
    assert f"{name} {fist[2] - at[2]:+.2f} (" in away


def state_at(tick: int, position: Array) -> HandState:
    rest = frozen(np.zeros(16))
    return HandState(0.003 * tick, tick, frozen(position), rest, rest, rest, frozen([0.0, 0.0, -9.81]))


def test_a_hand_in_real_time_stays_limp_while_its_approach_is_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    written, enough, planned = list[Command](), threading.Event(), list[Array]()

    class Live:
        def write(self, command: Command) -> None:
            written.append(command)

        def read(self) -> HandState:
            if len(written) >= 5:
                enough.set()
            sagged = np.full(16, 0.1 if len(written) > 3 else 0.0)
            return state_at(len(written), sagged)

    def plan(spec: HandSpec, position: Array, wish: Waypoint, shift: Array, what: str) -> list[Waypoint]:
        planned.append(position)
        assert enough.wait(30.0)
        return [wish]

    monkeypatch.setattr(approach, "plan_approach", plan)
    rig: Any = SimpleNamespace(live=True, spec=SPEC, backend=Live())
    state, legs = approach.approach_from(rig, state_at(0, np.zeros(16)), Waypoint(np.ones(16)), np.zeros(16), "fist")
    assert len(legs) == 1
    assert len(written) >= 5
    assert all(isinstance(each, TorqueCommand) and not each.torque.any() for each in written)
    assert state.t > 0.0
    np.testing.assert_array_equal(planned, [np.zeros(16), np.full(16, 0.1)])  # It had moved on meanwhile.


@pytest.mark.slow
def test_the_way_to_a_posture_stays_clear_with_the_errors_of_a_hand_that_follows() -> None:
    """From wherever the posture before has left the fingers; 30 ms late, 20 mrad beside, its encoders 20 mrad off."""
    shift, clear = np.full(16, 0.02), CollisionFreePaths(SPEC)
    for begin, end in (("ok", "fist"), ("fist", "point"), ("fist", "ok")):
        start, goal = (load_posture(name, SPEC) for name in (begin, end))
        legs = approach.plan_approach(SPEC, start - shift, Waypoint(goal - shift), shift, end)
        assert len(legs) > 1
        path = Moves(legs).begin(start - shift)
        out, near = path.times[1], path.times[-2]  # Before and after these, parts that touch may separate and meet.
        late = np.array([path(t - 0.03).position for t in np.arange(out, near, 0.01)])
        beside = np.random.default_rng(0).uniform(-0.02, 0.02, late.shape)
        assert not any(clear.touching(row + shift) for row in late + beside), (begin, end)


def test_a_hand_that_lies_in_ok_reaches_the_fist() -> None:
    found = hold_posture(RehearsedHand(hidden(start="ok")), "palm-up", NOBODY, "fist", "pid")
    assert far_joints(steady_error(found, found.position), found) == ""
    assert len(found.begins) == 2  # One approach, in however many legs.


def test_only_a_hand_on_a_bus_is_rehearsed() -> None:
    with pytest.raises(ConfigError, match="this is a sim hand: try conf/can_virtual.yaml"):
        RehearsedHand(load_config("sim_right"))


def hidden(start: str | None = None, **more: object) -> RunConfig:
    """A virtual hand whose encoders are 20 mrad off and whose motors are weaker than its host believes."""
    truth = {"wire": {"torque_constant": 0.9}, "drive": {"encoder_offset": [0.02] * 16}}
    scene = {"kind": "sim", "truth": truth} | ({} if start is None else {"start": start})
    return load_config("can_virtual").changed(backend={"scene": scene, **more})


@pytest.mark.slow
def test_a_virtual_hand_stays_what_it_is_whatever_its_host_believes(tmp_path: Path) -> None:
    hand, file, recorded = RehearsedHand(hidden()), tmp_path / "mine.yaml", tmp_path / "held.arrow"
    first = hold_posture(hand, "palm-up", NOBODY, "ok", "pid", recorded)
    np.testing.assert_allclose(steady_error(first, first.known), -0.02, atol=0.003)
    np.testing.assert_allclose(steady_error(first, first.position), 0.0, atol=0.003)
    assert load(recorded).meta["config"]["task"]["posture"] == "ok"
    right = lead_to_ends(hand, "palm-up", "").encoder_offsets()
    wire = {"version": "v4", "side": "right", "encoder_offset": list(right.offset)}
    file.write_text(yaml.safe_dump({"wire": wire, "actuation": {"damping": 3.0}}))
    then = hold_posture(hand, "palm-up", NOBODY._replace(serial=str(file)), "ok", "pid")
    np.testing.assert_allclose(steady_error(then, then.known), 0.0, atol=0.003)


@pytest.mark.slow
def test_encoders_judge_as_the_truth_does_once_the_ends_have_told_their_offsets() -> None:
    hand = RehearsedHand(hidden())
    found = lead_to_ends(hand, "up", "")
    shift = found.encoder_offsets().limits.lower - found.limits.lower
    motion = follow_trajectory(hand, "palm-up", NOBODY._replace(shift=shift), 3.0, "pd")
    np.testing.assert_allclose(tracking_error(motion, motion.position), tracking_error(motion, motion.known), rtol=0.1)
    assert 0.0 < tracking_lag(motion, motion.known) < 0.05


@pytest.mark.slow
def test_a_joint_that_is_stuck_is_named_before_anything_is_learned() -> None:
    hand = RehearsedHand(hidden(faults={"script": [{"at": 0.0, "what": "stuck", "which": 5, "amount": 1.0}]}))
    with pytest.raises(ConfigError, match=rf"{SPEC.joint_labels[5]} did not move .* without power, or stuck"):
        lead_to_ends(hand, "side", "")


@pytest.mark.slow
def test_a_grasp_in_the_air_is_closed_and_not_squeezed() -> None:
    found = close_in_air(RehearsedHand(hidden()), "palm-up", NOBODY, "lemon", "pid")
    took = closing_time(found, found.position)
    assert took is not None
    assert 0.2 < took < found.begins[-1] - found.begins[-2] + 1.0


@pytest.mark.slow
def test_a_film_of_a_grasp_is_as_long_as_its_trial_and_changes_nothing(tmp_path: Path) -> None:
    hand, path = RehearsedHand(hidden()), tmp_path / "films" / "lemon.mp4"
    assert hand.trial("lemon", "", path) == hand.trial("lemon", "")
    with av.open(str(path)) as film:
        assert film.duration == pytest.approx(1e6 * make_trial("lemon", SPEC).seconds, abs=1e5)


@pytest.mark.slow
def test_a_grasp_whose_film_meets_a_full_disk_is_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(made: _Film) -> None:
        raise OSError(ENOSPC, "No space left on device")

    monkeypatch.setattr(_Film, "finish", full)
    hand, path = RehearsedHand(hidden()), tmp_path / "films" / "lemon.mp4"
    assert hand.trial("lemon", "", path).held
    assert not list(path.parent.iterdir())


def test_a_hand_that_lies_otherwise_than_said_is_not_moved() -> None:
    hand = RehearsedHand(hidden())
    lies = find_pose("side", "right")

    class Fallen(RehearsedHand):
        def placed(self, pose):  # type: ignore[no-untyped-def]  # As its parent's.
            return super().placed(lies)

    moved: list[float] = []
    with pytest.raises(WrongPose, match="IMU is 90° off the pose 'palm-up'"):
        hold_posture(Fallen(hand.config), "palm-up", NOBODY, "ok", "pd", advance=moved.append)
    with pytest.raises(WrongPose, match="IMU is 90° off the pose 'up'"):
        lead_to_ends(Fallen(hand.config), "up", "", advance=moved.append)
    assert moved == []
