"""Cuts the hand off when its program no longer commands it: a hand keeps its last torque for ever."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Deadman:
    """A thread that calls `strike` once when `feed` was not called for `patience` seconds, where no keeper can.

    It runs beside a controller that spins or sleeps in Python, for the interpreter changes threads every 5 ms. It
    cannot run when the process is killed, or when native code holds the interpreter: docs/explanation/safety.md.
    """

    def __init__(self, patience: float, strike: Callable[[], None]) -> None:
        self._patience, self._strike = patience, strike
        self._fed, self._armed, self._news = 0.0, False, threading.Event()
        self._closed = False
        self.cut = False
        """Whether it has struck since it was armed."""
        self._thread = threading.Thread(target=self._watch, name="deadman", daemon=True)
        self._thread.start()

    def arm(self) -> None:
        """Watch from now on."""
        self.feed()
        self.cut, self._armed = False, True
        self._news.set()

    def feed(self) -> None:
        self._fed = time.monotonic()

    def disarm(self) -> None:
        """The hand is limp already."""
        self._armed = False

    def close(self) -> None:
        self._closed = True
        self._news.set()
        if self._thread is not threading.current_thread():
            self._thread.join(timeout=1.0)

    def _watch(self) -> None:
        while not self._closed:
            if not self._armed:
                self._news.wait()
                self._news.clear()
                continue
            remaining = self._fed + self._patience - time.monotonic()
            if remaining > 0.0:
                self._news.wait(remaining)
                self._news.clear()
                continue
            self._armed, self.cut = False, True
            self._strike()
