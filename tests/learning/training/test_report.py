"""What a policy is worth is measured in the environment's own episodes, the same for every policy."""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.assets import data_root
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.settings import EnvSettings, env_keywords
from allegro_twin.learning.policy.controller import ZeroPolicy
from allegro_twin.learning.tasks import TASKS, make_task
from allegro_twin.learning.training.evaluation import Evaluation, evaluate
from allegro_twin.learning.training.progress import EVALUATION, ROUND_SEEDS
from allegro_twin.learning.training.report import (
    LOOKED_AT,
    SEED,
    SELECTION,
    Comparison,
    as_shipped,
    check_objects,
    check_seeds,
    compare_policy,
    evaluation_sets,
    film_policy,
    seeds_overlap,
    write_report,
)
from allegro_twin.learning.training.settings import Recipe, load_recipe
from allegro_twin.surfaces.cli import console
from allegro_twin.surfaces.cli.main import main

REACH = data_root() / "conf" / "policies" / "reach_right.onnx"
LIFT = REACH.with_name("lift_right.onnx")


def recipe(**changes: Any) -> Recipe:
    return load_recipe("reach").model_copy(update=changes)


@pytest.mark.slow
def test_an_evaluation_is_the_single_environments_episodes_to_their_end() -> None:
    few = EnvSettings(objects=("tennis_ball", "golf_ball"), position_noise=0.03)
    found = evaluate(ZeroPolicy(16), "Grasp", few, 6, seed=40)
    env = HandEnv("Grasp", objects=few.objects, position_noise=0.03)
    for row in range(6):
        _, report = env.reset(seed=40 + row)
        info: dict[str, Any] = {}
        total, over = 0.0, False
        while not over:
            _, reward, failed, cut, info = env.step(np.zeros(16, np.float32))
            total, over = total + reward, failed or cut
        assert found.returns[row] == pytest.approx(total, rel=1e-12)
        assert found.success[row] == info["is_success"]
        assert found.objects[row] == report["object"]
    assert 0 < found.success.sum() < 6, "all alike: nothing was told apart"
    by_object = found.by_object()
    assert sum(count for _, count in by_object.values()) == 6
    assert sum(held for held, _ in by_object.values()) == found.success.sum()
    with pytest.raises(ConfigError, match="at least 1 episode, not 0"):
        evaluate(ZeroPolicy(16), "Grasp", few, 0)


def test_policies_are_judged_in_what_ships_whatever_they_were_trained_in() -> None:
    grasp = load_recipe("grasp_easy")
    assert list(evaluation_sets(grasp)) == ["trained on", LOOKED_AT, "held out"]
    seen, looked_at, unseen = evaluation_sets(grasp).values()
    assert looked_at.objects == grasp.looked_at
    assert seen.timestep == EnvSettings().timestep < grasp.environment.timestep
    assert seen.randomise == EnvSettings().randomise != grasp.environment.randomise
    assert (seen.position_noise, seen.decimation) == (0.015, grasp.environment.decimation)
    assert unseen.objects == grasp.held_out
    assert as_shipped(unseen) == unseen
    rotate = load_recipe("rotate_on_palm").environment
    assert rotate.device == "warp"
    assert as_shipped(rotate) == EnvSettings(decimation=rotate.decimation, state=True, palm="allowed")
    assert list(evaluation_sets(recipe())) == ["trained on"]


