"""The shutdown sequence, which leaves a hand limp: sent until the hand, and not only the adapter, has confirmed it."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import StatusBits
from allegro_twin.drivers.can.link.shared_bus import BusPort
from allegro_twin.errors import LinkError, ProtocolError

PATIENCE, TRIES = 0.3, 60
"""s for which it is sent in the foreground, and how often at most."""
ANSWER = 0.05
"""s that a hand has to say whether its motors are off."""
PERIODS = 10
"""Without a report mean that a hand of a version which cannot say it has obeyed."""
_PAUSE = 0.005  # s between two tries.


class ShutdownSequence:
    """Zero torque, motors off, silence."""

    def __init__(self, codec: Codec, *, asks: bool, period: float) -> None:
        """`asks`: this hand can be asked whether its motors are on."""
        self._codec = codec
        self.frames: Sequence[Frame] = [*codec.torques.zero.frames, *map(codec.encode, codec.closing())]
        self.answer = codec.servo_answer if asks else None
        self._quiet = PERIODS * period

    def run(self, port: BusPort, *, reported: bool) -> str:
        """Send it until it is confirmed; why it was not, or nothing. `reported`: the hand did, until just now.

        A hand that can be asked says that its motors are off; of any other the reports must end.
        """
        deadline, why = port.link.now() + PATIENCE, ""
        for _ in range(TRIES):
            try:
                why = self._said(port, reported)
            except LinkError as error:
                why = str(error).split(";")[0]
                threading.Event().wait(0.0 if port.link.lockstep else _PAUSE)
            if not why or port.link.now() >= deadline:
                break
        return why

    def _said(self, port: BusPort, reported: bool) -> str:
        if not port.send(self.frames):
            port.receive(_PAUSE)
            return "the transmit queue is full"
        if self.answer is None:
            if not reported:
                return "it reported nothing before"
            return "" if self._silent(port) else "it goes on reporting"
        port.send([self.answer.ask])
        if why := self._off(port):
            return why
        port.send(self.frames)  # Last on the bus, whatever came between.
        return ""

    def _off(self, port: BusPort) -> str:
        """Why the hand has not said that its motors are off; empty when it has."""
        deadline, why = port.link.now() + ANSWER, "it does not answer"
        while (left := deadline - port.link.now()) > 0.0 and (stamped := port.receive(left)) is not None:
            message = self._decoded(stamped.frame)
            if isinstance(message, m.Information):
                if not (message.bits or StatusBits(0)) & StatusBits.SERVO_ON:
                    return ""
                why = "it says that its motors are still on"
        return why

    def _silent(self, port: BusPort) -> bool:
        """Whether no report comes any more."""
        deadline = port.link.now() + 2 * self._quiet
        while port.link.now() < deadline:
            while (stamped := port.receive(self._quiet)) is not None:
                if isinstance(self._decoded(stamped.frame), m.FingerPosition):
                    break
            else:
                return True
        return False

    def _decoded(self, frame: Frame) -> m.Message | None:
        try:
            return self._codec.decode(frame)
        except ProtocolError:
            return None
