"""Virtual hands that share one bus, with whatever goes wrong on it."""

from __future__ import annotations

from collections.abc import Sequence

from allegro_twin.errors import ConfigError
from allegro_twin.wire.faults import FaultPlan, Faults
from allegro_twin.wire.firmware import Firmware
from allegro_twin.wire.frames import Frame


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

    def receive(self, frame: Frame) -> list[Frame]:
        """What the hands answer to a frame at once."""
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
        frames = self._faults.due(self.now)
        for firmware in self.firmwares:
            frames += self._faults.from_hand(firmware.tick(), self.now, firmware)
        return frames

    def close(self) -> None:
        for firmware in self.firmwares:
            firmware.close()
