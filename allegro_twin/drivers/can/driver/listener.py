"""Reads the bus for a session: an interpreter keeps what the hand says, and fatal errors are raised."""

from __future__ import annotations

import math

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.detect import reporting
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import COMMANDS, Message, StatusBits
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.driver.interpreter import Interpreter
from allegro_twin.errors import HandFault, LinkError, LinkTimeout

FATAL = {
    StatusBits.JOINT_HOT: "a joint is too hot; let it cool down",
    StatusBits.PALM_HOT: "the palm is too hot; let it cool down",
    StatusBits.JOINT_TIMEOUT: "a joint no longer answers the palm; switch the hand off and on",
}


class Listener(Interpreter):
    """An interpreter that raises HandFault for what stops a hand, and LinkError when somebody else commands it."""

    def __init__(self, codec: Codec, settings: CanHostSettings) -> None:
        super().__init__(codec, settings)
        self.serving = False
        """Whether the motors ought to be on."""
        self.motors: bool | None = None
        """Whether they are, by the hand's last word on it."""

    def _take(self, message: Message, frame: Frame) -> None:
        super()._take(message, frame)
        self._judge(message, frame)

    def timeout(self, seconds: float, link: str) -> LinkTimeout:
        """Why there was no state for so long, on which link."""
        newest = max(self.heard)
        if newest > -math.inf and (fingers := self.silent(seconds)):
            return LinkTimeout(f"no report from {fingers} for {seconds:g} s on {link}; is it powered and plugged in?")
        if self.reports > self._before:
            return LinkTimeout(
                f"no whole state for {seconds:g} s on {link}, though {self.reports - self._before} reports came: they "
                "are lost or out of order; check cable, termination and `allegro-twin check`"
            )
        if not self.reports and self.motors is not None:
            return LinkTimeout(
                f"no report from the hand for {seconds:g} s on {link}, though it answers there that its motors are "
                f"{'on' if self.motors else 'off'}: it was told to report every {1e3 * self._period:g} ms, and does "
                "not; check `version`, cable and termination"
            )
        others = reporting(self.others)
        version = self._codec.version
        who = f"the hand, a {version} (but {others} reports: correct `version`)," if others else "the hand"
        return LinkTimeout(f"no report from {who} for {seconds:g} s on {link}; is it powered and plugged in?")

    def check_period(self) -> None:
        """Raises HandFault where the hand clearly keeps another period than the config's: its speeds are not known."""
        if math.isnan(self.own_period):
            return
        found, told = 1e3 * self.own_period, 1e3 * self._period
        raise HandFault(
            f"the hand reports every {found:.1f} ms, not every {told:g} ms as the config says, so its speeds are not "
            f"known; set `period: {max(round(found), 1) / 1e3:g}`, or end the program that changed it, then reset"
        )

    def _judge(self, message: Message, frame: Frame) -> None:
        match message:
            case m.Status(bits=bits) | m.Information(bits=bits):
                self._judge_status(bits)
            case m.MotorError():
                raise HandFault(f"motor {message.motor} reports {_complaint(message)}; reset to go on")
            case _ if isinstance(message, COMMANDS):
                name = type(message).__name__
                raise LinkError(f"another program commands this hand ({name}, frame {frame}); stop one of the two")
            case _:
                pass  # Answers to somebody else's question, and questions, do no harm.

    def _judge_status(self, bits: StatusBits | None) -> None:
        if bits is None:
            return
        refuse(bits)
        if bits & StatusBits.THROTTLED:
            self.health.note("throttled", "the hand says that a hot joint gets less torque")
        motors = bool(bits & StatusBits.SERVO_ON)
        if self.serving and self.motors and not motors:
            raise HandFault("the hand switched its motors off; reset to go on")
        self.motors = motors


def refuse(bits: StatusBits) -> None:
    """Raises HandFault where a status says that the hand must not be driven."""
    for bit, why in FATAL.items():
        if bits & bit:
            raise HandFault(f"the hand says {bit.name}: {why}, then reset")


def _complaint(error: m.MotorError) -> str:
    said = [name for name in ("voltage", "overheat", "shock", "overload") if getattr(error, name)]
    return " and ".join(said) or "an unknown error"
