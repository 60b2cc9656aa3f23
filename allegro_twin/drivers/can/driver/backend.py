"""A hand on a CAN bus."""

from __future__ import annotations

import atexit
import logging
from collections.abc import Callable
from typing import Any

import can
import numpy as np

from allegro_twin.backend import torque_of
from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import FINGERS, Codec, described
from allegro_twin.drivers.can.codec.messages import Topic
from allegro_twin.drivers.can.driver.health import Health
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.driver.listener import Listener
from allegro_twin.drivers.can.driver.shutdown import ShutdownSequence
from allegro_twin.drivers.can.driver.startup import TRIES, begin, set_up
from allegro_twin.drivers.can.driver.watch import Watch
from allegro_twin.drivers.can.link.shared_bus import BusPort
from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, LinkTimeout
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, frozen

log = logging.getLogger(__name__)

FIRST = 0.5
"""s that a hand may take to its first report."""
PATIENCE = 10
"""Commands in a row that a full transmit queue may refuse before nobody can be listening."""


class CanBackend:
    """Reset says hello, `write` sends one torque frame a finger, `read` waits for a whole hand and skips to the newest.

    Raises LinkError, LinkTimeout, ProtocolError or HandFault; after any of them the hand is limp until `reset`, or the
    error says that this was not confirmed.
    """

    def __init__(
        self, spec: HandSpec, codec: Codec, open_port: Callable[[], BusPort], settings: CanHostSettings | None = None
    ) -> None:
        if spec.n_joints != 4 * len(FINGERS):
            raise ConfigError(f"{spec.name} has {spec.n_joints} joints; the protocol carries {4 * len(FINGERS)}")
        self._spec, self._codec, self._open, self._settings = spec, codec, open_port, settings or CanHostSettings()
        self._port: BusPort | None = open_port()
        self._lockstep = self._port.link.lockstep
        asks = codec.identifies and self._settings.identify
        self._shutdown = ShutdownSequence(codec, asks=asks, period=self._settings.period)
        self._watch = Watch(codec, self._shutdown, self._settings)
        self._fault: HandError | None = HandFault("the hand has not been reset; call reset() before read() or write()")
        self._every = max(round(self._settings.status_period / self._settings.period), 1)
        self.unconfirmed = ""
        """Why it is not sure that the hand was left limp; empty when it is."""
        self._fresh()
        atexit.register(self.close)

    @property
    def spec(self) -> HandSpec:
        return self._spec

    @property
    def period(self) -> float:
        return self._settings.period

    @property
    def codec(self) -> Codec:
        """How this hand is spoken to."""
        return self._codec

    @property
    def calibration(self) -> dict[str, Any]:
        """What turns this hand's counts into rad and N·m, for recordings."""
        return described(self._codec)

    @property
    def keeper(self) -> int:
        """The process that watches this one; 0: none."""
        return self._watch.keeper

    @property
    def live(self) -> bool:
        """Whether the hand's time passes by itself; else only while this backend reads."""
        return not self._lockstep

    def warnings(self) -> list[str]:
        """What went wrong since reset without ending the session."""
        return [*self.health.lines(), *self._watch.warnings()]

    @property
    def health(self) -> Health:
        """What was counted since reset."""
        health = self._listener.health
        if self._port is not None:
            health.errors = self._port.link.error_frames - self._errors_before
        return health

    def listen(self, log: Callable[[can.Message], None]) -> bool:
        """Pass every frame, sent or received, to a bus log until this bus is closed."""
        if self._port is not None:
            self._port.link.listen(log)
        return True

    def reset(self) -> HandState:
        self._watch.disarm()
        try:
            if self._port is None:
                self._port = self._open()
            self._fresh()
            self._watch.ready(self._port)
            greeting = begin(self._port, self._codec, self._settings, self._spec, self._shutdown.frames, self._serve)
            for stamped in greeting:
                self._listener.hear(*stamped)
            self._fault = None
            self._poll()  # A hand that is still hot says so before anything moves.
            self._polled = 1
            caught_up = self._first()
            if self._settings.imu_period and self._settings.gravity is None:
                caught_up = self._level()
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._listener.serving = True
        self._watch.feed()
        return self._listener.state(self._torque, caught_up=caught_up)

    def write(self, command: Command) -> None:
        if self._fault is not None or self._watch.armed:
            self._ready()
        port = self._port
        assert port is not None
        torque = torque_of(command, self._spec)
        try:
            frames, applied = self._codec.torques.frames(torque, self._codec.pwm_limits)
            if port.send((frames,)):
                self._refused = 0
                self._torque = applied
            else:
                self._refused += 1
                self._listener.health.note("unsent", "the transmit queue is full")
                if self._refused >= PATIENCE:
                    raise LinkError(f"{port.link.name} takes no frames; is the hand powered and on this bus?")
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        if self._watch.armed:
            self._ready()  # It may have been cut off meanwhile, and these torques came after the zeros.

    def read(self) -> HandState:
        if self._fault is not None or self._watch.armed:
            self._ready()
        try:
            if self._polled % self._every == 0:
                self._poll()
            self._polled += 1
            caught_up = self._wait(self._settings.timeout)
            self._listener.check_period()
            if self._listener.motors is False:
                self._wake()
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        return self._listener.state(self._torque, caught_up=caught_up)

    def close(self) -> None:
        if self._port is not None:
            self._leave()
            if self.unconfirmed:
                log.error(self.unconfirmed)
            self._port.close()
            self._port = None
        self._watch.close()
        self._fault = HandFault("the hand is closed; reset() opens it again")
        atexit.unregister(self.close)

    def _fresh(self) -> None:
        """Forget the last session."""
        self._listener = Listener(self._codec, self._settings)
        self._torque = frozen(np.zeros(self._spec.n_actuators))
        self._refused = self._polled = self._woken = 0
        self._served = False
        self.unconfirmed = ""
        self._errors_before = self._port.link.error_frames if self._port is not None else 0

    def _serve(self) -> None:
        """The motors are about to go on."""
        self._served = True
        self._watch.arm()

    def _ready(self) -> None:
        """Raises why the hand may not be driven; also says that somebody still does."""
        if self._fault is not None:
            raise self._fault
        if fault := self._watch.fault():
            raise self._stopped(fault)
        self._watch.feed()

    def _wait(self, timeout: float) -> bool:
        """Read until there is a whole hand, and on while more waits, but for a period at most; whether nothing is left.
        Raises LinkTimeout when none comes."""
        port, listener = self._port, self._listener
        assert port is not None
        link, queue = port.link, port.queue
        deadline, until, left = link.now() + timeout, None, timeout
        while True:
            if queue:
                listener.hear_all(queue)
            if listener.whole is not None:
                if link.lockstep or not link.pump(0.0):
                    return True
                until = until or link.now() + self.period
                if link.now() > until:
                    return False
            elif left > 0.0:
                if self._watch.armed:
                    self._watch.check()
                    self._watch.feed()
                    left = min(left, self._watch.beat)
                link.pump(left)
                if queue:
                    listener.hear_all(queue)
                if listener.whole is None:
                    left = deadline - link.now()
            elif not link.pump(0.0):
                raise listener.timeout(timeout, link.name)

    def _first(self) -> bool:
        """Wait for the first whole hand; where no report comes, the hand is set up again, for a frame of that may be
        lost. Whether nothing is left to read."""
        patience, port = max(self._settings.timeout, FIRST), self._port
        assert port is not None
        for tries_left in reversed(range(TRIES)):
            try:
                caught_up = self._wait(patience)
            except LinkTimeout:
                if self._listener.reports or not tries_left:
                    raise
                for stamped in set_up(port, self._codec, self._settings):
                    self._listener.hear(*stamped)
                self._poll()
            else:
                break
        if self._listener.motors is False:
            self._wake()
        return caught_up

    def _wake(self) -> None:
        """Switch the motors on once more: the hand says that they have not been, so that frame was lost."""
        self._woken += 1
        if self._woken == TRIES:
            raise HandFault(f"the hand was told {TRIES} times to switch its motors on, and does not; reset to go on")
        assert self._port is not None
        self._port.send([self._codec.encode(m.ServoOn())])
        self._listener.motors = None  # Until the next question: who switches them on may take its time.

    def _level(self) -> bool:
        """Wait until the IMU has told where down is."""
        link, listener = self._port.link, self._listener  # type: ignore[union-attr]  # Open since reset.
        deadline, caught_up = link.now() + FIRST + 2 * self._settings.imu_period, True
        while not listener.gravity.any() or not np.isfinite(listener.gravity).all():
            if link.now() > deadline:
                raise LinkTimeout(f"the hand reports positions on {link.name}, but no IMU; give `gravity` instead")
            listener.whole = None
            caught_up = self._wait(self._settings.timeout)
        return caught_up

    def _poll(self) -> None:
        """Ask for the status now and then, for no hand is known to report it by itself."""
        assert self._port is not None
        if self._settings.identify and self._codec.identifies:
            self._port.send([self._codec.encode(m.Request(Topic.INFORMATION))])

    def _stopped(self, error: HandError) -> HandError:
        """Leave the hand limp and remember why."""
        error = self._watch.fault() or error  # What was heard after a cut is its doing.
        self._fault = error
        self._leave()
        if self.unconfirmed:
            error.args = (f"{error}; {self.unconfirmed}",)
        if isinstance(error, LinkError) and self._port is not None:
            self._port.close()
            self._port = None
        return error

    def _leave(self) -> None:
        """Run the shutdown sequence until it is confirmed; else the keeper, if there is one, goes on with it."""
        if self._port is None:
            return
        now = self._port.link.now()
        reported = max(self._listener.heard) > now - 2 * FIRST
        why = self._shutdown.run(self._port, reported=reported)
        if self._served and why:
            self.unconfirmed = f"the hand has not confirmed that it is limp ({why}): {self._watch.take_over()}"
        if not why:
            self._served = False
            self._watch.disarm()
