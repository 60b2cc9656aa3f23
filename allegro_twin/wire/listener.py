"""What a hand says, taken in frame by frame."""

from __future__ import annotations

import math

import numpy as np

from allegro_twin.errors import HandFault, LinkError, ProtocolError
from allegro_twin.types import Vector, frozen
from allegro_twin.wire import messages as m
from allegro_twin.wire.assembler import Assembler, Whole
from allegro_twin.wire.codec import FINGERS, Codec
from allegro_twin.wire.frames import Frame
from allegro_twin.wire.health import Health
from allegro_twin.wire.imu import gravity_of
from allegro_twin.wire.messages import StatusBits
from allegro_twin.wire.strangers import neighbours

_FATAL = {
    StatusBits.JOINT_HOT: "a joint is too hot; let it cool down",
    StatusBits.PALM_HOT: "the palm is too hot; let it cool down",
    StatusBits.JOINT_TIMEOUT: "a joint no longer answers the palm; switch the hand off and on",
}


class Listener:
    """Turns frames into whole hands, keeps temperatures and gravity, counts trouble and raises on what is fatal."""

    def __init__(self, codec: Codec, period: float, gravity: tuple[float, float, float] | None) -> None:
        self._codec, self._given = codec, gravity is not None
        self._assembler = Assembler(period)
        self.health = Health()
        self.temperature: Vector = frozen(np.full(16, math.nan))
        self.gravity: Vector = frozen(np.full(3, math.nan) if gravity is None else gravity)
        self.serving = False
        """Whether the motors ought to be on."""

    @property
    def moments(self) -> int:
        """Periods of which any report came."""
        return self._assembler.moments

    def hear(self, frame: Frame, t: float) -> Whole | None:
        """Take one frame in; the whole hand, when it completes one. Raises HandFault or LinkError."""
        try:
            message = self._codec.decode(frame)
        except ProtocolError as error:
            self.health.note("malformed", error)
            return None
        match message:
            case m.FingerPosition():
                return self._assembler.add(message, t)
            case None:
                if not neighbours(self._codec.version, frame.id):
                    self.health.note("unknown", f"frame {frame}")
            case m.FingerTemperature(finger=finger, temperature=celsius):
                values = self.temperature.copy()
                values[4 * finger : 4 * finger + 4] = celsius
                self.temperature = frozen(values)
            case m.Imu(orientation=orientation):
                if not self._given:
                    self.gravity = gravity_of(orientation)
            case m.Status(bits=bits) | m.Information(bits=bits):
                self._judge(bits)
            case m.MotorError():
                raise HandFault(f"motor {message.motor} reports {_complaint(message)}; reset to go on")
            case m.SetTorque() | m.ServoOn() | m.ServoOff():
                name = type(message).__name__
                raise LinkError(f"another program commands this hand ({name}, frame {frame}); stop one of the two")
            case _:
                pass  # Answers to somebody else's question, and questions, do no harm.
        return None

    def count(self, error_frames: int) -> None:
        """Bring the counts up to date with what others count."""
        self.health.states += 1
        self.health.incomplete, self.health.doubtful = self._assembler.incomplete, self._assembler.doubtful
        self.health.errors = error_frames

    def silent(self, timeout: float) -> str:
        """Who has fallen silent."""
        heard = self._assembler.heard
        newest = max(heard)
        fingers = [FINGERS[k] for k, t in enumerate(heard) if t < newest - timeout / 2]
        return ", ".join(fingers) if newest > -math.inf and fingers else "the hand"

    def _judge(self, bits: StatusBits | None) -> None:
        if bits is None:
            return
        for bit, why in _FATAL.items():
            if bits & bit:
                raise HandFault(f"the hand says {bit.name}: {why}, then reset")
        if bits & StatusBits.THROTTLED:
            self.health.note("throttled", "the hand says that a hot joint gets less torque")
        if self.serving and not bits & StatusBits.SERVO_ON:
            raise HandFault("the hand switched its motors off; reset to go on")


def _complaint(error: m.MotorError) -> str:
    said = [name for name in ("voltage", "overheat", "shock", "overload") if getattr(error, name)]
    return " and ".join(said) or "an unknown error"
