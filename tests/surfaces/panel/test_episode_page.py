"""What the page shows of an episode, and how a person turns its goal there; viser is a fake (`fake_viser.py`)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="needs viser: extra panel")

from allegro_twin.hands.description.appearance import VisualShape  # Behind the check for the extra.
from allegro_twin.kinematics.orientation import quaternion_from_euler
from allegro_twin.surfaces.panel import requests as r
from allegro_twin.surfaces.panel.page.html import episode_state
from allegro_twin.surfaces.panel.stream import StreamFrame
from allegro_twin.viewing.scenery import scenery
from tests.surfaces.panel.fake_viser import change, click, drop
from tests.surfaces.panel.test_session_page import SPEC, Page, moment, opened

CUBE = VisualShape("box", (0.03, 0.03, 0.03))
PLACE = np.array([0.12, 0.0, 0.11])
STRAIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def goal_of(yaw: float) -> Any:
    return quaternion_from_euler(np.radians([0.0, 0.0, yaw]))


def frame(t: float, yaw: float = 40.0, *, seconds: float = 0.0, by_hand: bool = False, reached: int = 0) -> StreamFrame:
    row = np.array([seconds, 30.0, reached, 0.0, float(by_hand), 1.5])
    pose = np.concatenate([[0.0, 0.0, 0.09], STRAIGHT])
    look = {"object": pose, "object_goal": np.concatenate([PLACE, goal_of(yaw)]), "episode": row}
    return moment(t, look=look, kind="hold")


def episode(**changes: Any) -> Page:
    around = replace(scenery(SPEC, {}), objects={"object": [CUBE]})
    page = Page(replace(opened(scenery=around, episode="Reorient", plans=True, turns=True), **changes))
    page.show(frame(1.0))
    page.asked.clear()
    return page


def ring(page: Page) -> Any:
    return page.first.scene.at("/turn_goal")


def turn(page: Page, quaternion: Any) -> None:
    """Drag the ring to an orientation."""
    import asyncio
    from types import SimpleNamespace

    ring(page).wxyz = np.array(quaternion)
    asyncio.run(ring(page).updated(SimpleNamespace(client_id=1, client=1, target=ring(page))))


def test_the_goal_is_drawn_beside_the_hand_as_the_object_should_be() -> None:
    page = episode()
    scene = page.server.scene
    np.testing.assert_array_equal(scene.at("/object_goal").position, PLACE)
    np.testing.assert_allclose(scene.at("/object_goal").wxyz, goal_of(40.0))
    assert scene.at("/object_goal/look").kind == "glb"
    assert scene.at("/goal_name").visible
    np.testing.assert_allclose(scene.at("/goal_name").position, PLACE - [0.0, 0.0, 0.07])
    assert not page.at("Drag fingertips").value  # Their arrows would lie over the object.


def test_a_ring_that_is_dragged_and_numbers_that_are_typed_turn_the_goal() -> None:
    page = episode()
    assert ring(page).disable_axes
    assert ring(page).disable_sliders
    turn(page, goal_of(70.0))
    (asked,) = page.asked
    assert isinstance(asked, r.TurnGoal)
    assert asked.quaternion is not None
    np.testing.assert_allclose(asked.quaternion, goal_of(70.0))
    change(page.at("Goal (°)"), (0.0, 0.0, -30.0))
    np.testing.assert_allclose(page.asked[-1].quaternion, goal_of(-30.0))  # type: ignore[union-attr, arg-type]
    before = len(page.asked)
    change(page.at("Goal (°)"), (0.0, 0.0, 10.0), client=None)
    assert len(page.asked) == before  # The program itself has set it.


def test_a_goal_of_the_task_moves_ring_and_numbers_but_not_under_a_persons_hand() -> None:
    page = episode()
    np.testing.assert_allclose(ring(page).wxyz, goal_of(40.0))
    np.testing.assert_array_equal(ring(page).position, PLACE)
    assert page.at("Goal (°)").value == (0.0, 0.0, 40.0)
    turn(page, goal_of(70.0))
    page.show(frame(2.0, 90.0))
    np.testing.assert_allclose(ring(page).wxyz, goal_of(70.0))
    drop(ring(page))
    page.show(frame(3.0, 90.0), times=8)
    np.testing.assert_allclose(ring(page).wxyz, goal_of(90.0))
    assert page.at("Goal (°)").value == (0.0, 0.0, 90.0)


def test_a_person_goes_back_to_the_tasks_goals_and_has_the_task_performed() -> None:
    page = episode()
    assert page.at("Goals of the task").disabled
    page.show(frame(2.0, by_hand=True))
    assert not page.at("Goals of the task").disabled
    click(page.at("Goals of the task"))
    click(page.at("Perform the task"))
    assert page.asked == [r.TurnGoal(None), r.PerformEpisode()]


def test_who_may_not_drive_has_no_ring_and_a_new_session_takes_it_away() -> None:
    page = episode()
    assert ring(page).visible
    page.show(frame(2.0)._replace(stopped=True))
    assert not ring(page).visible
    assert page.at("Goal (°)").disabled
    assert page.at("Perform the task").disabled
    old = ring(page)
    page.session.hear(opened(session=2))
    assert old.removed


def test_a_task_without_an_orientation_as_its_goal_has_a_button_and_no_ring() -> None:
    page = episode(turns=False, episode="Rotate")
    assert not [each for each in page.first.scene.made if each.name == "/turn_goal"]
    assert not [each for each in page.server.scene.made if each.name.startswith("/object_goal")]
    click(page.at("Perform the task"))
    assert page.asked == [r.PerformEpisode()]


def test_the_state_of_an_episode_in_words() -> None:
    info = opened(episode="Reorient", plans=True, turns=True)
    begun, going = frame(1.0), frame(2.0, seconds=4.2, by_hand=True, reached=2)
    assert "its 30 s begin when it is performed<br>40° from the goal of the task<br>no goal" in episode_state(
        info, begun
    )
    text = episode_state(info, going)
    assert "4.2 of 30 s · 1.5 plans a second<br>40° from the goal set by hand<br>2 goals reached<" in text
    plain = episode_state(replace(info, plans=False, turns=False), going)
    assert "4.2 of 30 s<" in plain


def test_the_scene_of_an_episode_is_a_choice_by_its_name() -> None:
    page = episode(scenarios=("lemon",))
    assert page.at("Scenario").value == "episode of Reorient"
    click(page.at("Perform it"))
    assert page.asked == [r.OpenScene(None, None, perform=True)]
