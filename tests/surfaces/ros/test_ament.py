"""The files for people who have ROS 2 fit the hand, as far as files can be checked without it."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import typer.main
import yaml

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.spec import Side
from allegro_twin.surfaces.cli.main import app
from allegro_twin.surfaces.ros.hand_topics import NAMESPACE
from allegro_twin.surfaces.ros.joint_trajectory import TRAJECTORY
from allegro_twin.version import __version__

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ROOT / "ros" / "allegro_twin_ros"


def test_the_manifest_names_the_package_its_version_and_every_tool_that_is_used() -> None:
    manifest = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert manifest.get("format") == "3"
    assert (manifest.findtext("name"), manifest.findtext("version")) == (PACKAGE.name, __version__)
    assert f"project({PACKAGE.name})" in (PACKAGE / "CMakeLists.txt").read_text()
    needed = {each.text for each in manifest.iter("exec_depend")}
    assert {"launch", "launch_ros", "rviz2", "xacro"} <= needed


def test_the_launch_file_is_python_and_uses_options_that_the_command_has() -> None:
    tree = ast.parse((PACKAGE / "launch/hand.launch.py").read_text())
    texts = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    command = typer.main.get_command(app).commands["ros2"]  # type: ignore[attr-defined]  # It is a group.
    known = {name for parameter in command.params for name in parameter.opts}
    assert {text for text in texts if text.startswith("--")} <= known
    assert any(isinstance(node, ast.FunctionDef) and node.name == "generate_launch_description" for node in tree.body)
    assert NAMESPACE in texts


@pytest.mark.parametrize("side", ["right", "left"])
def test_xacro_makes_a_urdf_of_either_hand_with_an_interface_a_joint(side: Side) -> None:
    pytest.importorskip("xacro", reason="needs xacro: extra dev")
    models = ROOT / "models"
    arguments = [f"side:={side}", f"models:={models}"]
    done = subprocess.run(
        [sys.executable, "-c", "import xacro; xacro.main()", str(PACKAGE / "urdf/allegro_hand.urdf.xacro"), *arguments],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    robot = ElementTree.fromstring(done.stdout)
    spec = load_spec(side=side)
    moving = [joint.get("name") for joint in robot.findall("joint") if joint.get("type") == "revolute"]
    assert sorted(map(str, moving)) == sorted(spec.joints)
    control = robot.find("ros2_control")
    assert control is not None
    assert [joint.get("name") for joint in control.findall("joint")] == list(spec.joints)
    parameters = {each.get("name"): each.text for each in control.iter("param")}
    assert parameters["joint_commands_topic"] == f"{NAMESPACE}/joint_cmd"
    assert parameters["joint_states_topic"] == f"{NAMESPACE}/joint_states"


def test_the_controllers_drive_every_joint_under_the_name_of_the_bridges_topic() -> None:
    content = yaml.safe_load((PACKAGE / "config/controllers.yaml").read_text())
    name = TRAJECTORY.split("/")[0]
    assert name in content["controller_manager"]["ros__parameters"]
    assert content[name]["ros__parameters"]["joints"] == list(load_spec().joints)
    view = yaml.safe_load((PACKAGE / "config/hand.rviz").read_text())
    model = next(each for each in view["Visualization Manager"]["Displays"] if each["Name"] == "Hand")
    assert model["Description Topic"]["Value"] == f"{NAMESPACE}/robot_description"
