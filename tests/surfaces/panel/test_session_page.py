"""What a browser shows of a hand and what it asks for, without a browser: viser is a fake (`fake_viser.py`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

pytest.importorskip("viser", reason="needs viser: extra panel")

from allegro_twin.errors import HandError  # Behind the check for the extra.
from allegro_twin.hands.description.appearance import VisualShape, series_color
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp, load_posture
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.panel import requests as r
from allegro_twin.surfaces.panel.page import session_page
from allegro_twin.surfaces.panel.page.html import banner, health, hexed, joint_groups, joint_states
from allegro_twin.surfaces.panel.page.library_view import rows
from allegro_twin.surfaces.panel.page.scene import _floor, eye
from allegro_twin.surfaces.panel.page.session_page import SessionPage
from allegro_twin.surfaces.panel.stream import LibraryContents, Notice, SessionEnded, SessionInfo, StreamFrame
from allegro_twin.types import Vector
from allegro_twin.viewing.scenery import scenery
from allegro_twin.viewing.skeleton import Skeleton
from tests.patience import wait_for
from tests.snapshots import assert_snapshot
from tests.surfaces.panel.fake_viser import Client, Server, change, click, drag, drag_mesh, drop

SNAPSHOTS = Path(__file__).with_name("snapshots")
SPEC = load_spec()
HOME = load_posture("home", SPEC)
MUG = VisualShape("cylinder", (0.04, 0.04), (0.0, 0.0, 0.0), paint="mug")


def opened(spec: HandSpec = SPEC, **changes: Any) -> SessionInfo:
    around = replace(scenery(spec, {}), palm=(0.1, 0.2, 0.5, 1.0, 0.0, 0.0, 0.0))
    plain = SessionInfo(1, "a hand · simulated", spec, around, ("pd", "gravity", "torque"), ("default",))
    return replace(plain, **changes)


def moment(t: float, **changes: Any) -> StreamFrame:
    n = SPEC.n_joints
    plain = StreamFrame(
        1, t, HOME.copy(), np.zeros(n), np.full(n, np.nan), np.full(n, np.nan), {}, "pd", False, 0, (), -1.0, False
    )
    full = plain._replace(**changes)
    return full._replace(goal=np.where(np.isnan(full.target), full.position, full.target))


class Page:
    """A page with as many browsers as come."""

    def __init__(self, of: SessionInfo | None = None) -> None:
        self.server: Any = Server()
        self.asked: list[r.Request] = []
        self.session = SessionPage(self.server, self.asked.append)
        self.clients: list[Client] = []
        self.come()
        if of is not None:
            self.session.hear(of)

    def come(self) -> Client:
        self.clients.append(Client(len(self.clients) + 1))
        self.server.come(self.clients[-1])
        return self.clients[-1]

    @property
    def first(self) -> Client:
        return self.clients[0]

    def show(self, frame: StreamFrame, times: int = 1) -> None:
        """As often as it takes until the buttons are looked at, or so many times that."""
        for number in range(5 * times):
            self.session.show(frame._replace(t=frame.t + 0.01 * number))

    def says(self, client: Client | None = None) -> str:
        return str((client or self.first).gui.made[0].content)

    def at(self, name: str, kind: str = "") -> Any:
        return self.first.gui.named(name, kind)


def see(page: Page, drawn: list[float]) -> None:
    """Instead of being drawn, moments are counted."""

    def show(frame: StreamFrame) -> None:
        drawn.append(frame.t)

    assert page.session._scene is not None
    page.session._scene.show = page.session.state.redraw = show  # type: ignore[method-assign]


@pytest.fixture
def page() -> Page:
    found = Page(opened())
    found.show(moment(1.0))
    return found


def test_a_page_without_a_session_says_that_one_is_being_opened() -> None:
    page = Page()
    assert page.first.gui.panel == "Opening …"
    assert "The session is being opened …" in page.says()
    page.session.hear(opened())
    assert page.first.gui.panel == "a hand · simulated"
    assert [each.name for each in page.first.gui.made if each.kind == "tab"] == [
        "Joints", "Library", "Control", "Time", "Plots", "Health",
    ]  # fmt: skip


def test_who_comes_first_drives_and_the_others_look_on_until_the_wheel_is_free(page: Page) -> None:
    assert "You drive" in page.says()
    assert "look" not in page.says()
    second = page.come()
    assert "You drive; 1 more looks on" in page.says()
    assert "You look on; somebody else drives. STOP is for everybody" in page.says(second)
    assert second.gui.named("Drive").disabled
    page.come()
    assert "You drive; 2 more look on" in page.says()
    click(page.at("Let go"))
    assert page.asked == [r.DriverLeft()]
    assert "Nobody drives: press Drive" in page.says(second)
    click(second.gui.named("Drive"))
    assert "You drive" in page.says(second)
    assert page.at("Drive").disabled
    assert second.gui.named("Let go").name == "Drive", "one button for both"
    assert not second.gui.named("Let go").disabled
    page.server.gone(second)
    assert page.asked == [r.DriverLeft(), r.DriverLeft()]
    assert "Nobody drives" in page.says()


def test_who_looks_on_is_refused_and_told_so(page: Page) -> None:
    second = page.come()
    change(second.gui.named(SPEC.joint_labels[0], "slider"), 0.2)
    assert page.asked == []
    assert second.told == [("Not done", "you look on; somebody else drives, or nobody: press Drive", "red")]
    assert second.shown_for == [6.0]
    assert not page.first.told


def test_the_line_says_what_the_hand_does_and_when(page: Page) -> None:
    assert "Controller: pd · 1.0 s" in page.says()
    page.show(moment(2.0, kind="limp"))
    assert "Controller: off, the hand is limp · 2.0 s" in page.says()
    page.show(moment(2.5, kind="torque"))
    assert "Controller: off, the hand is limp" in page.says()
    page.show(moment(3.0, stopped=True))
    assert "STOPPED: limp until the stop is released · 3.0 s" in page.says()
    assert page.at("Release the stop").visible
    assert not page.at("Release the stop").disabled
    assert page.at("Hold here").disabled
    click(page.at("Release the stop"))
    assert page.asked == [r.ReleaseStop()]
    page.show(moment(4.0))
    assert not page.at("Release the stop").visible
    assert not page.at("Hold here").disabled
    click(page.at("Hold here"))
    assert page.asked[-1] == r.HoldHere()
    page.session.silence()
    assert "No news from the hand for a second" in page.says()
    page.show(moment(5.0))
    assert "No news" not in page.says()


def test_what_the_hand_says_is_a_line_and_for_a_while_a_notice(page: Page) -> None:
    page.session.hear(Notice("recording to <a>"))
    assert page.first.told == [("The hand", "recording to <a>", "blue")]
    assert "recording to &lt;a&gt;" in page.says()
    page.session.hear(Notice("no", bad=True))
    assert page.first.told[-1] == ("Not done", "no", "red")


def test_a_hand_that_has_ended_can_be_opened_again_by_who_drives(page: Page) -> None:
    second = page.come()
    assert not page.at("Open the hand again").visible
    page.session.hear(SessionEnded("a fault"))
    assert "The hand has ended: a fault" in page.says()
    assert page.at("Open the hand again").visible
    assert not page.at("Open the hand again").disabled
    assert second.gui.named("Open the hand again").disabled
    assert page.at("Hold here").disabled
    click(page.at("Open the hand again"))
    assert page.asked == [r.Reopen()]
    page.session.hear(opened(session=2))
    assert not page.at("Open the hand again").visible
    page.session.show(moment(1.0))  # Of the hand before it.
    assert page.session.state.frame is None


def test_a_moment_is_drawn_each_time_and_buttons_and_joints_every_fifth(page: Page) -> None:
    states = next(each for each in page.first.gui.made if each.kind == "html" and "joint-states" in each.content)
    before, drawn = states.content, list[float]()
    see(page, drawn)
    for number in range(4):
        page.session.show(moment(2.0 + number, position=HOME + 0.1))
        assert states.content == before
    page.session.show(moment(6.0, position=HOME + 0.1))
    assert states.content == joint_states(SPEC, moment(6.0, position=HOME + 0.1)) != before
    assert drawn == [2.0, 3.0, 4.0, 5.0, 6.0]


def test_a_slider_reaches_to_the_limits_in_whole_thousandths_and_moves_one_joint(page: Page) -> None:
    for joint, name in enumerate(SPEC.joint_labels):
        slider = page.at(name, "slider")
        assert SPEC.lower[joint] <= slider.min < SPEC.lower[joint] + 1e-3
        assert SPEC.upper[joint] - 1e-3 < slider.max <= SPEC.upper[joint]
        assert slider.min * 1000 == pytest.approx(round(slider.min * 1000), abs=1e-9)
        assert (slider.step, slider.hint) == (0.001, f"{slider.min:g} to {slider.max:g} rad")
    change(page.at(SPEC.joint_labels[1], "slider"), 0.75)
    (wish,) = page.asked
    assert wish == r.MoveJoints.of(SPEC.n_joints, {1: 0.75})
    change(page.at(SPEC.joint_labels[2], "slider"), 0.5, client=None)  # The program's own.
    assert len(page.asked) == 1
    change(page.at(SPEC.joint_labels[2], "slider"), 0.5)
    assert page.asked[1] == r.MoveJoints.of(SPEC.n_joints, {2: 0.5})


def test_the_next_who_drives_does_not_ask_for_the_goal_of_the_one_before(page: Page) -> None:
    second = page.come()
    change(page.at(SPEC.joint_labels[1], "slider"), 1.6)
    click(page.at("Let go"))
    click(second.gui.named("Drive"))
    page.show(moment(2.0))
    change(second.gui.named(SPEC.joint_labels[5], "slider"), 0.2)
    asked = page.asked[-1]
    assert isinstance(asked, r.MoveJoints)
    assert asked.position[1] != 1.6
    assert asked.position[5] == 0.2


def test_a_goal_that_was_refused_is_not_asked_for_again_and_its_slider_goes_back(page: Page) -> None:
    slider = page.at(SPEC.joint_labels[2], "slider")
    change(slider, 1.7)
    page.session.hear(Notice("index and thumb would be 5.8 mm inside each other", bad=True))
    page.show(moment(2.0), times=5)
    assert slider.value == pytest.approx(HOME[2], abs=2e-3)
    change(page.at(SPEC.joint_labels[9], "slider"), 0.7)
    asked = page.asked[-1]
    assert isinstance(asked, r.MoveJoints)
    assert asked.position[2] != 1.7
    assert asked.position[9] == 0.7


def test_a_slider_begins_at_nought_or_at_the_limit_that_is_nearest() -> None:
    page = Page(opened())
    for joint, name in enumerate(SPEC.joint_labels):
        slider = page.at(name, "slider")
        assert slider.value == min(max(0.0, slider.min), slider.max), joint


def test_a_slider_follows_where_its_joint_is_wished_to_be_once_that_rests(page: Page) -> None:
    name = SPEC.joint_labels[5]
    slider, goal = page.at(name, "slider"), HOME.copy()
    assert slider.value != pytest.approx(HOME[5], abs=1e-3)  # The first look has nothing to compare with.
    page.show(moment(2.0))
    assert slider.value == pytest.approx(HOME[5])
    goal[5] += 0.3
    page.show(moment(3.0, target=goal))
    assert slider.value == pytest.approx(HOME[5]), "on its way it rests"
    page.show(moment(4.0, target=goal))
    assert slider.value == pytest.approx(goal[5])
    goal[5] += 1.5e-3
    page.show(moment(5.0, target=goal), times=2)
    assert slider.value == pytest.approx(goal[5] - 1.5e-3), "so near it is not moved"
    goal[5] = SPEC.upper[5] + 1.0
    page.show(moment(6.0, target=goal), times=2)
    assert slider.value == slider.max


def test_a_slider_that_was_touched_is_left_to_the_person_for_three_looks(page: Page) -> None:
    page.show(moment(1.5))
    slider = page.at(SPEC.joint_labels[5], "slider")
    change(slider, 0.9)
    other = HOME.copy()
    other[5] = 0.2
    for number in range(3):
        page.show(moment(2.0 + number, target=other))
        assert slider.value == 0.9, number
    page.show(moment(6.0, target=other), times=2)
    assert slider.value == pytest.approx(0.2)


def test_only_who_drives_and_while_nothing_is_stopped_has_sliders_that_move(page: Page) -> None:
    slider = page.at(SPEC.joint_labels[0], "slider")
    assert not slider.disabled
    page.show(moment(2.0, stopped=True))
    assert slider.disabled
    page.show(moment(3.0))
    assert not slider.disabled
    assert page.come().gui.named(SPEC.joint_labels[0], "slider").disabled


def test_after_a_stop_the_recording_can_be_ended_and_the_picture_paused(page: Page) -> None:
    second = page.come()
    page.show(moment(2.0, stopped=True, recorded=1.0))
    assert not page.at("End the recording").disabled
    assert not page.at("Pause the picture").disabled
    assert page.at("Teach").disabled
    assert page.at("Repeat what was shown").disabled
    assert all(second.gui.named(name).disabled for name in ("End the recording", "Pause the picture", "Teach"))
    click(page.at("End the recording"))
    assert page.asked == [r.Record(on=False)]
    click(page.at("Pause the picture"))
    assert not page.at("Play from there").disabled
    page.session.hear(SessionEnded("a fault"))
    assert page.at("Record").disabled, "there is nothing to record"
    assert not page.at("Pause the picture").disabled


def test_a_tip_is_dragged_to_where_its_finger_then_is(page: Page) -> None:
    controls = {name: page.first.scene.at(f"/palm/drag_{name}") for name in ("index", "middle", "ring", "thumb")}
    assert page.session.state.tip_ik is not None
    for name, control in controls.items():
        assert control.visible
        np.testing.assert_allclose(control.position, page.session.state.tip_ik.tip(name, HOME), atol=1e-12)
    wish = controls["index"].position + np.array([0.004, 0.002, -0.006])
    drag(controls["index"], wish)
    (found,) = page.asked
    assert isinstance(found, r.MoveJoints)
    posture = [here if asked is None else asked for here, asked in zip(HOME, found.position, strict=True)]
    np.testing.assert_allclose(page.session.state.tip_ik.tip("index", np.array(posture)), wish, atol=1e-6)
    box = page.at("Drag fingertips")
    change(box, False)
    assert not any(control.visible for control in controls.values())
    change(box, True)
    page.show(moment(2.0, stopped=True))
    assert not any(control.visible for control in controls.values())


def test_a_tip_out_of_reach_is_marked_with_the_nearest_place_and_the_joints_stay(page: Page) -> None:
    scene, control = page.first.scene, page.first.scene.at("/palm/drag_index")
    far = np.array([0.0, 0.05, 0.5])
    drag(control, far)
    assert page.asked == []
    said = next(each for each in page.first.gui.made if each.kind == "html" and "out of reach" in str(each.content))
    assert page.session.state.tip_ik is not None
    found = page.session.state.tip_ik.drag("index", far, HOME)
    assert f"index: out of reach by {1000 * found.distance:.0f} mm; the joints stay" in said.content
    red, green, line = scene.at("/palm/out_of_reach"), scene.at("/palm/nearest"), scene.at("/palm/short")
    np.testing.assert_array_equal(red.position, far)
    np.testing.assert_array_equal(green.position, found.nearest)
    assert (red.radius, green.radius, red.color) == (0.006, 0.003, (200, 16, 46))
    assert green.color == tuple(round(255 * part) for part in series_color(0))
    np.testing.assert_allclose(line.given[0], [[far, found.nearest]], rtol=1e-6)
    page.show(moment(2.0), times=3)
    assert not red.removed, "the person still drags"
    drop(control)
    assert red.removed
    assert green.removed
    assert line.removed
    assert not said.content
    page.show(moment(3.0))
    np.testing.assert_allclose(control.position, page.session.state.tip_ik.tip("index", HOME))


def test_a_tip_that_is_dragged_is_left_to_the_person_for_three_looks(page: Page) -> None:
    control = page.first.scene.at("/palm/drag_index")
    drag(control, np.array([0.0, 0.05, 0.5]))
    for number in range(3):
        page.show(moment(2.0 + number))
        np.testing.assert_array_equal(control.position, [0.0, 0.05, 0.5])
    page.show(moment(6.0))
    assert np.abs(control.position - [0.0, 0.05, 0.5]).max() > 0.1
    there = control.position.copy()
    page.show(moment(7.0, position=HOME + 2e-4))
    assert np.abs(control.position - there).max() < 1e-4, "nor is it moved by less than a tenth of a millimetre"


def test_a_hand_whose_tips_cannot_be_dragged_says_why() -> None:
    page = Page(opened(no_tips="it has tendons"))
    assert page.session.state.tip_ik is None
    said = [str(each.content) for each in page.first.gui.made if each.kind == "html"]
    assert any("fingertips of this hand cannot be dragged: it has tendons" in each for each in said)
    assert not [each for each in page.first.scene.made if each.kind == "transform_controls"]
    page.show(moment(1.0))


def test_what_is_dragged_is_taken_out_of_the_picture_when_the_hand_is_opened_again(page: Page) -> None:
    controls = [each for each in page.first.scene.made if each.kind == "transform_controls"]
    page.session.hear(opened(session=2))
    assert all(each.removed for each in controls)


class Renderer:
    """A process that renders a posture as its sum, or cannot."""

    fails: ClassVar[bool] = False
    rendered: ClassVar[list[float]] = []

    def __init__(self, task: Any, *, nice: int) -> None:
        self.nice = nice

    def __enter__(self) -> Callable[[Vector], bytes]:
        if self.fails:
            raise HandError("no context")
        return self.render

    def render(self, posture: Vector) -> bytes:
        self.rendered.append(float(posture.sum()))
        return f"{posture.sum():.3f}".encode()

    def __exit__(self, *raised: object) -> None: ...


@pytest.fixture
def renderer(monkeypatch: pytest.MonkeyPatch) -> type[Renderer]:
    monkeypatch.setattr(session_page, "WorkerProcess", Renderer)
    monkeypatch.setattr(Renderer, "rendered", [])
    monkeypatch.setattr(Renderer, "fails", False)
    return Renderer


def groups_of(page: Page) -> list[Any]:
    """The rows of names in the library that stand there now."""
    return [each for each in page.first.gui.made if each.kind == "button_group" and not each.name and not each.removed]


def rows_of(page: Page) -> list[str]:
    return [each.content for each in page.first.gui.made
            if each.kind == "html" and "library-row" in str(each.content) and not each.removed]  # fmt: skip


def fill(page: Page, postures: dict[str, Vector], grasps: dict[str, Vector]) -> None:
    """Until it is drawn."""
    page.session.hear(LibraryContents(postures, grasps))
    names = [*postures, *grasps]
    wait_for(lambda: sum(len(group.given[0]) for group in groups_of(page)) == len(names), "the library")


def test_the_library_is_rows_of_pictures_with_buttons_below(page: Page, renderer: type[Renderer]) -> None:
    postures = {name: load_posture(name, SPEC) for name in ("home", "fist", "rock")}
    grasp = load_grasp("grasp_3", SPEC).close
    fill(page, postures, {"grasp_3": grasp})
    pictures = page.session.state.thumbnails
    assert set(pictures) == {"home", "fist", "rock", "grasp_3"}
    first, second = groups_of(page)
    assert (first.given[0], second.given[0]) == (("home", "fist", "rock"), ("grasp_3",))
    click(first, "rock")
    click(second, "grasp_3")
    assert page.asked == [r.MoveToPosture("rock"), r.PerformGrasp("grasp_3")]
    assert [row.count("<img") for row in rows_of(page)] == [3, 1]
    assert all(pictures[name] in rows_of(page)[0] for name in postures)
    assert len(renderer.rendered) == 4
    fill(page, {**postures, "mine": HOME}, {"grasp_3": grasp})
    assert len(renderer.rendered) == 5, "what was drawn is not drawn again"
    assert second.removed
    fill(page, postures, {})
    assert any("none for this hand" in str(each.content) for each in page.first.gui.made if each.kind == "html")


def test_the_search_leaves_the_entries_with_all_its_words(page: Page, renderer: type[Renderer]) -> None:
    fill(page, {"pinch_index": HOME, "pinch_middle": HOME, "fist": HOME}, {})
    change(page.at("Search"), "Index pinch")
    assert [group.given[0] for group in groups_of(page)] == [("pinch_index",)]
    change(page.at("Search"), "pinch_")
    assert [group.given[0] for group in groups_of(page)] == [("pinch_index", "pinch_middle")]
    change(page.at("Search"), "wave")
    assert not groups_of(page)
    said = [each.content for each in page.first.gui.made if each.kind == "html" and not each.removed]
    assert len([text for text in said if "none with such a name" in text]) == 2


def test_a_library_without_pictures_says_why(page: Page, renderer: type[Renderer]) -> None:
    renderer.fails = True
    fill(page, {"home": HOME}, {})
    page.show(moment(2.0))
    assert "the library has no pictures: no context" in page.says()
    assert groups_of(page)[0].given[0] == ("home",)


def test_names_stand_side_by_side_as_far_as_they_have_room() -> None:
    assert rows(["a", "b", "c", "d", "e"]) == [("a", "b", "c", "d"), ("e",)]
    long = "x" * 20
    assert rows([long, "y" * 14, "z"]) == [(long, "y" * 14), ("z",)]
    assert rows([long, "y" * 15]) == [(long,), ("y" * 15,)]
    assert rows([]) == []


def test_what_ships_for_a_model_is_called_without_the_models_name_unless_that_is_anothers(
    renderer: type[Renderer],
) -> None:
    spec = load_spec("sih")
    page = Page(opened(spec, no_tips="tendons"))
    middle = (spec.lower + spec.upper) / 2
    fill(page, {}, {"sih_mug": middle, "sih_apple": middle + 0.1, "apple": middle + 0.2})
    assert [name for group in groups_of(page) for name in group.given[0]] == ["mug", "sih_apple", "apple"]
    assert all(picture in "".join(rows_of(page)) for picture in page.session.state.thumbnails.values())


def test_a_recording_is_begun_and_ended_with_one_button(page: Page) -> None:
    click(page.at("Record", "button"))
    page.show(moment(2.0, recorded=0.0))
    assert page.at("End the recording").label == "End the recording"
    assert any("recording: 0 s" in str(each.content) for each in page.first.gui.made if each.kind == "html")
    page.show(moment(3.0, recorded=61.6))
    assert any("recording: 62 s" in str(each.content) for each in page.first.gui.made if each.kind == "html")
    click(page.at("End the recording"))
    assert page.asked == [r.Record(True), r.Record(False)]
    page.show(moment(4.0))
    assert not any("recording:" in str(each.content) for each in page.first.gui.made if each.kind == "html")


def test_what_is_shown_is_taught_repeated_and_kept(page: Page) -> None:
    assert page.at("Teach", "button").hint == "Gravity compensation: lead the fingers"
    click(page.at("Teach", "button"))
    page.show(moment(2.0, teaching=True))
    click(page.at("Done"))
    click(page.at("Repeat what was shown"))
    change_name, keep = page.at("Name"), page.at("Store the")
    change_name.value = " wave "
    click(keep, "motion")
    click(keep, "posture")
    page.at("Replace").value = True
    click(keep, "motion")
    click(keep, "motion")
    assert page.asked == [
        r.Teach(True),
        r.Teach(False),
        r.PlayTaught(),
        r.StoreTaught("wave", True),
        r.StoreTaught("wave", False),
        r.StoreTaught("wave", True, replace=True),
        r.StoreTaught("wave", True),
    ]
    own = Page(opened(kinds=("position", "limp")))
    assert own.at("Teach", "button").hint == "The motors let go: lead the fingers"


def test_one_looks_back_while_the_hand_goes_on(page: Page) -> None:
    drawn: list[float] = []
    see(page, drawn)
    back, play = page.at("s ago"), page.at("Play from there")
    for number in range(100):
        page.session.show(moment(2.0 + 0.1 * number))
    assert drawn[-1] == pytest.approx(11.9)
    assert not back.visible
    assert (back.min, back.max) == (0.0, 60.0)
    click(page.at("Pause the picture"))
    page.show(moment(12.0))
    assert back.visible
    assert play.visible
    assert "The picture is 0.1 s old; the hand goes on" in page.says()
    assert drawn[-1] == pytest.approx(11.9), "it is paused"
    change(back, 5.0)
    assert drawn[-1] == pytest.approx(12.04 - 5.0, abs=0.06)
    change(back, 1.0, client=None)  # The program's own.
    assert page.session.state.age == pytest.approx(5.0, abs=0.06)
    count = len(drawn)
    page.show(moment(13.0))
    assert len(drawn) == count
    late = page.session.state.age
    assert f"The picture is {late:.1f} s old" in page.says()
    click(play)
    page.show(moment(14.0))
    assert len(drawn) == count + 5
    assert drawn[-1] == pytest.approx(14.04 - late, abs=0.06)
    click(page.at("Back to now"))
    page.show(moment(15.0))
    assert drawn[-1] == pytest.approx(15.04)
    assert not back.visible
    second = page.come()
    click(second.gui.named("Pause the picture"))
    assert page.session.state.shown is None, "the picture is everybody's: who looks on does not stop it"
    change(second.gui.named("s ago"), 3.0)
    assert page.session.state.shown is None


def test_a_picture_that_was_paused_just_now_is_said_to_be_paused(page: Page) -> None:
    click(page.at("Pause the picture"))
    page.session.hear(Notice("a word"))
    assert "The picture is paused; the hand goes on" in page.says()


def curves(page: Page) -> list[Any]:
    return [each for each in page.first.gui.made if each.kind == "uplot" and not each.removed]


def test_curves_are_of_the_newest_ten_seconds_of_one_finger(page: Page) -> None:
    see(page, [])
    for number in range(360):
        page.session.show(moment(2.0 + number / 30, torque=np.full(16, 0.1 * number)))
    assert len(curves(page)) == 2, "they are there without being asked for"
    page.at("Finger").value = "middle"
    page.show(moment(14.0, target=HOME + 0.1))
    position, torque = curves(page)
    assert (position.title, torque.title) == ("position, rad", "torque, N·m")
    assert position.height == 210
    joints = list(joint_groups(SPEC)[1].joints)
    assert [series["label"] for series in position.series] == [
        "s", *(SPEC.joint_labels[k] for k in joints), *(f"{SPEC.joint_labels[k]} goal" for k in joints),
    ]  # fmt: skip
    assert [series["stroke"] for series in position.series[1:5]] == [hexed(k) for k in range(4)]
    assert [series["width"] for series in position.series[1:]] == [2] * 4 + [1] * 4
    limits = np.unique(SPEC.actuation.torque_limit[joints])
    assert len(torque.data) == 1 + 4 + 2 * len(limits)
    np.testing.assert_allclose([column[0] for column in torque.data[5:]], [*limits, *-limits])
    t = position.data[0]
    assert t[-1] - t[0] == pytest.approx(10.0, abs=0.15)
    assert 145 <= len(t) <= 160
    np.testing.assert_allclose(position.data[1], HOME[joints[0]])
    np.testing.assert_allclose(position.data[5][:-5], HOME[joints[0]])  # Without a goal it is where the joint is.
    changes, newest = 0, t[-1]
    for number in range(6):
        page.show(moment(15.0 + number))
        changes += bool(position.data[0][-1] != newest)
        newest = position.data[0][-1]
    assert changes == 2, "every third time"
    page.at("Live").value = False
    page.show(moment(22.0), times=3)
    assert position.data[0][-1] == newest, "they stand still"
    page.at("Live").value = True
    page.at("Finger").value = "thumb"
    page.show(moment(23.0))
    assert position.removed
    assert torque.removed
    assert curves(page)[0].series[1]["label"].startswith("thumb")


def test_links_and_things_are_drawn_where_they_are() -> None:
    around = replace(
        scenery(SPEC, {}),
        palm=(0.1, 0.2, 0.5, 1.0, 0.0, 0.0, 0.0),
        objects={"mug": [MUG], "apple": [VisualShape("sphere", (0.03,))]},
        fixed=[VisualShape("box", (0.4, 0.4, 0.02))],
    )
    page = Page(opened(scenery=around))
    scene = page.server.scene
    np.testing.assert_array_equal(scene.at("/palm").position, [0.1, 0.2, 0.5])
    page.show(moment(1.0))
    skeleton = Skeleton(around.bodies, SPEC)
    places = skeleton.places(HOME[None])
    for body, (place, _) in zip(skeleton.bodies, places, strict=True):
        if body.parent >= 0:
            np.testing.assert_allclose(scene.at(f"/palm/{body.name}").position, place[0])
            assert np.linalg.norm(scene.at(f"/palm/{body.name}").wxyz) == pytest.approx(1.0)
    pose, other = np.array([0.3, 0.1, 0.2, 0.0, 1.0, 0.0, 0.0]), np.array([0.5, 0.5, 0.5, 1.0, 0.0, 0.0, 0.0])
    lifted = np.array([0.1, 0.2, 0.6, 1.0, 0.0, 0.0, 0.0])
    page.show(moment(2.0, look={"palm": lifted, "object": pose, "others": other[None]}))
    np.testing.assert_array_equal(scene.at("/palm").position, lifted[:3])
    np.testing.assert_array_equal(scene.at("/object_0").position, pose[:3])
    np.testing.assert_array_equal(scene.at("/object_0").wxyz, pose[3:])
    np.testing.assert_array_equal(scene.at("/object_1").position, other[:3])
    page.show(moment(3.0, look={"object": pose + 9e-6}))
    np.testing.assert_array_equal(scene.at("/object_0").position, pose[:3])  # What moves by so little is not sent.
    page.show(moment(4.0, look={"object": pose + 2e-5}))
    np.testing.assert_array_equal(scene.at("/object_0").position, pose[:3] + 2e-5)
    meshes = [each.name for each in scene.made if each.kind == "glb"]
    assert {"/palm/look", "/fixed", "/object_0/mug", "/object_1/apple"} <= set(meshes)
    assert not [each for each in scene.made if each.name == "/floor"]
    assert page.server.together == 20


def test_a_hand_alone_has_a_net_below_it_and_is_looked_at_from_aside_of_its_palm(page: Page) -> None:
    floor = page.server.scene.at("/floor")
    lines = floor.given[0]
    assert lines.shape == (26, 2, 3)
    np.testing.assert_allclose(lines.reshape(-1, 3).mean(axis=0), [0.1, 0.2, 0.36])
    np.testing.assert_allclose(np.ptp(lines.reshape(-1, 3), axis=0), [0.6, 0.6, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1), 0.6)
    np.testing.assert_allclose(np.diff(np.unique(_floor(np.zeros(3))[:, 0, 0].round(9))), 0.05)
    camera, of = page.server.initial_camera, opened()
    position, middle = eye(SPEC, of.scenery)
    np.testing.assert_array_equal(camera.position, position)
    np.testing.assert_array_equal(camera.look_at, middle)
    np.testing.assert_array_equal(camera.up, [0.0, 0.0, 1.0])
    away = position - middle
    assert np.linalg.norm(away) == pytest.approx(0.42)
    # The palm faces x; one stands 35 degrees past it, 8 degrees above.
    assert np.degrees(np.arctan2(away[1], away[0])) == pytest.approx(35.0, abs=2.0)
    assert np.degrees(np.arcsin(away[2] / 0.42)) == pytest.approx(8.0)
    assert np.linalg.norm(middle - [0.1, 0.2, 0.5]) < 0.15


def test_an_arrow_of_twelve_millimetres_a_newton_ends_where_a_finger_presses(page: Page) -> None:
    scene = page.server.scene
    points, vectors = np.full((5, 3), np.nan), np.zeros((5, 3))
    page.show(moment(2.0, look={"contact_point": points.reshape(-1), "contact_vector": vectors.reshape(-1)}))
    assert not [each for each in scene.made if each.kind == "arrows"]
    points[1], vectors[1] = [0.1, 0.0, 0.2], [0.0, 2.0, 0.0]
    look = {"contact_point": points.reshape(-1), "contact_vector": vectors.reshape(-1)}
    page.show(moment(3.0, look=look))
    arrows = scene.at("/contact")
    np.testing.assert_allclose(arrows.points[1], [[0.1, -0.024, 0.2], [0.1, 0.0, 0.2]])
    assert (arrows.points[[0, 2, 3, 4], :, 2] <= -50.0).all()
    np.testing.assert_array_equal(arrows.given[1], [[round(255 * c) for c in series_color(k)] for k in range(5)])
    vectors[1] = [0.0, 1.0, 0.0]
    page.show(moment(4.0, look=look))
    np.testing.assert_allclose(arrows.points[1, 0], [0.1, -0.012, 0.2])
    assert arrows.visible
    page.show(moment(5.0))
    assert not arrows.visible
    page.show(moment(6.0, look=look))
    assert arrows.visible


def test_joints_health_and_banner_are_what_somebody_has_looked_at() -> None:
    n = SPEC.n_joints
    frame = moment(
        12.34, torque=np.linspace(-1.0, 1.0, n) * SPEC.actuation.torque_limit, target=HOME + 0.1, lost=7,
        temperature=np.linspace(30.0, 75.0, n), link=("two <b> late",),
    )  # fmt: skip
    assert_snapshot(joint_states(SPEC, frame), SNAPSHOTS / "joints.html")
    assert_snapshot(health(SPEC, frame, 29.7), SNAPSHOTS / "health.html")
    assert_snapshot(banner([("#555", "calm"), ("#c8102e", "<bad>")]), SNAPSHOTS / "banner.html")


def test_a_page_hears_of_nobody_who_has_gone() -> None:
    page = Page(opened())
    page.server.gone(page.first)
    assert page.asked == [r.DriverLeft()]
    before = len(page.first.told)
    page.session.hear(Notice("late"))
    assert len(page.first.told) == before


LEMON = VisualShape("sphere", (0.03,), (0.0, 0.0, 0.0), paint="lemon")
POSE = np.array([1.0, 2.0, 3.0, np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])  # A quarter turn about the vertical.


def with_objects() -> Page:
    around = replace(scenery(SPEC, {}), objects={"mug": [MUG], "lemon": [LEMON]})
    found = Page(opened(scenery=around))
    found.show(moment(1.0, look={"object": np.zeros(7), "others": POSE[None]}))
    return found


def mesh(page: Page) -> Any:
    return page.server.scene.at("/object_1/lemon")


def test_a_mouse_on_an_object_pulls_the_place_where_it_was_picked_until_it_lets_go() -> None:
    page = with_objects()
    page.asked.clear()
    drag_mesh(mesh(page), "start", (1.0, 2.03, 3.0), (1.0, 2.03, 3.0))
    drag_mesh(mesh(page), "update", (9.0, 9.0, 9.0), (1.0, 2.1, 3.2))
    drag_mesh(mesh(page), "end", (9.0, 9.0, 9.0), (1.0, 2.1, 3.2))
    first, second, last = page.asked
    assert isinstance(first, r.DragObject)
    assert isinstance(second, r.DragObject)
    np.testing.assert_allclose(first.point, (0.03, 0.0, 0.0), atol=1e-9)  # In the frame of the lemon.
    assert (second.number, second.point, second.target) == (1, first.point, (1.0, 2.1, 3.2))
    assert last == r.DropObject()


def test_the_picture_has_a_line_and_the_force_while_an_object_is_pulled() -> None:
    page = with_objects()
    pulled = moment(2.0, look={"drag": np.array([1.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.2, 0.0, 3.0, 4.0])})
    page.show(pulled)
    line, label = page.server.scene.at("/pull"), page.server.scene.at("/pull_force")
    page.show(pulled._replace(t=3.0))
    np.testing.assert_allclose(line.points, [[[0.0, 0.0, 0.1], [0.0, 0.0, 0.2]]])
    assert (label.text, label.visible, line.visible) == ("5.0 N", True, True)
    assert "The mouse pulls lemon with 5.0 N" in page.says()
    page.show(moment(4.0))
    assert not label.visible
    assert not line.visible
    assert "pulls" not in page.says()


def test_who_looks_on_a_stopped_hand_and_a_picture_of_the_past_pull_nothing() -> None:
    page = with_objects()
    second = page.come()
    page.asked.clear()
    drag_mesh(mesh(page), "start", POSE[:3], POSE[:3], client=2)
    drag_mesh(mesh(page), "update", POSE[:3], POSE[:3], client=2)
    drag_mesh(mesh(page), "end", POSE[:3], POSE[:3], client=2)
    assert len(second.told) == 1
    assert "you look on" in second.told[0][1]
    page.session.state.look_back(0.0)
    drag_mesh(mesh(page), "start", POSE[:3], POSE[:3])
    assert "the picture is of the past" in page.first.told[-1][1]
    page.session.state.look_back(None)
    page.show(moment(2.0, stopped=True))
    drag_mesh(mesh(page), "start", POSE[:3], POSE[:3])
    assert "until the stop is released" in page.first.told[-1][1]
    assert page.asked == []


def test_who_lets_go_of_the_wheel_while_pulling_pulls_no_longer() -> None:
    page = with_objects()
    page.asked.clear()
    drag_mesh(mesh(page), "start", POSE[:3], POSE[:3])
    click(page.at("Let go"))
    drag_mesh(mesh(page), "update", POSE[:3], POSE[:3])
    drag_mesh(mesh(page), "end", POSE[:3], POSE[:3])
    assert [type(each) for each in page.asked] == [r.DragObject, r.DriverLeft, r.DropObject]


def test_a_hand_whose_objects_cannot_be_pulled_says_why() -> None:
    around = replace(scenery(SPEC, {}), objects={"mug": [MUG]})
    page = Page(opened(scenery=around, no_drag="this hand is on <can0>"))
    assert not hasattr(page.server.scene.at("/object_0/mug"), "dragged")
    text = next(each.content for each in page.first.gui.made if "pulled with the mouse" in getattr(each, "content", ""))
    assert 'title="this hand is on &lt;can0&gt;"' in text
    assert any("to pull it" in getattr(each, "content", "") for each in with_objects().first.gui.made)
