"""Hands of one program share a bus without waiting for each other."""

from __future__ import annotations

import threading
import time

import can
import pytest

from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.link.adapter import AdapterLink
from allegro_twin.drivers.can.link.shared_bus import Stamped


def test_a_hand_does_not_wait_for_the_bus_while_another_hands_thread_does() -> None:
    with can.Bus(interface="virtual", channel="shared", ignore_config=True) as bus:
        link = AdapterLink(bus)
        port = link.port()
        other = threading.Thread(target=link.pump, args=(1.0,))
        other.start()
        time.sleep(0.05)
        assert link.pump(0.0) is False
        assert port.receive(0.05) is None
        port.queue.append(Stamped(Frame(0x80), 0.0))  # As the other thread would.
        assert port.receive(1.0) == (Frame(0x80), 0.0)
        assert other.is_alive()  # Which waits for its second still.
        other.join()


@pytest.mark.parametrize("clock", [1_700_000_000.0, 20.0])
def test_what_is_sent_before_anything_came_is_logged_on_the_clock_of_the_stamps(clock: float) -> None:
    """An adapter's stamps may be the time of day, or s since it was plugged in."""
    heard: list[can.Message] = []
    with (
        can.Bus(interface="virtual", channel="log", ignore_config=True) as bus,
        can.Bus(interface="virtual", channel="log", ignore_config=True, preserve_timestamps=True) as hand,
    ):
        link = AdapterLink(bus)
        link.listen(heard.append)
        link.port()
        link.send([Frame(0x100), Frame(0x204)])
        assert not heard
        hand.send(can.Message(arbitration_id=0x80, is_extended_id=False, timestamp=clock))
        link.pump(1.0)
        link.send([Frame(0x180)])
        assert [message.arbitration_id for message in heard] == [0x100, 0x204, 0x80, 0x180]
        assert [message.timestamp for message in heard] == pytest.approx([clock] * 4, abs=0.5)


def test_what_is_sent_to_nobody_is_logged_at_the_time_of_day_when_the_bus_is_closed() -> None:
    heard: list[can.Message] = []
    link = AdapterLink(can.Bus(interface="virtual", channel="nobody", ignore_config=True))
    link.listen(heard.append)
    port = link.port()
    link.send([Frame(0x100)])
    port.close()
    assert [message.timestamp for message in heard] == pytest.approx([time.time()], abs=0.5)
