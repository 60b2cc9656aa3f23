"""Wishes wait for the hand in the order in which they were made, and a stop waits for none of them."""

from __future__ import annotations

import threading

from allegro_twin.surfaces.panel import requests as w


def test_of_joint_positions_in_a_row_only_the_newest_waits() -> None:
    waiting = w.Wishes()
    for wish in (w.Posture("home"), w.Joints((0.1,)), w.Joints((0.2,)), w.Hold(), w.Joints((0.3,)), w.Joints((0.4,))):
        waiting.put(wish)
    taken = [waiting.get(0.0) for _ in range(5)]
    assert taken == [w.Posture("home"), w.Joints((0.2,)), w.Hold(), w.Joints((0.4,)), None]


def test_a_stop_forgets_all_that_waits() -> None:
    waiting = w.Wishes()
    waiting.put(w.Grasp("grasp_3"))
    waiting.clear()
    assert waiting.get(0.0) is None


def test_whoever_waits_is_woken_by_a_wish() -> None:
    waiting, taken = w.Wishes(), []
    thread = threading.Thread(target=lambda: taken.append(waiting.get(30.0)))
    thread.start()
    waiting.put(w.Hold())
    thread.join(10.0)
    assert taken == [w.Hold()]