@pytest.mark.slow
def test_the_shipped_policy_for_reach_beats_a_hand_that_stays(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    (found,) = compare_policy(REACH, recipe(), 20)
    assert found.policy.rate > 0.8 > found.no_action.rate
    write_report([found], tmp_path / "evaluation.json")
    content = json.loads((tmp_path / "evaluation.json").read_text())
    assert content["trained on"]["policy"]["rate"] == found.policy.rate
    with pytest.raises(ConfigError, match="the policy has task AllegroTwin/Reach-v0, these environments have"):
        compare_policy(REACH, load_recipe("Lift"), 1)


@pytest.mark.slow
def test_a_film_shows_whole_episodes(tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="films are made by PyAV: extra view")
    slow = EnvSettings(decimation=40)  # A third of the pictures of a shipped policy, which take the time.
    film_policy(ZeroPolicy(16), recipe(environment=slow), tmp_path / "policy.mp4", episodes=2)
    with av.open(str(tmp_path / "policy.mp4")) as film:
        assert sum(1 for _ in film.decode(video=0)) == 2 * HandEnv("Reach", decimation=40).engine.limit
        assert film.streams.video[0].average_rate == 8


@pytest.mark.slow
def test_the_command_line_says_both_rates_and_films(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    asked = ["--episodes", "4", "--can", "2", "--film", str(tmp_path / "reach.mp4")]
    monkeypatch.setattr("sys.argv", ["allegro-twin", "evaluate", "reach_right", "Reach", *asked])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    said = capfd.readouterr().out
    assert "trained on" in said
    assert "0% (0% to 49%)" in said
    assert "over CAN, trained on: 100% (34% to 100%)" in said
    assert (tmp_path / "reach.mp4").stat().st_size > 10_000


def test_a_policy_that_is_judged_off_the_palm_on_which_it_was_trained_is_told_so(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    from allegro_twin.learning.training import report

    monkeypatch.setattr(report, "compare_policy", lambda *_: [])
    for recipe_name, warned in (("rotate", True), ("rotate_on_palm", False)):
        code, _, errors = ask(monkeypatch, capfd, "rotate_right", recipe_name, "--episodes", 1)
        assert code == 0
        assert ("rotate_right was trained with palm allowed; these episodes have forbidden" in errors) == warned


def test_whoever_is_imitated_or_collected_from_is_told_of_the_palm_too(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    (tmp_path / "mine.yaml").write_text(
        "task: Rotate\nlearner: dagger\nteacher: rotate_right\nsteps: 8\n"
        "environment: {observation: hand, history: 3, decimation: 20, timestep: 0.003}\n"
    )
    monkeypatch.chdir(tmp_path)
    for name in ("training.train", "environments.collect.collect_episodes"):
        monkeypatch.setattr(f"allegro_twin.learning.{name}", lambda *_, **__: sys.exit(0))
    for words in (["train", "mine.yaml"], ["collect", "rotate", "set", "--policy", "rotate_right"]):
        monkeypatch.setattr("sys.argv", ["allegro-twin", *words])
        with pytest.raises(SystemExit):
            main()
        assert "rotate_right was trained with palm allowed; these episodes have forbidden" in capfd.readouterr().err


@pytest.mark.slow
def test_objects_that_a_policy_was_not_trained_on_are_not_said_to_be_of_its_training() -> None:
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    own = {"name": "mine", "shape": "sphere", "size": [0.03], "mass": 0.05, "like": "tennis_ball"}
    for objects, name in ((["lemon"], "trained on"), (["lemon", own], "the recipe's objects")):
        lift = load_recipe("lift")
        other = EnvSettings.model_validate(env_keywords(lift.environment) | {"objects": objects})
        judged = compare_policy(LIFT, lift.model_copy(update={"environment": other, "held_out": ()}), 2)
        assert [each.name for each in judged] == [name]


def ask(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    monkeypatch.setattr("sys.argv", ["allegro-twin", "evaluate", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capfd.readouterr()
    return int(ended.value.code or 0), said.out, said.err


@pytest.mark.slow
def test_another_seed_is_another_set_of_episodes(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Also of those over the bus, and of the film; the same seed is the same ones."""
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    from allegro_twin.learning.training import deployment, evaluation, report

    used: list[tuple[str, int]] = []

    def noted(name: str, real: Any) -> Any:
        def play(*args: Any, seed: int, **more: Any) -> Any:
            used.append((name, seed))
            return real(*args, seed=seed, **more)

        return play

    monkeypatch.setattr(report, "evaluate", noted("batch", evaluation.evaluate))
    monkeypatch.setattr(deployment, "evaluate_on_can", noted("can", deployment.evaluate_on_can))
    for words, first in (((), SEED), (("--seed", 5_000_000_000), 5_000_000_000)):
        used.clear()
        code, out, errors = ask(monkeypatch, capfd, "reach_right", "Reach", "--episodes", 2, "--can", 1, *words)
        assert code == 0
        assert used == [("batch", first), ("batch", first), ("can", first)]
        assert f"seeds from {first}" in out
        assert not errors, errors
    one, other = (
        evaluation.evaluate(ZeroPolicy(16), "Reach", EnvSettings(), 3, seed=seed).returns for seed in (77, SEED)
    )
    assert not np.array_equal(one, other)


def test_episodes_that_a_training_has_used_are_named(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    reach = load_recipe("reach")
    assert seeds_overlap(reach, SEED, 1_000_000) == ""
    assert "round 1 of" in seeds_overlap(reach, 0, 1)
    assert "round 2 of" in seeds_overlap(reach, ROUND_SEEDS + reach.envs - 1, 1)
    assert seeds_overlap(reach, ROUND_SEEDS + reach.envs, 1) == ""
    assert "after every round" in seeds_overlap(reach, EVALUATION + reach.trials - 1, 5)
    assert "end of a training" in seeds_overlap(reach, SELECTION - 4, 5)
    assert seeds_overlap(load_recipe("grasp_easy"), 0, 1) == "", "rsl-rl's episodes are drawn otherwise"
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    code, _, errors = ask(monkeypatch, capfd, "reach_right", "reach", "--episodes", 1, "--seed", EVALUATION)
    assert code == 0
    assert "some are those of the evaluation after every round" in errors


def test_a_training_ends_with_other_episodes_than_those_that_evaluate_asks_by_default(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Or else every choice about the next training would have seen them."""
    from allegro_twin.learning.training import report
    from allegro_twin.surfaces.cli.learning import train

    used: list[int] = []

    def compared(policy: Path, of: Recipe, episodes: int, seed: int) -> list[Comparison]:
        used.append(seed)
        return []

    monkeypatch.setattr(report, "compare_policy", compared)
    monkeypatch.setattr(report, "write_report", lambda *args: None)
    train._evaluate_and_film(tmp_path, recipe(), tmp_path, 3, False)
    assert used == [SELECTION]
    assert SELECTION != SEED
    assert SEED > 2**31 + 100_000, "trainings have seeds below 2^31, and a simulation's number on top"


def test_a_film_that_cannot_be_is_no_error_and_says_all_of_the_way_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    from allegro_twin.learning.policy import loading
    from allegro_twin.learning.training import report
    from allegro_twin.surfaces.cli.learning import train

    def refuse(*given: object, **more: object) -> None:
        raise error

    monkeypatch.setattr(report, "compare_policy", lambda *given: [])
    monkeypatch.setattr(loading, "load_policy", lambda path: SimpleNamespace(policy=None))
    monkeypatch.setattr(report, "film_policy", refuse)
    for error in (
        ConfigError("a film needs PyAV: pip install 'allegro-twin[view]'"),
        RecordingError(f"cannot write {tmp_path}: No space left on device"),
    ):
        train._evaluate_and_film(tmp_path, recipe(), tmp_path, 3, True)
        assert capfd.readouterr().err == f"no film: {error}\n"


@pytest.mark.parametrize(
    ("option", "value"),
    [("--out", "x"), ("--uncertainty", 3), ("--vary", "yaw=1"), ("--grasp", "tripod"), ("--object", "apple"),
     ("--protocol", "fc"), ("--jobs", 2), ("--engine", "ray"), ("--rrd", "ends")],
)  # fmt: skip
def test_an_option_that_a_policy_has_no_use_for_is_refused(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], option: str, value: object
) -> None:
    code, _, errors = ask(monkeypatch, capfd, "reach_right", "Reach", option, value)
    assert code == 2
    assert f"{option} {value} is for scenarios, and reach_right is a policy" in errors.replace("\n", " ")


@pytest.mark.parametrize(("option", "value"), [("--episodes", 3), ("--can", 3), ("--seed", 3)])
def test_an_option_that_a_scenario_has_no_use_for_is_refused(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], option: str, value: object
) -> None:
    code, _, errors = ask(monkeypatch, capfd, "scenarios/demo/lemon.yaml", option, value)
    assert code == 2
    assert f"{option} {value} is for" in errors


def test_the_shapes_that_are_held_out_are_those_of_the_stated_seed() -> None:
    from benchmarks.shapes import SEED as SHAPES
    from benchmarks.shapes import drawn

    grasp = load_recipe("grasp_easy")
    fit = [each for each in drawn(10, SHAPES) if each["name"] != "new_sugar_box"]
    wanted = Recipe.model_validate({"task": "Grasp", "held_out": fit})
    assert wanted.held_out == grasp.held_out
    known = {getattr(each, "name", each) for each in (*(grasp.environment.objects or ()), *grasp.looked_at)}
    assert not known & {getattr(each, "name", each) for each in grasp.held_out}
    assert drawn(10, SHAPES + 1) != drawn(10, SHAPES)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["grasp_easy", "rotate", "rotate_cradle"])
def test_the_objects_that_shipped_recipes_hold_out_can_be_evaluated(name: str) -> None:
    check_objects(load_recipe(name))


BALL = {"shape": "sphere", "size": [0.06], "mass": 0.05, "like": "tennis_ball"}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"environment": {"objects": ["apple"]}, "held_out": ["apple"]},
         r"held_out: apple is among the objects of the training's environments: leave it out of one of them"),
        ({"held_out": ["apple"]}, "held_out: apple is among the objects of the training's environments"),
        ({"held_out": ["scenarios/demo/apple.yaml"]}, "held_out: apple is among the objects of the training's"),
        ({"looked_at": ["apple"]}, "looked_at: apple is among the objects of the training's environments"),
        ({"looked_at": ["orange"], "held_out": ["orange"]}, "held_out: orange is among the objects of looked_at"),
        ({"environment": {"objects": [BALL | {"name": "one"}]}, "held_out": [BALL | {"name": "other"}]},
         "held_out: other is among the objects of the training's environments as one"),
        ({"held_out": ["orange", "orange"]}, "held_out: objects has orange twice"),
        ({"held_out": ["oragne"]}, "held_out: no object named 'oragne'; did you mean 'orange'"),
        ({"looked_at": ["oragne"]}, "looked_at: no object named 'oragne'; did you mean 'orange'"),
        ({"environment": {"hand": "qb_softhand", "level": "easy"}, "held_out": ["orange"]}, "held_out: .*orange"),
        ({"task": "Reach", "held_out": ["apple"]}, "held_out: Reach has no objects to choose"),
        ({"task": "Rotate", "held_out": ["cube"]}, "held_out: cube is among the objects of the training's"),
        ({"task": "Rotate", "environment": {"palm": "allowed"}, "held_out": ["rubiks_cube"]}, "held_out: rubiks_cube"),
    ],
)  # fmt: skip
def test_objects_that_are_held_out_and_cannot_be_are_refused_before_the_first_action(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str], content: dict[str, Any],
    message: str,
) -> None:  # fmt: skip
    from allegro_twin.learning import training

    monkeypatch.setattr(training, "check_packages", lambda recipe: None)
    path = tmp_path / "mine.yaml"
    path.write_text(json.dumps({"task": "Grasp"} | content))
    with pytest.raises(ConfigError, match=f"^mine.yaml: {message}"):
        training.train(load_recipe(str(path)), tmp_path / "out", source="mine.yaml")
    assert not (tmp_path / "out").exists()
    code, _, errors = ask(monkeypatch, capfd, "grasp_right", path)
    assert code == 2
    assert f"{path}: {message.split(': ')[0]}: " in " ".join(errors.split())


