"""A cell at the panel: thirty moments a second, and what is asked for there moves its palm until somebody stops it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.remote.remote_control import (
    PalmCommand,
    ReleaseCommand,
    RemoteControl,
    StayCommand,
    StopCommand,
)
from allegro_twin.errors import ConfigError
from allegro_twin.recording.events import DeviceSample, JournalEntry
from allegro_twin.surfaces.panel import requests as r
from allegro_twin.surfaces.panel.cell_session import CellSession
from allegro_twin.surfaces.panel.stream import RATE, Notice, StreamFrame
from tests.cell.test_run import cell_of


class Desk:
    """A cell's session; what it sends and what it asks the cell for are kept."""

    def __init__(self, cell: Cell) -> None:
        self.sent, self.commands = list[StreamFrame](), list[Any]()
        goal = SimpleNamespace(position=np.array([0.4, 0.1, 0.3]), quaternion=np.array([0.0, 1.0, 0.0, 0.0]))
        self.remote = SimpleNamespace(cell=cell, goal=goal, command=self.commands.append, stopped=False)
        sessions = CellSession(self.remote)  # type: ignore[arg-type]  # Looks alike.
        session = sessions.prepare(None)(7, self.sent.append)
        assert isinstance(session, CellSession)
        self.session = session


@pytest.fixture(scope="module")
def cell() -> Cell:
    return cell_of()


@pytest.fixture
def desk(cell: Cell) -> Desk:
    return Desk(cell)


def moved(device: str, t: float, **extras: Any) -> DeviceSample:
    n = 7 if device == "arm" else 16
    state = SimpleNamespace(t=t, position=np.full(n, t), torque=np.full(n, 2 * t), temperature=np.full(n, 3 * t))
    extras = {"target": np.full(n, 4 * t)} | extras
    return DeviceSample(device, SimpleNamespace(state=state), extras)  # type: ignore[arg-type]  # All that is asked of it.


def test_the_page_is_told_what_the_cell_is(desk: Desk, cell: Cell) -> None:
    info = desk.session.describe()
    assert info.session == 7
    assert info.title == f"{cell.robot.spec.name} with {cell.hand.spec.name} · simulated"
    assert (info.arm, info.spec) == (cell.robot.spec, cell.hand.spec)
    assert info.scenery.arm is not None
    assert len(info.scenery.objects) == 1
    assert info.scenery.fixed
    assert info.scenery.bodies
    desk.session.library()  # A cell has none, and there is nothing to tell.


def test_a_cell_is_not_opened_anew_from_its_page(desk: Desk) -> None:
    for request in (r.Reopen(), r.OpenScene(None, None, perform=False)):
        with pytest.raises(ConfigError, match="a cell cannot be opened anew from here"):
            desk.session.prepare(request)


def test_a_moment_has_arm_hand_objects_and_goal_and_comes_thirty_times_a_second(desk: Desk) -> None:
    pose, see = np.arange(7.0), desk.session.on_event
    arm = {"flange": pose, "tool": pose + 1.0, "force": np.arange(6.0)}
    see(moved("arm", 0.5, **arm))
    assert not desk.sent, "nothing is known of the hand"
    see(moved("hand", 0.6, object=pose + 2.0, others=np.arange(14.0)))
    see(moved("arm", 0.7, **arm))
    (frame,) = desk.sent
    assert (frame.session, frame.t) == (7, 0.7)
    np.testing.assert_array_equal(frame.arm, np.full(7, 0.7))
    np.testing.assert_array_equal(frame.position, np.full(16, 0.6))
    np.testing.assert_array_equal(frame.torque, np.full(16, 1.2))
    np.testing.assert_allclose(frame.temperature, np.full(16, 1.8))
    np.testing.assert_array_equal(frame.target, np.full(16, 2.4))
    np.testing.assert_array_equal(frame.look["flange"], pose)
    np.testing.assert_array_equal(frame.look["palm"], pose + 1.0)
    np.testing.assert_array_equal(frame.look["goal"], [0.4, 0.1, 0.3, 0.0, 1.0, 0.0, 0.0])
    np.testing.assert_array_equal(frame.look["object"], pose + 2.0)
    np.testing.assert_array_equal(frame.look["others"], np.arange(14.0).reshape(2, 7))
    np.testing.assert_array_equal(frame.look["force"], np.arange(6.0))
    assert not frame.stopped
    assert (frame.kind, frame.lost, frame.link, frame.teaching) == ("", 0, (), False)
    assert frame.recorded < 0.0, "it does not record"
    assert RATE == 30.0
    see(moved("arm", 0.7 + 0.99 / RATE, **arm))
    assert len(desk.sent) == 1
    see(moved("arm", 0.7 + 1.01 / RATE, **arm))
    assert len(desk.sent) == 2
    see(moved("hand", 1.0, object=pose))
    see(moved("arm", 1.0, **arm))
    assert desk.sent[-1].look["others"].shape == (0, 7)


def test_a_sentence_of_the_cells_states_is_shown_once_and_nothing_else_of_its_journal(desk: Desk) -> None:
    desk.session.on_event(JournalEntry("states", {"t": 1.0, "sentence": "the fence is in the way"}))
    desk.session.on_event(JournalEntry("states", {"t": 1.0, "sentence": ""}))
    desk.session.on_event(JournalEntry("perception", {"t": 1.0, "sentence": "nothing was seen"}))
    assert list(desk.session.report()) == [Notice("the fence is in the way", bad=True)]
    assert not list(desk.session.report())


def test_the_palm_moves_as_asked_and_a_stop_and_its_release_go_to_the_cell(desk: Desk) -> None:
    """The cell itself refuses what comes after a stop (tests/cell/test_remote_control.py)."""
    half, session = np.sqrt(0.5), desk.session
    assert session.execute(r.MovePalm((0.1, 0.2, 0.3, half, 0.0, 0.0, half))) == ""
    (palm,) = desk.commands
    assert isinstance(palm, PalmCommand)
    np.testing.assert_array_equal(palm.pose.position, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(palm.pose.rotation, [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-15)
    session.stop()
    session.execute(r.HoldHere())
    session.stay()
    assert [type(each) for each in desk.commands[1:]] == [StopCommand, StayCommand, StayCommand]
    pose = np.zeros(7)
    desk.remote.stopped = True
    session.on_event(moved("hand", 1.0, object=pose))
    session.on_event(moved("arm", 1.0, flange=pose, tool=pose, force=np.zeros(6)))
    assert desk.sent[-1].stopped
    session.execute(r.ReleaseStop())
    session.execute(r.MovePalm((0.5,) * 3 + (1.0, 0.0, 0.0, 0.0)))
    assert [type(each) for each in desk.commands[4:]] == [ReleaseCommand, PalmCommand]


def test_a_pose_that_is_none_is_refused(desk: Desk) -> None:
    with pytest.raises(ConfigError):
        desk.session.execute(r.MovePalm((0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 0.0)))
    assert not desk.commands


def test_when_the_page_is_closed_the_cell_stays_where_it_is(desk: Desk) -> None:
    desk.session.close()
    (command,) = desk.commands
    assert isinstance(command, StayCommand)


def test_the_remote_control_has_what_its_stand_in_has() -> None:
    assert {"command", "goal", "stopped"} <= set(vars(RemoteControl))
