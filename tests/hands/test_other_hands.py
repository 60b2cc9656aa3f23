"""Hands other than the Allegro: what closes its own loop, what follows, and what the facade makes of them."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from allegro_twin import Hand
from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.control.controllers import PositionControl
from allegro_twin.control.trajectory import Hold
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import Library, load_posture
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.loop import run, until
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import Recorder
from allegro_twin.recording.replay import ReplayBackend, replay_samples
from allegro_twin.recording.spec_json import spec_from_json, spec_to_json
from allegro_twin.safety import Guard, Limits
from allegro_twin.sim.model.parts import body_parts, part_names
from allegro_twin.sim.model.scene import hand_spec
from allegro_twin.spec import Finger, HandSpec
from allegro_twin.surfaces.cli.hand_override import on_hand
from allegro_twin.types import PositionCommand, Sample
from tests.conftest import MakeSim
from tests.hands.models import hand

LEAP = {"hand": {"model": "leap"}, "backend": {"kind": "sim"}, "controller": {"kind": "position"}}


@pytest.fixture
def soft(tmp_path: Path) -> HandSpec:
    return hand("soft", tmp_path)


@pytest.fixture
def gripper(tmp_path: Path) -> HandSpec:
    return hand("gripper", tmp_path)


def test_the_leap_hands_fingertips_are_where_its_public_description_has_them() -> None:
    """mujoco_menagerie leap_hand at zero, brought into our palm frame: tips 48 mm beyond a finger's last axis, 60 mm
    beyond the thumb's; ours end a sphere of 12 mm there."""
    tips = hand_kinematics(load_spec("leap")).fingertips(np.zeros(16))
    ends = {"index": (0.0008, 0.0454, 0.1372), "middle": (0.0008, 0.0, 0.1372), "ring": (0.0008, -0.0454, 0.1372)}
    for finger, end in ends.items():
        np.testing.assert_allclose(tips[finger].position + np.array([0.0, 0.0, 0.012]), end, atol=1e-4)
    np.testing.assert_allclose(
        tips["thumb"].position + np.array([0.0, 0.012, 0.0]), (0.0029, 0.1745, -0.0753), atol=1e-4
    )


def test_a_left_leap_hand_is_the_mirror_image_of_a_right_one() -> None:
    posture = np.linspace(0.1, 0.8, 16)
    right, left = (hand_kinematics(load_spec("leap", side)).fingertips(posture) for side in ("right", "left"))
    for finger, pose in right.items():
        np.testing.assert_allclose(left[finger].position, pose.position * (1, -1, 1), atol=1e-12)


def test_a_hand_with_its_own_loop_is_limp_until_its_first_command_and_after_a_limp_one(make_sim: MakeSim) -> None:
    spec = load_spec("leap")
    sim = make_sim(spec)
    sim.reset()
    np.testing.assert_array_equal(sim.read().torque, 0.0)
    sim.write(PositionCommand(np.full(16, 0.3)))
    assert np.abs(sim.read().torque).max() > 0.1
    sim.write(PositionCommand(np.full(16, 0.3), effort=np.zeros(16)))
    np.testing.assert_array_equal(sim.read().torque, 0.0)


def test_an_effort_is_not_exceeded(make_sim: MakeSim) -> None:
    spec = load_spec("leap")
    sim = make_sim(spec)
    sim.reset()
    sim.write(PositionCommand(np.full(16, 0.8), effort=np.full(16, 0.05)))
    torques = np.array([sim.read().torque for _ in range(50)])
    assert np.abs(torques).max() == pytest.approx(0.05)


def test_what_a_recording_says_of_the_model_does_not_change_with_what_the_servos_may_give(make_sim: MakeSim) -> None:
    sim = make_sim(load_spec("leap"))
    sim.reset()
    before = sim.meta()
    sim.write(PositionCommand(np.zeros(16), effort=np.full(16, 0.05)))
    sim.read()
    assert sim.meta() == before


