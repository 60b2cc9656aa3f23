"""`allegro-twin plan`: from an object to files that run."""

from __future__ import annotations

import json
import math
import signal
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import yaml

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.assets import find_file
from allegro_twin.files.output_folder import UNFINISHED
from allegro_twin.grasping.plan import save, validate
from allegro_twin.grasping.plan import search as searching
from allegro_twin.grasping.plan.region import parse_region
from allegro_twin.grasping.plan.search import GraspSearch
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.plan.validate import PlannedGrasp
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.grasping.statistics import count_pairs
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entry_files import name_from
from allegro_twin.sim.objects import catalogue
from allegro_twin.sim.objects.meshes import load_mesh, mesh_report
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.cli.console import plan_table
from allegro_twin.surfaces.cli.grasps import improve
from allegro_twin.surfaces.cli.grasps.plan import alternatives, judging, restless, scenario_of, search_failure
from tests.sim.dirty_meshes import bottomless, cracker, moved, obj
from tests.surfaces.cli.conftest import Run

Found = Callable[..., None]


@pytest.fixture
def finds(monkeypatch: pytest.MonkeyPatch) -> Found:
    """Let searches find one grasp at once, and do something else besides."""

    def having(besides: Callable[[GraspSearch], None] = lambda search: None) -> None:
        def run(search: GraspSearch, *_: Any) -> list[PlannedGrasp]:
            search.closed = 5
            besides(search)
            candidate: Any = SimpleNamespace(direction="above", template="tripod_lemon")
            return [PlannedGrasp(candidate, search.scenario, search.templates[0], 16, 16, margin=0.5, sustained=0.5)]

        monkeypatch.setattr(GraspSearch, "run", run)
        monkeypatch.setattr(validate, "judge_planned", lambda *_: None)

    having()
    return having


def never(search: GraspSearch) -> None:
    pytest.fail("the search has begun")


@pytest.mark.long
def test_plan_writes_grasps_that_run_with_a_picture_of_each(command: Run, tmp_path: Path) -> None:
    folder = tmp_path / "plans"
    code, shown, errors = command("plan", "lemon", "--n", 2, "--out", folder, "--keep", tmp_path / "library")
    assert code == 0
    assert errors.startswith("the search is over: 2 grasps; each is now judged on 20 fresh draws, ")
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
        (["lemon", "--twin", "allegro"], "--twin allegro is what every allegro is: name one hand's own file"),
        (["lemon", "--hand", "SAH030C033R"], "is one hand's own file, and --hand names its model: say --twin "),
    ],
)
def test_what_cannot_be_planned_for_is_one_line(words: list[str], message: str, command: Run) -> None:
    code, _, errors = command("plan", *words)
    assert code == 2
    assert message in errors
    assert errors.count("\n") == 1


