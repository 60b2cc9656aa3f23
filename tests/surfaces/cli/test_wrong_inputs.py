"""Nothing wrong is accepted and nothing ends in a traceback: the whole table, and what the API is asked for wrongly.

`pytest tests/surfaces/cli/test_wrong_inputs.py -q` prints the table with the answers.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin import Hand, HandError, load_config
from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Hold
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_posture
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.loop import run, until
from allegro_twin.recording.recorder import record
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.scene import Stage, compile_scene
from tests.surfaces.cli.wrong import TABLE, Wrong, answered, workspace

ROOT = Path(__file__).resolve().parents[3]
EXTRAS = ["mink", "daqp", "ruckig", "onnxruntime", "stable_baselines3", "torch", "onnx", "tensorboard", "tqdm", "h5py",
          "mujoco_warp", "warp", "rerun", "av", "PIL",
          "cyclonedds", "rosbags", "rospy", "dex_retargeting", "mediapipe", "cv2"]  # fmt: skip
"""What every extra of pyproject.toml brings."""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wrong")
    spec = load_spec()
    hand = SimBackend(
        spec, compile_scene(spec, Stage(np.zeros(3), quaternion_facing((1, 0, 0), (0, 0, 1)))), period=0.003
    )
    controller = PD(Hold(load_posture("home", spec)), load_gains("default", spec))
    path = tmp_path_factory.mktemp("recording") / "r.arrow"
    for _ in record(until(0.03, run(hand, controller)), path, spec, 0.003):
        pass
    hand.close()
    workspace(folder, path)
    return folder


@pytest.fixture(scope="module")
def told(request: pytest.FixtureRequest) -> Iterator[list[str]]:
    """Lines that are printed when all rows were tried; pytest captures what tests print."""
    lines: list[str] = []
    yield lines
    capture = request.config.pluginmanager.getplugin("capturemanager")
    if capture is not None and lines:
        with capture.global_and_fixture_disabled():
            sys.stdout.write("\n" + "\n".join(lines) + f"\n{len(lines)} wrong inputs\n")


@pytest.mark.parametrize("row", TABLE, ids=[row.typed for row in TABLE])
def test_a_wrong_input_is_one_line_that_names_it(
    row: Wrong, place: Path, told: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place)
    monkeypatch.setattr(sys, "argv", [])
    for name in ("console", "errors"):
        monkeypatch.setattr(f"allegro_twin.surfaces.cli.console.{name}", None)
    before = contents(place)
    code, errors = answered(row.typed)
    told.append(f"[{code}] {row.typed}\n     {errors.strip()}")
    assert row.names in errors
    assert (code, errors.count("\n"), errors[-1]) == (row.code, 1, "\n")
    assert errors.startswith("allegro-twin")
    assert contents(place) == before


def contents(folder: Path) -> dict[str, int]:
    """Every file; empty folders may be made on the way."""
    files = [path for path in folder.rglob("*") if not path.is_dir()]
    return {str(path): path.lstat().st_size for path in files}


def test_the_table_has_more_than_a_hundred_rows_and_none_twice() -> None:
    assert len({row.typed for row in TABLE}) == len(TABLE) > 100


def without(packages: list[str], rows: list[str], folder: Path) -> dict[str, tuple[int, str]]:
    """What the command line answers to some rows in a process without some packages."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.surfaces.cli.wrong", folder, *packages],
        cwd=ROOT, input=json.dumps(rows), capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict[str, tuple[int, str]] = {key: (code, text) for key, (code, text) in json.loads(done.stdout).items()}
    return found


# Each package that an extra brings, with the commands that need it, and which extra the line must name.
NEEDED = [
    ("rerun", "view", ["run sim_right --seconds 0.01 --rrd a.rrd", "run sim_right --seconds 0.01 --web",
                       "view r.arrow --web", "view r.arrow", "export r.arrow a.rrd", "keyboard --web"]),
    ("av", "view", ["run sim_right --seconds 0.01 --video a.mp4"]),
    ("cyclonedds", "ros2", ["ros2 sim_right"]),
    ("rosbags", "ros2", ["export r.arrow x.mcap"]),
    ("PIL", "view", ["run sim_right --seconds 0.01 --image a.png", "gallery pictures",
                     "run sim_right --out results"]),
    ("onnxruntime", "policy", ["run sim_right --policy reach_right --goal ok", "evaluate reach_right Reach"]),
    ("torch", "rl", ["train Reach"]),
    ("stable_baselines3", "rl", ["train Reach"]),
    ("onnx", "rl", ["train Reach"]),
    ("tensorboard", "rl", ["train Reach"]),
    ("h5py", "demos", ["export r.arrow set-v0 --format minari", "export minari a.arrow"]),
    ("ruckig", "trajectory", ["grasp optimal.yaml"]),
]  # fmt: skip
WORKS = ["list", "list policies", "envs", "hand show", "export r.arrow a.csv"]
"""What needs no extra."""


