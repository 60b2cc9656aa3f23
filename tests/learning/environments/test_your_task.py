"""docs/how-to/add_a_task.md does what it says, from an empty folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.learning import tasks
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.episode import EpisodeBackend
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.mpc import MpcSettings, run_episodes
from allegro_twin.learning.policy.controller import ZeroPolicy
from allegro_twin.learning.tasks import GROUP, task_names
from allegro_twin.learning.tasks.base import Task
from allegro_twin.learning.tasks.reach import ReachTask
from allegro_twin.learning.tasks.rotate import RotateTask
from allegro_twin.learning.training import Recipe, load_recipe, train
from allegro_twin.learning.training.evaluation import evaluate
from allegro_twin.learning.training.report import Comparison, compare_policy, write_report
from allegro_twin.surfaces.cli.console import mpc_table, policy_table
from allegro_twin.surfaces.cli.learning.envs import environment_table

ROOT = Path(__file__).resolve().parents[3]
BLOCK = re.compile(r"```python\n# (\w+\.py)\n(.*?)```", re.DOTALL)
BOX = {"name": "soap", "shape": "box", "size": [0.055, 0.055, 0.08], "mass": 0.1}


@pytest.mark.slow
def test_the_page_runs_from_an_empty_folder(tmp_path: Path) -> None:
    blocks = BLOCK.findall((ROOT / "docs" / "how-to" / "add_a_task.md").read_text())
    assert [name for name, _ in blocks] == ["objects.py", "my_tasks.py", "my_numbers.py", "use.py"]
    for name, text in blocks:
        (tmp_path / name).write_text(text)
    for name in ("objects.py", "my_numbers.py", "use.py"):
        done = subprocess.run(
            [sys.executable, "-W", "error", name],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr[-2000:]


@pytest.fixture
def level(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The page's task, in the current folder."""
    blocks = dict(BLOCK.findall((ROOT / "docs" / "how-to" / "add_a_task.md").read_text()))
    (tmp_path / "my_tasks.py").write_text(blocks["my_tasks.py"])
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "my_tasks", raising=False)
    return "my_tasks:Level"


def test_an_evaluation_reports_the_shares_that_a_task_has_and_no_others(level: str, tmp_path: Path) -> None:
    """The page's task inherits the names of shares and does not report them."""
    settings = EnvSettings(timestep=0.003, decimation=200)
    found = evaluate(ZeroPolicy(16), level, settings, 2)
    assert (found.counts, found.shares) == (None, {})
    both = [Comparison("trained on", found, found)]
    assert len(policy_table(both, Recipe(task=level), 0).columns) == 4
    write_report(both, tmp_path / "evaluation.json")
    episode = EpisodeBackend(level, settings)
    episode.reset()
    while not episode.over:
        episode.read()
    assert episode.shares == {}


def test_a_task_of_ones_own_is_listed_by_its_name(level: str) -> None:
    table = environment_table(level)
    assert [next(iter(column.cells)) for column in table.columns][:2] == [
        "my_tasks:Level",
        "keep an object in the fingertips level (privileged: sees what no real hand reports)",
    ]


class Unjudged(Task):
    name = "Unjudged"

    def variant(self, *given: Any) -> Any: ...


def test_a_task_that_lacks_a_method_is_refused_with_what_it_lacks() -> None:
    with pytest.raises(
        ConfigError, match=r"task '.*:Unjudged': Unjudged in .* has no begin, outcome: write what every"
    ):
        HandEnv(f"{__name__}:Unjudged")


class Spelled(ReachTask):
    name = "Spelled"
    seconds = "4"  # type: ignore[assignment]


def test_a_task_whose_seconds_are_no_number_is_refused() -> None:
    with pytest.raises(ConfigError, match="^Spelled.seconds must be a number, not '4'"):
        HandEnv(f"{__name__}:Spelled")


