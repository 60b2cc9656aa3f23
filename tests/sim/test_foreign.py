"""Somebody else's MJCF of the hand, with other names and position servos, runs under our names."""

from __future__ import annotations

import sys
import types
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig
from allegro_twin.control.controllers import PD, GravityFeedforward
from allegro_twin.control.trajectory import Hold
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_posture
from allegro_twin.kinematics.hand import HandKinematics, hand_kinematics
from allegro_twin.loop import run, until
from allegro_twin.sim.model.scene import Stage, compile_scene, hand_spec
from allegro_twin.spec import Side
from allegro_twin.surfaces.cli.start.jobs import RunOptions as Options
from allegro_twin.surfaces.cli.start.jobs import configs_of
from allegro_twin.surfaces.hand import Hand
from tests.conftest import MakeSim

PREFIX = {"0": "ff", "1": "mf", "2": "rf", "3": "th"}


MASS = 1.5
"""Times ours: somebody else's hand weighs something else."""


def menagerie_like(folder: Path, side: Side) -> Path:
    """Our hand in Menagerie's clothes: its joint names and servos, fingertips that are bodies of their own and welded
    to the last link, and heavier links; and the file that maps them."""
    spec = mujoco.MjSpec.from_file(str(data_root() / "models" / "mjcf" / f"allegro_{side}.xml"))
    spec.modelfiledir, spec.meshdir = "", str(data_root() / "models" / "meshes")
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for joint in spec.joints:
        number = int(joint.name.split("_")[1].split(".")[0])
        joint.name = f"{PREFIX[str(number // 4)]}j{number % 4}"
        joint.damping = [0.1, 0, 0]
        servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=1.0)
    spec.body("palm_link").name = "palm"
    for exclude in spec.excludes:
        exclude.bodyname1 = exclude.bodyname1.replace("palm_link", "palm")
    for body in spec.bodies:
        body.mass *= MASS
        body.inertia, body.fullinertia = body.inertia * MASS, body.fullinertia * MASS
    tips = {}
    for finger, prefix, last, end in (
        ("index", "ff", 3, 0.0267),
        ("middle", "mf", 7, 0.0267),
        ("ring", "rf", 11, 0.0267),
        ("thumb", "th", 15, 0.0423),
    ):
        spec.delete(spec.site(f"link_{last}.0_tip"))
        distal, pad = spec.body(f"link_{last}.0"), spec.geom(f"link_{last}.0_tip")
        distal.name = f"{prefix}_distal"
        tip = distal.add_body(name=f"{prefix}_tip", mass=0.005, inertia=[1e-7] * 3, explicitinertial=True)
        tip.add_geom(
            type=pad.type, fromto=pad.fromto, size=pad.size, contype=pad.contype, conaffinity=pad.conaffinity, group=3
        )
        spec.delete(pad)
        tips[finger] = [f"{prefix}_tip", [0, 0, end]]
    (folder / "hand.xml").write_text(spec.to_xml())
    names = [f"{prefix}j{k}" for prefix in PREFIX.values() for k in range(4)]
    path = folder / "theirs.yaml"
    path.write_text(yaml.safe_dump({"mjcf": "hand.xml", "root": "palm", "joints": names, "tips": tips}))
    return path


def test_it_gets_our_joints_tips_torque_motors_and_sensors(tmp_path: Path, side: Side) -> None:
    spec = load_spec(side=side, serial=str(menagerie_like(tmp_path, side)))
    model = hand_spec(spec).compile()
    assert model.nu == 16
    for finger in spec.fingers:
        assert model.site(finger.tip).id >= 0
        assert model.sensor(f"{finger.name}_touch").dim[0] == 4
    for joint in spec.joints:
        assert model.actuator(joint).gainprm[0] == 1.0
        assert not model.actuator(joint).biasprm.any()


