"""Targets become items, stamped with all that their rows depend on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.app.portraits import ends_of_objects, staged, worth_showing
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.batch.trials import TrialRunner, run_cases
from allegro_twin.grasping.evaluation.campaign import (
    JUDGE,
    EvaluationTarget,
    SamplingSettings,
    TargetOptions,
    find_targets,
    make_campaign,
)
from allegro_twin.grasping.evaluation.outcomes import compare_pairs, rates, summarise
from allegro_twin.grasping.interchange.dexgraspbench import write_dexgraspbench
from allegro_twin.grasping.interchange.read import import_grasp
from allegro_twin.grasping.metrics.trial_metrics import NAMES, trial_metrics
from allegro_twin.grasping.scenario import load_protocol
from allegro_twin.grasping.timeline import make_stage
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.limits import hand_limits
from allegro_twin.hands.settings import LimitSettings
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard
from allegro_twin.sim.objects.meshes import mesh_middle
from allegro_twin.spec import Side
from allegro_twin.sweep import Sweep
from tests.app.files import grasps, scenario, short

BLOCK = """v 0 0 0
v 0.04 0 0
v 0.04 0.02 0
v 0 0.02 0
v 0 0 0.06
v 0.04 0 0.06
v 0.04 0.02 0.06
v 0 0.02 0.06
f 1 4 3 2
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""


def sweep_of(targets: list[EvaluationTarget], noise: SamplingSettings) -> Sweep:
    items, shared, stamps, inputs = make_campaign(targets, noise)
    return Sweep(JUDGE, items, shared, stamps=stamps, inputs=inputs)


def differing(one: Sweep, other: Sweep) -> set[str]:
    there, here = one.fingerprints(), other.fingerprints()
    return {name for name in there.keys() | here.keys() if there.get(name) != here.get(name)}


def test_more_draws_are_the_same_sweep_and_whatever_changes_rows_is_another(tmp_path: Path) -> None:
    asked = TargetOptions(str(short(tmp_path)))
    mine = find_targets([scenario(tmp_path)], asked)
    few, more = sweep_of(mine, SamplingSettings(1)), sweep_of(mine, SamplingSettings(3))
    assert more.keys()[:2] == few.keys()
    assert len(more.items) == 4
    assert more.items[0]["draw"] is None
    assert sweep_of(mine, SamplingSettings(1, seed=1)).all_stamps()["seed"] == "1"
    short(tmp_path).write_text(short(tmp_path).read_text().replace("seconds: 0.15, push", "seconds: 0.16, push"))
    longer = sweep_of(find_targets([scenario(tmp_path)], asked), SamplingSettings(1))
    assert longer.question() == few.question()
    assert differing(longer, few) == {"protocol short_10"}
    other = sweep_of(find_targets([scenario(tmp_path, friction=0.7)], asked), SamplingSettings(1))
    assert differing(other, longer) == {"scenario mine", "scene of allegro_right at mine"}
    assert len({few.keys()[0], longer.keys()[0], other.keys()[0]}) == 3


def test_both_sides_are_two_targets_and_twice_the_same_is_refused(tmp_path: Path) -> None:
    path = scenario(tmp_path)
    assert [target.side for target in find_targets([path], TargetOptions(sides=("right", "left")))] == ["right", "left"]
    with pytest.raises(ConfigError, match="mine: asked for twice"):
        find_targets([path, path])


def test_grasps_of_a_file_are_tried_without_a_table_and_do_not_mix_with_other_protocols(tmp_path: Path) -> None:
    grasps(tmp_path / "0.npy", count=2)
    found = find_targets([tmp_path / "0.npy"], TargetOptions(object="lemon"))
    assert [(target.name, target.item["protocol"]) for target in found] == [("0_0", "fc"), ("0_1", "fc")]
    assert "grasps 0.npy" in sweep_of(found, SamplingSettings()).all_stamps()
    with pytest.raises(ConfigError, match=r"know of no table, which table_pick has: say --protocol fc"):
        find_targets([tmp_path / "0.npy"], TargetOptions("table_pick", object="lemon"))
    with pytest.raises(ConfigError, match=r"different protocols do not compare: fc \(0_1\), table_pick \(mine\)"):
        find_targets([tmp_path / "0.npy", scenario(tmp_path)], TargetOptions(object="lemon"))


