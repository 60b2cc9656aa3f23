"""A hand of DYNAMIXEL servos, through the vendor's SDK."""

from __future__ import annotations

import atexit
import logging
from collections.abc import Callable
from typing import Any

import numpy as np

from allegro_twin.backend import position_of
from allegro_twin.errors import HandError, HandFault, LinkError
from allegro_twin.serial.dynamixel.codec import budget
from allegro_twin.serial.dynamixel.codec.calibration import Calibration
from allegro_twin.serial.dynamixel.codec.shafts import Joints, Shafts, to_joints
from allegro_twin.serial.dynamixel.host import prepare
from allegro_twin.serial.dynamixel.host.line import Line
from allegro_twin.serial.dynamixel.host.motors import Motors
from allegro_twin.serial.dynamixel.host.reading import Reading
from allegro_twin.serial.dynamixel.host.sdk import Sdk
from allegro_twin.serial.dynamixel.host.settings import HostSettings
from allegro_twin.serial.line.glide import Glide, onward
from allegro_twin.serial.line.keeper import Keeper
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, PositionCommand, frozen

log = logging.getLogger(__name__)


class DynamixelBackend:
    """Reset leaves the servos limp; the first command that is not limp switches them on; `read` asks all at once.

    Raises ConfigError, LinkError, LinkTimeout, ProtocolError or HandFault; after these the hand is limp until `reset`,
    or the error says that this was not confirmed. `joints`: how joints follow from actuators.
    """

    def __init__(
        self,
        spec: HandSpec,
        calibration: Calibration,
        open_line: Callable[[], Line],
        settings: HostSettings | None = None,
        *,
        joints: Joints | None = None,
    ) -> None:
        calibration.check(spec)
        self._spec, self._calibration, self._open = spec, calibration, open_line
        self._settings = settings or HostSettings()
        self._joints = joints or to_joints(spec)
        self._names = calibration.names(spec.readable)
        self._line: Line | None = None
        self._keeper: Keeper | None = None
        self._fault: HandError | None = HandFault("the hand has not been reset; call reset() before read() or write()")
        self._tick = self._next = 0
        self.unconfirmed = ""
        """Why it is not sure that the hand was left limp; empty when it is."""
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
        return self._calibration.described()

    def warnings(self) -> list[str]:
        """What went wrong since reset without ending the session."""
        return self._reading.warnings()

    def reset(self) -> HandState:
        try:
            if self._keeper is not None and not self._keeper.alive:
                self._hang_up()
            if self._line is None:
                self._connect()
            self.unconfirmed = ""
            self._sdk.alerts.clear()
            self._motors.on = True  # Nobody knows what was before.
            self._let_go()
            prepare.wake(self._sdk, self._calibration, self._names)
            prepare.settle(self._sdk, self._calibration, self._settings.return_delay)
            self._fresh()
            self._opened.begin()
            self._reading.first_temperatures()
            shafts = self._reading.state()
            prepare.check_place(self._spec, shafts.position, self._calibration)
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._fault = None
        self._origin = self._spoken = self._opened.now()
        return self._state(0.0, 0, shafts)

    def write(self, command: Command) -> None:
        self._ready()
        wanted = position_of(command, self._spec)
        try:
            if wanted.limp:
                self._let_go()
            else:
                self._go(wanted)
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._sent = True

    def read(self) -> HandState:
        self._ready()
        line, period = self._opened, self._settings.period
        try:
            line.wait(self._origin + (self._tick + 1) * period)
            if self._glide is not None and not self._sent:
                self._motors.goals(self._glide.at(line.now()))  # A goal is never confirmed: say it every period.
            shafts = self._reading.state()
            t = line.now() - self._origin
            self._tick = max(round(t / period), self._tick + 1)
            if self._tick >= self._next:
                self._next = self._tick + self._every
                self._reading.ask_more(moving=self._motors.on)
                if self._keeper is not None and not self._keeper.alive:
                    raise HandFault("the keeper of this hand has ended, and nobody would leave it limp; reset to go on")
        except HandError as error:
            raise self._stopped(error) from error.__cause__
        self._sent, self._spoken = False, line.now()
        if line.lockstep:
            t = self._tick * period
        return self._state(t, self._tick, shafts)

    def close(self) -> None:
        if self._line is not None:
            self._leave()
            if self.unconfirmed:
                log.error(self.unconfirmed)
            self._hang_up()
        self._fault = HandFault("the hand is closed; reset() opens it again")
        atexit.unregister(self.close)

    @property
    def _opened(self) -> Line:
        assert self._line is not None
        return self._line

    def _connect(self) -> None:
        """Open the line and find the servos."""
        self._line = line = self._open()
        try:
            n = len(self._calibration.ids)
            budget.check(self._settings.period, budget.budget(n, line.baud, self._settings.return_delay, limited=True))
            self._sdk = Sdk(line, self._calibration.model, self._names, self._settings.tries)
            self._motors = Motors(self._sdk, self._calibration, self._settings.watchdog_counts)
            self._fresh()
            prepare.find(self._sdk, self._calibration)
            if self._settings.keeper and line.shared is not None:
                self._keeper = Keeper(line.shared, self._sdk.limp_words())
        except HandError:
            self._hang_up()
            raise

    def _hang_up(self) -> None:
        """Close the line. Raises nothing."""
        keeper, self._keeper = self._keeper, None
        if keeper is not None:
            (keeper.speak if self.unconfirmed else keeper.dismiss)()
        if self._line is not None:
            self._line.close()
        self._line = None

    def _fresh(self) -> None:
        """Forget the last session."""
        self._reading = Reading(self._sdk, self._calibration, self._names, self._settings.tries)
        self._every = self._settings.every(Reading.QUESTIONS * len(self._calibration.ids))
        self._tick, self._next = 0, self._every
        self._glide: Glide | None = None
        self._sent = False

    def _ready(self) -> None:
        if self._fault is not None:
            raise self._fault
        silent = self._opened.now() - self._spoken
        if self._motors.on and silent > self._settings.watchdog:
            why = f"nobody called for {silent:.2f} s, so the servos stopped by themselves; reset to go on"
            raise self._stopped(HandFault(why))

    def _go(self, wanted: PositionCommand) -> None:
        now = self._opened.now()
        self._glide = onward(self._glide, self._shafts.position, wanted, now)
        goal = self._glide.at(now)
        if not self._motors.on:
            self._motors.start(goal, wanted.effort)
        else:
            self._motors.currents(wanted.effort)
            self._motors.goals(goal)
        self._spoken = self._opened.now()

    def _let_go(self) -> None:
        """Limp, confirmed. Raises LinkError."""
        self._glide = None
        if self._motors.on and (why := self._motors.stop()):
            raise LinkError(why)

    def _state(self, t: float, tick: int, shafts: Shafts) -> HandState:
        self._shafts = shafts
        joints, n = self._joints(shafts), self._spec.n_joints
        same = n == len(self._calibration.ids)
        return HandState(
            t=t,
            tick=tick,
            position=frozen(joints.position),
            velocity=frozen(joints.velocity),
            torque=frozen(joints.torque),
            temperature=frozen(self._reading.temperature if same else np.full(n, np.nan)),
            gravity=frozen(np.full(3, np.nan)),
        )

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
        if self._line is None or not self._motors.on:
            return
        if why := self._motors.stop():
            self.unconfirmed = f"the hand has not confirmed that it is limp ({why}); cut its power if it still pushes"
