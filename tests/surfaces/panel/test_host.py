"""The hand's process: wishes are done or refused, a stop waits for none, and no page that dies moves the hand."""

from __future__ import annotations

import queue
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.verdict import TrialReport
from allegro_twin.hands.library.library import load_posture
from allegro_twin.hands.settings import TaskSettings
from allegro_twin.recording.reader import load
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.panel import requests as r
from allegro_twin.surfaces.panel.description import scene_of
from allegro_twin.surfaces.panel.hand_session import Folders, HandSession, HandSessions
from allegro_twin.surfaces.panel.host import Host
from allegro_twin.surfaces.panel.stream import (
    LibraryContents,
    Notice,
    PageMessage,
    SessionEnded,
    SessionInfo,
    StreamFrame,
    receive_frame,
)


class FakePage:
    """A page whose wishes are put into a queue, and whose news are kept."""

    def __init__(self) -> None:
        self.alive, self.said, self.given = True, list[PageMessage](), queue.SimpleQueue[r.Request | None]()
        self.frames, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.theirs.setblocking(False)

    def requests(self) -> Iterator[r.Request]:
        while (wish := self.given.get()) is not None:
            yield wish
        self.alive = False

    def tell(self, news: PageMessage) -> None:
        self.said.append(news)

    def address(self) -> str:
        return "here"

    def close(self) -> None:
        self.given.put(None)
        self.frames.close()
        self.theirs.close()

    def frame(self) -> StreamFrame:
        """The newest, once there is one."""
        newest = None
        while newest is None:
            try:
                while True:
                    got = receive_frame(self.theirs)
                    newest = got if got is not None else newest
            except BlockingIOError:
                threading.Event().wait(0.01)
        return newest

    def notices(self) -> str:
        return "; ".join(news.text for news in self.said if isinstance(news, Notice))


class FakePages:
    def __init__(self, gone: str) -> None:
        self.gone = gone
        self.opened: list[FakePage] = []

    def open(self) -> FakePage:
        self.opened.append(FakePage())
        return self.opened[-1]


class Desk:
    """A host in the test's own hands."""

    def __init__(self, folder: Path, config: RunConfig | None = None, gone: Any = "hold") -> None:
        self.pages = FakePages(gone)
        folders = Folders(folder / "out", folder / "library" / "mine.yaml")
        sessions = HandSessions(config or load_config("sim_right"), folders)
        self.host = Host(sessions, self.pages)  # type: ignore[arg-type]  # Looks alike.
        self.host.begin()

    @property
    def page(self) -> FakePage:
        return self.pages.opened[-1]

    @property
    def spec(self) -> HandSpec:
        session = self.host._session
        assert isinstance(session, HandSession)
        return session.rig.spec

    def wish(self, wish: r.Request) -> None:
        self.page.given.put(wish)

    def until(self, over: Callable[[], bool], most: int = 300) -> None:
        for _ in range(most):
            if over():
                return
            self.host.turn()
        pytest.fail(f"it never came to that; {self.page.notices()}")


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    monkeypatch.chdir(tmp_path)
    found = Desk(tmp_path)
    yield found
    found.host.close()


def test_the_page_is_told_who_the_hand_is_and_what_the_library_has_for_it(desk: Desk) -> None:
    desk.until(lambda: len(desk.page.said) > 1)
    opened, shelf = desk.page.said[:2]
    assert isinstance(opened, SessionInfo)
    assert isinstance(shelf, LibraryContents)
    assert opened.title == "allegro_right · simulated"
    assert {"pd", "pid", "gravity", "torque"} == set(opened.kinds)
    assert "lemon" in opened.scenarios
    assert not opened.no_tips
    assert {"home", "fist"} <= set(shelf.postures)
    assert "grasp_3" in shelf.grasps


def test_frames_come_with_the_hands_time_and_a_wish_moves_it(desk: Desk) -> None:
    opened = desk.page.said[0]
    assert isinstance(opened, SessionInfo)
    goal = np.clip(desk.page.frame().position, opened.spec.lower, opened.spec.upper)
    goal[1] = 0.7
    desk.wish(r.MoveJoints(tuple(goal)))
    desk.until(lambda: abs(desk.page.frame().position[1] - 0.7) < 0.02)
    assert desk.page.frame().kind == "pid"
    assert desk.page.frame().lost == 0