@pytest.mark.slow
@pytest.mark.parametrize("learner", ["stable-baselines3", "rsl-rl"])
def test_the_pages_task_trains(level: str, tmp_path: Path, learner: str) -> None:
    for name in ("torch", "onnx", "onnxruntime", {"rsl-rl": "rsl_rl"}.get(learner, "stable_baselines3")):
        pytest.importorskip(name, reason="training needs the extra rl, or rsl")
    recipe = Recipe.model_validate({
        "task": level, "learner": learner, "envs": 2, "rollout": 4, "round": 8, "steps": 8, "batch": 8, "epochs": 1,
        "hidden": [8], "trials": 1, "environment": {"timestep": 0.003, "decimation": 100}, "log": [],
    })  # fmt: skip
    trained = train(recipe, tmp_path / "out")
    assert trained.progress.steps == 8
    (compared,) = [each for each in compare_policy(trained.policy, recipe, 1) if each.name == "trained on"]
    assert compared.policy.shares == {}


class Uncounted(RotateTask):
    """Its outcome has nothing of what it is said to count."""

    name = "Uncounted"

    def outcome(self, *given: Any) -> Any:
        found = super().outcome(*given)
        return found._replace(terms={name: value for name, value in found.terms.items() if name != "turned"})


def test_a_task_may_inherit_what_is_counted_and_not_report_it() -> None:
    name, settings = f"{__name__}:Uncounted", EnvSettings(timestep=0.003, decimation=50, objects=("cube",))
    found = evaluate(ZeroPolicy(16), name, settings, 1)
    assert found.counts is None
    assert found.shares.keys() == {"on_palm", "by_tips"}
    few = MpcSettings(samples=2, horizon=0.3, knots=2)
    (episode,) = run_episodes(name, settings, few, 1, seconds=0.3)
    assert np.isnan(episode.count)
    assert "–" in [next(iter(column.cells)) for column in mpc_table([episode], Uncounted, few, 0).columns]
    with pytest.raises(ConfigError, match="count: Uncounted reports no turned: leave count out"):
        run_episodes(name, settings, few.model_copy(update={"count": 1.0}), 1, seconds=0.3)


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("no_such_module:Stack", "task 'no_such_module:Stack': no module 'no_such_module' can be imported"),
        (
            "allegro_twin.errors:Stack",
            "'Stack' in allegro_twin.errors is no subclass of allegro_twin.gym.Task",
        ),
        (":Stack", "task ':Stack': no module '' can be imported: '' is no name of a module"),
    ],
)
def test_a_task_that_is_none_is_named(task: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        HandEnv(task)


def test_a_console_script_finds_a_task_of_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "hovering_task.py").write_text(
        "from allegro_twin.learning.tasks.reach import ReachTask\nclass Hover(ReachTask):\n    name = 'Hover'\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path not in ("", str(tmp_path))])
    before = list(sys.path)
    assert tasks.task_type("hovering_task:Hover").name == "Hover"
    assert sys.path == before
    sys.modules.pop("hovering_task")


class Hover(ReachTask):
    name = "Hover"


def outcome_of(change: Callable[[Any], Any]) -> type[Hover]:
    class Strange(Hover):
        def outcome(self, *given: Any) -> Any:
            return change(super().outcome(*given))

    return Strange


@pytest.mark.parametrize(("change", "message"), [
    (lambda found: found._replace(reward=np.array([0.0, np.nan, 0.0, 0.0])),
     "Hover: the reward of simulation 1 at step 1 is nan, and its simulation has not diverged: have the task's"),
    (lambda found: found._replace(reward=np.zeros(3)), r"Hover: outcome's reward is \(3,\), not an array of shape"),
    (lambda found: found._replace(reward=0.5), r"Hover: outcome's reward is float, not an array of shape \(4,\): one"),
    (lambda found: found._replace(terms={"odd": np.zeros((4, 2))}), r"Hover: outcome's odd is \(4, 2\), not an array"),
    (lambda found: found._replace(failed=np.zeros(4)), "Hover: outcome's failed is of float64: give bool"),
    (tuple, "Hover: outcome returns a StepOutcome, not tuple"),
])  # fmt: skip
def test_an_outcome_that_is_none_is_said_in_one_line(
    change: Callable[[Any], Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.modules[__name__], "Strange", outcome_of(change), raising=False)
    env = HandVectorEnv(f"{__name__}:Strange", 4, timestep=0.003)
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=message):
        env.step(np.zeros((4, 16), np.float32))
    with pytest.raises(ConfigError, match="Hover: "):
        run_episodes(f"{__name__}:Strange", EnvSettings(timestep=0.003), MpcSettings(samples=4), 1, seconds=0.1)


def test_an_object_that_diverges_ends_its_episode_alone() -> None:
    env = HandVectorEnv("Rotate", 2, timestep=0.003)
    env.reset(seed=0)
    env.step(np.zeros((2, 16), np.float32))
    thing = env.engine.task.object_body
    assert thing is not None
    thing.pose[1] = np.nan
    outcome, diverged = env.engine.outcome(np.zeros((2, 16)), env.engine.observe())
    assert (outcome.failed.tolist(), diverged.tolist()) == ([False, True], [False, True])
    assert np.isfinite(outcome.reward).all()


def test_a_task_of_an_installed_package_has_a_name_like_those_of_this_one(monkeypatch: pytest.MonkeyPatch) -> None:
    points = {"Hover": EntryPoint("Hover", f"{__name__}:Hover", GROUP), "Reach": EntryPoint("Reach", "no:Where", GROUP)}
    monkeypatch.setattr(tasks, "entry_points_of", lambda group: points if group == GROUP else {})
    assert task_names()[-1] == "Hover"
    assert HandEnv("Hover").engine.task.id == f"{__name__}:Hover"
    assert load_recipe("Hover").task == "Hover"
    assert HandEnv("Reach").engine.task.id == "AllegroTwin/Reach-v0"
    with pytest.raises(ConfigError, match="no task named 'Hovr'; did you mean 'Hover'"):
        HandEnv("Hovr")


def test_an_object_that_nobody_knows_how_to_grasp_is_refused_with_the_ways_out() -> None:
    with pytest.raises(ConfigError, match="how the hand should grasp soap is not said: give it like="):
        HandEnv("Grasp", objects=(BOX,))
    with pytest.raises(ConfigError, match="no object named 'aple'; did you mean 'apple'"):
        HandEnv("Grasp", objects=(BOX | {"like": "aple"},))
    with pytest.raises(ConfigError, match="objects: shpae: unknown key; did you mean 'shape'"):
        HandEnv("Grasp", objects=({"name": "soap", "shpae": "box"},))


@pytest.mark.parametrize("task", ["Grasp", "Lift", "HoldDisturbed"])
def test_an_object_too_large_for_the_grasp_it_is_given_is_refused_when_the_environment_is_made(task: str) -> None:
    large = BOX | {"like": "rubiks_cube", "size": [0.13, 0.13, 0.13]}
    with pytest.raises(ConfigError, match=r"soap at 1 times its size is too large for prismatic_3_finger_cube: it wou"):
        HandEnv(task, objects=(large,), timestep=0.003)


@pytest.mark.parametrize("task", ["Grasp", "Rotate"])
def test_two_objects_of_one_name_are_refused(task: str) -> None:
    with pytest.raises(ConfigError, match="objects has soap twice: leave one out, or give each a name of its own"):
        HandEnv(task, objects=(BOX | {"like": "apple"}, BOX | {"like": "apple", "mass": 0.2}))


def test_a_scenario_is_an_object_of_its_own(tmp_path: Path) -> None:
    scenario = (ROOT / "scenarios" / "demo" / "lemon.yaml").read_text().replace("name: lemon", "name: golf_ball")
    (tmp_path / "mine.yaml").write_text(scenario)
    env = HandEnv("Lift", objects=(str(tmp_path / "mine.yaml"),))
    assert env.reset(seed=0)[1]["object"] == "golf_ball"


@pytest.mark.parametrize("task", ["Grasp", "Lift", "Pinch", "HoldDisturbed"])
def test_a_scenario_that_says_its_side_decides_whose_hand_it_is_and_another_one_is_refused(
    task: str, tmp_path: Path
) -> None:
    mine = tmp_path / "mine.yaml"
    ball = data_root() / "scenarios" / "demo" / "tennis_ball.yaml"
    mine.write_text(f"side: left\n{ball.read_text()}")
    assert HandEnv(task, objects=(str(mine),)).engine.task.spec.side == "left"
    with pytest.raises(ConfigError, match="its scenario is for the left hand .*, and this one is the right one: say"):
        HandEnv(task, objects=(str(mine),), side="right").reset(seed=0)
    other = tmp_path / "other.yaml"
    other.write_text(f"side: right\n{ball.read_text()}")
    with pytest.raises(ConfigError, match=r"other.yaml is for the right hand, .*mine.yaml for the left one: take"):
        HandEnv(task, objects=(str(mine), str(other)))


def test_a_recipe_takes_a_task_and_objects_of_one_s_own() -> None:
    assert load_recipe("my_tasks:Level").task == "my_tasks:Level"
    settings = EnvSettings(objects=(BOX | {"like": "apple"}, "my.obj"))  # type: ignore[arg-type]  # As a user writes it.
    again = EnvSettings.model_validate(settings.model_dump(mode="json"))
    assert again == settings


CORNERS = [(x, y, z) for x in (-0.03, 0.03) for y in (-0.03, 0.03) for z in (-0.03, 0.03)]
SIDES = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]