@pytest.mark.parametrize("hand", ["leap", "model_o"])
def test_grasps_of_a_file_are_judged_with_the_hand_that_it_names(tmp_path: Path, hand: str) -> None:
    grasps(tmp_path / "0.npy", hand=hand)
    asked = TargetOptions(str(short(tmp_path, push=0.5)), object="lemon")
    (found,) = find_targets([tmp_path / "0.npy"], asked)
    assert (found.spec.model, found.case.scenario.hand) == (hand, hand)
    (row,) = run_cases({"threads": 1}, [found.item])
    assert row["hand"] == hand
    with pytest.raises(ConfigError, match=f"is of the hand {hand}; this one is allegro"):
        find_targets([tmp_path / "0.npy"], replace(asked, hand="allegro"))


def test_trials_with_one_hands_own_file_have_its_side_and_its_motors(tmp_path: Path) -> None:
    weak = tmp_path / "weak.yaml"
    weak.write_text("wire: {version: v4, side: left, pwm_limit: 20}\n")
    path, protocol = scenario(tmp_path), str(short(tmp_path))
    plain, mine = (find_targets([path], TargetOptions(protocol, ("left",), serial=s)) for s in ("", str(weak)))
    assert [target.side for target in find_targets([path], TargetOptions(protocol, serial=str(weak)))] == ["left"]
    stall = []
    for targets in (plain, mine):
        items, shared, *_ = make_campaign(targets, SamplingSettings())
        stall += [row["stall"] for row in run_cases(shared, items)]
    assert stall[1] > stall[0]
    assert sweep_of(mine, SamplingSettings()).question() != sweep_of(plain, SamplingSettings()).question()
    with pytest.raises(ConfigError, match=r"weak.yaml is a left hand; hand.side is right"):
        find_targets([path], TargetOptions(protocol, ("right",), serial=str(weak)))


def test_trials_with_a_drive_have_it_as_a_run_has(tmp_path: Path) -> None:
    late = tmp_path / "late.yaml"
    late.write_text("wire: {version: v4, side: right}\ndrive: {delay: 0.012}\n")
    (target,) = find_targets([scenario(tmp_path)], TargetOptions(str(short(tmp_path)), serial=str(late)))
    items, shared, *_ = make_campaign([target], SamplingSettings())
    (row,) = run_cases(shared, items)
    bench = TrialRunner(target.spec)
    trial = bench.trial(target.case)
    for _ in until(trial.seconds, trial.watched(run(Guard(trial.backend, bench.limits), bench.controller(trial)))):
        pass
    (plain,) = run_cases({"threads": 1}, items)
    assert row["drift_mm"] == 1e3 * max(phase.drift for phase in trial.report().phases if phase.check)
    assert row["drift_mm"] != plain["drift_mm"]


def test_rates_of_both_hands_are_told_apart_for_they_perform_the_same_draws() -> None:
    rows = [{"object": "lemon", "side": side, "success": 1.0, "n": 6, "target": "lemon"} for side in ("right", "left")]
    assert [(rate.name, rate.n) for rate in rates(rows, "object")] == [("lemon, right", 6), ("lemon, left", 6)]
    assert [(rate.name, rate.n) for rate in rates(rows[:1] * 2, "object")] == [("lemon", 12)]


