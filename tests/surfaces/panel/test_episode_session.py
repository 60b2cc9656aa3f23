"""A hand in an episode: its object is held until somebody has the task performed, and a person may move the goal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig
from allegro_twin.backend import limp_of
from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse_settings
from allegro_twin.kinematics.orientation import angle_between_quaternions
from allegro_twin.learning.mpc.controller import MpcController
from allegro_twin.recording.reader import load
from allegro_twin.surfaces.panel import requests as r
from allegro_twin.surfaces.panel.episode_watch import EpisodeWatch
from allegro_twin.surfaces.panel.hand_session import HandSession
from allegro_twin.surfaces.panel.stream import SessionEnded, SessionInfo, goals_reached
from allegro_twin.types import Array, PositionCommand, Sample
from tests.surfaces.panel.test_host import Desk

TINY = {"method": "predictive", "samples": 4, "iterations": 1, "horizon": 0.12, "hold": 0.0, "knots": 2, "stride": 2,
        "spread": 0.02}  # fmt: skip  # So little that no object is lost by it.
SIM: dict[str, Any] = {"kind": "sim"}
BUS: dict[str, Any] = {"kind": "can", "version": "v4", "interface": "allegro-virtual"}
TURNED = (0.5, 0.5, 0.5, 0.5)


def config(task: str = "Reorient", backend: Any = SIM, time: str = "real", **environment: Any) -> RunConfig:
    settings = {"decimation": 20, "timestep": 0.003} | environment
    content = {
        "backend": backend,
        "task": {"episode": {"task": task, "environment": settings}},
        "controller": {"kind": "mpc", "time": time, "threads": 1, "planning": TINY},
    }
    return parse_settings(RunConfig, content, "config")


class EpisodeDesk(Desk):
    """A host whose hand is in an episode."""

    @property
    def session(self) -> HandSession:
        assert isinstance(self.host._session, HandSession)
        return self.host._session

    @property
    def watch(self) -> EpisodeWatch:
        assert self.session.watch is not None
        return self.session.watch

    @property
    def judged(self) -> Array:
        """The goal by which the episode judges, (4,)."""
        assert self.session.rig.episode is not None
        goal = self.session.rig.episode.engine.task.goal()
        assert goal is not None
        return np.array(goal[0], dtype=float)

    @property
    def planned(self) -> Any:
        """The goal that the planner is given, (4,)."""
        assert isinstance(self.session.rig.controller, MpcController)
        return self.session.rig.controller.episode.goal

    @property
    def shown(self) -> Array:
        """The goal in the newest frame, (4,)."""
        return self.page.frame().look["object_goal"][3:]

    @property
    def info(self) -> SessionInfo:
        return [news for news in self.page.said if isinstance(news, SessionInfo)][-1]

    @property
    def ends(self) -> list[str]:
        return [news.why for news in self.page.said if isinstance(news, SessionEnded)]

    def until(self, over: Callable[[], bool], most: int = 300) -> None:
        """As of any desk; there are no frames to wait for after an end."""

        def seen() -> bool:
            assert not self.ends, self.ends
            return over()

        super().until(seen, most)

    def end(self) -> str:
        """How the episode ended, once it has."""
        super().until(lambda: bool(self.ends))
        (why,) = self.ends
        self.page.said = [news for news in self.page.said if not isinstance(news, SessionEnded)]
        return why

    def row(self) -> list[float]:
        """Time and limit, s, goals reached, those of them set by hand, whether this one is, and plans a second."""
        found: list[float] = self.page.frame().look["episode"].tolist()
        return found

    def turn(self, goal: tuple[float, ...] | None) -> None:
        self.wish(r.TurnGoal(goal))
        self.until(lambda: bool(self.row()[4]) is (goal is not None))


Opened = Callable[..., EpisodeDesk]


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Opened]:
    monkeypatch.chdir(tmp_path)
    made: list[EpisodeDesk] = []

    def make(*given: Any, **more: Any) -> EpisodeDesk:
        made.append(EpisodeDesk(tmp_path, config(*given, **more)))
        return made[-1]

    yield make
    for desk in made:
        desk.host.close()


@pytest.mark.parametrize("backend", [SIM, BUS], ids=["sim", "bus"])
def test_an_episode_opens_with_its_object_which_the_hand_holds_while_its_time_stands(
    backend: Any, opened: Opened
) -> None:
    desk = opened(backend=backend)
    info = desk.info
    assert (info.episode, info.plans, info.turns) == ("Reorient", True, True)
    (shapes,) = info.scenery.objects.values()
    assert [shape.kind for shape in shapes] == ["box"]
    np.testing.assert_allclose(info.scenery.palm[3:], [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)], atol=1e-5)
    first = desk.page.frame()
    assert first.kind == "hold"
    desk.until(lambda: desk.page.frame().t > first.t + 1.0)
    look = desk.page.frame().look
    np.testing.assert_allclose(look["object"], first.look["object"], atol=0.02)
    assert np.abs(look["object"] - first.look["object"]).max() > 0.0  # It is simulated.
    assert desk.row()[:2] == [0.0, 30.0]
    assert not desk.ends


@pytest.mark.parametrize("task", ["Rotate", "Reach"])
def test_an_episode_without_an_orientation_as_its_goal_shows_none(task: str, opened: Opened) -> None:
    desk = opened(task)
    assert (desk.info.episode, desk.info.turns) == (task, False)
    assert "object_goal" not in desk.page.frame().look
    assert ("object" in desk.page.frame().look) is (task == "Rotate") is bool(desk.info.scenery.objects)
    desk.wish(r.TurnGoal(TURNED))
    desk.until(lambda: f"{task} has no orientation as its goal" in desk.page.notices())


def test_a_goal_set_by_hand_is_what_the_planner_plans_for_and_the_episode_judges_by(opened: Opened) -> None:
    desk = opened()
    before = desk.judged
    np.testing.assert_allclose(desk.shown, before, atol=1e-6)
    desk.turn(TURNED)
    for goal in (desk.judged, desk.planned, desk.shown):
        np.testing.assert_allclose(goal, TURNED, atol=1e-6)
    desk.wish(r.PerformEpisode())
    desk.until(lambda: desk.row()[0] > 0.3)
    for goal in (desk.judged, desk.planned, desk.shown):
        np.testing.assert_allclose(goal, TURNED, atol=1e-6)
    model = desk.session.rig.controller.episode.engine.task.goal()  # type: ignore[attr-defined]
    np.testing.assert_allclose(model[0], TURNED, atol=1e-6)
    desk.turn(None)
    desk.until(lambda: float(angle_between_quaternions(desk.judged, TURNED)) > 0.1)
    desk.until(lambda: float(angle_between_quaternions(desk.shown, desk.judged)) < 1e-6)
    np.testing.assert_allclose(desk.planned, desk.judged)


def test_a_goal_set_by_hand_that_is_reached_counts_as_such_and_the_task_goes_on_with_its_own(opened: Opened) -> None:
    desk = opened()
    here = desk.page.frame().look["object"][3:]
    desk.wish(r.TurnGoal(tuple(here.tolist())))
    desk.until(lambda: desk.row()[2] > 0)
    assert desk.row()[2:5] == [1.0, 1.0, 0.0]
    desk.until(lambda: float(angle_between_quaternions(desk.shown, here)) > 0.25)  # The nearest of new goals is 0.3.
    np.testing.assert_allclose(desk.planned, desk.judged)
    task = desk.watch._task
    task.set_goal(0, desk.page.frame().look["object"][3:])  # As if the task had drawn this one.
    desk.until(lambda: desk.row()[2] == 2.0)
    assert desk.row()[2:5] == [2.0, 1.0, 0.0]


@pytest.mark.parametrize("goal", [(1.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 1.0), (0.0,) * 4])
def test_what_is_no_unit_quaternion_is_refused_and_the_goal_stays(goal: tuple[float, ...], opened: Opened) -> None:
    desk = opened()
    before = desk.judged
    desk.wish(r.TurnGoal(goal))
    desk.until(lambda: "unit quaternion w, x, y, z, four finite numbers of norm 1; not (" in desk.page.notices())
    np.testing.assert_array_equal(desk.judged, before)
    assert desk.row()[4] == 0.0


def test_a_goal_of_nearly_norm_1_is_made_one(opened: Opened) -> None:
    desk = opened()
    desk.turn(tuple(1.0005 * value for value in TURNED))
    np.testing.assert_allclose(desk.judged, TURNED, atol=1e-6)


def test_a_hand_in_no_episode_refuses_goals_and_has_nothing_to_perform(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    for wish in (r.TurnGoal(TURNED), r.PerformEpisode()):
        desk.wish(wish)
        desk.until(lambda: "this hand is in no episode: name one in the config" in desk.page.notices())
        desk.page.said.clear()
    desk.host.close()


def test_of_goals_in_a_row_only_the_newest_waits() -> None:
    waiting = r.RequestQueue()
    for goal in (TURNED, (1.0, 0.0, 0.0, 0.0), None):
        waiting.put(r.TurnGoal(goal))
    assert [waiting.get(0.0), waiting.get(0.0)] == [r.TurnGoal(None), None]


def test_a_planner_in_lockstep_is_refused_with_the_way_out(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^controller\.time lockstep: .*; choose controller\.time: real$"):
        EpisodeDesk(tmp_path, config(time="lockstep"))


def test_the_task_is_performed_until_its_time_is_over_and_can_be_opened_again(opened: Opened) -> None:
    desk = opened()
    assert desk.session.rig.episode is not None
    desk.session.rig.episode.engine.limit = 5
    desk.wish(r.PerformEpisode())
    desk.until(lambda: desk.page.frame().kind == "the task's own")
    desk.wish(r.PerformEpisode())
    desk.until(lambda: "Reorient is being performed" in desk.page.notices())
    assert desk.end() == "the 0 s of Reorient are over; no goal reached"
    assert desk.host._session is None
    desk.wish(r.Reopen())
    desk.until(lambda: desk.info.session == 2 and desk.page.frame().session == 2)
    assert desk.page.frame().kind == "hold"
    assert desk.row()[:2] == [0.0, 30.0]
    desk.wish(r.OpenScene(None, None, perform=True))
    desk.until(lambda: desk.page.frame().session == 3 and desk.row()[0] > 0.1)
    assert desk.page.frame().kind == "the task's own"


def test_a_stop_lets_go_of_the_object_and_its_loss_is_the_end(opened: Opened) -> None:
    desk = opened()
    desk.wish(r.StopMotion())
    assert desk.end() == "the object of Reorient is lost before the task was performed; no goal reached"


@pytest.mark.parametrize("end", [r.HoldHere(), r.DriverLeft()])
def test_who_ends_the_performance_leaves_the_object_in_the_fingers(end: r.Request, opened: Opened) -> None:
    desk = opened()
    desk.wish(r.PerformEpisode())
    desk.until(lambda: desk.row()[0] > 0.1)
    desk.wish(end)
    desk.until(lambda: desk.page.frame().kind == "hold")
    held = desk.page.frame()
    desk.until(lambda: desk.page.frame().t > held.t + 0.7)
    np.testing.assert_allclose(desk.page.frame().look["object"][:3], held.look["object"][:3], atol=4e-3)


def test_a_motion_that_a_person_began_ends_with_the_one_who_drives(opened: Opened) -> None:
    desk = opened("Reach")
    goal = np.clip(desk.page.frame().position, desk.info.spec.lower, desk.info.spec.upper)
    goal[1] += 0.8
    desk.session.execute(r.MoveJoints(tuple(goal.tolist())))
    desk.session.stay()
    began = desk.page.frame().t
    desk.until(lambda: desk.page.frame().t > began + 1.0)
    frame = desk.page.frame()
    assert frame.kind == "pid"
    assert frame.target[1] < goal[1] - 0.1


def test_a_limp_hand_that_closes_its_own_loop_is_held_where_it_is() -> None:
    leap = config().changed(hand={"model": "leap"})
    rig = assemble(leap)
    assert rig.episode is not None
    watch = EpisodeWatch(rig, rig.episode)
    state = rig.backend.reset()
    watch.see(Sample(state, limp_of(rig.spec)))
    held = watch.hold()
    command, _ = held(state, held.start(state))
    assert isinstance(command, PositionCommand)
    np.testing.assert_array_equal(command.position, state.position)
    watch.see(Sample(state, PositionCommand(state.position + 0.1)))
    held = watch.hold()
    command, _ = held(state, held.start(state))
    np.testing.assert_array_equal(command.position, state.position + 0.1)  # type: ignore[union-attr]
    watch.close()
    rig.backend.close()


def test_joints_can_be_moved_in_an_episode_whose_palm_reports_no_gravity(opened: Opened) -> None:
    desk = opened()
    np.testing.assert_allclose(desk.session.hand.gravity, [-9.81, 0.0, 0.0], atol=0.01)  # Palm up: its x.
    goal = np.clip(desk.page.frame().position, desk.info.spec.lower, desk.info.spec.upper)
    for wish in (r.SetGravity(None), r.MoveJoints(tuple(goal.tolist()))):
        desk.wish(wish)
    desk.until(lambda: desk.page.frame().kind == "pid")
    assert desk.page.notices() == ""


def test_a_recording_of_an_episode_has_its_object_and_its_looks(opened: Opened, tmp_path: Path) -> None:
    desk = opened()
    desk.wish(r.Record(on=True))
    desk.until(lambda: desk.page.frame().recorded > 0.2)
    desk.wish(r.Record(on=False))
    desk.until(lambda: "is whole" in desk.page.notices())
    recording = load(tmp_path / "out" / "panel_001.arrow")
    assert recording.columns["object"].shape[1] == recording.columns["object_goal"].shape[1] == 7
    assert list(recording.meta["look"]["objects"]) == ["object"]
    assert "episode" not in recording.columns


def test_a_scenario_takes_the_place_of_the_episode_and_the_episode_comes_back(opened: Opened) -> None:
    desk = opened()
    desk.wish(r.OpenScene("lemon", None, perform=False))
    desk.until(lambda: desk.info.session == 2)
    assert (desk.info.episode, desk.info.scenario) == ("", "lemon")
    desk.wish(r.OpenScene(None, None, perform=False))
    desk.until(lambda: desk.info.session == 3)
    assert desk.info.episode == "Reorient"
    assert desk.session.rig.episode is not None
    assert "of an episode cannot be pulled" in desk.info.no_drag


def test_goals_are_counted_in_words() -> None:
    assert [goals_reached(*counts) for counts in ((0, 0), (1, 0), (1, 1), (3, 2))] == [
        "no goal reached", "1 goal reached", "1 goal reached, 1 of them set by hand",
        "3 goals reached, 2 of them set by hand",
    ]  # fmt: skip