def fetched(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """robot_descriptions as it is when it has fetched a folder."""
    package, module, git = (types.ModuleType(name) for name in ("robot_descriptions", "description", "git"))
    module.PACKAGE_PATH = str(folder)  # type: ignore[attr-defined]  # What the real one has.
    git.GitError = type("GitError", (Exception,), {})  # type: ignore[attr-defined]  # Likewise.
    monkeypatch.setitem(sys.modules, "git", git)
    monkeypatch.setitem(sys.modules, "robot_descriptions", package)
    monkeypatch.setitem(sys.modules, "robot_descriptions.allegro_hand_mj_description", module)


def test_menagerie_is_found_by_robot_descriptions_where_it_is_installed(
    tmp_path: Path, side: Side, monkeypatch: pytest.MonkeyPatch
) -> None:
    menagerie_like(tmp_path, side)
    (tmp_path / "hand.xml").rename(tmp_path / f"{side}_hand.xml")
    fetched(monkeypatch, tmp_path)
    assert hand_spec(load_spec(side=side, serial=f"menagerie_{side}")).compile().nu == 16
    (tmp_path / f"{side}_hand.xml").unlink()
    with pytest.raises(ConfigError, match=f"robot_descriptions has no {side}_hand.xml in"):
        hand_spec(load_spec(side=side, serial=f"menagerie_{side}"))


def test_menagerie_that_is_nowhere_says_both_ways_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "git", None)
    words = r"pip install 'allegro-twin\[menagerie\]' fetches it, or set `mjcf` in its file to your copy"
    with pytest.raises(ConfigError, match=words):
        hand_spec(load_spec(serial="menagerie_right"))


def test_it_goes_home_and_ends_where_our_own_hand_does(tmp_path: Path, side: Side, make_sim: MakeSim) -> None:
    theirs, ours = load_spec(side=side, serial=str(menagerie_like(tmp_path, side))), load_spec(side=side)
    home = load_posture("home", ours)
    ends = []
    for spec in (theirs, ours):
        controller = PD(
            Hold(home), load_gains("default", spec), GravityFeedforward(hand_kinematics(spec).gravity_torque)
        )
        backend = make_sim(spec)
        for sample in until(1.0, run(backend, controller)):
            last = sample.state.position
        tips = np.array([backend.data.site(f.tip).xpos.copy() for f in spec.fingers])
        ends.append((last, tips))
    np.testing.assert_allclose(ends[0][0], home, atol=0.015)
    np.testing.assert_allclose(ends[0][1], ends[1][1], atol=3e-4)


def test_gravity_jacobians_and_fingertips_are_those_of_the_model_in_use(tmp_path: Path, side: Side) -> None:
    spec = load_spec(side=side, serial=str(menagerie_like(tmp_path, side)))
    turn = np.array([0.6, 0.48, 0.0, 0.64])
    model = compile_scene(spec, Stage(np.array([0.1, 0.2, 0.3]), turn))
    data, ours = mujoco.MjData(model), hand_kinematics(spec)
    places = [int(model.joint(name).qposadr[0]) for name in spec.joints]
    palm = model.body("palm_link").id
    for posture in np.random.default_rng(3).uniform(spec.lower, spec.upper, (20, 16)):
        data.qpos[places] = posture
        mujoco.mj_forward(model, data)
        down = data.xmat[palm].reshape(3, 3).T @ model.opt.gravity
        weight = data.qfrc_bias[[int(model.joint(name).dofadr[0]) for name in spec.joints]]
        np.testing.assert_allclose(ours.gravity_torque(posture, down), weight, atol=1e-12)
        for finger, pose in ours.fingertips(posture).items():
            seen = data.site(spec.finger(finger).tip).xpos - data.xpos[palm]
            np.testing.assert_allclose(pose.position, data.xmat[palm].reshape(3, 3).T @ seen, atol=1e-12)
    heavy, light = (
        hand_kinematics(s).gravity_torque(spec.lower, np.array([0.0, 9.81, 0.0])) for s in (spec, load_spec(side=side))
    )
    assert (heavy / light > MASS).all()


