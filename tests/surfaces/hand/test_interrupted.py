"""A motion that another thread stops or replaces does not count as done."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from allegro_twin.errors import CommandError, ConfigError, HandError, HandFault, LinkError, MotionInterrupted
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.surfaces.hand import Hand, loop_thread
from allegro_twin.surfaces.hand.loop_thread import LoopThread
from allegro_twin.types import Sample
from tests.surfaces.hand.test_hand_parts import sample

Act = Callable[[Hand], object]


@pytest.fixture
def hand() -> Iterator[Hand]:
    with Hand.open("sim_right") as found:
        yield found


def after(hand: Hand, seconds: float, act: Act) -> None:
    """Another thread that acts once, at a time of the hand; the motion waits for it: nothing is left to luck."""
    begun = hand.state.t

    def look(sample: Sample) -> None:
        if sample.state.t < begun + seconds:
            return
        hand._mover.listeners.remove(look)
        thread = threading.Thread(target=lambda: act(hand))
        thread.start()
        thread.join()

    hand.listen(look)


@pytest.mark.parametrize(
    ("act", "words", "controller"),
    [
        (lambda hand: hand.stop(), "home was stopped before its end", "pid"),
        (lambda hand: hand.direct.limp(), "home was stopped, and the hand is limp, before its end", "torque"),
        (lambda hand: hand.direct.stay(), "home was stopped before its end", "pid"),
        (lambda hand: hand.move_to("rock", wait=False), "home was replaced by rock before its end", "pid"),
        (lambda hand: hand.set_controller("torque"), "home was replaced by the controller torque before", "torque"),
        (lambda hand: hand.set_controller("pd"), "home was replaced by the controller pd before its end", "pd"),
        (lambda hand: hand.grasp("grasp_3", wait=False), "home was replaced by grasp grasp_3", "grasp grasp_3"),
    ],
)
def test_a_motion_that_another_thread_ends_raises_and_says_what_ended_it(
    hand: Hand, act: Act, words: str, controller: str
) -> None:
    after(hand, 0.3, act)
    with pytest.raises(MotionInterrupted, match=words):
        hand.move_to("home")
    assert hand.state.t < 0.4
    assert hand.controller == controller


@pytest.mark.parametrize(
    "motion",
    [
        lambda hand: hand.grasp("grasp_3"),
        lambda hand: hand.play("ripple"),
        lambda hand: hand.move_fingertips({"index": hand.fingertips()["index"].position - np.full(3, 0.006)}, 0.01),
        lambda hand: (hand.move_to("rock", wait=False), hand.wait()),
    ],
    ids=["grasp", "play", "fingertips", "wait"],
)
def test_every_call_that_waits_for_a_motion_raises_when_it_is_stopped(hand: Hand, motion: Act) -> None:
    hand.move_to("home", 3.0)
    after(hand, 0.2, lambda hand: hand.stop())
    with pytest.raises(MotionInterrupted, match="was stopped before its end"):
        motion(hand)
    hand.move_to("home")  # A stop does not latch.
    assert np.abs(hand.errors).max() < 0.03


def test_a_stop_in_the_background_ends_the_motion_of_the_script() -> None:
    with Hand.open("sim_right", background=True) as hand:
        after(hand, 0.2, lambda hand: hand.stop())
        with pytest.raises(MotionInterrupted, match="was stopped"):
            hand.move_to("home")


def test_a_stop_after_the_end_and_a_time_to_wait_are_no_interruption(hand: Hand) -> None:
    hand.move_to("home", 3.0)
    hand.stop()
    hand.wait()
    after(hand, 0.1, lambda hand: hand.stop())
    hand.move_to("rock", wait=False)
    assert hand.wait(0.3).t == pytest.approx(hand.state.t)


def test_a_goal_that_moves_is_one_motion_for_whoever_waits(hand: Hand) -> None:
    hand.move_to("home", 3.0)
    goal = hand.state.position + 0.1
    hand.direct.steer(goal)
    after(hand, 0.05, lambda hand: hand.direct.steer(goal + 0.1))
    hand.wait()
    np.testing.assert_allclose(hand.state.position, goal + 0.1, atol=0.03)
    hand.direct.steer(goal)
    after(hand, 0.02, lambda hand: hand.direct.steer(goal - 0.1))
    after(hand, 0.05, lambda hand: hand.stop())
    with pytest.raises(MotionInterrupted, match="was stopped"):
        hand.wait()


@pytest.mark.parametrize("wish", [lambda hand: hand.move_to("fist"), lambda hand: hand.grasp("grasp_3")])
def test_a_stop_while_a_motion_is_being_planned_is_kept(hand: Hand, wish: Act, monkeypatch: pytest.MonkeyPatch) -> None:
    hand.move_to("home", 3.0)
    legs = hand._mover.paths.legs

    def planned(*given: object) -> object:
        found = legs(*given)  # type: ignore[arg-type]  # As it was called.
        thread = threading.Thread(target=hand.stop)
        thread.start()
        thread.join()
        return found

    monkeypatch.setattr(hand._mover.paths, "legs", planned)
    here = hand.state.position
    with pytest.raises(MotionInterrupted, match="was stopped before it began"):
        wish(hand)
    hand.wait(0.3)
    np.testing.assert_allclose(hand.state.position, here, atol=0.02)


def test_what_overtakes_a_hand_that_stops_to_plan_is_told_by_the_name_of_its_motion(
    hand: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    hand.move_to("home", wait=False)
    legs = hand._mover.paths.legs

    def planned(*given: object) -> object:
        found = legs(*given)  # type: ignore[arg-type]  # As it was called.
        hand.wait(0.4)  # It has moved on meanwhile.
        monkeypatch.undo()
        after(hand, 0.02, lambda hand: hand.move_to("open", wait=False))
        return found

    monkeypatch.setattr(hand._mover.paths, "legs", planned)
    with pytest.raises(MotionInterrupted, match="rock was replaced by open before its end"):
        hand.move_to("rock")


def test_a_hand_in_the_foreground_takes_one_waiting_thread_at_a_time(hand: Hand) -> None:
    raised: list[HandError] = []

    def waits(hand: Hand) -> None:
        try:
            hand.wait(0.1)
        except HandError as error:
            raised.append(error)

    after(hand, 0.1, waits)
    hand.wait(0.3)
    assert isinstance(raised[0], ConfigError)
    assert "open it with background=True for several threads" in str(raised[0])
    assert hand.state.t == pytest.approx(0.3)


@pytest.mark.parametrize("background", [False, True])
def test_a_listener_that_waits_is_refused(background: bool) -> None:
    with Hand.open("sim_right", background=background) as hand:

        def waits(_: Sample) -> None:
            hand.wait(0.1)

        hand.listen(waits)
        with pytest.raises(ConfigError, match="listener"):
            hand.wait(1.0)


def test_another_thread_may_close_a_hand_in_the_foreground() -> None:
    def endless() -> Iterator[Sample]:
        tick = 0
        while True:
            yield sample(tick)
            tick += 1

    driver = LoopThread(endless(), background=False)
    closing = threading.Thread(target=driver.close)

    def over(_: Sample) -> bool:
        if not closing.ident:
            closing.start()
        return False

    with pytest.raises(HandFault, match="the hand is closed"):
        driver.wait(over)
    closing.join(5.0)
    assert not closing.is_alive()


@pytest.mark.parametrize("background", [False, True])
def test_a_hand_that_is_closed_while_a_listener_does_not_return_says_so_and_its_own_thread_lets_go_of_it(
    background: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop_thread, "CLOSING", 0.05)
    closers, stuck, enough = list[str](), threading.Event(), threading.Event()
    monkeypatch.setattr(SimBackend, "close", lambda _: closers.append(threading.current_thread().name))

    def blocks(_: Sample) -> None:
        stuck.set()
        enough.wait(10.0)

    opened = Hand.open("sim_right", background=background)

    def waits() -> None:
        with pytest.raises(HandFault, match="the hand is closed"):
            opened.wait(1.0)

    opened.listen(blocks)
    waiting = threading.Thread(target=waits, name="waiting")
    waiting.start()
    assert stuck.wait(10.0)
    with pytest.raises(LinkError, match=r"not closed, and may still push: a period or a listener has not ended within"):
        opened.close()
    assert closers == []
    enough.set()
    waiting.join(10.0)
    opened.close()
    assert closers[0] == ("allegro_twin" if background else "waiting")


@pytest.mark.parametrize("background", [False, True])
def test_a_listener_may_close_the_hand_and_waits_for_nothing(background: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_thread, "CLOSING", 60.0)
    hand = Hand.open("sim_right", background=background)
    hand.listen(lambda _: hand.close())
    with pytest.raises(HandFault, match="the hand is closed"):
        hand.wait(1.0)
    hand.close()


def test_a_limp_hand_says_so_first(hand: Hand) -> None:
    hand.direct.limp()
    with pytest.raises(CommandError, match="release the stop first"):
        hand.move_to("home")
