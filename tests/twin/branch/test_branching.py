"""A recorded simulation goes on as it did, to the last bit, or otherwise from the instant of a change."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.app.rig import assemble
from allegro_twin.app.session import Outputs, perform
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.appearance import lighten, series_color
from allegro_twin.loop import run, until
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.spec import Finger, HandSpec
from allegro_twin.surfaces.cli.twin import branch_run
from allegro_twin.twin.branch.overrides import parse_changes
from allegro_twin.twin.branch.result import BranchOptions, BranchResult
from allegro_twin.twin.branch.what_if import branch_recording
from tests.viewing.test_viewer import rows_of


def made(tmp_path: Path, config: RunConfig) -> Path:
    path = tmp_path / "run.arrow"
    perform(assemble(config), config, Outputs(record=path))
    return path


@pytest.mark.parametrize("name", ["sim_right", "can_virtual", "sim_left"])
def test_without_a_change_the_future_is_the_recorded_one_bit_for_bit(tmp_path: Path, name: str) -> None:
    path = made(tmp_path, load_config(name).changed(seconds=1.0))
    found = branch_recording(path, 0.3, {})
    np.testing.assert_array_equal(found.branched, load(path).columns["position"])


def test_a_branch_is_not_recorded_over_the_recording_it_comes_from(tmp_path: Path) -> None:
    path = made(tmp_path, load_config("sim_right").changed(seconds=0.3))
    whole, link = path.read_bytes(), tmp_path / "link.arrow"
    link.symlink_to(path)
    for into in (path, link):
        with pytest.raises(ConfigError, match=r"--record .*: that is the recording itself; name another file"):
            branch_run.run_branch(path, 0.1, ["controller.gains=v4"], branch_run.BranchOutputs(into), BranchOptions())
    assert path.read_bytes() == whole


@pytest.mark.slow
def test_a_grasp_without_a_change_is_the_recorded_one_bit_for_bit(tmp_path: Path) -> None:
    content = {
        "backend": {"kind": "sim"}, "task": {"scenario": "lemon"}, "controller": {"kind": "pd"},
    }  # fmt: skip
    path, rrd = made(tmp_path, RunConfig.model_validate(content)), tmp_path / "if.rrd"
    same, kept = branch_recording(path, 6.0, {}), branch_run.BranchOutputs(tmp_path / "if.arrow", rrd)
    slippery = branch_run.run_branch(path, 6.0, ["friction=0.01"], kept, BranchOptions())
    np.testing.assert_array_equal(same.branched, same.recorded)
    assert same.report is not None
    assert same.report.held
    off = np.abs(slippery.branched - slippery.recorded).max(axis=1)
    assert not off[slippery.t <= 6.0].any()
    assert slippery.report is not None
    assert not slippery.report.held
    was, fell = (load(each).columns["object"] for each in (path, kept.record or path))
    np.testing.assert_array_equal(load(tmp_path / "if.arrow").columns["target_object"], was)
    assert fell[-1, 2] < was[-1, 2] - 0.05
    drawn = rows_of(rrd)
    for kind, height in (("objects", fell[-1, 2]), ("ghosts", was[-1, 2])):
        (name,) = [key for key in drawn if key.startswith(f"world/{kind}/") and not key.endswith("/look")]
        np.testing.assert_allclose(drawn[name][-1][1]["translation"][0][2], height, atol=0.01)
        assert drawn[f"{name}/look"]


@pytest.mark.parametrize("change", [{"controller.gains": "v4"}, {"damping": 0.3}, {"frictionloss": 0.1}])
def test_a_change_acts_from_its_instant_on(tmp_path: Path, change: dict[str, object]) -> None:
    path = made(tmp_path, load_config("sim_right").changed(seconds=1.0, task={"posture": "rock"}))
    found = branch_recording(path, 0.3, change)
    off = np.abs(found.branched - found.recorded).max(axis=1)
    assert not off[found.t <= 0.3].any()
    assert off[-1] > 1e-5


def test_both_futures_are_in_one_recording_one_rerun_file_and_one_picture(tmp_path: Path) -> None:
    path = made(tmp_path, load_config("sim_right").changed(seconds=0.6, task={"posture": "rock"}))
    record, rrd, png = (tmp_path / f"if.{suffix}" for suffix in ("arrow", "rrd", "png"))
    found = branch_run.run_branch(path, 0.3, ["damping=0.3"], branch_run.BranchOutputs(record, rrd), BranchOptions())
    branch_run.draw_branch(png, path, found, 0.3)
    both = load(record).columns
    np.testing.assert_array_equal(both["position"], found.branched)
    np.testing.assert_array_equal(both["target"], load(path).columns["position"])
    assert (both["target"][-1] != both["position"][-1]).any()
    drawn = rows_of(rrd)
    names = [row["names"] for t, row in drawn["joints/target/index"] if t is None]
    assert names[0][0] == "index_0 as it was"
    for kind in ("position", "target"):
        t, row = drawn[f"joints/{kind}/thumb"][-1]
        assert t is not None
        np.testing.assert_allclose(row["scalars"], both[kind][round(t / 0.003), 12:])
    assert drawn["world/palm/target/link_13.0"]
    with Image.open(png) as picture:
        pixels = np.asarray(picture).reshape(-1, 3)
    color = [round(255 * part) for part in lighten(series_color(1))]
    assert (pixels == color).all(axis=1).sum() > 100


def test_the_table_has_a_column_for_every_finger_of_whatever_hand(spec: HandSpec) -> None:
    two = (Finger("claw", (0, 1, 2), "claw_tip"), Finger("paw", (3, 4, 5, 6, 7), "paw_tip"))
    was, would = np.zeros((2, 8)), np.zeros((2, 8))
    would[1, 2], would[1, 7] = 0.001, 0.005
    found = BranchResult(np.array([0.0, 0.1]), was, would, replace(spec, fingers=two), None)
    table = branch_run.table(Path("r.arrow"), found, 0.0)
    assert [column.header for column in table.columns] == ["after", "claw", "paw"]
    assert [list(column.cells)[-1] for column in table.columns] == ["0.1 s", "1.000", "5.000"]


def test_what_cannot_be_repeated_says_why(tmp_path: Path, recording_path: Path) -> None:
    with pytest.raises(ConfigError, match="needs the first 1 s to know the hand"):
        branch_recording(recording_path, 0.1, {})
    path = made(tmp_path, load_config("sim_right").changed(seconds=0.3))
    with pytest.raises(ConfigError, match="--at 9 s: .* goes from 0 to 0.3 s"):
        branch_recording(path, 9.0, {})
    for key, value, said in (
        ("engine", "mujoco 3.1.0", "was made with mujoco 3.1.0, and this is mujoco"),
        ("config", {**load(path).meta["config"], "task": {"posture": "rock"}}, "is not repeated by this program"),
    ):
        other = tmp_path / f"{key}.arrow"
        meta = {**load(path).meta, key: value}
        config = load_config("sim_right").changed(seconds=0.3)
        with closing(assemble(config).backend) as backend:
            samples = until(0.3, run(backend, assemble(config).controller))
            for _ in record(samples, other, backend.spec, 0.003, meta=json.loads(json.dumps(meta))):
                pass
        with pytest.raises(ConfigError, match=said):
            branch_recording(other, 0.2, {})


def test_a_change_is_read_from_text_and_an_unknown_one_named() -> None:
    assert parse_changes(["friction=0.5", "controller.gains=v4"]) == {"friction": 0.5, "controller.gains": "v4"}
    for wrong, said in (
        ("friction", "say key=value"),
        ("fricton=1", "no key named 'fricton'; did you mean 'friction'"),
        ("damping=much", "damping needs a number, not much"),
    ):
        with pytest.raises(ConfigError, match=said):
            parse_changes([wrong])
