"""`allegro-twin plan`: from an object to files that run."""

from __future__ import annotations

from pathlib import Path

import pytest

from allegro_twin.grasping.scenario import load_scenario
from tests.surfaces.cli.conftest import Run


@pytest.mark.long
def test_plan_writes_grasps_that_run_with_a_picture_of_each(command: Run, tmp_path: Path) -> None:
    folder = tmp_path / "plans"
    code, shown, errors = command("plan", "lemon", "--n", 2, "--out", folder, "--keep", tmp_path / "library")
    assert (code, errors) == (0, "")
    assert "2 grasps for lemon" in shown
    names = {path.name for path in folder.iterdir()}
    assert names >= {"lemon_1.yaml", "lemon_2.yaml", "lemon_1.png", "overview.png", "grasps"}
    assert load_scenario(folder / "lemon_1.yaml")[0].objects[0].name == "lemon"
    assert (tmp_path / "library" / "lemon_2.yaml").exists()
    assert command("run", folder / "lemon_1.yaml")[0] == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["lemno"], "did you mean 'lemon'"),
        (["lemon", "--scale", "0.001"], "--scale and --mass are for meshes"),
        (["lemon", "--friction", "3"], "--friction is at most 1, not 3.0"),
        (["lemon", "--type", "Medium Warp"], "Medium Wrap"),
        (["lemon", "--time", "-1"], "--time must be positive"),
        (["nowhere.stl"], "no file"),
    ],
)
def test_what_cannot_be_planned_for_is_one_line(words: list[str], message: str, command: Run) -> None:
    code, _, errors = command("plan", *words)
    assert code == 2
    assert message in errors
    assert errors.count("\n") == 1


@pytest.mark.slow
def test_a_mesh_with_a_hole_is_refused_with_a_way_out_that_each_command_has(command: Run, tmp_path: Path) -> None:
    """A tetrahedron of 60 mm without one of its faces."""
    (tmp_path / "open.obj").write_text("v 0 0 0\nv .06 0 0\nv 0 .06 0\nv 0 0 .06\nf 1 3 2\nf 1 2 4\nf 1 4 3\n")
    for name in ("plan", "new"):
        code, _, said = command(name, tmp_path / "open.obj", "--out", tmp_path / "out")
        assert (code, said.count("\n")) == (2, 1)
        assert "--hull of `plan` and `new`" in said
    code, _, said = command("new", tmp_path / "open.obj", "--hull", "--no-picture", "--out", tmp_path / "out")
    assert (code, said) == (0, "")
    assert "collision: hull" in (tmp_path / "out" / "open_new.yaml").read_text()
    assert command("new", "lemon", "--hull", "--out", tmp_path / "out")[2].endswith("lemon is of the catalogue\n")