def moved(desk: Desk, joint: int, position: float, over: Callable[[], bool]) -> None:
    desk.wish(r.MoveJoints.of(16, {joint: position}))
    desk.until(over)


def test_a_goal_whose_driver_has_gone_is_given_up_for_every_page(desk: Desk) -> None:
    moved(desk, 1, 1.6, lambda: desk.page.frame().position[1] > 0.3)
    assert desk.page.frame().goal[1] == 1.6
    desk.wish(r.DriverLeft())
    desk.until(lambda: desk.page.frame().goal[1] < 1.5)
    desk.until(lambda: abs(desk.page.frame().position[1] - desk.page.frame().goal[1]) < 0.02)
    held = desk.page.frame().goal[1]
    moved(desk, 5, 0.2, lambda: abs(desk.page.frame().position[5] - 0.2) < 0.02)
    frame = desk.page.frame()
    assert frame.goal[1] == pytest.approx(held, abs=1e-6)
    assert frame.position[1] == pytest.approx(held, abs=0.05)


def test_a_refused_goal_is_no_goal_and_the_next_one_is_carried_out(desk: Desk) -> None:
    posture = np.zeros(16)
    posture[12:] = 1.39, 0.3, 1.0, 1.0  # The thumb across the palm,
    posture[1] = 1.6  # and the index finger bent beside it.
    desk.wish(r.MoveJoints(tuple(posture.tolist())))
    desk.until(lambda: np.abs(desk.page.frame().position - posture).max() < 0.03)
    desk.wish(r.MoveJoints.of(16, {2: 1.7}))
    desk.until(lambda: "inside each other" in desk.page.notices())
    assert desk.page.frame().goal[2] == pytest.approx(posture[2], abs=1e-9)
    moved(desk, 9, 0.7, lambda: abs(desk.page.frame().position[9] - 0.7) < 0.03)
    moved(desk, 1, 1.2, lambda: abs(desk.page.frame().position[1] - 1.2) < 0.03)
    assert desk.page.frame().goal[2] == pytest.approx(posture[2], abs=1e-9)
    assert desk.page.notices().count("inside each other") == 1


