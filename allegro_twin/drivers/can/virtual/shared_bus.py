"""Virtual hands that share one bus, with whatever goes wrong on it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from allegro_twin.drivers.can.codec.frames import Frame, JointFrames, single
from allegro_twin.drivers.can.config import FaultSettings
from allegro_twin.drivers.can.virtual.faults import BusFaults
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.errors import ConfigError


class VirtualHands:
    """Firmwares that step alike. Raises ConfigError when they do not."""

    def __init__(self, firmwares: Sequence[Firmware], plan: FaultSettings | None = None) -> None:
        steps = {firmware.period for firmware in firmwares}
        if len(steps) != 1:
            raise ConfigError(f"hands on one virtual bus must have the same period; these have {sorted(steps)} s")
        self.firmwares, self.period = tuple(firmwares), steps.pop()
        self.faults = BusFaults(plan) if plan is not None else None
        self._ticks = 0
        self.now = 0.0
        """s since they were switched on."""

    @property
    def bus_off(self) -> bool:
        """Whether a fault took the bus down."""
        return self.faults is not None and self.faults.bus_off

    @property
    def due(self) -> float:
        """When the next frame arrives that a fault holds back, s; infinite when there is none."""
        return self.faults.due if self.faults is not None else math.inf

    def late(self, now: float) -> list[Frame]:
        """Frames that a fault held back until now."""
        return self.faults.late(now) if self.faults is not None else []

    def receive(self, frame: Frame | JointFrames) -> list[Frame]:
        """What the hands answer to a frame at once."""
        if self.faults is None:
            if len(self.firmwares) == 1:
                return self.firmwares[0].receive(frame)
            return [answer for each in single([frame]) for hand in self.firmwares for answer in hand.receive(each)]
        answers: list[Frame] = []
        for arrived in self.faults.to_hand(single([frame])):
            for firmware in self.firmwares:
                answers += self.faults.from_hand(firmware.receive(arrived), self.now, firmware)
        return answers

    def step(self) -> list[Frame | JointFrames]:
        """Let one step pass; what arrives at the host at its end."""
        self._ticks += 1
        self.now = self._ticks * self.period
        if self.faults is None:
            if len(self.firmwares) == 1:
                return self.firmwares[0].step()
            return [frames for firmware in self.firmwares for frames in firmware.step()]
        self.faults.happen(self.now, self.firmwares)
        frames = list[Frame | JointFrames]()
        for firmware in self.firmwares:
            frames += self.faults.from_hand(single(firmware.step()), self.now, firmware)
        return frames

    def close(self) -> None:
        for firmware in self.firmwares:
            firmware.close()
