"""`allegro-twin plan`: from an object to files that run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from allegro_twin.grasping.plan.region import parse_region
from allegro_twin.grasping.plan.search import GraspSearch
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.objects.meshes import load_mesh, mesh_report
from allegro_twin.surfaces.cli.console import plan_table
from allegro_twin.surfaces.cli.grasps.plan import alternatives, scenario_of
from tests.sim.dirty_meshes import bottomless, cracker, moved, obj
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
        (["lemon", "--edge", "0.15"], "9 mm of it would stand out"),
        (["lemon", "--edge", "0.15", "--protocol", "fc"], "--edge is of a table; under fc there is none"),
        (["lemon", "--by", "x>5"], "is in the region x > 5; it reaches over x -0.034 to 0.034, y"),
        (["lemon", "--twin", "allegro"], "has no intervals to draw from"),
    ],
)
def test_what_cannot_be_planned_for_is_one_line(words: list[str], message: str, command: Run) -> None:
    code, _, errors = command("plan", *words)
    assert code == 2
    assert message in errors
    assert errors.count("\n") == 1


@pytest.mark.slow
def test_a_mesh_with_a_hole_is_closed_and_said_or_taken_as_its_hull(command: Run, tmp_path: Path) -> None:
    """A tetrahedron of 60 mm without one of its faces."""
    (tmp_path / "open.obj").write_text("v 0 0 0\nv .06 0 0\nv 0 .06 0\nv 0 0 .06\nf 1 3 2\nf 1 2 4\nf 1 4 3\n")
    code, _, said = command("new", tmp_path / "open.obj", "--hull", "--no-picture", "--out", tmp_path / "out")
    assert (code, said) == (0, "")
    assert "collision: hull" in (tmp_path / "out" / "open_new.yaml").read_text()
    assert command("new", "lemon", "--hull", "--out", tmp_path / "out")[2].endswith("lemon is of the catalogue\n")


def test_a_mesh_whose_mass_is_in_grams_is_refused_before_anything_is_searched(command: Run, tmp_path: Path) -> None:
    file = obj(tmp_path / "box.obj", cracker().vertices, cracker().faces.tolist())
    volume = load_mesh(file).volume
    for name in ("plan", "new"):
        code, _, errors = command(name, file, "--mass", 120, "--out", tmp_path / "out")
        assert code == 2
        assert f"object box: 120 kg in {1e6 * volume:.3g} cm³ is {120.0 / volume:,.0f} kg/m³" in errors
        assert errors.endswith("masses are in kg; if this is in g, say 0.12\n")


def test_a_table_of_fewer_grasps_than_were_asked_for_says_so() -> None:
    assert str(plan_table("lemon", [], 3).title) == "0 grasps of 3 asked for: lemon"
    assert str(plan_table("lemon", [], 0).title) == "0 grasps for lemon"


def test_where_no_pre_shape_goes_round_an_object_the_alternatives_that_were_not_taken_are_named() -> None:
    scenario, spec = scenario_of("lemon", "z", 1.0, None, 0.8), load_spec()
    edge, way = "--edge M, to push it over the table's edge first", "no pre-shape goes round it; try "
    search = GraspSearch(scenario, spec, ())
    assert alternatives(search) == f"{way}{edge}, or another --hand"
    narrow = replace(search, region=parse_region("x>0"), kind="Tripod")
    assert alternatives(narrow) == f"{way}{edge}, or another --hand, or another --by, or another --type"
    in_the_air = replace(search, scenario=scenario.model_copy(update={"protocol": "fc"}))
    assert alternatives(in_the_air) == f"{way}another --hand"


@pytest.mark.slow
def test_the_command_mesh_writes_a_closed_obj_a_picture_and_a_report(command: Run, tmp_path: Path) -> None:
    """A box of 60 × 40 × 20 mm, in mm, without its top, and inside out."""
    solid = bottomless(moved(cracker(), (0.0, 0.0, 0.0), 0.25))
    file = obj(tmp_path / "scan.obj", solid.vertices, solid.faces[:, ::-1].tolist(), 0.001)
    code, shown, errors = command("mesh", file, "--out", tmp_path / "clean.obj")
    assert (code, errors) == (0, "")
    assert "1 hole closed" in shown
    assert "volume 31.5 cm³" in shown
    assert {path.name for path in tmp_path.iterdir()} >= {"clean.obj", "clean.png", "clean.json"}
    assert load_mesh(tmp_path / "clean.obj").volume == pytest.approx(31.5e-6, rel=1e-4)
    assert mesh_report(tmp_path / "clean.obj") is None
    assert json.loads((tmp_path / "clean.json").read_text())["scale"] == 0.001


def test_the_command_mesh_refuses_what_is_no_length_and_to_write_over_what_it_reads(
    command: Run, tmp_path: Path
) -> None:
    file = obj(tmp_path / "scan.obj", cracker().vertices, cracker().faces.tolist(), 0.001)
    code, _, errors = command("mesh", file, "--tolerance", "2 miles")
    assert (code, errors.count("\n")) == (2, 1)
    assert "'2 miles' is no length" in errors
    assert "its unit is one of m, cm, mm" in errors
    code, _, errors = command("mesh", file, "--out", file)
    assert (code, errors.count("\n")) == (2, 1)
