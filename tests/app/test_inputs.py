"""A trial's key covers all that the trial reads, and nothing else: each input is changed in turn in a copy."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from allegro_twin.app.config import RunConfig
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.fingerprints import reached_sources
from allegro_twin.files.schema import parse_settings
from tests.app.files import grasps
from tests.app.test_campaign import BLOCK

PROGRAM = Path(__file__).with_name("inputs_program.py")
BALL, LEAP, OPEN, MESH, FILE = range(5)
ALL = {BALL, LEAP, OPEN, MESH, FILE}
ALLEGRO = {BALL, MESH, FILE}
CHANGES: list[tuple[str, str, str, set[int]]] = [
    ("conf/hands/allegro.yaml", "frictionloss: 0.02", "frictionloss: 0.05", ALLEGRO),
    ("conf/hands/allegro.yaml", "damping: 0.0735", "damping: 0.0736", ALLEGRO),
    ("conf/hands/allegro.yaml", "torque_constant: 1.0", "torque_constant: 1.1", ALLEGRO),
    ("conf/hands/allegro.yaml", "# The Allegro", "# An Allegro", set()),
    ("conf/gains/allegro.yaml", "kp: 12", "kp: 6", {BALL, MESH}),
    ("models/mjcf/allegro_right.xml", 'mass="0.5124"', 'mass="0.5125"', ALLEGRO),
    ("models/urdf/allegro_right.urdf", 'value="0.5124"', 'value="0.5125"', ALLEGRO),
    ("models/allegro.yaml", "limit: [-0.470, 0.470]", "limit: [-0.470, 0.480]", ALLEGRO),
    ("models/leap.yaml", "limit: [-0.314, 2.230]", "limit: [-0.314, 2.231]", {LEAP}),
    ("models/urdf/leap_right.urdf", 'value="0.237"', 'value="0.238"', {LEAP}),
    ("conf/hands/menagerie_right.yaml", "ffj2, ffj3", "ffj3, ffj2", {FILE}),  # How the file's joints are read.
    ("conf/hands/leap.yaml", "stiffness: 3.0", "stiffness: 3.1", {LEAP}),
    ("models/mjcf/leap_right.xml", 'mass="0.237"', 'mass="0.238"', {LEAP}),
    ("conf/hands/model_o.yaml", "effort: 2.45", "effort: 2.44", {OPEN}),
    ("models/mjcf/model_o_right.xml", 'mass="0.375"', 'mass="0.376"', {OPEN}),
    ("conf/objects/ycb.yaml", "size: [42.7],           mass: 46", "size: [42.7],           mass: 47", {BALL, OPEN}),
    ("conf/objects/ycb.yaml", "size: [42.7]", "size: [42.8]", {BALL, OPEN}),
    ("conf/objects/ycb.yaml", "mass: 118}", "mass: 119}", {FILE}),
    ("conf/appearance/objects.yaml", "#", "# Looks. #", set()),
    ("conf/protocols/table_pick.yaml", "seconds: 2.0, check", "seconds: 2.1, check", ALL - {FILE}),
    ("conf/protocols/fc.yaml", "version: ", "version: 1", {FILE}),
    ("scenarios/demo/golf_ball.yaml", "friction: 0.8", "friction: 0.7", {BALL}),
    ("scenarios/demo/golf_ball.yaml", "description: ", "description: A ball. ", set()),
    ("conf/grasps/palmar_pinch.yaml", "speed: ", "speed: 1", {BALL}),
    ("mine.yaml", "friction: 0.", "friction: 0.1", {MESH}),
    ("block.obj", "v 0.04 0.02 0.06", "v 0.04 0.02 0.0600001", {MESH}),
    ("conf/hands/sih.yaml", "effort: 1.0", "effort: 1.1", set()),
    ("models/mjcf/allegro_left.xml", 'mass="0.5124"', 'mass="0.5125"', set()),
    ("conf/training/grasp_easy.yaml", "seed: ", "seed: 1", set()),
]
"""What is changed in which file, and of which targets the key must change."""
LOOKS = ("conf/appearance/", "conf/grasps/", "scenarios/", "conf/postures/", "conf/trajectories/")
"""Where pictures and names come from: a trial that opens one of these is not made of all that stand there."""


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package and its data, and a mesh and grasps of a user's own."""
    folder = tmp_path_factory.mktemp("copied")
    for name in ("conf", "models", "scenarios"):
        shutil.copytree(data_root() / name, folder / name)
    package = Path(sys.modules["allegro_twin"].__file__ or "").parent
    shutil.copytree(package, folder / "allegro_twin", ignore=shutil.ignore_patterns("__pycache__", "_data"))
    (folder / "block.obj").write_text(BLOCK)
    text = (folder / "scenarios/demo/pudding_box.yaml").read_text()
    own = "objects: [{name: block, shape: mesh, file: block.obj}]"
    lines = [own if line.startswith("objects:") else line for line in text.splitlines()]
    (folder / "mine.yaml").write_text("\n".join(lines))
    grasps(folder / "0.npy", thing="mug")
    return folder