def test_a_mesh_keeps_its_size_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "die.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS]
    path.write_text("\n".join([*lines, *(f"f {a} {b} {c} {d}" for a, b, c, d in SIDES)]))
    die = {"name": "die", "shape": "mesh", "file": str(path), "mass": 0.1, "like": "rubiks_cube"}
    env = HandEnv("Lift", objects=(die,), randomise={"size": (0.8, 0.9), "mass": (2.0, 2.0)}, timestep=0.003)
    _, info = env.reset(seed=0)
    assert info["randomised"]["size"] == 1.0
    thing = env.engine.task.object_body
    assert thing is not None
    assert thing.pose[0, 2] == pytest.approx(0.03, abs=1e-3)
    with pytest.raises(ConfigError, match="a mesh keeps its size in an episode: leave out the option size"):
        env.reset(options={"size": 0.9})
    cube = HandEnv("Lift", objects=("rubiks_cube",), randomise={"size": (0.8, 0.9)}, timestep=0.003)
    assert 0.8 <= cube.reset(seed=0)[1]["randomised"]["size"] <= 0.9


WEDGE = [(-0.025, y, z) for y in (-0.025, 0.025) for z in (-0.025, 0.025)] + [
    (0.025, y, -0.025) for y in (-0.025, 0.025)
]
WEDGE_FACES = [(1, 2, 4), (1, 4, 3), (1, 3, 6), (1, 6, 5), (2, 5, 6), (2, 6, 4), (1, 5, 2), (3, 4, 6)]


def test_a_mesh_whose_weight_is_off_its_middle_is_presented_without_turning(tmp_path: Path) -> None:
    path = tmp_path / "wedge.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in WEDGE]
    path.write_text("\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in WEDGE_FACES)]))
    wedge = {"name": "wedge", "shape": "mesh", "file": str(path), "mass": 0.1, "like": "rubiks_cube"}
    env = HandEnv("Grasp", objects=(wedge,), level="easy", position_noise=0.0)
    env.reset(seed=0)
    task = env.engine.task
    assert task.object_body is not None
    before = task.object_body.pose[0].copy()
    for _ in range(int(0.5 / (task.settings.period * task.settings.decimation))):  # The fingers wait for 0.6 s.
        env.step(np.zeros(16, np.float32))
    turned = 2.0 * np.arccos(min(1.0, abs(task.object_body.pose[0, 3:] @ before[3:])))
    assert np.degrees(turned) < 1.0


def test_objects_of_the_catalogue_are_presented_by_their_middle() -> None:
    for model in HandEnv("Grasp").engine.task.worlds.models:
        np.testing.assert_array_equal(model.equality("presenter").data[:6], np.zeros(6))
