"""What a browser shows of a cell and what it asks for, without a browser: viser is a fake (`fake_viser.py`)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="needs viser: extra panel")

from allegro_twin.cell.assembly import Cell  # Behind the check for the extra.
from allegro_twin.cell.journal.recording import cell_look
from allegro_twin.surfaces.panel import requests as r
from allegro_twin.surfaces.panel.page.session_page import SessionPage
from allegro_twin.surfaces.panel.stream import Notice, SessionInfo, StreamFrame
from allegro_twin.types import Vector
from allegro_twin.viewing.scenery import scenery
from tests.cell.test_run import cell_of
from tests.surfaces.panel.fake_viser import Client, Server, change, click, drag, drop


@pytest.fixture(scope="module")
def cell() -> Cell:
    return cell_of(objects=[{"name": "apple", "at": [0.0, 0.03]}, {"name": "mug", "at": [0.1, -0.1]}])


@pytest.fixture(scope="module")
def opened(cell: Cell) -> SessionInfo:
    arm, hand = cell.robot.spec, cell.hand.spec
    return SessionInfo(1, "a cell", hand, scenery(hand, {"look": cell_look(cell)}), arm=arm)


def pose(x: float) -> Vector:
    return np.array([x, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0])


def moment(opened: SessionInfo, t: float, look: dict[str, Any] | None = None, **changes: Any) -> StreamFrame:
    places = {"flange": pose(0.1), "palm": pose(0.2), "goal": pose(0.4), "object": pose(0.5), "others": pose(0.6)[None]}
    assert opened.arm is not None
    arm, hand = (np.clip(np.zeros(spec.n_joints), spec.lower, spec.upper) for spec in (opened.arm, opened.spec))
    unknown = np.full(len(hand), np.nan)
    plain = StreamFrame(
        1, t, hand, unknown, unknown, unknown, places | (look or {}), "", False, 0, (), -1.0, False, arm
    )
    return plain._replace(**changes)


class Page:
    """A page of a cell with as many browsers as come."""

    def __init__(self) -> None:
        self.server: Any = Server()
        self.asked: list[r.Request] = []
        self.session = SessionPage(self.server, self.asked.append)
        self.clients: list[Client] = []

    def come(self) -> Client:
        self.clients.append(Client(len(self.clients) + 1))
        self.server.come(self.clients[-1])
        return self.clients[-1]

    def says(self, client: Client | None = None) -> str:
        return str((client or self.clients[0]).gui.made[0].content)

    def at(self, name: str) -> Any:
        return self.clients[0].gui.named(name)

    @property
    def marker(self) -> Any:
        return self.clients[0].scene.at("/marker")

    def show(self, frame: StreamFrame, times: int = 1) -> None:
        """As often as it takes until the buttons are looked at, or so many times that."""
        for number in range(5 * times):
            self.session.show(frame._replace(t=frame.t + 1e-3 * number))


@pytest.fixture
def page(opened: SessionInfo) -> Page:
    found = Page()
    found.session.hear(opened)
    found.come()
    found.show(moment(opened, 1.0))
    return found


def test_before_there_is_a_moment_nothing_can_be_dragged(opened: SessionInfo) -> None:
    page = Page()
    page.session.hear(opened)
    page.come()
    assert page.clients[0].gui.panel == "a cell"
    assert not page.marker.visible
    assert page.at("Palm to (m)").disabled
    assert page.at("Stay here").disabled
    assert not page.at("Release the stop").visible


def test_who_drives_has_a_marker_and_the_others_look_on(page: Page, opened: SessionInfo) -> None:
    assert page.clients[0].gui.panel == "a cell"
    assert "You drive: drag the marker" in page.says()
    assert "Palm at +0.200, +0.200, +0.300 m · 1.0 s" in page.says()
    assert page.marker.visible
    second = page.come()
    page.show(moment(opened, 2.0))
    assert "You look on; somebody else drives. STOP is for everybody" in page.says(second)
    assert not second.scene.at("/marker").visible
    assert second.gui.named("Palm to (m)").disabled
    assert second.gui.named("Stay here").disabled
    assert not page.at("Palm to (m)").disabled
    click(second.gui.named("Stay here"))
    assert second.told == [("Not done", "you look on; somebody else drives, or nobody: press Drive", "red")]
    click(page.at("Let go"))
    assert page.asked == [r.DriverLeft()]
    click(second.gui.named("Drive"))
    page.show(moment(opened, 3.0))
    assert "You drive" in page.says(second)
    assert page.at("Drive").label == "Drive"
    page.server.gone(second)
    assert page.asked == [r.DriverLeft(), r.DriverLeft()]


def test_the_marker_leads_the_palm_and_stays_where_it_was_left_for_six_looks(page: Page, opened: SessionInfo) -> None:
    np.testing.assert_array_equal(page.marker.position, [0.4, 0.2, 0.3])
    assert page.at("Palm to (m)").value == (0.4, 0.2, 0.3)
    drag(page.marker, [0.5, 0.1, 0.35])
    assert page.asked == [r.MovePalm((0.5, 0.1, 0.35, 1.0, 0.0, 0.0, 0.0))]
    page.show(moment(opened, 2.0), times=6)
    np.testing.assert_array_equal(page.marker.position, [0.5, 0.1, 0.35])
    page.show(moment(opened, 3.0))
    np.testing.assert_array_equal(page.marker.position, [0.4, 0.2, 0.3])
    drop(page.marker)
    assert len(page.asked) == 1
    page.show(moment(opened, 4.0, {"goal": pose(0.4009)}), times=8)
    assert page.marker.position[0] == 0.4
    page.show(moment(opened, 5.0, {"goal": np.array([0.4, 0.2, 0.3, 0.8, 0.6, 0.0, 0.0])}), times=2)
    np.testing.assert_array_equal(page.marker.wxyz, [0.8, 0.6, 0.0, 0.0])


def test_numbers_lead_the_palm_too_with_the_markers_orientation(page: Page, opened: SessionInfo) -> None:
    page.marker.wxyz = np.array([0.0, 1.0, 0.0, 0.0])
    change(page.at("Palm to (m)"), (0.1, 0.2, 0.4))
    assert page.asked == [r.MovePalm((0.1, 0.2, 0.4, 0.0, 1.0, 0.0, 0.0))]
    change(page.at("Palm to (m)"), (0.3, 0.3, 0.3), client=None)  # The program's own.
    assert len(page.asked) == 1
    page.show(moment(opened, 2.0, {"goal": pose(0.12345)}), times=8)
    assert page.at("Palm to (m)").value == (0.123, 0.2, 0.3)


def test_a_stop_is_released_by_who_drives_and_meanwhile_nothing_moves(page: Page, opened: SessionInfo) -> None:
    page.show(moment(opened, 2.0, stopped=True))
    assert "STOPPED: arm and fingers stay until the stop is released" in page.says()
    assert page.at("Release the stop").visible
    assert not page.at("Release the stop").disabled
    assert not page.marker.visible
    assert page.at("Palm to (m)").disabled
    click(page.at("Release the stop"))
    click(page.at("Stay here"))
    assert page.asked == [r.ReleaseStop(), r.HoldHere()]
    page.show(moment(opened, 3.0))
    assert not page.at("Release the stop").visible
    assert page.marker.visible


def test_what_the_cell_says_stays_until_the_next_request_and_silence_until_it_ends(
    page: Page, opened: SessionInfo
) -> None:
    page.session.hear(Notice("out of reach", bad=True))
    page.session.hear(Notice("there"))
    told = [("Not done", "out of reach", "red"), ("The cell", "there", "blue")]
    assert page.clients[0].told == told
    assert page.clients[0].shown_for == [6.0, 6.0]
    page.show(moment(opened, 2.0))
    assert "there" in page.says()
    click(page.at("Stay here"))
    page.show(moment(opened, 3.0))
    assert "there" not in page.says()
    page.session.silence()
    assert "No news from the cell for a second" in page.says()
    page.show(moment(opened, 4.0))
    assert "No news" not in page.says()


def test_buttons_are_looked_at_every_fifth_moment(page: Page, opened: SessionInfo) -> None:
    for number in range(4):
        page.session.show(moment(opened, 7.0 + number))
        assert "· 1.0 s" in page.says()
    page.session.show(moment(opened, 11.0))
    assert "· 11.0 s" in page.says()
    page.server.gone(page.clients[0])
    page.session.hear(Notice("late"))
    assert page.clients[0].told == []


def test_arm_hand_and_objects_are_drawn_where_they_are(page: Page, opened: SessionInfo) -> None:
    scene, scenery = page.server.scene, opened.scenery
    assert scenery.arm is not None
    np.testing.assert_allclose(scene.at("/arm").position, scenery.arm.base)
    for name, x in (("/flange", 0.1), ("/palm", 0.2), ("/object_0", 0.5), ("/object_1", 0.6)):
        np.testing.assert_array_equal(scene.at(name).position, [x, 0.2, 0.3])
        np.testing.assert_array_equal(scene.at(name).wxyz, [1.0, 0.0, 0.0, 0.0])
    for root, bodies in (("/arm", scenery.arm.bodies), ("/palm", scenery.bodies)):
        links = [scene.at(f"{root}/{body.name}") for body in bodies if body.parent >= 0]
        assert len(links) == len(bodies) - 1
        assert all(np.linalg.norm(link.wxyz) == pytest.approx(1.0) for link in links)
    meshes = {each.name for each in scene.made if each.kind == "glb"}
    assert {"/flange/look", "/fixed", "/object_0/apple", "/object_1/mug"} <= meshes
    assert not [each for each in scene.made if each.name == "/floor"]
    camera = page.server.initial_camera
    np.testing.assert_array_equal(camera.up, [0.0, 0.0, 1.0])
    assert not np.allclose(camera.position, camera.look_at)
    page.show(moment(opened, 2.0, {"object": pose(0.5) + 9e-5}))
    assert scene.at("/object_0").position[0] == 0.5  # What moves by so little is not sent.
    page.show(moment(opened, 3.0, {"object": pose(0.5) + 1.1e-4}))
    assert scene.at("/object_0").position[0] == pytest.approx(0.50011)
    bent = moment(opened, 4.0)
    page.show(bent._replace(arm=bent.arm + 0.1))
    assert np.abs(scene.at(f"/arm/{scenery.arm.bodies[2].name}").wxyz - [1.0, 0.0, 0.0, 0.0]).max() > 0.01