def test_a_stop_works_while_a_wish_is_being_planned(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    planning, go_on = threading.Event(), threading.Event()
    opened = desk.host._session
    assert isinstance(opened, HandSession)
    legs = opened.hand._mover.paths.legs

    def slowly(*given: Any) -> Any:
        planning.set()
        go_on.wait(10.0)
        return legs(*given)

    monkeypatch.setattr(opened.hand._mover.paths, "legs", slowly)
    desk.wish(r.MoveToPosture("fist"))
    turning = threading.Thread(target=lambda: desk.until(lambda: "release the stop" in desk.page.notices()))
    turning.start()
    assert planning.wait(10.0)
    desk.wish(r.StopMotion())
    while not desk.page.frame().stopped:
        pass
    go_on.set()
    turning.join(30.0)
    assert desk.page.frame().kind == "torque"


@pytest.mark.slow
@pytest.mark.parametrize(("gone", "stopped"), [("hold", False), ("limp", True)])
def test_when_nobody_drives_a_motion_ends_as_configured(gone: str, stopped: bool, tmp_path: Path) -> None:
    desk = Desk(tmp_path, gone=gone)
    desk.wish(r.MoveToPosture("fist"))
    desk.until(lambda: desk.page.frame().position[1] > 0.3)
    desk.wish(r.DriverLeft())
    desk.until(lambda: desk.page.frame().kind == ("torque" if stopped else "pid"))
    desk.until(lambda: not np.abs(np.diff([desk.page.frame().position for _ in range(2)], axis=0)).max() > 1e-3)
    assert desk.page.frame().stopped is stopped
    if not stopped:
        assert np.nanmax(np.abs(desk.page.frame().target - desk.page.frame().position)) < 0.1
    desk.host.close()


def test_a_page_that_dies_is_opened_again_and_the_hand_holds(desk: Desk) -> None:
    desk.wish(r.MoveToPosture("home"))
    desk.until(lambda: desk.page.frame().kind == "pid")
    first = desk.page
    first.given.put(None)
    desk.until(lambda: len(desk.pages.opened) == 2)
    assert isinstance(desk.page.said[0], SessionInfo)
    assert desk.page.frame().kind == "pid"


def test_what_cannot_be_is_refused_in_words_and_the_hand_goes_on(desk: Desk) -> None:
    refused = (
        (r.MoveToPosture("hmoe"), "did you mean 'home'"), (r.MoveJoints((9.0,) * 16), "outside its limits"),
        (r.MoveJoints((0.0,) * 3), "16, one per joint"), (r.ChooseController("psd"), "no controller named"),
        (r.ChooseGains("x"), "no gains named"), (r.MoveJoints((float("nan"),) * 16), "must be finite"),
        (r.SetGravity((0.0, 0.0, float("inf"))), "finite"), (r.StoreTaught("../x", motion=False), "name"),
        (r.MovePalm((0.0,) * 7), "a hand cannot carry out MovePalm"),
    )  # fmt: skip
    for wish, words in refused:
        desk.wish(wish)
        desk.until(lambda words=words: words in desk.page.notices())  # type: ignore[misc]  # Bound for this turn.
    assert desk.page.frame().kind == "torque"


def test_a_recording_is_whole_and_says_what_it_is_of(desk: Desk, tmp_path: Path) -> None:
    desk.wish(r.Record(on=True))
    desk.until(lambda: desk.page.frame().recorded > 0.5)
    desk.wish(r.Record(on=False))
    desk.until(lambda: "is whole" in desk.page.notices())
    recording = load(tmp_path / "out" / "panel_001.arrow")
    assert recording.complete
    assert recording.spec.name == "allegro_right"
    assert "target" in recording.columns


def test_a_stop_ends_a_demonstration_before_the_hand_sags(desk: Desk, tmp_path: Path) -> None:
    session = desk.host._session
    assert isinstance(session, HandSession)
    desk.wish(r.Teach(on=True))
    desk.until(lambda: len(session._demonstration._rows) > 3)
    desk.wish(r.StopMotion())
    desk.until(lambda: desk.page.frame().stopped)
    shown = len(session._demonstration._rows)
    t = desk.page.frame().t
    desk.until(lambda: desk.page.frame().t > t + 0.3)
    assert len(session._demonstration._rows) == shown
    assert not desk.page.frame().teaching
    desk.wish(r.StoreTaught("shown", motion=False))
    desk.until(lambda: "shown is in" in desk.page.notices())
    assert desk.page.frame().stopped
    desk.until(lambda: "the demonstration has ended here: repeat it, or store it" in desk.page.notices())
    desk.wish(r.StopMotion())
    desk.wish(r.ReleaseStop())
    desk.until(lambda: "the stop is released" in desk.page.notices())
    assert desk.page.notices().count("has ended here") == 1


@pytest.mark.parametrize("wish", [r.OpenScene("lemon", "nope", False), r.OpenScene("lemon", None, False), r.Reopen()])
def test_what_was_shown_outlives_the_session_of_its_hand(desk: Desk, wish: r.Request) -> None:
    """A scene that is refused while it is opened, too: the hand is opened again as it was."""
    desk.wish(r.MoveToPosture("fist"))
    desk.until(lambda: desk.page.frame().t > 2.0)
    desk.wish(r.Teach(on=True))
    desk.until(lambda: desk.page.frame().teaching)
    t, position = desk.page.frame().t, desk.page.frame().position
    desk.until(lambda: desk.page.frame().t > t + 0.1)
    desk.wish(wish)
    desk.until(lambda: desk.page.frame().session > 1 and desk.host._session is not None)
    assert "the demonstration has ended with this hand: what was shown can be stored" in desk.page.notices()
    desk.wish(r.StoreTaught("shown", motion=False))
    desk.until(lambda: "shown is in" in desk.page.notices())
    stored = load_posture("shown", desk.spec)
    np.testing.assert_allclose(stored, position, atol=0.1)
    desk.wish(r.PlayTaught())
    desk.until(lambda: abs(desk.page.frame().position[1] - position[1]) < 0.1)


def test_store_without_a_demonstration_says_what_to_do(desk: Desk) -> None:
    for wish in (r.StoreTaught("shown", motion=True), r.StoreTaught("shown", motion=False), r.PlayTaught()):
        desk.page.said.clear()
        desk.wish(wish)
        desk.until(lambda: "nothing was shown: press Teach and lead the fingers" in desk.page.notices())


def test_what_is_asked_of_a_hand_that_has_failed_is_answered(desk: Desk) -> None:
    session = desk.host._session
    assert isinstance(session, HandSession)
    desk.wish(r.Teach(on=True))
    desk.until(lambda: len(session._demonstration._rows) > 3)
    session.report = lambda: iter([SessionEnded("a joint is too hot")])  # type: ignore[method-assign]
    desk.until(lambda: desk.host._session is None)
    desk.wish(r.StoreTaught("shown", motion=False))
    desk.until(lambda: "there is no hand: open it again first" in desk.page.notices())
    desk.wish(r.Reopen())
    desk.until(lambda: desk.host._session is not None)
    desk.wish(r.StoreTaught("shown", motion=False))
    desk.until(lambda: "shown is in" in desk.page.notices())


def test_what_is_stored_where_no_name_is_looked_for_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for folder, said in (("library", False), ("elsewhere", True)):
        sessions = HandSessions(load_config("sim_right"), Folders(tmp_path / "out", tmp_path / folder / "my.yaml"))
        session = sessions.prepare(None)(1, lambda frame: None)
        session.execute(r.Teach(on=True))
        session.hand.wait(0.05)  # type: ignore[attr-defined]
        text = session.execute(r.StoreTaught(f"in_{folder}", motion=False))
        assert ("names are found in the folder library: put" in text) == said
        session.close()


def test_frames_tell_the_gains_and_the_gravity_in_use_and_none_that_was_refused(desk: Desk) -> None:
    def newest() -> StreamFrame:
        return desk.page.frame()

    assert (newest().gains, newest().gravity) == ("default", None)
    desk.wish(r.ChooseGains("loose"))
    desk.wish(r.SetGravity((0.0, 0.0, 9.81)))
    desk.until(lambda: (newest().gains, newest().gravity) == ("loose", (0.0, 0.0, 9.81)))
    desk.wish(r.SetGravity((0.0, 0.0, -981.0)))
    desk.until(lambda: "on no planet" in desk.page.notices())
    assert newest().gravity == (0.0, 0.0, 9.81)
    desk.wish(r.SetGravity(None))
    desk.until(lambda: newest().gravity is None)


def test_the_gravity_of_the_configs_controller_is_the_one_in_use(tmp_path: Path) -> None:
    controller = {"kind": "pid", "gravity": [0.0, 9.81, 0.0]}
    opened = Desk(tmp_path, load_config("sim_right").changed(controller=controller))
    try:
        assert opened.page.frame().gravity == (0.0, 9.81, 0.0)
    finally:
        opened.host.close()


def test_the_end_of_no_recording_is_not_said_to_be_whole(desk: Desk) -> None:
    desk.wish(r.Record(on=False))
    desk.until(lambda: desk.page.notices() == "nothing is being recorded")


def test_a_library_that_cannot_be_made_is_told_and_the_panel_goes_on(desk: Desk, tmp_path: Path) -> None:
    (tmp_path / "library").write_text("")
    desk.wish(r.Teach(on=True))
    desk.until(lambda: desk.page.frame().teaching)
    desk.wish(r.StoreTaught("shown", motion=False))
    desk.until(lambda: "cannot write" in desk.page.notices())
    desk.wish(r.MoveToPosture("home"))
    desk.until(lambda: desk.page.frame().kind == "pid")


@pytest.mark.parametrize("wish", [r.Reopen(), r.OpenScene("scenarios/demo/lemon.yaml", None, False)])
def test_a_hand_that_is_opened_anew_says_which_recording_ended_with_the_other(
    desk: Desk, tmp_path: Path, wish: r.Request
) -> None:
    desk.wish(r.Record(on=True))
    desk.until(lambda: desk.page.frame().recorded > 0.1)
    desk.page.said.clear()
    desk.wish(wish)
    desk.until(lambda: any(isinstance(news, SessionInfo) for news in desk.page.said))
    path = tmp_path / "out" / "panel_001.arrow"
    assert desk.page.notices() == f"the recording {path} has ended with this hand: it is whole"
    assert load(path).complete
    desk.page.said.clear()
    desk.wish(wish)
    desk.until(lambda: any(isinstance(news, SessionInfo) for news in desk.page.said))
    assert "recording" not in desk.page.notices()


def test_a_recording_whose_columns_change_ends_there_with_all_rows_before(desk: Desk, tmp_path: Path) -> None:
    desk.wish(r.Record(on=True))
    desk.until(lambda: desk.page.frame().recorded > 0.02)
    session = desk.host._session
    assert isinstance(session, HandSession)
    look = session._look
    session._look = lambda: {**look(), "pull": np.zeros(3)}
    desk.until(lambda: "has pull, which the first row has not" in desk.page.notices())
    recording = load(tmp_path / "out" / "panel_001.arrow")
    assert recording.complete
    assert len(recording) > 5


def test_what_is_shown_is_kept_in_the_users_library(desk: Desk, tmp_path: Path) -> None:
    desk.wish(r.Teach(on=True))
    desk.until(lambda: desk.page.frame().teaching)
    desk.wish(r.Teach(on=False))
    desk.until(lambda: not desk.page.frame().teaching)
    desk.wish(r.StoreTaught("mine", motion=False))
    desk.until(lambda: "mine is in" in desk.page.notices())
    shelf = [news for news in desk.page.said if isinstance(news, LibraryContents)][-1]
    assert "mine" in shelf.postures
    file = tmp_path / "library" / "mine.yaml"
    before = file.read_bytes()
    desk.wish(r.StoreTaught("mine", motion=False))
    desk.until(lambda: "'mine' is a posture in" in desk.page.notices() and "tick Replace" in desk.page.notices())
    assert file.read_bytes() == before
    count = desk.page.notices().count("mine is in")
    desk.wish(r.StoreTaught("mine", motion=False, replace=True))
    desk.until(lambda: desk.page.notices().count("mine is in") > count)


def test_a_simulated_hand_is_opened_in_another_scene_and_one_that_is_not_there_is_refused(desk: Desk) -> None:
    desk.wish(r.OpenScene("lemon", None, perform=False))
    desk.until(lambda: len([1 for news in desk.page.said if isinstance(news, SessionInfo)]) == 2)
    frame = desk.page.frame()
    while frame.session < 2:
        frame = desk.page.frame()
    assert {"palm", "object", "contact_vector"} <= set(frame.look)
    begin = frame.look["object"]
    desk.until(lambda: desk.page.frame().t > 0.5)
    np.testing.assert_allclose(desk.page.frame().look["palm"], frame.look["palm"], atol=2e-3)
    np.testing.assert_allclose(desk.page.frame().look["object"], begin, atol=2e-3)
    desk.wish(r.OpenScene("lemmon", None, perform=False))
    desk.until(lambda: "did you mean" in desk.page.notices())
    assert desk.host._session is not None


def test_a_recording_is_a_hand_to_look_at_and_its_end_is_told(recording_path: Path, tmp_path: Path) -> None:
    config = tmp_path / "replay.yaml"
    config.write_text(f"backend: {{kind: replay, file: {recording_path}}}\ncontroller: {{kind: torque}}\n")
    desk = Desk(tmp_path, load_config(config))
    desk.until(lambda: any(isinstance(news, SessionEnded) for news in desk.page.said))
    desk.wish(r.OpenScene(None, None, perform=False))
    desk.until(lambda: "only a simulated hand" in desk.page.notices())
    desk.wish(r.Reopen())
    desk.until(lambda: len([1 for news in desk.page.said if isinstance(news, SessionInfo)]) == 2)
    assert [type(news) for news in desk.page.said].index(SessionEnded) > 0  # After it was opened for the first time.
    desk.host.close()


def test_a_hand_that_cannot_be_opened_is_an_error_and_no_page(tmp_path: Path) -> None:
    config = tmp_path / "replay.yaml"
    config.write_text("backend: {kind: replay, file: nowhere.arrow}\ncontroller: {kind: torque}\n")
    with pytest.raises(ConfigError, match="nowhere"):
        Desk(tmp_path, load_config(config))


MOTORS = {"leap": 16, "model_o": 4, "sih": 5, "qb_softhand": 1}


@pytest.mark.parametrize("config", [f"sim_{hand}" for hand in MOTORS] + [f"{hand}_virtual" for hand in MOTORS])
def test_every_hand_is_opened_with_what_is_its_own_and_does_what_is_wished(
    config: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    hand = config.removeprefix("sim_").removesuffix("_virtual")
    settings = load_config(config)
    if settings.backend.kind == "dynamixel":
        pytest.importorskip("dynamixel_sdk", reason="servos need the vendor's SDK: extra dynamixel")
    desk = Desk(tmp_path, settings)
    try:
        desk.until(lambda: len(desk.page.said) > 1)
        opened, shelf = desk.page.said[:2]
        assert isinstance(opened, SessionInfo)
        assert isinstance(shelf, LibraryContents)
        assert opened.kinds == ("limp", "position")
        assert opened.gains == ("default",)
        assert len(opened.scenarios) == 12
        assert {name for name in shelf.grasps if not name.endswith("_on_arm")} == set(opened.scenarios)
        assert all(name.startswith(hand) for name in (*shelf.postures, *shelf.grasps))
        assert desk.page.frame().position.shape == (MOTORS[hand],)
        spec, last = opened.spec, opened.spec.fingers[0].joints[-1]
        goal = np.clip(desk.page.frame().position, spec.lower, spec.upper)
        goal[last] = spec.lower[last] + 0.4 * (spec.upper - spec.lower)[last]
        desk.wish(r.MoveJoints(tuple(goal)))
        desk.until(lambda: desk.page.frame().kind == "position")
        near = 0.1 * (spec.upper - spec.lower)[last]
        desk.until(lambda: abs(desk.page.frame().position[last] - goal[last]) < near)
        desk.wish(r.StopMotion())
        desk.until(lambda: desk.page.frame().stopped)
        assert desk.page.frame().kind == "limp"
    finally:
        desk.host.close()


def test_a_hand_that_closes_its_own_loop_performs_a_scenario_by_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    desk = Desk(tmp_path, load_config("sim_model_o"))
    try:
        desk.wish(r.OpenScene("model_o_lemon", None, perform=True))
        desk.until(lambda: desk.page.notices() != "" or desk.page.frame().session == 2)
        assert desk.page.notices() == ""
        desk.until(lambda: len([1 for news in desk.page.said if isinstance(news, SessionInfo)]) == 2)
        desk.wish(r.OpenScene(None, None, perform=False))
        desk.until(lambda: len([1 for news in desk.page.said if isinstance(news, SessionInfo)]) == 3)
        assert desk.page.notices() == ""
    finally:
        desk.host.close()


@pytest.fixture
def lemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    """A hand over a lemon."""
    monkeypatch.chdir(tmp_path)
    config = load_config("sim_right")
    found = Desk(tmp_path, config.model_copy(update={"task": TaskSettings(scenario="lemon")}))
    yield found
    found.host.close()


def pull(desk: Desk, up: float = 0.2) -> StreamFrame:
    """Drag the lemon upwards until it is seen to be pulled."""
    at = desk.page.frame().look["object"][:3]
    desk.wish(r.DragObject(0, (0.0, 0.0, 0.0), (at[0], at[1], at[2] + up)))
    desk.until(lambda: "drag" in desk.page.frame().look)
    return desk.page.frame()


def test_the_mouse_pulls_an_object_with_a_force_that_is_told_and_bounded(lemon: Desk) -> None:
    number, *_, fx, fy, fz = pull(lemon, up=3.0).look["drag"]
    assert number == 0
    np.testing.assert_allclose(np.linalg.norm([fx, fy, fz]), 5.0, rtol=1e-6)
    lemon.wish(r.DropObject())
    lemon.until(lambda: "drag" not in lemon.page.frame().look)


@pytest.mark.parametrize("end", [r.DropObject(), r.StopMotion(), r.DriverLeft(), None, r.Reopen()])
def test_the_force_ends_with_the_button_a_stop_the_driver_the_page_and_the_session(end: Any, lemon: Desk) -> None:
    begin = pull(lemon).t
    session = lemon.host._session
    assert isinstance(session, HandSession)
    assert session.rig.sim is not None
    lemon.wish(end)  # None: the page has died.
    lemon.until(lambda: "drag" not in lemon.page.frame().look)
    assert lemon.page.frame().t < begin + 3.0, "it ended by itself, after five seconds of simulated time"
    assert session.rig.sim.mouse.drag is None
    if isinstance(end, r.StopMotion):
        lemon.wish(r.DragObject(0, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
        lemon.until(lambda: "nothing is pulled until the stop is released" in lemon.page.notices())


def test_letting_go_does_not_wait_for_a_wish_that_is_being_planned(lemon: Desk) -> None:
    begin = pull(lemon).t
    lemon.wish(r.DropObject())  # The host does not turn: no other request is carried out.
    while "drag" in (frame := lemon.page.frame()).look:
        assert frame.t < begin + 3.0


def test_a_recording_has_the_force_and_a_verdict_says_that_there_was_one(lemon: Desk, tmp_path: Path) -> None:
    lemon.wish(r.OpenScene("lemon", None, perform=True))
    lemon.until(lambda: lemon.page.frame().session == 2)
    lemon.wish(r.Record(on=True))
    lemon.until(lambda: lemon.page.frame().recorded > 0.1)
    pull(lemon)
    session = lemon.host._session
    assert isinstance(session, HandSession)
    session._verdict_due = True
    assert session.rig.trial is not None
    session.rig.trial.report = lambda: TrialReport(True, "", (), 0.0, 0.0, 0.0, {})  # type: ignore[method-assign]  # As if it were over.
    lemon.until(lambda: "no verdict on the scenario" in lemon.page.notices())
    assert "held; but the mouse pulled an object with up to" in lemon.page.notices()
    lemon.wish(r.Record(on=False))
    lemon.until(lambda: "is whole" in lemon.page.notices())
    recording = load(tmp_path / "out" / "panel_001.arrow")
    force = np.linalg.norm(recording.columns["mouse_force"], axis=1)
    assert force[0] == 0.0
    assert 0.0 < force.max() <= 5.0 + 1e-9


def test_an_object_that_is_not_there_is_not_pulled(lemon: Desk, tmp_path: Path) -> None:
    for number, height in ((1, 0.1), (-1, 0.1), (0, float("nan"))):
        lemon.wish(r.DragObject(number, (0.0, 0.0, 0.0), (0.0, 0.0, height)))
        lemon.until(lambda number=number: f"no object {number}" in lemon.page.notices())  # type: ignore[misc]  # Bound for this turn.


@pytest.mark.parametrize(
    "wish", [r.HoldHere(), r.DriverLeft(), r.StopMotion(), r.PerformGrasp("fist_free"), r.MoveToPosture("home")]
)
def test_a_scenario_that_somebody_took_over_has_no_verdict(lemon: Desk, wish: r.Request) -> None:
    lemon.wish(r.OpenScene("lemon", None, perform=True))
    lemon.until(lambda: lemon.page.frame().session == 2)
    session = lemon.host._session
    assert isinstance(session, HandSession)
    assert session.rig.trial is not None
    session.rig.trial.report = lambda: TrialReport(True, "", (), 0.0, 0.0, 0.0, {})  # type: ignore[method-assign]  # As if it were over.
    lemon.wish(r.ChooseGains("v4"))
    lemon.until(lambda: "gains v4 from the next request on" in lemon.page.notices())
    session._verdict_due = True
    lemon.until(lambda: "the verdict: held" in lemon.page.notices())
    assert "no verdict" not in lemon.page.notices()
    lemon.wish(wish)
    lemon.until(lambda: session._interfered)
    session._verdict_due = True
    lemon.until(lambda: "held; but the hand was driven from the page: no verdict on" in lemon.page.notices())


def test_the_scene_of_the_config_is_performed_with_its_own_grasp_and_gains(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text("backend: {kind: sim}\ncontroller: {kind: pd, gains: v4}\n"
                    "task: {scenario: lemon, grasp: pinch_index}\n")  # fmt: skip
    config = load_config(str(path))
    same, other = (scene_of(config, r.OpenScene("lemon", name, perform=True)) for name in (None, "golf_ball"))
    assert same == config
    assert other.task.grasp is None
    assert scene_of(config, r.OpenScene("apple", None, perform=True)).task.scenario == "apple"


def test_a_hand_without_objects_and_a_recording_say_why_nothing_can_be_pulled(
    desk: Desk, recording_path: Path, tmp_path: Path
) -> None:
    opened = desk.page.said[0]
    assert isinstance(opened, SessionInfo)
    assert "choose a scenario" in opened.no_drag
    desk.wish(r.DragObject(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.1)))
    desk.until(lambda: "no simulated object to pull" in desk.page.notices())
    config = tmp_path / "replay.yaml"
    config.write_text(f"backend: {{kind: replay, file: {recording_path}}}\ncontroller: {{kind: torque}}\n")
    other = Desk(tmp_path, load_config(config))
    opened = other.page.said[0]
    assert isinstance(opened, SessionInfo)
    assert "only simulated objects" in opened.no_drag
    other.host.close()