def test_a_tendon_closes_what_nothing_holds_and_the_rest_adapts(soft: HandSpec, make_sim: MakeSim) -> None:
    """A finger that is held lets the other one go on: no linkage could do that."""
    sim = make_sim(soft)
    sim.reset()
    sim.write(PositionCommand(np.array([0.6])))
    for _ in range(1500):
        sim.read()
    free = [float(sim.data.joint(f"{finger}_1").qpos[0]) for finger in ("first", "second")]
    assert free[0] == pytest.approx(free[1], abs=1e-3)
    sim.reset()
    sim.write(PositionCommand(np.array([0.6])))
    stop = [sim.model.joint(name).id for name in ("first_1", "first_2")]
    sim.model.jnt_range[stop, 1] = 0.1
    for _ in range(1500):
        state = sim.read()
    assert sim.data.joint("first_1").qpos[0] < 0.12
    assert sim.data.joint("second_1").qpos[0] > 1.5 * free[1]
    assert state.position[0] > 0.5


def test_what_follows_is_estimated_where_nothing_is_in_the_way(soft: HandSpec, make_sim: MakeSim) -> None:
    sim = make_sim(soft)
    samples = list(until(4.0, run(sim, PositionControl(Hold(np.array([0.5]))))))
    true = [float(sim.data.joint(each.name).qpos[0]) for each in soft.followers]
    np.testing.assert_allclose(soft.coupled_positions(samples[-1].state.position), true, atol=0.05)


def test_a_state_says_where_the_tendon_is_now_and_not_a_step_ago(soft: HandSpec, make_sim: MakeSim) -> None:
    sim = make_sim(soft)
    sim.reset()
    sim.write(PositionCommand(np.array([1.0])))
    for _ in range(20):
        state = sim.read()
        bent = [
            float(sim.data.joint(f"{finger}_{place}").qpos[0]) for finger in ("first", "second") for place in (1, 2)
        ]
        assert state.position[0] == pytest.approx(np.dot([0.3, 0.2, 0.3, 0.2], bent), abs=1e-12)


