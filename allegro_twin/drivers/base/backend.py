"""A hand on a serial line as a backend, whatever language it speaks."""

from __future__ import annotations

import atexit
import logging
from collections.abc import Callable
from typing import Any

import numpy as np

from allegro_twin.backend import position_of
from allegro_twin.drivers.base.difference_quotient import DifferenceQuotient, Exchanged
from allegro_twin.drivers.base.driver import Answer, Driver
from allegro_twin.drivers.base.host_settings import SerialHostSettings
from allegro_twin.drivers.base.keeper.keeper import Keeper
from allegro_twin.drivers.base.serial_line import SerialLine
from allegro_twin.drivers.base.suspend import Inhibitor, SuspendWatch
from allegro_twin.drivers.base.timed_goals import Glide, onward
from allegro_twin.errors import HandError, HandFault, LinkError, ProtocolError
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, frozen

log = logging.getLogger(__name__)


class SerialBackend:
    """Reset leaves the hand limp; the first command that is not limp switches it on; `read` asks it.

    Raises ConfigError, LinkError, LinkTimeout, ProtocolError or HandFault; after these the hand is limp until `reset`,
    or the error says that this was not confirmed. `driver_of` speaks the hand's language on an open port.
    """

    def __init__(
        self,
        spec: HandSpec,
        open_port: Callable[[], SerialLine],
        driver_of: Callable[[SerialLine], Driver],
        settings: SerialHostSettings,
    ) -> None:
        self._spec, self._settings = spec, settings
        self._open, self._driver_of = open_port, driver_of
        self._port: SerialLine | None = None
        self._keeper: Keeper | None = None
        self._fault: HandError | None = HandFault("the hand has not been reset; call reset() before read() or write()")
        self.unconfirmed = ""
        """Why it is not sure that the hand was left limp; empty when it is."""
        self._glide: Glide | None = None
        self._sent, self._tick = False, 0
        self._answer: Answer
        self._quotient: DifferenceQuotient
        self._suspend = SuspendWatch()
        self._inhibitor: Inhibitor | None = None
        self._connect()
        self._lockstep = self._opened.lockstep
        atexit.register(self.close)

    @property
    def spec(self) -> HandSpec:
        return self._spec

    @property
    def period(self) -> float:
        return self._settings.period

    @property
    def live(self) -> bool:
        """Whether the hand's time passes by itself; else only while this backend reads."""
        return not self._lockstep

    @property
    def keeper(self) -> int:
        """The process that watches this one; 0: none."""
        return self._keeper.process if self._keeper is not None else 0

    @property
    def calibration(self) -> dict[str, Any]:
        """What turns this hand's ticks into rad and N·m, for recordings."""
        return self._driver.calibration

    def warnings(self) -> list[str]:
        """What went wrong since the session began without ending it."""
        return self._driver.warnings()

    def reset(self) -> HandState:
        try:
            if self._keeper is not None and not self._keeper.alive:
                self._hang_up()
            if self._port is None:
                self._connect()
            self.unconfirmed, self._driver.on = "", True  # Nobody knows what was before.
            self._let_go()
            self._driver.wake()
            self._opened.begin()
            answer = self._driver.first()
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._fault, self._sent = None, False
        self._origin = self._spoken = self._opened.now()
        self._suspend.restart()
        return self._state(0.0, 0, answer)

    def write(self, command: Command) -> None:
        self._ready()
        wanted = position_of(command, self._spec)
        try:
            if wanted.limp:
                self._let_go()
            else:
                now = self._opened.now()
                self._glide = onward(self._glide, self._answer.actuators, wanted, now)
                self._driver.go(self._glide.at(now), wanted.effort)
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._sent, self._spoken = True, self._opened.now()

    def read(self) -> HandState:
        self._ready()
        port, period = self._opened, self._settings.period
        try:
            port.wait(self._origin + (self._tick + 1) * period)
            if self._glide is not None and not self._sent:
                self._driver.again(self._glide.at(port.now()))
            answer = self._driver.ask()
            t = port.now() - self._origin
            tick = max(round(t / period), self._tick + 1)
            self._driver.ask_more(tick)
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._sent, self._spoken = False, port.now()
        return self._state(tick * period if port.lockstep else t, tick, answer)

    def close(self) -> None:
        if self._port is not None:
            self._leave()
            if self.unconfirmed:
                log.error(self.unconfirmed)
            self._hang_up()
        self._fault = HandFault("the hand is closed; reset() opens it again")
        atexit.unregister(self.close)

    @property
    def _opened(self) -> SerialLine:
        assert self._port is not None
        return self._port

    def _connect(self) -> None:
        """Open the line and find the hand."""
        self._port = port = self._open()
        if not port.lockstep and self._inhibitor is None:
            self._inhibitor = Inhibitor()
        try:
            self._driver = self._driver_of(port)
            self._driver.find()
            if self._settings.keeper and port.shared is not None:
                frames = self._driver.shutdown_frames.hex()
                self._keeper = Keeper({"kind": "bytes", "fd": port.shared, "shutdown_frames": frames})
                self._keeper.arm()
        except HandError:
            self._hang_up()
            raise

    def _hang_up(self) -> None:
        """Close the line. Raises nothing."""
        keeper, self._keeper = self._keeper, None
        if keeper is not None and self.unconfirmed:
            keeper.take_over(wait=True)
        elif keeper is not None:
            keeper.dismiss()
        if self._port is not None:
            self._port.close()
        self._port = None
        if self._inhibitor is not None:
            self._inhibitor.close()
            self._inhibitor = None

    def _ready(self) -> None:
        if self._fault is not None:
            raise self._fault
        if not self._driver.on:
            self._suspend.restart()
        elif slept := self._suspend.fault():
            raise self._stopped(slept)
        if self._driver.on and self._keeper is not None and not self._keeper.alive:
            self._keeper.dismiss()  # What it left behind would speak while this program does.
            why = "the keeper of this hand has ended, and nobody would leave it limp; reset to go on"
            raise self._stopped(HandFault(why))
        silent = self._opened.now() - self._spoken
        if self._driver.on and silent > self._settings.watchdog:
            why = f"nobody called for {silent:.2f} s, so the hand let go by itself; reset to go on"
            raise self._stopped(HandFault(why))

    def _let_go(self) -> None:
        """Limp, confirmed. Raises LinkError or ProtocolError."""
        self._glide = None
        if self._driver.on:
            self._driver.stop()

    def _state(self, t: float, tick: int, answer: Answer) -> HandState:
        velocity = answer.velocity
        if isinstance(velocity, Exchanged):
            if not tick:
                self._quotient = DifferenceQuotient(answer.position, velocity)
            velocity = self._quotient(answer.position, velocity)
        self._tick, self._answer = tick, answer
        return HandState(
            t, tick, frozen(answer.position), frozen(velocity), frozen(answer.torque),
            temperature=frozen(answer.temperature), gravity=frozen(np.full(3, np.nan)),
        )  # fmt: skip

    def _stopped(self, error: HandError) -> HandError:
        """Leave the hand limp and remember why."""
        self._fault = error
        self._leave()
        if self.unconfirmed:
            error.args = (f"{error}; {self.unconfirmed}",)
        if self.unconfirmed or isinstance(error, LinkError):
            self._hang_up()  # And let the keeper speak.
        return error

    def _leave(self) -> None:
        """Switch the motors off; where nobody confirms it, it is said so."""
        if self._port is None:
            return
        try:
            self._let_go()
        except (LinkError, ProtocolError) as error:
            why = str(error).split(";")[0]
            self.unconfirmed = f"the hand has not confirmed that it is limp ({why}); cut its power if it still pushes"