def kitchen(place: Path, folder: Path) -> Path:
    """A folder with what the commands of NEEDED and WORKS speak of."""
    (folder / "r.arrow").write_bytes((place / "r.arrow").read_bytes())
    (folder / "minari/data").mkdir(parents=True)
    (folder / "minari/data/main_data.hdf5").write_bytes(b"")
    grasp = (ROOT / "conf/grasps/tripod.yaml").read_text()
    (folder / "optimal.yaml").write_text(grasp.replace("speed: 1.0", "speed: 1.0\nprofile: time_optimal"))
    return folder


def names_in_a_line(extra: str, answer: tuple[int, str]) -> bool:
    """Whether an answer says which extra to install, in one line, and ends with the code of that."""
    code, errors = answer
    ends = 0 if "no pictures" in errors else 2  # A run into a folder is not for its pictures.
    return f"pip install 'allegro-twin[{extra}]'" in errors and (errors.count("\n"), code) == (1, ends)


@pytest.mark.slow
def test_without_any_extra_the_table_is_answered_in_one_line_each(place: Path) -> None:
    found = without(EXTRAS, [row.typed for row in TABLE], place)
    for row in TABLE:
        code, errors = found[row.typed]
        assert (code, errors.count("\n")) in {(row.code, 1), (2, 1)}, row
        assert row.names in errors or "pip install 'allegro-twin[" in errors, row


@pytest.mark.slow
def test_without_any_extra_what_needs_one_says_which_and_the_rest_works(place: Path, tmp_path: Path) -> None:
    needed = {typed: extra for _, extra, rows in NEEDED for typed in rows}
    found = without(EXTRAS, [*needed, *WORKS], kitchen(place, tmp_path))
    for typed, extra in needed.items():
        assert names_in_a_line(extra, found[typed]), (typed, found[typed])
    assert {typed: found[typed] for typed in WORKS} == dict.fromkeys(WORKS, (0, ""))


@pytest.mark.long
@pytest.mark.parametrize(("package", "extra", "rows"), NEEDED, ids=[row[0] for row in NEEDED])
def test_without_one_package_what_needs_it_says_which_extra_to_install(
    package: str, extra: str, rows: list[str], place: Path, tmp_path: Path
) -> None:
    for typed, answer in without([package], rows, kitchen(place, tmp_path)).items():
        assert names_in_a_line(extra, answer), (typed, answer)


Ask = Callable[[Hand], object]
ASKED: list[tuple[str, Ask, str]] = [
    ("open", lambda hand: Hand.open("nope"), "no config named 'nope'"),
    ("load_config", lambda hand: load_config("lemon"), r"\('lemon' is a scenario\)"),
    ("wait nan", lambda hand: hand.wait(float("nan")), "not nan"),
    ("wait inf", lambda hand: hand.wait(float("inf")), "not inf"),
    ("wait backwards", lambda hand: hand.wait(-1.0), "not -1.0"),
    ("move_to speed", lambda hand: hand.move_to("home", 1e9), "it is 1e\\+09"),
    ("move_to nan", lambda hand: hand.move_to(np.full(16, np.nan)), "every value must be finite"),
    ("move_to short", lambda hand: hand.move_to(np.zeros(3)), "one value or 16"),
    (
        "fingertips fast",
        lambda hand: hand.move_fingertips({"index": near(hand)}, 1e9),
        "12 is where the guard stops: slow down to",
    ),
    ("fingertips slow", lambda hand: hand.move_fingertips({"index": near(hand)}, 1e-9), "at least 1e-05"),
    ("fingertips far", lambda hand: hand.move_fingertips({"index": [1, 1, 1]}), "the nearest point in reach is"),
    ("fingertips finger", lambda hand: hand.move_fingertips({"pinky": [0, 0, 0]}), "no finger named 'pinky'"),
    ("fingertips shape", lambda hand: hand.move_fingertips({"index": [0, 0]}), "three finite numbers"),
    ("grasp force", lambda hand: hand.grasp("grasp_3", force=1000.0), "at most 5.8 N"),
    ("grasp width", lambda hand: hand.grasp("tripod", 5.0), "spans"),
    ("play speed", lambda hand: hand.play("ripple", 1e9), "12 is where the guard stops: slow down to"),
    ("controller", lambda hand: hand.set_controller("pids"), "no controller named 'pids'"),  # type: ignore[arg-type]
    ("torque", lambda hand: hand.set_controller("torque", torque=np.inf), "every value must be finite"),
    ("gravity", lambda hand: setattr(hand, "gravity", [0.0, 1.0]), "three finite numbers"),
    (
        "gravity word",
        lambda hand: setattr(hand, "gravity", "down"),
        "three finite numbers .*; not 'down'",
    ),
    ("gravity rows", lambda hand: setattr(hand, "gravity", [[0.0], [1.0, 2.0]]), "three finite numbers"),
    ("margin", lambda hand: hand.set_margin(9.0), "leaves some joint no range"),
]


