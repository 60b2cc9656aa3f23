"""A config may have a hand plan for a task, simulated or behind a virtual bus."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.app import rig, session
from allegro_twin.app.config import RunConfig
from allegro_twin.app.controllers import make_controller
from allegro_twin.app.references import posture_of
from allegro_twin.app.rig import assemble, spec_of
from allegro_twin.app.session import Outputs, perform
from allegro_twin.app.simulated import simulated
from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse_settings
from allegro_twin.learning.mpc.controller import MpcController
from allegro_twin.learning.mpc.settings import MpcSettings, planner_settings
from allegro_twin.learning.tasks.scenes import OBJECT
from allegro_twin.recording.reader import load
from allegro_twin.sim.settings import SimSettings
from allegro_twin.viewing import camera
from allegro_twin.viewing.scenery import scenery

TINY = {"method": "predictive", "samples": 4, "iterations": 1, "horizon": 0.12, "hold": 0.0, "knots": 2, "stride": 2}
SIM: dict[str, Any] = {"kind": "sim"}
BUS: dict[str, Any] = {"kind": "can", "version": "v4", "interface": "allegro-virtual"}


def config(backend: Any = SIM, task: Any = None, seconds: float = 0.3, **controller: Any) -> RunConfig:
    episode = {"task": "Rotate", "environment": {"objects": ["cube"], "decimation": 20, "timestep": 0.003}}
    content = {
        "backend": backend,
        "task": {"episode": episode} if task is None else task,
        "controller": {"kind": "mpc", "threads": 1, "planning": TINY} | controller,
        "seconds": seconds,
    }
    return parse_settings(RunConfig, content, "config")


@pytest.mark.parametrize("backend", [SIM, BUS, BUS | {"version": "v5"}], ids=["sim", "v4", "v5"])
def test_a_hand_plans_for_its_episode_and_its_session_tells_of_both(backend: Any) -> None:
    chosen = config(backend)
    outcome = perform(assemble(chosen), chosen, Outputs())
    plans, became = outcome.notes[-2:]
    assert plans.startswith("mpc: ")
    assert " plans in lockstep in " in plans
    assert became.startswith("Rotate: 0.3")
    assert became.endswith(" rad")


def test_beside_a_simulated_hand_its_time_passes_as_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    held_back: list[bool] = []

    def hold(samples: Any) -> Any:
        held_back.append(True)
        return samples

    monkeypatch.setattr(session, "paced", hold)
    for time, held in (("lockstep", []), ("real", [True])):
        chosen = config(time=time, camera={"delay": 0.03, "noise": 0.001})
        perform(assemble(chosen), chosen, Outputs())
        assert held_back == held
    monkeypatch.undo()
    chosen = config(time="real", camera={"delay": 0.03, "noise": 0.001})
    (*_, plans, _) = perform(assemble(chosen), chosen, Outputs()).notes
    assert " plans beside the hand in 6 decisions" in plans


@pytest.mark.parametrize("time", ["lockstep", "real"])
def test_a_config_without_settings_has_those_of_its_task_and_time(time: str, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[MpcSettings] = []

    def planner(controller: MpcController, task: str, episode: Any, settings: MpcSettings, **_: Any) -> None:
        seen.append(settings)
        raise ConfigError("enough")

    monkeypatch.setattr(MpcController, "__init__", planner)
    with pytest.raises(ConfigError, match="enough"):
        assemble(config(time=time, planning=None))
    ship = {each: planner_settings("Rotate", real_time=each == "real") for each in ("lockstep", "real")}
    assert seen == [ship[time]]
    assert ship["real"] != ship["lockstep"]


@pytest.mark.parametrize("backend", [SIM, BUS], ids=["sim", "v4"])
def test_a_recording_of_an_episode_shows_its_object_and_its_goal(backend: Any, tmp_path: Path) -> None:
    scene = {"objects": ["cube"], "goals": "yaw", "decimation": 20, "timestep": 0.003}
    chosen = config(backend, {"episode": {"task": "Reorient", "environment": scene}})
    rows: list[np.ndarray] = []
    made = assemble(chosen)
    assert made.episode is not None
    task, read = made.episode.engine.task, made.episode._state
    made.episode._state = lambda: (rows.append(task.object_body.pose[0].copy()), read())[1]  # type: ignore[method-assign, union-attr, func-returns-value]
    kept = perform(made, chosen, Outputs(record=tmp_path / "kept.arrow", rrd=tmp_path / "kept.rrd"))
    bare = perform(assemble(chosen), chosen, Outputs())
    np.testing.assert_array_equal(kept.last.position, bare.last.position)
    recording = load(tmp_path / "kept.arrow")
    np.testing.assert_array_equal(recording.columns["object"], rows[-len(recording) :])
    assert len(recording) > 90
    goal = task.goal()
    assert goal is not None
    np.testing.assert_allclose(recording.columns["object_goal"][:, 3:], np.tile(goal[0], (len(recording), 1)))
    seen = scenery(recording.spec, recording.meta)
    assert list(seen.objects) == [OBJECT]
    assert seen.palm == pytest.approx(recording.columns["palm"][0], abs=1e-6)
    assert (tmp_path / "kept.rrd").read_bytes().count(b"world/goals/object") > 0


def test_an_episode_that_is_lost_ends_the_run() -> None:
    chosen = config(seconds=5.0)
    made = assemble(chosen)
    assert made.episode is not None
    engine = made.episode.engine
    judge = engine.outcome

    def lose(*given: Any) -> Any:
        outcome, diverged = judge(*given)
        return outcome._replace(failed=engine.count >= 2), diverged

    engine.outcome = lose  # type: ignore[assignment, method-assign]
    outcome = perform(made, chosen, Outputs())
    assert outcome.last.t == pytest.approx(0.12)
    assert outcome.notes[-1].startswith("Rotate: lost at 0.12 s, ")
    assert outcome.failed


def test_a_posture_is_a_goal_of_fingertips() -> None:
    task = {"posture": "fist", "episode": {"task": "Reach", "environment": {"timestep": 0.003}}}
    made = assemble(config(task=task, planning=TINY | {"stride": 1}))
    interface = made.controller.episode.engine.task.interface  # type: ignore[attr-defined]
    goal = made.controller.episode.goal  # type: ignore[attr-defined]
    assert goal == pytest.approx(interface.fingertips(posture_of("fist", made.spec)))
    assert made.controller.start(made.backend.reset()).action.shape == (16,)
    assert made.controller.episode.engine.task.goal()[0] == pytest.approx(goal)  # type: ignore[attr-defined]
    made.backend.close()


def test_success_is_judged_about_the_posture_that_is_planned_for() -> None:
    task = {"posture": "ok", "episode": {"task": "Reach", "environment": {"timestep": 0.003}}}
    chosen = config(task=task, seconds=2.0, planning=TINY | {"stride": 1})
    made = assemble(chosen)
    assert made.episode is not None
    made.backend.reset()
    planned = made.controller.episode.goal  # type: ignore[attr-defined]
    np.testing.assert_array_equal(made.episode.goal, planned.astype(np.float32))
    outcome = perform(made, chosen, Outputs())
    assert outcome.notes[-1].endswith(" mm from their goals in the mean, not reached (every one within 10 mm)")
    assert outcome.failed
    follows = chosen.changed(controller={"kind": "pd", "gravity": [0.0, 0.0, -9.81], "speed": 2.0}, seconds=None)
    followed = perform(assemble(follows), follows, Outputs())
    assert followed.notes[-1].startswith("Reach: 1.99 s, fingertips ")
    assert followed.notes[-1].endswith(" in the mean, reached")
    assert not followed.failed


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ({"task": {}}, "mpc plans for an episode: name its task"),
        ({"task": {"posture": "fist", "episode": {"task": "Rotate"}}}, "Rotate has none: leave it out, or plan"),
        ({"task": {"grasp": "power", "episode": {"task": "Rotate"}}}, "task.grasp is not for the mpc controller"),
        ({"task": {"scenario": "demo", "episode": {"task": "Rotate"}}}, "are two scenes: leave one out"),
        ({"task": {"episode": {"task": "Rotate", "environment": {"side": "left"}}}}, "is the config's hand.side"),
        ({"task": {"episode": {"task": "Rotate", "environment": {"device": "warp"}}}}, "driven on cpu: leave it out"),
        ({"planning": TINY | {"terms": {"turnd": 1.0}}}, "controller.planning.terms.turnd: no term named 'turnd'; did"),
        ({"plannning": TINY}, "config: controller.plannning: unknown key; did you mean 'planning'"),
        ({"planning": {"sampls": 8}}, "config: controller.planning.sampls: unknown key; did you mean 'samples'"),
        ({"task": {"episode": {"task": "Rotte"}}}, "did you mean 'Rotate'"),
        ({"task": {"episode": {"task": "Reach"}}, "camera": {}}, "Reach has no object here to look at"),
        ({"backend": BUS | {"imu": 0.1}}, "backend.imu: the palm of an episode reports no gravity"),
        ({"backend": SIM | {"start": "fist"}}, "task.episode says it: leave one out"),
    ],
)  # fmt: skip
def test_what_a_planner_cannot_do_is_one_line(given: dict[str, Any], line: str) -> None:
    with pytest.raises(ConfigError, match=line):
        assemble(config(**given))


def test_a_hand_whose_time_passes_by_itself_does_not_wait_and_one_without_an_object_s_pose_is_refused() -> None:
    chosen = config()
    with pytest.raises(ConfigError, match="passes by itself; choose time: real"):
        make_controller(chosen, spec_of(chosen), None, live=True)
    chosen = config(time="real")
    with pytest.raises(ConfigError, match="this hand comes with no pose of one"):
        make_controller(chosen, spec_of(chosen), None, live=True)


def test_only_the_time_of_a_hand_that_is_not_simulated_here_passes_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the episode's, nor ours, nor the one of our simulation behind a bus."""
    asked: list[bool] = []

    def noted(*given: Any, live: bool, replayed: bool) -> Any:
        assert not replayed
        asked.append(live)
        raise ConfigError("asked")

    monkeypatch.setattr(rig, "make_controller", noted)
    limp = parse_settings(RunConfig, {"backend": BUS, "controller": {"kind": "limp"}, "seconds": 1.0}, "config")

    def foreign(spec: Any, step: float) -> Any:
        return simulated(SimSettings(kind="sim"), limp.task, spec, step)

    for chosen, physics in ((config(), None), (config(BUS), None), (limp, None), (limp, foreign)):
        with pytest.raises(ConfigError, match="asked"):
            assemble(chosen, physics)
    assert asked == [False, False, False, True]