def test_the_palm_is_where_the_file_has_it_from_the_middle_of_the_mesh(tmp_path: Path) -> None:
    mesh = tmp_path / "block.obj"
    mesh.write_text(BLOCK)
    made = grasps(tmp_path / "0.npy", count=2, thing="block.obj")
    found = import_grasp(tmp_path / "0.npy", 1, load_spec())
    assert found.scenario.objects[0].file == mesh
    wrist = found.scenario.wrist
    np.testing.assert_allclose(wrist.position, made.palm[1, 1, :3] - mesh_middle(mesh), atol=1e-12)
    np.testing.assert_allclose(mesh_middle(mesh), [0.02, 0.01, 0.03], atol=1e-12)
    np.testing.assert_allclose(np.cross(wrist.facing, wrist.fingers) @ np.cross(wrist.facing, wrist.fingers), 1.0)
    np.testing.assert_array_equal(found.grasp.close, made.close[1])


def test_the_object_of_a_file_is_beside_it_before_it_is_in_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sub").mkdir()
    for folder in (tmp_path, tmp_path / "sub"):
        (folder / "block.obj").write_text(BLOCK)
    monkeypatch.chdir(tmp_path)
    grasps(tmp_path / "sub" / "0.npy", thing="block.obj")
    found = import_grasp(Path("sub/0.npy"), 0, load_spec())
    assert found.scenario.objects[0].file == tmp_path / "sub" / "block.obj"
    (tmp_path / "sub" / "block.obj").unlink()
    assert import_grasp(Path("sub/0.npy"), 0, load_spec()).scenario.objects[0].file == tmp_path / "block.obj"
    asked = import_grasp(Path("sub/0.npy"), 0, load_spec(), "block.obj")
    assert asked.scenario.objects[0].file == tmp_path / "block.obj"


def test_the_object_of_a_file_may_be_a_name_of_the_catalogue_which_has_its_own_size(tmp_path: Path) -> None:
    made = grasps(tmp_path / "0.npy", thing="rubiks_cube")
    assert import_grasp(tmp_path / "0.npy", 0, load_spec()).scenario.objects[0].name == "rubiks_cube"
    write_dexgraspbench(tmp_path / "1.npy", replace(made, scale=np.full(len(made), 0.06)))
    with pytest.raises(ConfigError, match="its object 'rubiks_cube' has the catalogue's size, and its scale is 0.06"):
        import_grasp(tmp_path / "1.npy", 0, load_spec())


