"""One drives, the others look on, and nobody is pushed off the lock."""

from __future__ import annotations

import threading

from hypothesis import given
from hypothesis import strategies as st

from allegro_twin.surfaces.panel.page.page_state import ControlLock


def test_the_first_who_comes_drives_and_the_second_looks_on() -> None:
    lock = ControlLock()
    assert lock.join(1)
    assert not lock.join(2)
    assert lock.drives(1)
    assert not lock.take(2)
    assert lock.drives(1)


def test_who_leaves_lets_go_and_nobody_is_made_to_drive() -> None:
    lock = ControlLock()
    lock.join(1)
    lock.join(2)
    assert lock.leave(1)
    assert lock.driver is None
    assert lock.take(2)


def test_who_comes_back_alone_drives_again() -> None:
    lock = ControlLock()
    lock.join(1)
    lock.leave(1)
    assert lock.join(2)


def test_who_comes_while_others_look_on_does_not_drive() -> None:
    lock = ControlLock()
    lock.join(1)
    lock.join(2)
    lock.let_go(1)
    assert not lock.join(3)


def test_one_who_looks_on_may_leave_without_the_hand_being_told() -> None:
    lock = ControlLock()
    lock.join(1)
    lock.join(2)
    assert not lock.leave(2)
    assert not lock.let_go(2)
    assert lock.drives(1)


def test_who_is_not_there_does_not_drive() -> None:
    lock = ControlLock()
    lock.join(1)
    lock.leave(1)
    assert not lock.take(1)


@given(st.lists(st.tuples(st.sampled_from(["join", "leave", "take", "let_go"]), st.integers(0, 3)), max_size=40))
def test_whatever_happens_only_somebody_who_is_there_drives(steps: list[tuple[str, int]]) -> None:
    lock, there = ControlLock(), list[int]()
    for step, who in steps:
        if (step == "join") == (who in there):
            continue
        getattr(lock, step)(who)
        if step == "join":
            there.append(who)
        if step == "leave":
            there.remove(who)
        assert lock.driver is None or lock.driver in there
        assert lock.count == len(there)


def test_of_many_who_take_the_wheel_at_once_one_has_it() -> None:
    lock = ControlLock()
    for who in range(20):
        lock.join(who)
    lock.let_go(0)
    got: list[int] = []
    start = threading.Barrier(20)

    def take(who: int) -> None:
        start.wait()
        if lock.take(who):
            got.append(who)

    threads = [threading.Thread(target=take, args=(who,)) for who in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert got == [lock.driver]
