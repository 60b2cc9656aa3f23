"""Somebody else's MJCF of the hand, with other names and position servos, runs under our names."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from allegro_twin.control.controllers import PD, Gravity
from allegro_twin.control.trajectory import Hold
from allegro_twin.description.hands import load_spec
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.kinematics.model import HandModel
from allegro_twin.library.gains import load_gains
from allegro_twin.library.named import load_posture
from allegro_twin.loop import run, until
from allegro_twin.sim.scene import hand_spec
from allegro_twin.spec import Side
from tests.conftest import MakeSim

PREFIX = {"0": "ff", "1": "mf", "2": "rf", "3": "th"}


def menagerie_like(folder: Path, side: Side) -> Path:
    """Our hand in Menagerie's clothes: its joint names, tip bodies and servos; and the file that maps them."""
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
    tips = {}
    for finger, prefix, last, end in (
        ("index", "ff", 3, 0.0267),
        ("middle", "mf", 7, 0.0267),
        ("ring", "rf", 11, 0.0267),
        ("thumb", "th", 15, 0.0423),
    ):
        spec.delete(spec.site(f"link_{last}.0_tip"))
        spec.body(f"link_{last}.0").name = f"{prefix}_distal"
        tips[finger] = [f"{prefix}_distal", [0, 0, end]]
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


def test_it_goes_home_and_ends_where_our_own_hand_does(tmp_path: Path, side: Side, make_sim: MakeSim) -> None:
    theirs, ours = load_spec(side=side, serial=str(menagerie_like(tmp_path, side))), load_spec(side=side)
    home = load_posture("home", ours)
    ends = []
    for spec in (theirs, ours):
        controller = PD(Hold(home), load_gains("default", spec), Gravity(HandModel(spec).gravity_torque))
        backend = make_sim(spec)
        for sample in until(1.0, run(backend, controller)):
            last = sample.state.position
        tips = np.array([backend.data.site(f.tip).xpos.copy() for f in spec.fingers])
        ends.append((last, tips))
    np.testing.assert_allclose(ends[0][0], home, atol=0.015)
    np.testing.assert_allclose(ends[0][1], ends[1][1], atol=1e-4)


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
