"""`allegro-twin evaluate` and `compare`: from scenarios and files of grasps to a table, and a folder with a report."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from allegro_twin.errors import RecordingError
from allegro_twin.grasping.batch import trials
from allegro_twin.grasping.interchange.read import replaced_object
from allegro_twin.grasping.uncertainty import Uncertainty
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.surfaces.cli.grasps.trials import parse_variation
from allegro_twin.sweep import runner
from tests.app.files import grasps, scenario, short
from tests.grasping.interchange.samples import bench, saved
from tests.surfaces.cli.conftest import Run
from tests.sweep.work import as_bytes

ROOT = Path(__file__).resolve().parents[3]


def test_a_scenario_is_one_row_with_its_margin_and_the_exit_code_says_whether_it_held(
    command: Run, tmp_path: Path
) -> None:
    mine = scenario(tmp_path)
    code, shown, errors = command("evaluate", mine, "--protocol", short(tmp_path), "--jobs", 1)
    assert (code, errors) == (0, "")
    assert "1 of 1 held under short_10 7" in shown
    assert "tripod_lemon" in shown
    code, shown, _ = command("evaluate", mine, "--protocol", short(tmp_path, push=4000), "--jobs", 1)
    assert code == 5
    assert "lemon, tripod_lemon, right:" in shown
    assert "it is pushed with" in shown
    assert "it weighs" not in shown, "the protocol is without gravity"
    words = ("--protocol", short(tmp_path, push=4000), "--uncertainty", 1, "--jobs", 1)
    code, shown, _ = command("evaluate", mine, *words)
    assert code == 0, "a rate is no failure"
    assert "0 of 1 (0–79 %)" in shown


def test_scenarios_with_one_object_and_grasp_are_told_apart_and_objects_of_two_masses_are_not_pooled(
    command: Run, tmp_path: Path
) -> None:
    light = scenario(tmp_path)
    heavy = tmp_path / "heavier.yaml"
    heavy.write_text(light.read_text().replace("{name: lemon", "{name: lemon, mass: 0.035"))
    words = ("--protocol", short(tmp_path), "--jobs", 1)
    code, shown, said = command("evaluate", light, heavy, *words)
    assert code == 0
    assert "scenario" in shown
    assert "heavier" in shown
    assert "by object" not in shown
    assert "by grasp" in shown
    assert said == "no rates by object: lemon differs in mass or size between scenarios; see the rows\n"
    heavy.write_text(light.read_text())
    assert "by object: lemon 2 of 2" in command("evaluate", light, heavy, *words)[1]


def test_under_uncertainty_it_is_a_rate_with_its_interval_and_a_folder_keeps_all_of_it(
    command: Run, tmp_path: Path
) -> None:
    pytest.importorskip("scipy", reason="metrics of contacts need SciPy: extra objects")
    mine, out = scenario(tmp_path), tmp_path / "results"
    words = ("evaluate", mine, "--protocol", short(tmp_path), "--uncertainty", 2, "--vary", "torque=0", "--jobs", 1)
    code, shown, _ = command(*words, "--out", out)
    assert code == 0
    assert " of 2 (" in shown
    table = pq.read_table(out / "results.parquet")
    assert table["draw"].to_pylist() == [None, 0, 1]
    assert table["draw_torque"].to_pylist() == [None, 1.0, 1.0]
    assert len(set(table["draw_x"].to_pylist())) == 3
    assert table["epsilon"].to_pylist()[0] > 0.0
    stamps = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
    assert stamps["engine"].startswith("mujoco ")
    assert {"allegro_twin", "seed", "uncertainty", "scenario mine", "grasp tripod_lemon"} <= stamps.keys()
    assert stamps["protocol"] == "short_10 7"
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 1
    assert "epsilon" in page


def test_what_is_in_the_folder_is_not_tried_again_and_more_draws_go_on(
    command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried, run_cases = list[Any](), trials.run_cases

    def counted(shared: Any, items: Any) -> Any:
        tried.extend(items)
        return run_cases(shared, items)

    monkeypatch.setattr(trials, "run_cases", counted)
    words = ("evaluate", scenario(tmp_path), "--protocol", short(tmp_path), "--jobs", 1, "--out", tmp_path / "out")
    assert command(*words)[0] == 0
    assert command(*words, "--uncertainty", 1)[0] == 0
    assert [item["draw"] is None for item in tried] == [True, False]
    assert command(*words, "--uncertainty", 1)[0] == 0
    assert len(tried) == 2


@pytest.mark.slow
def test_what_changed_since_is_tried_again_in_the_same_folder_and_a_line_says_so(command: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--protocol", short(tmp_path), "--jobs", 1, "--out", out)
    assert command("evaluate", scenario(tmp_path), *words)[0] == 0
    before = pq.read_table(out / "results.parquet").to_pylist()
    code, _, errors = command("evaluate", scenario(tmp_path, friction=0.7), *words)
    assert code == 0
    said = f"{out}/trials: 1 rows were made with another scenario mine: they are made again; the old ones are in {out}"
    assert said in errors
    assert errors.count("\n") == 1
    after = pq.read_table(out / "results.parquet").to_pylist()
    assert after[0]["key"] != before[0]["key"]
    assert after[0]["drift_mm"] != before[0]["drift_mm"]
    assert command("evaluate", scenario(tmp_path, friction=0.7), *words)[2] == ""


def test_a_folder_of_other_targets_is_refused_in_a_line(command: Run, tmp_path: Path) -> None:
    words = ("--protocol", short(tmp_path), "--jobs", 1, "--out", tmp_path / "out")
    assert command("evaluate", scenario(tmp_path), *words)[0] == 0
    code, _, errors = command("evaluate", "mug", *words)
    assert code == 2
    assert "is of another sweep: targets mine right there, mug right here; give another folder" in errors
    assert errors.count("\n") == 1


def test_a_page_that_is_of_no_evaluation_is_not_replaced(command: Run, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("mine")
    words = ("--protocol", short(tmp_path), "--jobs", 1, "--out", tmp_path / "out")
    code, _, errors = command("evaluate", scenario(tmp_path), *words)
    assert (code, (tmp_path / "out" / "report.html").read_text()) == (2, "mine")
    assert "report.html: is of no evaluation, and is not replaced by one" in errors


def test_a_picture_that_the_disk_has_no_room_for_is_told_by_the_exit_code(
    command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(target: object, path: Path) -> None:
        raise RecordingError(f"cannot write {path}: No space left on device")

    monkeypatch.setattr("allegro_twin.app.portraits.portrait", full)
    words = ("--protocol", short(tmp_path), "--jobs", 1, "--out", tmp_path / "out")
    code, _, errors = command("evaluate", scenario(tmp_path), *words)
    assert code == 2
    assert "No space left on device" in errors
    assert (tmp_path / "out" / "report.html").is_file()


@pytest.mark.slow
def test_recordings_of_the_best_and_the_worst_of_each_object_are_linked_from_the_report(
    command: Run, tmp_path: Path
) -> None:
    pytest.importorskip("rerun", reason="recordings need Rerun: extra view")
    grasps(tmp_path / "others.npy", count=3)
    words = ("evaluate", tmp_path / "others.npy", "--object", "lemon", "--protocol", short(tmp_path), "--jobs", 1)
    code, shown, errors = command(*words, "--out", tmp_path / "out", "--rrd", "ends")
    assert (code, errors) == (0, "")
    made = sorted((tmp_path / "out" / "recordings").iterdir())
    assert len(made) == 2
    assert "2 recordings, " in shown
    page = (tmp_path / "out" / "report.html").read_text()
    links = re.findall(r'href="(recordings/[^"]+)">recording, \d\.\d MB', page)
    assert {(tmp_path / "out" / link).resolve() for link in links} == {path.resolve() for path in made}
    before = [path.stat().st_mtime_ns for path in made]
    assert command(*words, "--out", tmp_path / "out", "--rrd", "all")[0] == 0
    assert [path.stat().st_mtime_ns for path in made] == before
    assert len(list((tmp_path / "out" / "recordings").iterdir())) == 3


def test_grasps_of_a_file_are_rows_on_the_object_that_is_named(command: Run, tmp_path: Path) -> None:
    grasps(tmp_path / "others.npy", count=2)
    words = ("--object", "lemon", "--protocol", short(tmp_path), "--jobs", 1)
    code, shown, errors = command("evaluate", tmp_path / "others.npy", *words)
    assert (code, errors) == (0, "")
    assert "others_0" in shown
    assert "others_1" in shown
    assert "by object: lemon 2 of 2 (34–100 %)" in shown


def test_six_directions_have_a_margin_each_and_the_force_that_was_held(command: Run, tmp_path: Path) -> None:
    rules = short(tmp_path)
    rules.write_text(rules.read_text().replace("floating: true", "floating: true\ndirections: 6"))
    code, shown, _ = command("evaluate", scenario(tmp_path), "--protocol", rules, "--jobs", 1)
    assert code == 0
    for word in ("+x", "-z", "holds"):
        assert word in shown


def test_two_grasps_are_compared_in_the_same_draws(command: Run, tmp_path: Path) -> None:
    words = ("--protocol", short(tmp_path), "--uncertainty", 3, "--jobs", 1)
    code, shown, errors = command("compare", scenario(tmp_path), "--grasp", "power_sphere", *words)
    assert (code, errors) == (0, "")
    first, second, verdict = shown.strip().splitlines()
    assert first.startswith("tripod_lemon: held in ")
    assert second.startswith("power_sphere: held in ")
    assert " of 3 (" in first
    assert "p = " in verdict


def test_what_varies_is_said_in_millimetres_degrees_and_per_cent() -> None:
    found = parse_variation("position=5, yaw=3,size=2,mass=10,torque=15,friction=0.5-0.9")
    assert found == Uncertainty(position=0.005, yaw=3.0, size=0.02, mass=0.1, torque=0.15, friction=(0.5, 0.9))
    assert parse_variation("friction=0").friction is None
    assert parse_variation("") == Uncertainty()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["evaluate", "lemno"], "did you mean 'lemon'"),
        (["evaluate", "lemon", "--protocol", "table_pik"], "did you mean 'table_pick'"),
        (["evaluate", "lemon", "--rrd", "all"], "--rrd is kept beside the report: say --out FOLDER, too"),
        (["evaluate", "lemon", "--uncertainty", "0"], "--uncertainty must be positive and finite, not 0"),
        (["evaluate", "lemon", "--uncertainty", "2", "--vary", "weight=5"], "no variation named 'weight'"),
        (["evaluate", "lemon", "--uncertainty", "2", "--vary", "position"], "position=: must be a number"),
        (["evaluate", "lemon", "--uncertainty", "2", "--vary", "size=200"], "size"),
        (["evaluate", "lemon", "--vary", "size=2"], "--vary is for draws: say how many with --uncertainty N"),
        (["evaluate", "empty"], "empty: no scenarios in this folder"),
        (["evaluate", "sim_right"], "sim_right: no scenario; evaluate takes"),
        (["evaluate", "lemon", "lemon"], "lemon: asked for twice"),
        (["evaluate", "lemon", "--grasp", "nope"], "no grasp named 'nope'"),
        (["evaluate", "lemon", "--object", "nope"], "no object named 'nope'"),
        (["evaluate", "lemon", "--address", "here:1"], "--address is of a Ray cluster: say --engine ray, too"),
        (["evaluate", "nope.npy"], "no grasps at "),
        (["evaluate", "shadow.npy"], "22"),
        (["evaluate", "reach_right"], "missing argument"),
        (["compare", "lemon"], "compare takes two scenarios, or one and --grasp"),
        (["compare", "lemon", "lemon"], "are the same grasp on the same object"),
        (["compare", "lemon", "mug", "--side", "both"], "'both' is not one of 'right', 'left'"),
    ],
)
def test_what_cannot_be_evaluated_is_one_line(
    words: list[str], message: str, command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty").mkdir()
    record = bench(load_spec())
    wide = {key: np.concatenate([record[key], np.zeros(6)]) for key in record if key.endswith("_qpos")}
    saved(tmp_path / "shadow.npy", record | wide)
    monkeypatch.chdir(tmp_path)
    code, _, errors = command(*words)
    assert code == 2
    assert message in errors
    assert errors.count("\n") == 1


def test_recordings_without_rerun_are_one_line_before_anything_is_tried(
    command: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.delitem(sys.modules, "allegro_twin.viewing.rerun.viewer", raising=False)
    code, _, errors = command("evaluate", "lemon", "--rrd", "ends", "--out", tmp_path)
    assert code == 2
    assert "pip install 'allegro-twin[view]'" in errors
    assert errors.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_cluster_without_ray_is_one_line(command: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    code, _, errors = command("evaluate", "lemon", "--engine", "ray")
    assert code == 2
    assert "pip install 'allegro-twin[ray]'" in errors
    assert errors.count("\n") == 1


def test_an_interrupted_evaluation_says_how_many_trials_had_ended_and_where_they_are(
    command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes: list[int] = []

    def stopped(sweep: Any, store: Any, engine: Any, tell: Any) -> None:
        sizes.append(sweep.unit)
        tell(3, 41)
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "run", stopped)
    words = ("evaluate", scenario(tmp_path), "--uncertainty", 40, "--jobs", 2)
    out = tmp_path / "out"
    code, _, said = command(*words, "--out", out)
    assert (code, said) == (
        130,
        f"interrupted: 3 of 41 trials had ended; they are in {out}, and the same command goes on\n",
    )
    code, _, said = command(*words)
    assert (code, said) == (130, "interrupted: 3 of 41 trials had ended; none of them is kept\n")
    assert sizes == [6, 21]


@pytest.mark.long
def test_an_evaluation_that_is_killed_goes_on_and_repeats_nothing_that_was_finished(
    command: Run, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    words = ["evaluate", str(scenario(tmp_path)), "--protocol", str(short(tmp_path)), "--uncertainty", "63",
             "--jobs", "1", "--out", str(out)]  # fmt: skip
    begun = subprocess.Popen([sys.executable, "-m", "allegro_twin", *words], cwd=ROOT, env=os.environ)
    while not list(out.glob("trials/part-*")) and begun.poll() is None:
        time.sleep(0.01)
    begun.send_signal(signal.SIGKILL)
    begun.wait()
    before = {path: path.stat().st_mtime_ns for path in out.glob("trials/part-*")}
    finished = {key for path in before for key in pq.read_table(path)["key"].to_pylist()}
    assert 0 < len(finished) < 64
    assert command(*words)[0] == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before
    keys = [key for path in out.glob("trials/part-*") for key in pq.read_table(path)["key"].to_pylist()]
    assert len(keys) == len(set(keys)) == 64
    again = command(*words[:-1], tmp_path / "whole")
    assert again[0] == 0
    whole, resumed = (pq.read_table(path / "results.parquet") for path in (tmp_path / "whole", out))
    assert as_bytes(whole) == as_bytes(resumed)


GRASPS = """object: mug
grasps:
- object_pose: [0, 0, 0, 1, 0, 0, 0]
  scale: 80
  preshape: &a {pose: [0, 0, 0.1, 1, 0, 0, 0], angles: {index: [0, 0.5, 0.5, 0.5], middle: [0, 0.5, 0.5, 0.5],
    ring: [0, 0.5, 0.5, 0.5], thumb: [0.5, 0.5, 0.5, 0.5]}}
  close: *a
  squeeze: *a
"""


def test_what_of_a_grasp_file_another_object_replaces_is_said_in_a_line(tmp_path: Path) -> None:
    file, spec = tmp_path / "g.yaml", load_spec()
    file.write_text(GRASPS)
    assert replaced_object(file, "lemon", spec) == (
        "g.yaml: its grasps are for 'mug' and are tried on lemon; its scale (80) does not count: lemon has the "
        "catalogue's size"
    )
    assert replaced_object(file, "meshes/mug.stl", spec) == ""