@pytest.mark.parametrize("key", ["looked_at", "held_out"])
@pytest.mark.parametrize("how", [{"learner": "rsl-rl", "start": "grasp_right"},
                                 {"learner": "dagger", "teacher": "grasp_right"}])  # fmt: skip
def test_objects_that_the_policy_before_was_trained_on_are_no_unseen_ones(key: str, how: dict[str, str]) -> None:
    before = make_task("Grasp", EnvSettings(level="easy"), 1, 1).object_names()
    mine = {"task": "Grasp", "environment": {"level": "easy", "objects": ["tennis_ball"]}}
    assert "apple" in before
    check_objects(Recipe.model_validate(mine | {key: ["apple"]}))
    whose = "start" if "start" in how else "teacher"
    with pytest.raises(ConfigError, match=f"^mine: {key}: apple is among the objects of the training of {whose} grasp"):
        check_objects(Recipe.model_validate(mine | how | {key: ["apple"]}), "mine")


def test_an_evaluation_has_no_unseen_objects_that_the_policys_own_training_had(tmp_path: Path) -> None:
    own = data_root() / "conf" / "policies" / "grasp_right.onnx"
    mine = load_recipe("grasp_easy").model_dump(mode="json", exclude_unset=True) | {
        "looked_at": [],
        "held_out": ["apple"],
    }
    mine["environment"]["objects"] = ["tennis_ball"]
    with pytest.raises(ConfigError, match=r"^held_out: apple is among the objects of the training of .*grasp_right"):
        compare_policy(own, Recipe.model_validate(mine), 1)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"batch": 1}, "batch 1 has no other advantage to compare with: 2 or more"),
        ({"envs": 1, "rollout": 1}, "an update of envs times rollout is 1 action"),
        ({"log_spread": 1000}, "log_spread: input should be less than or equal to 20, not 1000"),
        ({"log_spread": -1000}, "log_spread: input should be greater than or equal to -20, not -1000"),
        ({"seed": 2**32}, "seed: input should be less than or equal to 4294967295, not 4294967296"),
        ({"farthest": [0.5, 1.5]}, r"farthest: Reach has no distance of goals \(Reorient has\): leave it out"),
        ({"environment": {"timestep": 3}}, r"environment: period 0\.003 s is not a whole number of physics steps of 3"),
        ({"environment": {"timestep": 0.0025, "period": 0.0025}}, r"environment: .* 0\.001 s, which evaluations have"),
        ({"task": "Reorient", "learner": "dagger", "teacher": "x", "farthest": [0.5, 1.5]}, "farthest is for PPO"),
    ],
)
def test_values_that_no_learner_takes_are_refused_with_file_and_key(
    tmp_path: Path, content: dict[str, Any], message: str
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(json.dumps({"task": "Reach"} | content))
    with pytest.raises(ConfigError, match=f"^{path}: {message}"):
        load_recipe(str(path))


@pytest.mark.parametrize("name", [path.stem for path in (data_root() / "conf" / "training").glob("*.yaml")])
def test_no_shipped_training_has_the_seeds_of_an_evaluation(name: str) -> None:
    check_seeds(load_recipe(name), 100_000)


def test_a_training_on_the_episodes_of_its_evaluations_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    from allegro_twin.learning import training

    monkeypatch.setattr(training, "check_packages", lambda recipe: None)
    few = {"task": "Reach", "envs": 8, "steps": 512, "round": 256, "rollout": 16, "trials": 3}
    (tmp_path / "mine.yaml").write_text(json.dumps(few))
    of_rounds = "round 2 of the training has episodes of the evaluation after every round"
    with pytest.raises(ConfigError, match=f"^recipe: seed {EVALUATION - ROUND_SEEDS + 2}: {of_rounds}: choose another"):
        training.train(Recipe.model_validate(few | {"seed": EVALUATION - ROUND_SEEDS + 2}), tmp_path / "out")
    for seed in (EVALUATION + 3, EVALUATION - 8, SELECTION - 8, SELECTION + 200):
        check_seeds(Recipe.model_validate(few | {"seed": seed}), 200)
    check_seeds(Recipe.model_validate(few | {"seed": SELECTION, "learner": "rsl-rl"}), 200)
    monkeypatch.setattr(
        "sys.argv", ["allegro-twin", "train", str(tmp_path / "mine.yaml"), "--seed", f"{SELECTION + 199}", "--out",
                     str(tmp_path / "out")],
    )  # fmt: skip
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    errors = " ".join(capfd.readouterr().err.split())
    assert f"seed {SELECTION + 199}: round 1 of the training has episodes of the evaluation at the end of" in errors


def test_a_hand_that_is_on_no_can_bus_is_told_before_the_first_episode(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    from allegro_twin.learning.training import report

    monkeypatch.setattr(report, "compare_policy", lambda *given: pytest.fail("an episode was run"))
    code, _, errors = ask(monkeypatch, capfd, "reach_right", "Reach", "--hand", "qb_softhand", "--can", 2)
    assert code == 2
    assert "is on no CAN bus: leave out --can" in errors


def test_an_evaluation_of_objects_that_the_training_has_is_refused() -> None:
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    grasp = load_recipe("grasp_easy")
    seen = grasp.model_copy(update={"held_out": (*grasp.held_out, "apple")})
    policy = data_root() / "conf" / "policies" / "grasp_right.onnx"
    with pytest.raises(ConfigError, match="held_out: apple is among the objects of the training's environments"):
        compare_policy(policy, seen, 1)


def test_a_rate_is_told_with_where_it_lies_for_few_episodes_say_little() -> None:
    def found(*success: bool) -> Evaluation:
        return Evaluation(np.array(success), np.zeros(len(success)), ())

    rows = console.policy_table(
        [Comparison("seen", found(True, True, True, True), found(False, False, True, True))], recipe(), 7
    )
    assert [next(iter(column.cells)) for column in rows.columns] == [
        "seen",
        "4",
        "100% (51% to 100%)",
        "50% (15% to 85%)",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", [path.stem for path in (data_root() / "conf" / "training").glob("*.yaml")])
def test_a_recipe_with_the_name_of_a_task_is_the_task_as_gymnasium_makes_it(name: str) -> None:
    own = {task.lower(): task for task in TASKS}
    found = as_shipped(load_recipe(name).environment)
    if name not in own:
        asked = {"palm", "level", "goals", "observation", "objects", "position_noise", "grip", "hand"}
        assert asked & found.model_fields_set, f"{name}: the task as it is, under another name"
        return
    # A learner may decide less often, move less at once and see the past, and its critic see more: nothing of it makes
    # what is asked of the hand easier.
    free = {"decimation", "state", "history", "step"} & found.model_fields_set
    of_the_learner: dict[str, Any] = {key: getattr(found, key) for key in sorted(free)}
    assert found == EnvSettings(**of_the_learner)
    assert (found.step or 0.0) <= make_task(own[name], EnvSettings(), 1, 1).card().step
    recipes, made = (HandEnv(own[name], **keywords) for keywords in (env_keywords(found), of_the_learner))
    ours, theirs = ([each.reset(seed=3), each.step(np.full(16, 0.3, np.float32))] for each in (recipes, made))
    assert pickle.dumps(ours) == pickle.dumps(theirs)


def test_the_name_of_a_task_is_that_task_as_gymnasium_makes_it_and_no_recipe() -> None:
    for task in TASKS:
        assert load_recipe(task) == Recipe(task=task)
        assert load_recipe(task, side="left").environment == EnvSettings(side="left")
    assert load_recipe("lift").environment.decimation == 26
    with pytest.raises(ConfigError, match="no task or recipe named 'LIFT'"):
        load_recipe("LIFT")
    with pytest.raises(ConfigError, match="'rotate_on_palm_hand'"):
        load_recipe("rotate_hand")
    with pytest.raises(ConfigError, match="'Reorient'"):
        load_recipe("reorient")
