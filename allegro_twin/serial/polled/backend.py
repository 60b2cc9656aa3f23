"""A hand that answers when it is asked, as a backend."""

from __future__ import annotations

import atexit
import logging
from collections.abc import Callable
from typing import Any

import numpy as np

from allegro_twin.backend import position_of
from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, ProtocolError
from allegro_twin.serial.line.glide import Glide, onward
from allegro_twin.serial.line.keeper import Keeper
from allegro_twin.serial.line.port import Port
from allegro_twin.serial.polled.exchange import Exchange
from allegro_twin.serial.polled.scale import Scale
from allegro_twin.serial.polled.settings import HostSettings
from allegro_twin.serial.polled.wire import Motors, Wire
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, Vector, frozen

log = logging.getLogger(__name__)
_FAR = 0.25
"""Share of its range outside of which an actuator cannot be."""
_TRIES = 3
_GLANCE = 50
"""Periods between two looks whether the keeper is there."""


class PolledBackend:
    """Reset leaves the hand limp; the first command that is not limp switches it on; `read` asks it.

    Raises ConfigError, LinkError, LinkTimeout, ProtocolError or HandFault; after these the hand is limp until `reset`,
    or the error says that this was not confirmed. `wire_of` speaks the hand's language through an exchange on its port.
    """

    def __init__(
        self,
        spec: HandSpec,
        scale: Scale,
        open_port: Callable[[], Port],
        wire_of: Callable[[Exchange], Wire],
        settings: HostSettings | None = None,
    ) -> None:
        self._spec, self._scale, self._settings = spec, scale, settings or HostSettings()
        self._open, self._wire_of = open_port, wire_of
        self._port: Port | None = None
        self._keeper: Keeper | None = None
        self._fault: HandError | None = HandFault("the hand has not been reset; call reset() before read() or write()")
        self._moving = False
        self.unconfirmed = ""
        """Why it is not sure that the hand was left limp; empty when it is."""
        self._glide: Glide | None = None
        self._fresh(spec.lower)
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
    def lockstep(self) -> bool:
        """Whether the hand's time passes only while this backend reads."""
        return self._lockstep

    @property
    def keeper(self) -> int:
        """The process that watches this one; 0: none."""
        return self._keeper.process if self._keeper is not None else 0

    @property
    def calibration(self) -> dict[str, Any]:
        """What turns this hand's ticks into rad and N·m, for recordings."""
        return self._scale.described()

    def warnings(self) -> list[str]:
        """What went wrong since the line was opened without ending the session."""
        return self._exchange.warnings()

    def reset(self) -> HandState:
        try:
            if self._keeper is not None and not self._keeper.alive:
                self._hang_up()
            if self._port is None:
                self._connect()
            self.unconfirmed, self._moving = "", True  # Nobody knows what was before.
            self._let_go()
            self._opened.begin()
            motors = self._wire.ask()
            self._check(motors)
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._fault = None
        self._origin = self._spoken = self._opened.now()
        self._fresh(self._scale.position(motors.ticks))
        return self._state(0.0, 0, motors)

    def write(self, command: Command) -> None:
        self._ready()
        wanted = position_of(command, self._spec)
        try:
            if wanted.limp:
                self._let_go()
            else:
                now = self._opened.now()
                self._glide = onward(self._glide, self._position, wanted, now)
                self._go(self._glide.at(now))
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._sent, self._spoken = True, self._opened.now()

    def read(self) -> HandState:
        self._ready()
        port, period = self._opened, self._settings.period
        try:
            port.wait(self._origin + (self._tick + 1) * period)
            if self._glide is not None and not self._sent:
                self._go(self._glide.at(port.now()))  # The way of a timed command, and a word for the watchdog.
            motors = self._wire.ask()
            t = port.now() - self._origin
            tick = max(round(t / period), self._tick + 1)
            self._check(motors)
            if self._keeper is not None and tick % _GLANCE == 0 and not self._keeper.alive:
                raise HandFault("the keeper of this hand has ended, and nobody would leave it limp; reset to go on")
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._sent, self._spoken = False, port.now()
        return self._state(tick * period if port.lockstep else t, tick, motors)

    def close(self) -> None:
        if self._port is not None:
            self._leave()
            if self.unconfirmed:
                log.error(self.unconfirmed)
            self._hang_up()
        self._fault = HandFault("the hand is closed; reset() opens it again")
        atexit.unregister(self.close)

    @property
    def _opened(self) -> Port:
        assert self._port is not None
        return self._port

    def _connect(self) -> None:
        """Open the line and find the hand."""
        self._port = port = self._open()
        try:
            self._exchange = Exchange(port, self._spec.name, self._settings.latency, self._settings.tries)
            self._wire = self._wire_of(self._exchange)
            self._wire.find()
            if self._settings.keeper and port.shared is not None:
                self._keeper = Keeper(port.shared, self._wire.limp_words)
        except HandError:
            self._hang_up()
            raise

    def _hang_up(self) -> None:
        """Close the line. Raises nothing."""
        keeper, self._keeper = self._keeper, None
        if keeper is not None:
            (keeper.speak if self.unconfirmed else keeper.dismiss)()
        if self._port is not None:
            self._port.close()
        self._port = None

    def _fresh(self, position: Vector) -> None:
        """Forget the last session."""
        self._tick, self._last, self._position = 0, 0.0, position
        self._glide, self._sent = None, False

    def _ready(self) -> None:
        if self._fault is not None:
            raise self._fault
        silent = self._opened.now() - self._spoken
        if self._moving and silent > self._settings.watchdog:
            why = f"nobody called for {silent:.2f} s, so the hand let go by itself; reset to go on"
            raise self._stopped(HandFault(why))

    def _go(self, position: Vector) -> None:
        self._moving = True
        self._wire.go(self._scale.ticks(position))

    def _let_go(self) -> None:
        """Limp, confirmed. Raises LinkError."""
        self._glide = None
        if not self._moving:
            return
        for left in reversed(range(_TRIES)):
            try:
                self._wire.stop()
                break
            except (LinkError, ProtocolError):
                if not left:
                    raise
        self._moving = False

    def _check(self, motors: Motors) -> None:
        """Raises HandFault for what the hand says of itself, ConfigError for a place where it cannot be."""
        if motors.why:
            raise HandFault(f"{self._spec.name}: {motors.why}; reset to go on")
        if self._moving and not motors.on:
            raise HandFault(f"{self._spec.name} has switched its motors off: it lost its power; reset to go on")
        position, spec = self._scale.position(motors.ticks), self._spec
        excess = np.maximum(spec.lower - position, position - spec.upper) / (spec.upper - spec.lower)
        worst = int(np.argmax(excess))
        if excess[worst] > _FAR:
            where = f"{position[worst]:.2f} rad, far outside [{spec.lower[worst]:.2f}, {spec.upper[worst]:.2f}]"
            raise ConfigError(f"{spec.readable[worst]} would be at {where}: its zero is wrong, or it lost a turn")

    def _state(self, t: float, tick: int, motors: Motors) -> HandState:
        position, unknown = self._scale.position(motors.ticks), frozen(np.full(self._spec.n_joints, np.nan))
        velocity = (position - self._position) / (t - self._last) if tick else np.zeros_like(position)
        self._tick, self._last, self._position = tick, t, position
        return HandState(
            t, tick, frozen(position), frozen(velocity), frozen(self._scale.torque(motors.current)),
            temperature=unknown, gravity=frozen(np.full(3, np.nan)),
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
        try:
            if self._port is not None:
                self._let_go()
        except (LinkError, ProtocolError) as error:
            why = str(error).split(";")[0]
            self.unconfirmed = f"the hand has not confirmed that it is limp ({why}); cut its power if it still pushes"