def test_a_region_off_a_mesh_is_refused_before_the_mesh_is_cut_into_pieces(
    command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(catalogue, "convex_parts", lambda *_: pytest.fail("the mesh is cut"))
    file = obj(tmp_path / "box.obj", cracker().vertices, cracker().faces.tolist())
    for more in ([], ["--edge", "0.15"], ["--seeds", "2"]):
        code, _, errors = command("plan", file, "--mass", 0.4, "--by", "x>0.5", *more, "--out", tmp_path / "out")
        assert (code, errors.count("\n")) == (2, 1)
        assert "object box: nothing of its surface is in the region x > 0.5; it reaches over x " in errors


def test_a_library_that_cannot_take_what_is_found_is_refused_before_anything_is_searched(
    command: Run, finds: Found, tmp_path: Path
) -> None:
    finds(never)
    (file := tmp_path / "file").touch()
    (mine := tmp_path / "mine").mkdir()
    (mine / "lemon_1.yaml").write_text("kind: posture\nangles: {}\n")
    (library := tmp_path / "library").mkdir()
    (library / "others.yaml").write_text("entries: {lemon_2: {kind: posture, angles: {}}}\n")
    (broken := tmp_path / "broken").mkdir()
    (broken / "mine.yaml").write_text("lemon_1: [\n")
    for folder, message in (
        (file, f"cannot write {file / 'lemon_1.yaml'}: "),
        (library, "'lemon_2' is in "),
        (mine, "'lemon_1' is in "),
        (broken, "mine.yaml"),
    ):
        given = command("plan", "lemon", "--n", 2, "--out", tmp_path / "out", "--keep", folder)
        assert (given[0], given[2].count("\n")) == (2, 1), given[2]
        assert message in given[2]


def test_a_plan_for_one_left_hand_is_judged_with_its_drive_and_says_whose_it_is(
    command: Run, finds: Found, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[HandSpec] = []
    monkeypatch.setattr(validate, "judge_planned", lambda found, spec, *_: judged.append(spec))
    mine = tmp_path / "mine.yaml"
    mine.write_text("wire: {version: v4, side: left}\ndrive: {delay: 0.004}\n")
    out = tmp_path / "out"
    assert command("plan", "lemon", "--n", 1, "--twin", mine, "--no-pictures", "--out", out)[0] == 0
    assert (judged[0].side, judged[0].drive is not None) == ("left", True)
    scenario, _ = load_scenario(out / "lemon_1.yaml")
    assert (scenario.side, "and the hand of mine.yaml" in scenario.description) == ("left", True)
    code, _, said = command("plan", "lemon", "--twin", mine, "--side", "right", "--out", out)
    assert (code, "mine.yaml is a left hand" in said) == (2, True)


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
    scenario, spec = scenario_of("lemon", "z", None, None, 0.8), load_spec()
    edge, way = (
        "--edge M, to push it over the table's edge first",
        "no pre-shape goes round it: too large, too flat or too small for the hand; try ",
    )
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


def test_the_command_mesh_replaces_no_picture_and_no_text_but_its_own(command: Run, tmp_path: Path) -> None:
    file = obj(tmp_path / "scan.obj", cracker().vertices, cracker().faces.tolist(), 0.001)
    for name, content in (("bowl.png", b"a texture"), ("bowl.json", b'{"file": "mine"}')):
        theirs = tmp_path / name
        theirs.write_bytes(content)
        code, _, errors = command("mesh", file, "--out", tmp_path / "bowl.obj")
        assert (code, errors.count("\n")) == (2, 1)
        assert f"{name} beside it is none of this command's: choose another name" in errors
        assert theirs.read_bytes() == content
        assert not (tmp_path / "bowl.obj").exists()
        theirs.unlink()
    for _ in range(2):
        assert command("mesh", file, "--out", tmp_path / "bowl.obj")[0] == 0


def test_grasps_of_a_mesh_are_named_after_its_file_as_nearly_as_names_allow(
    command: Run, tmp_path: Path, finds: Found
) -> None:
    assert [name_from(each, "") for each in ("Coke-Can", "can off", "Töpfchen", "006_mustard")] == [
        "coke_can", "can_off", "topfchen", "object_006_mustard",
    ]  # fmt: skip
    file = obj(tmp_path / "Can Off.obj", cracker().vertices, cracker().faces.tolist())
    code, _, said = command("plan", file, "--no-pictures", "--out", tmp_path / "out")
    assert (code, said) == (0, f"{file}: its grasps and files are named can_off\n")
    assert load_scenario(tmp_path / "out" / "can_off_1.yaml")[0].objects[0].name == "can_off"
    finds(never)
    file.rename(tmp_path / "箱.obj")
    code, _, said = command("plan", tmp_path / "箱.obj", "--out", tmp_path / "out")
    assert (code, said.count("\n")) == (2, 1)
    assert "has no letter a to z and no digit to name grasps by; rename the file" in said


def test_a_folder_that_cannot_take_a_plan_is_refused_before_the_search(
    command: Run, tmp_path: Path, finds: Found
) -> None:
    (tmp_path / UNFINISHED).mkdir()
    (tmp_path / UNFINISHED / "mine").touch()
    finds(never)
    code, _, said = command("plan", "lemon", "--out", tmp_path)
    assert (code, "stands where a run is written" in said) == (2, True)
    finds()
    (tmp_path / UNFINISHED / "mine").unlink()  # Empty, it is nobody's.
    assert command("plan", "lemon", "--no-pictures", "--out", tmp_path)[0] == 0
    assert not (tmp_path / UNFINISHED).exists()


def test_grasps_that_the_disk_does_not_take_are_printed(
    command: Run, tmp_path: Path, finds: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise RecordingError("cannot write it: No space left on device")

    monkeypatch.setattr(save, "save_grasps", full)
    code, shown, said = command("plan", "lemon", "--out", tmp_path / "p")
    assert (code, said) == (2, "allegro-twin: cannot write it: No space left on device\n")
    _, scenario, grasp = shown.split(f"# {tmp_path}/p/")
    assert yaml.safe_load(scenario.partition("\n")[2])["grasp"] == "grasps/lemon_1.yaml"
    assert set(yaml.safe_load(grasp.partition("\n")[2])) >= {"kind", "preshape", "close", "squeeze", "planned"}
    assert not (tmp_path / "p").exists()


def test_a_plan_names_the_files_of_the_one_before_that_were_changed_by_hand(
    command: Run, tmp_path: Path, finds: Found
) -> None:
    for change in (False, True):
        code, _, said = command("plan", "lemon", "--no-pictures", "--out", tmp_path)
        assert (code, said) == (0, "")
        if change:
            file = tmp_path / "grasps" / "lemon_1.yaml"
            file.write_text(file.read_text() + "# Mine.\n")
    code, _, said = command("plan", "lemon", "--no-pictures", "--out", tmp_path)
    assert said == f"{file}: changed since the plan before, and replaced by what this one finds\n"


def test_an_interrupted_search_returns_what_has_held_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = load_spec()
    search = GraspSearch(scenario_of("lemon", "z", None, None, 0.8), spec, grasp_templates(spec))

    def stopped(rounds: Any, tell: object) -> None:
        candidate: Any = SimpleNamespace(score=1.0)
        for confirmed in (True, None):
            rounds._prover.options.append(
                PlannedGrasp(candidate, search.scenario, search.templates[0], confirmed=confirmed)
            )
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(searching._Rounds, "_go_round", stopped)
    (found,) = search.run(1, searching.SearchBudget())
    assert (search.interrupted, found.confirmed) == (True, True)


def test_an_interrupted_plan_keeps_what_it_has_found_and_says_so(command: Run, tmp_path: Path, finds: Found) -> None:
    finds(lambda search: setattr(search, "interrupted", True))
    code, shown, said = command("plan", "lemon", "--n", 2, "--out", tmp_path / "p")
    assert code == 130
    assert said == "interrupted: 1 of 2 grasps had held the whole trial, 0 of them judged on fresh draws\n"
    assert "Judged afterwards" not in shown
    assert {path.name for path in (tmp_path / "p").glob("*.*")} >= {"lemon_1.yaml"}
    finds(lambda search: signal.raise_signal(signal.SIGINT))
    code, shown, said = command("plan", "lemon", "--out", tmp_path / "q")
    assert (code, shown) == (130, "")
    assert said == "interrupted after 5 candidates before a grasp had held the whole trial: nothing is written\n"
    assert not (tmp_path / "q").exists()


def test_improve_and_mesh_say_that_they_were_interrupted(command: Run, tmp_path: Path, finds: Found) -> None:
    from allegro_twin.grasping.plan.improve import GraspImprovement
    from allegro_twin.sim.objects import clean_mesh

    def stop(*_: Any) -> None:
        signal.raise_signal(signal.SIGINT)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(GraspImprovement, "run", stop)
        patch.setattr(clean_mesh, "clean_mesh", stop)
        code, _, said = command("improve", "lemon", "--out", tmp_path / "p")
        assert (code, said) == (130, "interrupted: 0 of 3 rounds had ended; nothing is compared or written\n")
        code, _, said = command("mesh", tmp_path / "scan.ply")
        assert (code, said.endswith("was not repaired to the end: nothing is written\n")) == (130, True)


def test_improve_is_of_one_hand_by_its_file_or_of_the_side_that_its_scenario_says(
    command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from allegro_twin.grasping.plan.improve import GraspImprovement

    seen: list[tuple[str, str, bool]] = []

    def run(search: GraspImprovement, tell: Any) -> None:
        seen.append((search.spec.side, search.scenario.side, search.spec.drive is not None))
        raise ConfigError("enough")

    monkeypatch.setattr(GraspImprovement, "run", run)
    (mine := tmp_path / "mine.yaml").write_text("wire: {version: v4, side: left}\ndrive: {delay: 0.004}\n")
    scenario = yaml.safe_load(find_file("lemon", "scenario", "scenarios", below=True).read_text())
    (left := tmp_path / "left.yaml").write_text(yaml.safe_dump(scenario | {"side": "left"}))
    for words in (["lemon", "--hand", mine], [left], ["lemon", "--side", "left"], ["lemon"]):
        command("improve", *words, "--out", tmp_path / "p")
    assert seen == [("left", "left", True), *[("left", "left", False)] * 2, ("right", "right", False)]
    code, _, said = command("improve", "lemon", "--hand", "leap")
    assert (code, said.endswith("is of one: name one hand's own file\n")) == (2, True)


def test_improve_of_another_object_has_it_where_the_scenarios_own_stands() -> None:
    scenario, _, _, _ = improve._load_start("lemon", None, "foam_brick", load_spec())
    own, other = load_scenario("lemon")[0].objects[0], scenario.objects[0]
    assert (other.name, other.yaw, other.at) == ("foam_brick", own.yaw, own.at)
    assert own.yaw != 0.0


@pytest.mark.parametrize(
    ("found", "only_before", "sustained", "written"),
    [(True, 0, False, True), (True, 3, False, False), (False, 0, False, False), (True, 3, True, True)],
)
def test_improve_writes_what_holds_no_fewer_draws_than_before(
    command: Run, tmp_path: Path, found: bool, only_before: int, sustained: bool, written: bool
) -> None:
    """Also fewer, where motors that sustain less were asked for."""
    from allegro_twin.grasping.plan.improve import GraspImprovement, GraspVariant, ImprovementResult

    def run(search: GraspImprovement, tell: Any) -> ImprovementResult:
        version = GraspVariant(search.scenario, search.grasp)
        pair = count_pairs([True] * 40, [k >= only_before for k in range(40)])
        return ImprovementResult(version, version, found, pair, (("index_1", 0.7), ("index_1", 0.5)))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(GraspImprovement, "run", run)
        more = ("--sustained", 0.6) if sustained else ()
        code, shown, _ = command("improve", "lemon", "--out", tmp_path / "p", *more)
    assert (code, (tmp_path / "p").exists()) == ((0, True) if written else (5, False))
    assert ("Play it" in shown, "Nothing is written" in shown) == (written, not written)


@pytest.mark.parametrize(("hand", "fast", "said"), [
    ("allegro", 10, ""), ("allegro", 11, "11 of 100 draws a joint moved faster than it may"),
    ("qb_softhand", 11, "the trial was stopped"),
])  # fmt: skip
def test_a_hand_that_coarse_physics_shakes_is_said_to_be(hand: str, fast: int, said: str) -> None:
    """Its draws say no for a reason that is not the grasp's; a hand whose card knows its step has no such way out."""
    spec = load_spec(hand)
    search = GraspSearch(scenario_of("lemon", "z", None, None, 0.8), spec, grasp_templates(spec))
    search.drawn.update({"draws": 100, "too fast": fast})
    line = restless(search)
    assert said in line if said else not line
    assert ("coarsest_step" in line) == (bool(said) and hand == "allegro")


def test_where_nothing_holds_every_candidate_is_lost_once_and_the_numbers_add_up() -> None:
    search: Any = SimpleNamespace(ends=Counter({"passed": 12, "lift": 1, "empty": 2, "whole trial": 2}))
    assert search_failure(search) == (
        "of 15 candidates that physics closed, 2 while closing, for they touched nothing, 1 in the lift were lost; 12 "
        "were lifted and turned; squeezed in several ways each, 2 ways came through draws to the whole trial, where "
        "2 dropped it; the budget ended the search: give it more --time, or --candidates"
    )
    search.ends = Counter({"pushed out": 3, "elsewhere": 1})
    assert search_failure(search).startswith("3 were pushed out of the hand; 1 held it elsewhere than by --by; the")


def test_a_scale_of_one_is_one_that_was_said(command: Run, tmp_path: Path) -> None:
    file = obj(tmp_path / "box.obj", cracker().vertices, cracker().faces.tolist(), 0.001)
    for words in (["mesh", file], ["plan", file], ["new", file]):
        code, _, said = command(*words, "--scale", 1)
        assert (code, said.count("\n")) == (2, 1)
        assert "m across" in said
    with pytest.raises(ConfigError, match="--scale and --mass are for meshes"):
        scenario_of("lemon", "z", 1.0, None, 0.8)


def test_a_search_that_is_over_says_what_judging_its_grasps_takes_on_top() -> None:
    known, unknown = (cast(GraspSearch, SimpleNamespace(whole=whole)) for whole in (2.0, math.nan))
    assert judging(known, 5) == (
        "the search is over: 5 grasps; each is now judged on 20 fresh draws, up to about 200 CPU-s"
    )
    assert judging(unknown, 1) == "the search is over: 1 grasp; each is now judged on 20 fresh draws"
