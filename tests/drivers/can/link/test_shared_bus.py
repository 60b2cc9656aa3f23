"""Hands of one program share a bus without waiting for each other."""

from __future__ import annotations

import threading
import time

import can

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