@pytest.mark.parametrize("row", [0, 1])
def test_a_palm_of_a_file_is_in_its_scene_where_the_file_has_it_for_either_hand(
    row: int, side: Side, tmp_path: Path
) -> None:
    (tmp_path / "block.obj").write_text(BLOCK)
    made = grasps(tmp_path / "0.npy", count=2, thing="block.obj", side=side)
    found = import_grasp(tmp_path / "0.npy", row, load_spec(side=side))
    stage = make_stage(found.scenario, load_protocol("fc"), side, found.folder)
    (block,) = stage.objects
    palm = made.palm_from(mesh_middle(tmp_path / "block.obj"))[row, 1]
    np.testing.assert_array_equal(np.abs(block.quaternion), [1.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(stage.position - block.position, palm[:3], atol=1e-12)
    turn = matrix_from_quaternion(stage.quaternion)
    np.testing.assert_allclose(turn, matrix_from_quaternion(palm[3:]), atol=1e-12)


def test_an_object_that_is_not_here_is_asked_for(tmp_path: Path) -> None:
    grasps(tmp_path / "0.npy", thing="assets/core_mug")
    with pytest.raises(
        ConfigError,
        match=r"0\.npy: its object 'assets/core_mug' is no mesh here and not in the catalogue: say --object FILE",
    ):
        find_targets([tmp_path / "0.npy"])


def test_metrics_are_those_of_the_contacts_at_the_end_of_the_first_check(tmp_path: Path) -> None:
    pytest.importorskip("scipy", reason="metrics of contacts need SciPy: extra objects")
    (target,) = find_targets([scenario(tmp_path)], TargetOptions(str(short(tmp_path))))
    draw = {"x": 0.001}
    row, drawn = run_cases({"metrics": True}, [target.item, target.item | {"draw": draw}])
    bench = TrialRunner(load_spec())
    trial = bench.trial(target.case)
    hand = Guard(trial.backend, hand_limits(LimitSettings(), bench.spec))
    for _ in until(trial.seconds, run(hand, bench.controller(trial))):
        pass
    alone = trial_metrics(trial, trial.backend.data)
    assert alone["fingers"] >= 3
    assert {name: row[name] for name in NAMES} == pytest.approx(alone, rel=1e-6)
    assert all(np.isnan(drawn[name]) for name in NAMES)
    assert not set(NAMES) & run_cases({}, [target.item])[0].keys()


def test_a_trial_that_could_not_be_made_is_no_success_and_a_draw_that_could_not_be_is_not_counted(
    tmp_path: Path,
) -> None:
    targets = find_targets([scenario(tmp_path)], TargetOptions(sides=("right", "left")))
    good = {"key": "k", "object": "lemon", "grasp": "g", "side": "right", "held": True, "error": None}
    bad = dict.fromkeys(good, None) | {"error": "the disk is full"}
    lost = good | {"held": False}
    rows = summarise(targets, [good, good, lost, bad, bad, good, good, good])
    assert [(row["held"], row["n"], row["success"]) for row in rows] == [(True, 2, 0.5), (False, 3, 1.0)]
    assert (rows[1]["reason"], rows[1]["object"], rows[1]["side"]) == ("the disk is full", "lemon", "left")
    right, left = rates(rows, "object")
    assert (right.held, right.n, left.held, left.n) == (1, 2, 3, 3)
    (both,) = rates([row | {"side": "right"} for row in rows], "object")
    assert (both.held, both.n) == (4, 5)
    assert str(both) == "4 of 5 (38–96 %)"
    with pytest.raises(ConfigError, match="^the disk is full"):
        summarise(targets, [bad] * 8)
    with pytest.raises(ConfigError, match="mine: no draw could be tried: the disk is full"):
        summarise(targets, [good, good, good, good, good, bad, bad, bad])


def test_pairs_are_of_the_draws_and_not_of_the_trials_without_one() -> None:
    def trial(held: bool) -> dict[str, object]:
        return {"held": held, "error": None}

    found = compare_pairs([trial(held) for held in (False, True, True, False, True, False, True, False)])
    assert found == (1, 1, 0, 1)


def test_pictures_are_of_the_best_and_the_worst() -> None:
    rows = [{"held": k > 2, "margin": float("nan") if k == 0 else 0.1 * k} for k in range(10)]
    assert worth_showing(rows, most=4) == [9, 8, 1, 0]
    assert worth_showing(rows[:3]) == [2, 1, 0]


def test_recordings_are_of_the_best_and_the_worst_of_every_object_in_the_direction_that_was_hardest(
    tmp_path: Path,
) -> None:
    rows = [
        {"object": "mug" if k < 4 else "lemon", "held": True, "margin": [0.2, 0.9, 0.1, 0.3, 0.5][k]} for k in range(5)
    ]
    assert ends_of_objects(rows) == [1, 2, 4]
    rules = short(tmp_path)
    rules.write_text(rules.read_text().replace("floating: true", "floating: true\ndirections: 6"))
    (target,) = find_targets([scenario(tmp_path)], TargetOptions(str(rules)))

    def pushed(row: dict[str, float] | None) -> tuple[float, ...]:
        trial = staged(target, row).trial
        assert trial is not None
        return trial.protocol.phases[-1].push

    margins = {f"margin_{axis}": 0.5 for axis in ("+x", "-x", "+y", "-y", "+z", "-z")}
    assert pushed(None) == (10.0, 0.0, 0.0)
    assert pushed(margins | {"margin_-y": 0.1}) == (0.0, -10.0, 0.0)
    assert pushed(margins | {"margin_-y": 0.1, "margin_+z": float("nan")}) == (0.0, 0.0, 10.0)
