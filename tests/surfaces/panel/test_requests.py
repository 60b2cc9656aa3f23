"""Requests wait for the hand in the order in which they were made, and a stop waits for none of them."""

from __future__ import annotations

import threading

from allegro_twin.surfaces.panel import requests as r


def test_of_joint_positions_in_a_row_only_the_newest_waits() -> None:
    waiting = r.RequestQueue()
    for wish in (
        r.MoveToPosture("home"),
        r.MoveJoints((0.1,)),
        r.MoveJoints((0.2,)),
        r.HoldHere(),
        r.MoveJoints((0.3,)),
        r.MoveJoints((0.4,)),
    ):
        waiting.put(wish)
    taken = [waiting.get(0.0) for _ in range(5)]
    assert taken == [
        r.MoveToPosture("home"),
        r.MoveJoints((0.2,)),
        r.HoldHere(),
        r.MoveJoints((0.4,)),
        None,
    ]


def test_what_is_asked_of_one_joint_waits_with_what_is_asked_of_another() -> None:
    waiting = r.RequestQueue()
    for joint, position in ((1, 0.1), (2, 0.2), (1, 0.3)):
        waiting.put(r.MoveJoints.of(3, {joint: position}))
    assert waiting.get(0.0) == r.MoveJoints((None, 0.3, 0.2))
    assert waiting.get(0.0) is None


def test_a_stop_forgets_all_that_waits() -> None:
    waiting = r.RequestQueue()
    waiting.put(r.PerformGrasp("grasp_3"))
    waiting.clear()
    assert waiting.get(0.0) is None


def test_whoever_waits_is_woken_by_a_wish() -> None:
    waiting, taken = r.RequestQueue(), []
    thread = threading.Thread(target=lambda: taken.append(waiting.get(30.0)))
    thread.start()
    waiting.put(r.HoldHere())
    thread.join(10.0)
    assert taken == [r.HoldHere()]
