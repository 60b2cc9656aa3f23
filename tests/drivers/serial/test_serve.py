"""A virtual hand at a terminal answers in time, whatever it computes meanwhile."""

from __future__ import annotations

import os
import select
import threading
from pathlib import Path

from allegro_twin.drivers.base.serve import serve
from allegro_twin.drivers.base.terminal import Terminal


class Slow:
    """A hand whose step lasts until it was asked something."""

    period = 0.005

    def __init__(self) -> None:
        self.seconds = 0.0
        self.begun, self.asked, self.alone = threading.Event(), threading.Event(), False

    def step(self) -> None:
        self.begun.set()
        self.alone = not self.asked.wait(20.0)

    def receive(self, data: bytes, baud: int) -> bytes:
        self.asked.set()
        return b"yes"

    def clear(self) -> None:
        pass


def test_a_hand_answers_while_it_computes_its_physics(tmp_path: Path) -> None:
    hand, terminal = Slow(), Terminal(tmp_path / "hand.tty")
    thread = threading.Thread(target=lambda: next(serve(hand, terminal)))
    thread.start()
    line = os.open(tmp_path / "hand.tty", os.O_RDWR | os.O_NOCTTY)
    assert hand.begun.wait(20.0)
    os.write(line, b"?")
    assert select.select([line], [], [], 20.0)[0]
    assert os.read(line, 16) == b"yes"
    thread.join(20.0)
    assert not hand.alone
    os.close(line)
    terminal.close()
