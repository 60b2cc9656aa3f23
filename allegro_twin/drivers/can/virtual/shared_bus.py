"""Virtual hands that share one bus, with whatever goes wrong on it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.virtual.faults import FaultPlan, Faults
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.errors import ConfigError


class VirtualHands:
    """Firmwares that step alike. Raises ConfigError when they do not."""

    def __init__(self, firmwares: Sequence[Firmware], plan: FaultPlan | None = None) -> None:
        steps = {firmware.step for firmware in firmwares}
        if len(steps) != 1:
            raise ConfigError(f"hands on one virtual bus must have the same period; these have {sorted(steps)} s")
        self.firmwares, self.step = tuple(firmwares), steps.pop()
        self._faults = Faults(plan) if plan is not None else None
        self._ticks = 0

    @property
    def now(self) -> float:
        """s since they were switched on."""
        return self._ticks * self.step

    @property
    def bus_off(self) -> bool:
        """Whether a fault took the bus down."""
        return self._faults is not None and self._faults.bus_off

    @property
    def due(self) -> float:
        """When the next frame arrives that a fault holds back, s; infinite when there is none."""
        return self._faults.due if self._faults is not None else math.inf

    def late(self, now: float) -> list[Frame]:
        """Frames that a fault held back until now."""
        return self._faults.late(now) if self._faults is not None else []

    def receive(self, frame: Frame) -> list[Frame]:
        """What the hands answer to a frame at once."""
        if self._faults is None and len(self.firmwares) == 1:
            return self.firmwares[0].receive(frame)
        if self._faults is None:
            return [answer for firmware in self.firmwares for answer in firmware.receive(frame)]
        answers: list[Frame] = []
        for arrived in self._faults.to_hand([frame]):
            for firmware in self.firmwares:
                answers += self._faults.from_hand(firmware.receive(arrived), self.now, firmware)
        return answers

    def tick(self) -> list[Frame]:
        """Let one step pass; what arrives at the host at its end."""
        self._ticks += 1
        if self._faults is None:
            return [frame for firmware in self.firmwares for frame in firmware.tick()]
        self._faults.happen(self.now, self.firmwares)
        frames: list[Frame] = []
        for firmware in self.firmwares:
            frames += self._faults.from_hand(firmware.tick(), self.now, firmware)
        return frames

    def close(self) -> None:
        for firmware in self.firmwares:
            firmware.close()