def near(hand: Hand) -> Any:
    return hand.fingertips()["index"].position - np.array([0.0, 0.0, 0.01])


@pytest.fixture(scope="module")
def hand() -> Iterator[Hand]:
    with Hand.open("sim_right") as opened:
        opened.move_to("home", 3.0)
        yield opened


@pytest.mark.parametrize(("ask", "names"), [row[1:] for row in ASKED], ids=[row[0] for row in ASKED])
def test_a_wrong_call_is_refused_by_name_and_moves_nothing(ask: Ask, names: str, hand: Hand) -> None:
    before = hand.state.t
    with pytest.raises(HandError, match=names) as refused:
        ask(hand)
    assert "\n" not in str(refused.value)
    assert hand.state.t == before


# Sends this process what Ctrl-C does while a library is being imported.
INTERRUPTED = """
import os, signal, sys
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == {library!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupts())
sys.argv = ["allegro-twin", "run", "lemon"]
from allegro_twin.__main__ import main
main()
"""


@pytest.mark.parametrize(
    "library",
    [
        "typer",
        "mujoco",
        *(
            pytest.param(name, marks=pytest.mark.long)
            for name in ("numpy", "pydantic", "allegro_twin.app.session", "pinocchio")
        ),
    ],
)
def test_ctrl_c_while_libraries_are_imported_is_exit_code_130_and_silence(library: str) -> None:
    code = INTERRUPTED.format(library=library)
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


# On a disk that takes so many bytes of a file and no more: what each command answers in a folder of its own.
FULL = """
import json, os, resource, signal, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from tests.surfaces.cli.wrong import answered
found = {}
for typed, folder in json.loads(sys.stdin.read()).items():
    os.chdir(folder)
    found[typed] = answered(f"export r.arrow {typed}")
sys.__stdout__.write(json.dumps(found))
"""
EXPORTS = ["set --format lerobot", "set-v0 --format minari", "bag --format rosbag2", "a.csv", "a.parquet", "a.mcap"]
Answers = dict[str, tuple[Path, int, str]]


@pytest.fixture(scope="module")
def on_a_full_disk(place: Path, tmp_path_factory: pytest.TempPathFactory) -> Answers:
    folders = {typed: tmp_path_factory.mktemp("full") for typed in EXPORTS}
    for folder in folders.values():
        (folder / "r.arrow").write_bytes((place / "r.arrow").read_bytes())
    done = subprocess.run(
        [sys.executable, "-c", FULL], input=json.dumps({typed: str(folder) for typed, folder in folders.items()}),
        cwd=ROOT, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return {typed: (folders[typed], code, errors) for typed, (code, errors) in json.loads(done.stdout).items()}


@pytest.mark.slow
@pytest.mark.parametrize("typed", EXPORTS)
def test_a_full_disk_leaves_nothing_half_written(typed: str, on_a_full_disk: Answers) -> None:
    folder, code, errors = on_a_full_disk[typed]
    assert code == 2, errors
    assert errors.startswith("allegro-twin: cannot write")
    assert errors.count("\n") == 1
    assert [path.name for path in folder.iterdir()] == ["r.arrow"]
