"""Watching a program's heart, and saying what leaves its hand limp."""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import select
import signal
import time

from . import ARMED, BEAT, CUTS, HUSH, OWED, PATIENCE, SPEAK, VOICE, Orders
from .links import Bus, SerialBytes, SlcanPort, connect

AGAIN, SLOWEST, GIVE_UP = 0.005, 0.1, 600.0
"""s between two tries, at first and at last; after which nobody will hear it any more."""
BEQUEST = 1.0
"""s after the program's end from which another program may have the port."""
ANSWER, QUIET = 0.06, 0.03
"""s that the hand has to answer; without a report (ten periods) that say as much of a hand that does not answer."""
TIMES, BETWEEN = 25, 0.02
"""How often bytes that nobody answers are said, and s between two: half a packet that the dead left is over by then."""

GRACE = 0.1
"""s that the second leaves to the keeper before it does the keeper's work: the keeper may stand still."""
GLANCE = 250
"""ms between two looks of the second where no patience is set."""


class HandWatch:
    """Watches the heart, and says what leaves the hand limp until that is confirmed.

    A keeper has a second, a process that it forks: whoever of the two is ended, the other knows it at once. Without its
    keeper the second leaves the hand limp; without its second the keeper makes another. So a hand is let go of though
    its program and one of the two are killed, in any order.
    """

    def __init__(self, orders: Orders, link: Bus | SerialBytes) -> None:
        self._orders, self._link = orders, link
        self._cells = memoryview(mmap.mmap(orders.memory, 0)).cast("Q")
        self._limp = [(identifier, bytes.fromhex(data), remote) for identifier, data, remote in orders.limp]

    def watch(self) -> None:
        """Until the program is gone and its hand is limp."""
        poll, cells = select.poll(), self._cells
        poll.register(0, select.POLLIN)
        with contextlib.suppress(AttributeError, OSError):  # Where the kernel has it: a fork may hold our socket open.
            poll.register(os.pidfd_open(self._orders.program), select.POLLIN)
        second, alive = self._hire(poll), True
        while alive:
            news = dict(poll.poll(self._patience()))
            if news.pop(second, 0):
                poll.unregister(second)
                os.close(second)
                os.waitpid(-1, 0)
                second = self._hire(poll)
            alive = not news or (news == {0: select.POLLIN} and bool(os.read(0, 64)))
            if cells[ARMED] and (not alive or self._patience() == 0 or cells[VOICE] == SPEAK):
                self._silence(alive=alive)

    def _hire(self, poll: select.poll) -> int:
        """Make a second; a descriptor by which its end is known, -1 where the kernel has none."""
        if not hasattr(os, "pidfd_open"):
            return -1
        try:
            keeper, second = os.pidfd_open(os.getpid()), os.fork()
        except OSError:
            return -1
        if not second:
            with contextlib.suppress(BaseException):
                self._stand_by(keeper)
            os._exit(0)
        os.close(keeper)
        watched = os.pidfd_open(second)
        poll.register(watched, select.POLLIN)
        return watched

    def _stand_by(self, keeper: int) -> None:
        """Be the second, until the keeper has gone in peace, or in its place."""
        nothing = os.open(os.devnull, os.O_RDWR)
        os.dup2(nothing, 0)  # The program is to see when the keeper's end of the line is closed.
        poll, cells, program = select.poll(), self._cells, os.pidfd_open(self._orders.program)
        poll.register(keeper, select.POLLIN)
        poll.register(program, select.POLLIN)
        alive = True
        while True:
            left = self._patience()
            gone = dict(poll.poll(GLANCE if left < 0 else left + round(1000 * GRACE)))
            if program in gone:  # The keeper knows it as well.
                poll.unregister(program)
                alive = False
                gone = dict(poll.poll(round(1000 * GRACE)))
            owed = cells[ARMED] or (cells[OWED] and keeper in gone)
            if owed and (keeper in gone or not alive or self._patience() == 0):
                self._silence(alive=alive)
            if keeper in gone:
                return

    def _patience(self) -> int:
        """ms until the program must have called again; 0: it has stalled; -1: it may take its time."""
        cells = self._cells
        if not cells[ARMED] or not cells[PATIENCE]:
            return -1
        left = cells[BEAT] + cells[PATIENCE] - time.monotonic_ns()
        return -(-left // 1_000_000) if left > 0 else 0

    def _silence(self, *, alive: bool) -> None:
        """Say it to the end: `_insist` or, where nobody answers, `_repeat`."""
        self._cells[CUTS] += 1
        self._cells[OWED] = 1  # First: between the two somebody may look, or this process be ended.
        self._cells[ARMED] = 0
        try:
            if isinstance(self._link, SerialBytes):
                self._repeat(self._link)
            else:
                self._insist(self._link, alive=alive)
        finally:
            self._cells[OWED] = 0

    def _repeat(self, link: SerialBytes) -> None:
        """Say it so often that it was heard, unless the program speaks itself again."""
        for _ in range(TIMES):
            if self._cells[VOICE] == HUSH:
                return
            with contextlib.suppress(OSError):  # The port is gone, and with it the way to say it; or it takes no more.
                link.say()
            select.select([], [], [], BETWEEN)

    def _insist(self, link: Bus, *, alive: bool) -> None:
        """Say it until it is confirmed: an interface may be down, or its queue full of what was said before."""
        pause, began = AGAIN, time.monotonic()
        while (now := time.monotonic()) < began + GIVE_UP and self._cells[VOICE] != HUSH:
            if not alive and now > began + BEQUEST and isinstance(link, SlcanPort) and link.taken():
                return
            try:
                link.begin()
                if self._said(link):
                    link.end()
                    return
            except BlockingIOError:
                pass
            except OSError:
                if not isinstance(link, SlcanPort):
                    with contextlib.suppress(OSError):
                        link = connect(self._orders)  # type: ignore[assignment]  # A bus again.
            select.select([], [], [], pause)
            pause = min(2 * pause, SLOWEST)

    def _said(self, link: Bus) -> bool:
        """Say it once; whether the hand has confirmed it: its motors are off, or it reports no more."""
        for frame in self._limp:
            link.send(*frame)
        ask = self._orders.ask
        if ask is not None:
            link.send(ask[0], b"", True)
        began = heard = time.monotonic()
        while time.monotonic() < began + ANSWER:
            if not select.select([link], [], [], AGAIN)[0]:
                continue
            for identifier, data in link.receive():
                if ask is not None and identifier == ask[0] and len(data) > ask[1] and not data[ask[1]] & ask[2]:
                    for frame in self._limp:  # The last words on the bus, whatever came between.
                        link.send(*frame)
                    return True
                if identifier in self._orders.reports:
                    heard = time.monotonic()
        return ask is None and time.monotonic() > heard + QUIET


def main() -> None:
    """Be the keeper of the program at the other end of standard input."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_IGN)  # It is the program that is told to end; this ends after it.
    with os.fdopen(os.dup(0), "rb", 0) as line:
        orders = Orders(**json.loads(line.readline()))
    try:
        link = connect(orders)
    except OSError as error:
        os.write(0, f"no: {error}".encode())
        return
    if os.fork():
        os._exit(0)  # Nobody's child, for nobody is to wait for it.
    os.write(0, f"ready {os.getpid()}".encode())
    HandWatch(orders, link).watch()