def test_what_carries_several_fingers_is_none_of_them() -> None:
    finger = """<body name="{0}" pos="0 {1} 0.03"><joint name="{0}" axis="0 1 0" range="0 60"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.005"/><site name="{0}_tip"/></body>"""
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody><body name="palm_link"><geom size="0.01"/>
      <body name="carpus" pos="0 0 0.02"><joint name="wrist" axis="1 0 0"/><geom size="0.01"/>
      {finger.format("one", 0.02)}{finger.format("two", -0.02)}</body></body></worldbody></mujoco>""")
    spec = replace(load_spec("model_o"), fingers=(Finger("one", (0,), "one_tip"), Finger("two", (1,), "two_tip")))
    names, parts = part_names(spec), body_parts(model, spec)
    told = {name: names[parts[model.body(name).id]] for name in ("palm_link", "carpus", "one", "two")}
    assert told == {"palm_link": "palm", "carpus": "palm", "one": "one", "two": "two"}


def test_another_model_of_hand_brings_the_controller_that_it_takes() -> None:
    config = on_hand(load_config("sim_right"), "leap")
    assert (config.hand.model, config.controller.kind) == ("leap", "position")
    assert assemble(config).spec.name == "leap_right"


def test_a_linkage_moves_both_jaws_and_both_are_fingers(gripper: HandSpec, make_sim: MakeSim) -> None:
    tips = [hand_kinematics(gripper).fingertips(np.array([at])) for at in (0.0, 0.02)]
    for finger, way in (("left_finger", 0.02), ("right_finger", -0.02)):
        moved = tips[1][finger].position - tips[0][finger].position
        np.testing.assert_allclose(np.abs(moved).max(), abs(way), atol=1e-6)
    model, names = hand_spec(gripper).compile(), part_names(gripper)
    parts = body_parts(model, gripper)
    for body, part in (("palm_link", "palm"), ("left_finger", "left_finger"), ("right_finger", "right_finger")):
        assert names[parts[model.body(body).id]] == part


def test_gravity_is_what_the_driven_joints_feel_of_all_that_moves_with_them(
    gripper: HandSpec, make_sim: MakeSim
) -> None:
    """Both jaws of 50 g slide: hung along their way, the one motor feels one up and one down."""
    torque = hand_kinematics(gripper).gravity_torque(np.array([0.0]), np.array([0.0, 0.0, -9.81]))
    np.testing.assert_allclose(torque, [0.0], atol=1e-9)


def test_the_palm_of_a_card_looks_where_the_card_says(soft: HandSpec) -> None:
    """Fingers along x and closing downwards, in its file: along z and towards x, in ours. Masses go with it."""
    open_, closed = (hand_kinematics(soft).fingertips(np.array([at]))["first"].position for at in (0.0, 1.0))
    assert open_[2] > 0.05
    assert closed[0] > open_[0] + 0.02
    model = hand_spec(soft).compile()
    palm = model.body("palm_link").id
    assert model.body_mass[palm] == pytest.approx(0.3)
    np.testing.assert_allclose(model.body_ipos[palm], [0.0, 0.0, 0.001], atol=1e-9)


@pytest.mark.parametrize("name", ["leap", "gripper", "soft"])
def test_a_spec_survives_the_recording_that_carries_it(name: str, tmp_path: Path) -> None:
    spec = load_spec("leap") if name == "leap" else hand(name, tmp_path)
    back = spec_from_json(spec_to_json(spec))
    assert (back.joints, back.commands) == (spec.joints, spec.commands)
    assert [(f.name, f.driven) for f in back.followers] == [(f.name, f.driven) for f in spec.followers]
    middle = (spec.lower + spec.upper) / 2
    np.testing.assert_array_equal(back.coupled_positions(middle), spec.coupled_positions(middle))


def test_the_guard_keeps_positions_inside_the_soft_stops_and_efforts_under_the_ceiling(make_sim: MakeSim) -> None:
    spec = load_spec("leap")
    limits = Limits(np.full(16, 0.1), np.full(16, 12.0), spec.lower + 0.1, spec.upper - 0.1)
    guard = Guard(make_sim(spec), limits)
    guard.reset()
    guard.write(PositionCommand(spec.upper + 5.0))
    assert isinstance(guard.applied, PositionCommand)
    np.testing.assert_array_equal(guard.applied.position, spec.upper - 0.1)
    np.testing.assert_array_equal(guard.applied.effort, 0.1)
    guard.write(PositionCommand(spec.lower - 5.0, effort=np.linspace(0.05, 0.2, 16)))
    np.testing.assert_array_equal(guard.applied.position, spec.lower + 0.1)
    np.testing.assert_array_equal(guard.applied.effort, np.minimum(np.linspace(0.05, 0.2, 16), 0.1))


def test_a_guard_that_trips_leaves_a_hand_with_its_own_loop_limp(make_sim: MakeSim) -> None:
    spec = load_spec("leap")
    inner = make_sim(spec)
    guard = Guard(inner, Limits(spec.actuation.torque_limit, np.full(16, 0.5), spec.lower, spec.upper))
    guard.reset()
    guard.write(PositionCommand(spec.upper))
    with pytest.raises(HandFault, match="over its limit"):
        for _ in range(300):
            guard.read()
    np.testing.assert_array_equal(inner.read().torque, 0.0)


def test_the_facade_moves_a_leap_hand_and_lets_go_of_it() -> None:
    with Hand.open(RunConfig.model_validate(LEAP)) as leap:
        assert leap.controllers == ("limp", "position")
        assert leap.controller == "limp"
        home = load_posture("home", leap.spec)
        leap.move_to("home")
        np.testing.assert_allclose(leap.state.position, home, atol=0.05)
        assert leap.controller == "position"
        leap.set_controller("limp")
        leap.wait(0.5)
        np.testing.assert_array_equal(leap.state.torque, 0.0)


@pytest.mark.parametrize("kind", ["pd", "pid", "torque", "gravity"])
def test_a_controller_of_torques_is_refused_by_a_hand_that_takes_positions(kind: str) -> None:
    with pytest.raises(ConfigError, match="leap_right takes position, limited_position: use position or limp"):
        assemble(RunConfig.model_validate(LEAP | {"controller": {"kind": kind}}))


def test_a_controller_of_positions_is_refused_by_a_hand_that_takes_torques() -> None:
    with pytest.raises(ConfigError, match="allegro_right: use pd"):
        assemble(RunConfig.model_validate(LEAP | {"hand": {"model": "allegro"}}))


def test_a_posture_of_another_hand_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match=r"fist.yaml: a posture of the hand allegro; this one is leap"):
        load_posture("fist", load_spec("leap"))
    with pytest.raises(ConfigError, match="a posture of the hand leap; this one is allegro"):
        load_posture("leap_home", load_spec())


def test_what_a_hand_is_taught_is_stored_as_its_own(tmp_path: Path, soft: HandSpec) -> None:
    from allegro_twin.hands.library.entries import posture_entry

    for spec, position in ((load_spec("leap"), np.full(16, 0.25)), (soft, np.array([0.4]))):
        library = Library()
        library.add("mine", posture_entry(position, spec), spec)
        library.store("mine", tmp_path / f"{spec.model}_mine.yaml")
        again = Library(tmp_path / f"{spec.model}_mine.yaml")
        np.testing.assert_array_equal(again.posture("mine", spec), position)
        with pytest.raises(ConfigError, match=f"of the hand {spec.model}; this one is allegro"):
            again.posture("mine", load_spec())


def test_a_recording_keeps_every_part_of_a_command(tmp_path: Path, make_sim: MakeSim) -> None:
    spec, middle = load_spec("leap"), np.full(16, 0.3)
    efforts = (None, np.full(16, 0.1), np.zeros(16))
    commands = [*(PositionCommand(middle, effort) for effort in efforts), PositionCommand(middle, None, 0.25)]
    sim = make_sim(spec)
    state = sim.reset()
    path = tmp_path / "r.arrow"
    with closing(Recorder(path, spec, 0.003)) as recorder:
        for command in commands:
            recorder.add(Sample(state, command))
            state = sim.read()
    back = [sample.command for sample in replay_samples(ReplayBackend(load(path)))]
    for before, after in zip(commands, back, strict=True):
        assert isinstance(after, PositionCommand)
        assert (after.limp, after.duration) == (before.limp, before.duration)
        np.testing.assert_array_equal(after.position, before.position)
        assert (after.effort is None) == (before.effort is None)
        if before.effort is not None:
            np.testing.assert_array_equal(after.effort, before.effort)


def test_the_file_of_one_hand_of_another_model_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"SAH030C033R.yaml is not of a leap: it has a `wire` block"):
        load_spec("leap", "right", "SAH030C033R")


@pytest.mark.parametrize("name", ["model_o", "sih", "qb_softhand"])
def test_coupled_joints_with_a_motor_each_are_where_their_tables_have_them(name: str) -> None:
    """To the bit, inside the limits and beyond them; with one motor for all they are where it leads them."""
    spec, random = load_spec(name), np.random.default_rng(0)
    driven = [each.driven for each in spec.followers]
    low, high = spec.lower[driven], spec.upper[driven]
    motors = low + (high - low) * np.vstack([random.uniform(-0.1, 1.1, (50, len(driven))), np.zeros_like(low)])
    expected = [
        [
            np.interp((at - low[k]) / (high[k] - low[k]), np.linspace(0.0, 1.0, len(each.positions)), each.positions)
            for k, (each, at) in enumerate(zip(spec.followers, row, strict=True))
        ]
        for row in motors
    ]
    np.testing.assert_array_equal(spec.coupled_each(motors), expected)
    posture = 0.3 * spec.lower + 0.7 * spec.upper
    np.testing.assert_array_equal(spec.coupled_each(posture[driven]), spec.coupled_positions(posture))
