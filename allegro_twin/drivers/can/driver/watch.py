"""Watchdogs that cut a hand off when its program stalls or dies: a keeper process where the bus can be shared,
else a thread."""

from __future__ import annotations

import logging
import math
import os
import time
from contextlib import suppress

from allegro_twin.drivers.base.keeper.keeper import Keeper
from allegro_twin.drivers.base.suspend import Inhibitor, SuspendWatch
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.driver.deadman import Deadman
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.driver.shutdown import ShutdownSequence
from allegro_twin.drivers.can.link.shared_bus import BusPort
from allegro_twin.errors import HandFault, LinkError

log = logging.getLogger(__name__)

_BEAT = 0.025
"""s between two looks at the keeper at most, while something is waited for."""


class Watch:
    """One hand's. On a lockstep bus nobody watches: time stands still while nobody calls."""

    def __init__(self, codec: Codec, shutdown: ShutdownSequence, settings: CanHostSettings) -> None:
        self._codec, self._shutdown, self._settings = codec, shutdown, settings
        self._patience = math.inf if settings.deadman is None else settings.deadman
        self._port: BusPort | None = None
        self._guard: Keeper | Deadman | None = None
        self.armed, self._fed, self._alone = False, 0.0, ""
        self._suspend = SuspendWatch()
        self._inhibitor: Inhibitor | None = None

    @property
    def beat(self) -> float:
        """How often at least `feed` must be called while something is waited for, s."""
        return min(self._patience / 4, _BEAT)

    @property
    def keeper(self) -> int:
        """The keeper's process; 0: none."""
        return self._guard.process if isinstance(self._guard, Keeper) else 0

    def warnings(self) -> list[str]:
        """What a user should know of it."""
        return [f"no keeper: {self._alone}; a crash of this program leaves the hand pushing"] if self._alone else []

    def ready(self, port: BusPort) -> None:
        """Be ready before the motors go on. Raises LinkError when a keeper does not start."""
        if port is self._port and self._guard is not None and not self._spoke():
            return
        self._dismiss()
        self._port, self._alone = port, ""
        if port.link.lockstep:
            return
        self._inhibitor = self._inhibitor or Inhibitor()
        way = port.link.address if hasattr(os, "memfd_create") else "this system cannot share memory with one"
        if self._settings.keeper and isinstance(way, dict):
            answer, reports = self._shutdown.answer, self._codec.positions.fingers
            ask = None if answer is None else (answer.ask.id, answer.byte, answer.mask)
            self._guard = Keeper(way, self._shutdown.frames, reports, ask, self._settings.deadman)
            return
        if self._settings.keeper:
            self._alone = str(way)
            log.warning("no keeper on %s: %s", port.link.name, way)
        if self._settings.deadman is not None:
            self._guard = Deadman(self._settings.deadman, self._cut)

    def arm(self) -> None:
        """The motors go on."""
        self._fed, self.armed = time.monotonic(), self._guard is not None
        self._suspend.restart()
        if self._guard is not None:
            self._guard.arm()

    def feed(self) -> None:
        """Somebody drives the hand."""
        if self.armed:
            self._fed = time.monotonic()
            self._guard.feed()  # type: ignore[union-attr]  # There is one where it is armed.

    def struck(self) -> bool:
        """Whether the hand was cut off, or ought to have been: a machine that stalled stopped its watch as well."""
        return self.armed and (time.monotonic() > self._fed + self._patience or self._guard.cut)  # type: ignore[union-attr]

    def fault(self) -> HandFault | None:
        """Why the hand may not be driven on: the computer slept, the keeper is gone, or the hand was cut off."""
        if not self.armed:
            return None
        if slept := self._suspend.fault():
            return slept
        if isinstance(self._guard, Keeper) and not self._guard.alive:
            return HandFault("the keeper of this hand has ended, and nobody would leave it limp; reset to go on")
        if not self.struck():
            return None
        after = "" if math.isinf(self._patience) else f" for {self._patience:g} s"
        return HandFault(f"nobody called{after}, so the hand was cut off; reset to go on")

    def check(self) -> None:
        """Raises HandFault where the hand may not be driven on."""
        if fault := self.fault():
            raise fault

    def disarm(self) -> None:
        """The hand is limp."""
        self.armed = False
        if self._guard is not None:
            self._guard.disarm()

    def take_over(self) -> str:
        """The shutdown was not confirmed: what happens now."""
        self.armed = False
        if isinstance(self._guard, Keeper) and self._guard.alive:
            self._guard.take_over()
            return "its keeper goes on telling it to be; cut its power if it still pushes"
        return "cut its power"

    def close(self) -> None:
        """Let the guard go; a keeper that has taken over goes on by itself."""
        guard, self._guard, self._port, self.armed = self._guard, None, None, False
        if guard is not None:
            guard.close()
        if self._inhibitor is not None:
            self._inhibitor.close()
            self._inhibitor = None

    def _spoke(self) -> bool:
        return isinstance(self._guard, Keeper) and (self._guard.speaking or not self._guard.alive)

    def _dismiss(self) -> None:
        guard, self._guard = self._guard, None
        if isinstance(guard, Keeper):
            guard.dismiss()
        elif guard is not None:
            guard.close()

    def _cut(self) -> None:
        """Called by the deadman, on its own thread."""
        with suppress(LinkError):  # Nothing left to say it with.
            if self._port is not None:
                self._port.send(self._shutdown.frames)