def test_an_episode_may_have_any_other_controller() -> None:
    task = {"episode": {"task": "Rotate", "environment": {"timestep": 0.003}}}
    chosen = parse_settings(
        RunConfig, {"backend": SIM, "task": task, "controller": {"kind": "limp"}, "seconds": 3.0}, "config"
    )
    outcome = perform(assemble(chosen), chosen, Outputs())
    assert "lost at" in outcome.notes[-1]
    assert outcome.last.t < 2.0


@pytest.mark.parametrize("backend", [SIM, BUS], ids=["sim", "v4"])
def test_pictures_of_a_run_in_an_episode_show_its_object_as_it_is_then_and_its_goal(
    backend: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[Any, Any]] = []

    class Eye:
        def __init__(self, scene: Any, *, marks: Any, **about: object) -> None:
            self.scene, self.marks = scene, marks

        def take(self) -> camera.Picture:
            (goal,) = self.marks()
            seen.append((self.scene.data.body(OBJECT).xpos.copy(), goal.pose.copy()))
            return np.zeros((8, 8, 3), dtype=np.uint8)

        def close(self) -> None: ...

    monkeypatch.setattr(camera, "Camera", Eye)
    episode = {"task": "Reorient", "environment": {"objects": ["cube"], "decimation": 20, "timestep": 0.003}}
    content = {"backend": backend, "task": {"episode": episode}, "controller": {"kind": "limp"}, "seconds": 0.09}
    chosen = parse_settings(RunConfig, content, "config")
    made = assemble(chosen)
    assert made.episode is not None
    outcome = perform(made, chosen, Outputs(video=tmp_path / "a.mp4", image=tmp_path / "a.png", optional=True))
    assert not any("no pictures" in note for note in outcome.notes)
    assert {path.name for path in tmp_path.iterdir()} == {"a.mp4", "a.png"}
    task: Any = made.episode.engine.task
    places = np.array([place for place, _ in seen])
    np.testing.assert_allclose(places[-1], task.object_body.pose[0, :3], atol=1e-9)
    assert np.linalg.norm(places[-1] - places[0]) > 1e-3
    np.testing.assert_array_equal(seen[-1][1], task.marks(0)[0].pose)
