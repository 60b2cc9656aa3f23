"""Who drives: one of those who look on, and never two."""

from __future__ import annotations

import threading


class Wheel:
    """The first who comes drives. Who leaves lets go; then nobody drives until somebody takes the wheel or, alone,
    comes back. Any thread may ask."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._there: list[int] = []
        self._driver: int | None = None

    @property
    def driver(self) -> int | None:
        """Who drives; None: nobody."""
        return self._driver

    @property
    def count(self) -> int:
        """How many are there."""
        return len(self._there)

    def drives(self, who: int) -> bool:
        return self._driver == who

    def join(self, who: int) -> bool:
        """Somebody came: whether they drive."""
        with self._lock:
            self._there.append(who)
            if self._driver is None and len(self._there) == 1:
                self._driver = who
            return self._driver == who

    def leave(self, who: int) -> bool:
        """Somebody left: whether it was who drove."""
        with self._lock:
            if who in self._there:
                self._there.remove(who)
            return self._released(who)

    def take(self, who: int) -> bool:
        """Somebody wants to drive: whether they do now. Nobody is pushed off the wheel."""
        with self._lock:
            if self._driver is None and who in self._there:
                self._driver = who
            return self._driver == who

    def let_go(self, who: int) -> bool:
        """Somebody wants no longer to drive: whether it was who drove."""
        with self._lock:
            return self._released(who)

    def _released(self, who: int) -> bool:
        if self._driver != who:
            return False
        self._driver = None
        return True
