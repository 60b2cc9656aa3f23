"""A hand on a CAN bus."""

from __future__ import annotations

import atexit
from collections.abc import Callable

import can
import numpy as np

from allegro_twin.backend import torque_of
from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, LinkTimeout
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, Vector, frozen
from allegro_twin.wire import messages as m
from allegro_twin.wire.assembler import Whole
from allegro_twin.wire.clock import HandClock
from allegro_twin.wire.codec import FINGERS, Codec
from allegro_twin.wire.deadman import Deadman
from allegro_twin.wire.frames import Frame
from allegro_twin.wire.handshake import begin
from allegro_twin.wire.health import Health
from allegro_twin.wire.link import Port
from allegro_twin.wire.listener import Listener
from allegro_twin.wire.messages import Topic
from allegro_twin.wire.terms import Terms
from allegro_twin.wire.velocity import VelocityFilter

FIRST = 0.5
"""s that a hand may take to its first report."""
PATIENCE = 10
"""Commands in a row that a full transmit queue may refuse before nobody can be listening."""


class CanBackend:
    """Reset says hello, `write` sends one torque frame a finger, `read` waits for a whole hand and skips to the newest.

    Raises LinkError, LinkTimeout, ProtocolError or HandFault; after any of them the hand is limp until `reset`.
    """

    def __init__(self, spec: HandSpec, codec: Codec, open_port: Callable[[], Port], terms: Terms | None = None) -> None:
        if spec.n_joints != 4 * len(FINGERS):
            raise ConfigError(f"{spec.name} has {spec.n_joints} joints; the protocol carries {4 * len(FINGERS)}")
        self._spec, self._codec, self._open, self._terms = spec, codec, open_port, terms or Terms()
        self._port: Port | None = open_port()
        self._lockstep = self._port.link.lockstep
        self._limp = [*self._torque_frames([0.0] * 16), *map(codec.encode, codec.closing())]
        self._fault: HandError | None = HandFault("the hand has not been reset; call reset() before read() or write()")
        self._deadman: Deadman | None = None
        self._fresh()
        atexit.register(self.close)

    @property
    def spec(self) -> HandSpec:
        return self._spec

    @property
    def period(self) -> float:
        return self._terms.period

    @property
    def lockstep(self) -> bool:
        """Whether the hand's time passes only while this backend reads."""
        return self._lockstep

    def warnings(self) -> list[str]:
        """What went wrong since reset without ending the session."""
        return self._ears.health.words()

    @property
    def health(self) -> Health:
        """What was counted since reset."""
        return self._ears.health

    def listen(self, log: Callable[[can.Message], None]) -> None:
        """Tell a bus log of every frame, sent or received, until this bus is closed."""
        if self._port is not None:
            self._port.link.listen(log)

    def reset(self) -> HandState:
        self._disarm()
        if self._port is None:
            self._port = self._open()
        self._fresh()
        try:
            greeting = begin(self._port, self._codec, self._terms, self._spec, self._limp)
            for stamped in greeting:
                self._ears.hear(*stamped)
            self._fault = None
            self._poll()  # A hand that is still hot says so before anything moves.
            whole = self._wait(max(self._terms.timeout, FIRST))
            if self._terms.imu_period and self._terms.gravity is None:
                whole = self._level(whole)
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._clock = HandClock(self._terms.period, whole.t, self._ears.moments)
        self._ears.serving = True
        position = frozen(whole.position)
        self._filter = VelocityFilter(self._terms.velocity_cutoff, position)
        self._arm()
        return self._state(position, frozen(np.zeros(16)))

    def write(self, command: Command) -> None:
        port = self._ready()
        frames = self._torque_frames(torque_of(command, self._spec).tolist())
        try:
            if port.send(frames):
                self._refused = 0
                self._torque = self._on_the_wire(frames)
            else:
                self._refused += 1
                self._ears.health.note("unsent", "the transmit queue is full")
                if self._refused >= PATIENCE:
                    raise LinkError(f"{port.link.name} takes no frames; is the hand powered and on this bus?")
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        if self._deadman is not None:
            self._deadman.feed()
        if self._fault is not None:  # The deadman struck meanwhile, and these torques came after its zeros.
            self._silence()
            raise self._fault

    def read(self) -> HandState:
        self._ready()
        if self._deadman is not None:
            self._deadman.feed()
        try:
            self._poll()
            whole = self._wait(self._terms.timeout)
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        periods = self._clock.advance(whole.t, self._ears.moments)
        self._ears.health.missed += periods - 1
        position = frozen(whole.position)
        return self._state(position, self._filter(position, periods * self.period))

    def close(self) -> None:
        self._disarm()
        if self._deadman is not None:
            self._deadman.close()
            self._deadman = None
        if self._port is not None:
            self._silence()
            self._port.close()
            self._port = None
        self._fault = HandFault("the hand is closed; reset() opens it again")
        atexit.unregister(self.close)

    def _fresh(self) -> None:
        """Forget the last session."""
        self._ears = Listener(self._codec, self._terms.period, self._terms.gravity)
        self._torque = frozen(np.zeros(16))
        self._refused = self._polled = 0
        self._errors_before = self._port.link.error_frames if self._port is not None else 0

    def _ready(self) -> Port:
        if self._fault is not None:
            raise self._fault
        assert self._port is not None
        return self._port

    def _wait(self, timeout: float) -> Whole:
        """The newest whole hand; raises LinkTimeout when none comes."""
        port = self._port
        assert port is not None
        link, queue, hear = port.link, port.queue, self._ears.hear
        deadline = link.now() + timeout
        newest: Whole | None = None
        while True:
            while queue:
                newest = hear(*queue.popleft()) or newest
            if newest is not None:
                if link.lockstep or not link.pump(0.0):  # Lockstep pumps till nothing is left.
                    self._ears.count(link.error_frames - self._errors_before)
                    return newest
            elif (left := deadline - link.now()) > 0.0:
                link.pump(left)
            elif not link.pump(0.0):
                who = self._ears.silent(timeout)
                raise LinkTimeout(
                    f"no report from {who} for {timeout:g} s on {link.name}; is it powered and plugged in?"
                )

    def _level(self, whole: Whole) -> Whole:
        """Wait until the IMU has told where down is."""
        link, ears = self._port.link, self._ears  # type: ignore[union-attr]  # Open since reset.
        deadline = link.now() + FIRST + 2 * self._terms.imu_period
        while not ears.gravity.any() or not np.isfinite(ears.gravity).all():
            if link.now() > deadline:
                raise LinkTimeout(f"the hand reports positions on {link.name}, but no IMU; give `gravity` instead")
            whole = self._wait(self._terms.timeout)
        return whole

    def _poll(self) -> None:
        """Ask for the status now and then, for no hand is known to report it by itself."""
        every = max(round(self._terms.status_period / self._terms.period), 1)
        if self._terms.identify and self._codec.identifies and self._polled % every == 0:
            assert self._port is not None
            self._port.send([self._codec.encode(m.Request(Topic.INFORMATION))])
        self._polled += 1

    def _state(self, position: Vector, velocity: Vector) -> HandState:
        clock, ears = self._clock, self._ears
        return HandState(clock.t, clock.tick, position, velocity, self._torque, ears.temperature, ears.gravity)

    def _torque_frames(self, torque: list[float]) -> list[Frame]:
        words = [m.SetTorque(k, tuple(torque[4 * k : 4 * k + 4])) for k in range(4)]  # type: ignore[arg-type]
        return [*map(self._codec.encode, words)]

    def _on_the_wire(self, frames: list[Frame]) -> Vector:
        """What the hand will make of these torques: saturated and in whole counts."""
        values: list[float] = []
        for frame in frames:
            message = self._codec.decode(frame)
            assert isinstance(message, m.SetTorque)
            values += message.torque
        return frozen(values)

    def _stopped(self, error: HandError) -> HandError:
        """Leave the hand limp and remember why."""
        self._fault = error
        self._disarm()
        self._silence()
        if isinstance(error, LinkError) and self._port is not None:
            self._port.close()
            self._port = None
        return error

    def _silence(self) -> None:
        try:
            if self._port is not None:
                self._port.send(self._limp)
        except LinkError:
            pass  # Nothing left to say it with.

    def _arm(self) -> None:
        if self._terms.deadman is None or self._lockstep:
            return  # On a lockstep bus time stands still while nobody calls.
        if self._deadman is None:
            self._deadman = Deadman(self._terms.deadman, self._cut_off)
        self._deadman.arm()

    def _disarm(self) -> None:
        if self._deadman is not None:
            self._deadman.disarm()

    def _cut_off(self) -> None:
        """Called by the deadman, on its own thread."""
        self._silence()
        self._fault = HandFault(f"nobody called for {self._terms.deadman:g} s, so the hand was cut off; reset to go on")