def test_nobody_takes_our_weights_for_another_hands(tmp_path: Path) -> None:
    spec = load_spec(serial=str(menagerie_like(tmp_path, "right")))
    for model in (hand_kinematics(spec), HandKinematics(spec)):
        theirs, ours = (
            each.gravity_torque(spec.lower, [0.0, 9.81, 0.0]) for each in (model, hand_kinematics(load_spec()))
        )
        assert (theirs / ours > MASS).all()


def test_a_hand_that_carries_its_own_weight_stays_where_it_is(tmp_path: Path, side: Side) -> None:
    serial = str(menagerie_like(tmp_path, side))
    blocks = {
        "hand": {"side": side, "serial": serial},
        "backend": {"kind": "sim", "facing": [0, 0, 1], "fingers": [1, 0, 0], "start": "ready"},
        "controller": {"kind": "gravity"},
    }
    rig = assemble(RunConfig.model_validate(blocks))
    before = rig.backend.reset().position
    last = list(until(5.0, run(rig.backend, rig.controller)))[-1]
    assert abs(last.state.position - before).max() < 0.005


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(path.stem, marks=() if path.stem == "apple" else pytest.mark.long)
        for path in sorted((data_root() / "scenarios" / "demo").glob("*.yaml"))
    ],
)
def test_its_welded_fingertips_hold_an_object_and_are_credited_with_it(name: str, tmp_path: Path, side: Side) -> None:
    serial = str(menagerie_like(tmp_path, side))
    (job,) = configs_of([name], Options(hand=serial, side=side))
    rig = assemble(job.config)
    assert rig.trial is not None
    assert rig.seconds is not None
    for _ in rig.trial.watched(until(rig.seconds, run(rig.backend, rig.controller))):
        pass
    report = rig.trial.report()
    assert report.held, report.reason


def test_its_fingertips_are_moved_where_its_geometry_is_ours(tmp_path: Path) -> None:
    path = menagerie_like(tmp_path, "right")
    blocks = {"hand": {"serial": str(path)}, "backend": {"kind": "sim", "start": "home"}, "controller": {"kind": "pid"}}
    with Hand.open(RunConfig.model_validate(blocks)) as hand:
        there = hand.fingertips()["index"].position + np.array([0.0, 0.0, -0.005])
        hand.move_fingertips({"index": there})
        assert abs(hand.fingertips()["index"].position - there).max() < 0.002
    path.write_text(path.read_text().replace("0.0267", "0.0367"))
    with Hand.open(RunConfig.model_validate(blocks)) as hand, pytest.raises(ConfigError, match=r"10\.0 mm from where"):
        hand.move_fingertips({"index": there})


def test_a_hand_of_one_side_is_not_taken_for_the_other(tmp_path: Path) -> None:
    path = menagerie_like(tmp_path, "left")
    path.write_text(path.read_text() + "wire: {side: left}\n")
    (job,) = configs_of(["lemon"], Options(hand=str(path)))
    assert job.config.hand.side == "left"
    with pytest.raises(ConfigError, match=r"theirs\.yaml is a left hand; hand\.side is right"):
        assemble(configs_of(["lemon"], Options(hand=str(path), side="right"))[0].config)


def test_a_name_that_the_file_does_not_have_is_given_with_the_nearest(tmp_path: Path) -> None:
    path = menagerie_like(tmp_path, "right")
    path.write_text(path.read_text().replace("- ffj0", "- ffj9"))
    with pytest.raises(ConfigError, match=r"no joint named 'ffj9'; did you mean 'ffj"):
        hand_spec(load_spec(serial=str(path)))


def test_a_map_that_is_not_complete_says_what_is_missing(tmp_path: Path) -> None:
    path = menagerie_like(tmp_path, "right")
    content = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump(content | {"joints": content["joints"][:15]}))
    with pytest.raises(ConfigError, match="joints has 15 names; the hand has 16"):
        load_spec(serial=str(path))
    path.write_text(yaml.safe_dump(content | {"mjcf": "elsewhere.xml"}))
    with pytest.raises(ConfigError, match=r"no MJCF at .*elsewhere\.xml"):
        hand_spec(load_spec(serial=str(path)))