def asked(
    folder: Path, changes: list[tuple[str, str, str]], targets: list[str], *, tried: bool = False
) -> dict[str, Any]:
    given = json.dumps({"targets": targets, "changes": changes, "try": tried})
    done = subprocess.run(
        [sys.executable, str(PROGRAM)], cwd=folder, input=given, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(folder)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def changed_file(folder: Path) -> str:
    """The key of the last target with another file of grasps, which has one more of them."""
    before = (folder / "0.npy").read_bytes()
    grasps(folder / "0.npy", thing="mug", count=2)
    (key,) = asked(folder, [], ["0.npy"])["before"]
    (folder / "0.npy").write_bytes(before)
    return str(key)


TARGETS = [
    "scenarios/demo/golf_ball.yaml", "scenarios/leap/leap_lemon.yaml", "scenarios/model_o/model_o_golf_ball.yaml",
    "mine.yaml", "0.npy",
]  # fmt: skip


@pytest.mark.slow
def test_every_input_that_changes_changes_the_keys_of_its_trials_and_of_no_others(copied: Path) -> None:
    found = asked(copied, [(name, old, new) for name, old, new, _ in CHANGES], TARGETS, tried=True)
    assert len(set(found["before"])) == len(TARGETS)
    assert found["restored"] == found["before"]
    for (name, old, new, expected), after in zip(CHANGES, found["after"], strict=True):
        changed = {k for k, (was, now) in enumerate(zip(found["before"], after, strict=True)) if was != now}
        assert changed == expected, f"{name}: {old!r} became {new!r}"
    known = {name for name, *_ in CHANGES} | {"0.npy"}
    read = {Path(os.path.normpath(copied / path)) for path in found["read"]}
    ours = {path.relative_to(copied).as_posix() for path in read if path.is_relative_to(copied)}
    data = {
        path for path in ours if not path.endswith(".py") and "__pycache__" not in path and not path.startswith(LOOKS)
    }
    assert changed_file(copied) != found["before"][FILE]
    assert data <= known, "a trial opens a file that no change above covers"


@pytest.mark.slow
def test_code_that_a_trial_can_reach_is_in_its_key_and_other_code_is_not(copied: Path) -> None:
    target, first = TARGETS[:1], "from __future__ import annotations\n"
    modules = ("allegro_twin/surfaces/panel/host.py", "allegro_twin/grasping/verdict.py")
    found = asked(copied, [(path, first, f"{first}_ADDED = 1\n") for path in modules], target)
    assert [keys != found["before"] for keys in found["after"]] == [False, True]
    reached = {name.removeprefix("allegro_twin.") for name in reached_sources("allegro_twin.grasping.batch.trials")}
    assert reached >= {
        "grasping.verdict",
        "sim.contact.probe",
        "errors",
        "grasping.batch.trials",
        "control.laws",
        "spec",
    }
    assert not reached & {
        "surfaces.panel.host",
        "surfaces.cli.main",
        "learning.training.report",
        "cell.run",
        "surfaces.ros.bridge",
    }


@pytest.mark.slow
def test_every_module_that_trials_load_is_among_the_sources_that_count() -> None:
    program = (
        "import sys; from allegro_twin.grasping.batch.trials import run_cases;"
        "run_cases({'threads': 1, 'metrics': True}, [{'scenario': name, 'protocol': 'quick'} for name in"
        " ('lemon', 'leap_lemon', 'pinch_index', 'model_o_lemon')]);"
        "print(*(name for name in sys.modules if name.split('.')[0] == 'allegro_twin'))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) <= reached_sources("allegro_twin.grasping.batch.trials").keys()


@pytest.mark.parametrize(
    ("blocks", "said"),
    [
        ({"backend": {"kind": "can", "version": "v4", "interface": "allegro-virtual", "gravity": [0, 0, 9810]}},
         r"gravity \[0\.0, 0\.0, 9810\.0\] is 9810 m/s² strong, and on no planet it is more than 30"),
        ({"controller": {"kind": "gravity", "gravity": [0, 0, -98]}}, "is 98 m/s² strong"),
        ({"limits": {"velocity": 1000}}, "1000 rad/s limits no joint: it must be above 0 and at most 60"),
        ({"limits": {"velocity": [12.0] * 15 + [0.0]}}, "0 rad/s limits no joint"),
    ],
)  # fmt: skip
def test_a_gravity_or_a_limit_in_another_unit_is_refused(blocks: dict[str, Any], said: str) -> None:
    content = {"backend": {"kind": "sim"}, "controller": {"kind": "pd"}} | blocks
    with pytest.raises(ConfigError, match=said):
        parse_settings(RunConfig, content, "config")
