"""Faults to inject between a virtual hand and its bus: at random with a seed, or by script."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol, cast

import numpy as np

from allegro_twin.drivers.base.faults import FaultScript
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import FingerPosition, StatusBits
from allegro_twin.drivers.can.config import FaultSettings
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.errors import ConfigError, ProtocolError
from allegro_twin.spec.drivetrain import AILMENTS, Ailment

OVERHEATED = 90.0  # °C that a joint is set to; above what the firmware bears.


class BusFaults:
    """Does to hands and their frames what a config's `faults` say. Probabilities are per frame."""

    def __init__(self, plan: FaultSettings) -> None:
        self._plan, self._rng = plan, np.random.default_rng(plan.seed)
        self._chance = np.random.default_rng((plan.seed, 1))
        self._script = FaultScript(plan.script, 16, "joints")
        self._held: list[tuple[float, Frame]] = []
        self._silent: set[int] = set()
        self.cut = False
        """Whether the hands are off the bus: no power, or bus-off."""
        self.bus_off = False
        """Whether the bus itself is down."""

    def happen(self, now: float, hands: Sequence[Firmware]) -> None:
        """Let the events up to `now` happen."""
        if self._plan.failures and self._chance.random() < self._plan.failures * hands[0].period / 60.0:
            what = list(AILMENTS)[self._chance.integers(len(AILMENTS))]
            joint, amount = int(self._chance.integers(16)), float(self._chance.uniform(*AILMENTS[what]))
            _suffer(hands, what, _tip(hands[0], joint) if what == "loose" else joint, amount)
        for event in self._script.take(now):
            match event.what:
                case "silence":
                    self._silent.add(event.which)
                case "overheat":
                    for hand in hands:
                        hand.motors.temperature[event.which] = OVERHEATED
                case "joint_timeout":
                    for hand in hands:
                        hand.failed |= StatusBits.JOINT_TIMEOUT
                case "bus_off":
                    self.cut = self.bus_off = True
                case "power_cut":
                    self.cut = True
                    for hand in hands:
                        hand.power_up()
                case "recover":
                    self._recover(hands)
                case _:
                    usual = sum(AILMENTS[event.what]) / 2.0
                    _suffer(hands, event.what, event.which, usual if event.amount is None else event.amount)

    def to_hand(self, frames: list[Frame]) -> list[Frame]:
        """What arrives at the hands of what the host sent."""
        return [] if self.cut else self._disturbed(frames)

    def from_hand(self, frames: list[Frame], now: float, hand: Firmware) -> list[Frame]:
        """What arrives at the host of what a hand sent, and of what was held back before."""
        if self.cut:
            self._held.clear()
            return []
        heard = [frame for frame in frames if not self._silent or self._finger(frame, hand) not in self._silent]
        kept = []
        for frame in self._disturbed(heard):
            if self._plan.delay and self._rng.random() < self._plan.delay:
                self._held.append((now + self._plan.delay_by, frame))
            else:
                kept.append(frame)
        if self._plan.reorder and len(kept) > 1 and self._rng.random() < self._plan.reorder:
            kept = [kept[k] for k in self._rng.permutation(len(kept))]
        return kept

    @property
    def due(self) -> float:
        """When the next frame that is held back arrives, s; infinite when there is none."""
        return min((t for t, _ in self._held), default=math.inf)

    def late(self, now: float) -> list[Frame]:
        """Frames that were held back until now."""
        ready = [frame for t, frame in self._held if t <= now]
        self._held = [(t, frame) for t, frame in self._held if t > now]
        return ready

    def _disturbed(self, frames: list[Frame]) -> list[Frame]:
        plan, rng = self._plan, self._rng
        if not (plan.drop or plan.duplicate or plan.corrupt):
            return frames
        out: list[Frame] = []
        for frame in frames:
            if rng.random() < plan.drop:
                continue
            arrived = self._corrupted(frame) if rng.random() < plan.corrupt else frame
            out += [arrived] * (2 if rng.random() < plan.duplicate else 1)
        return out

    def _corrupted(self, frame: Frame) -> Frame:
        bit = int(self._rng.integers(11 + 8 * len(frame.data) + 1))
        if bit < 11:
            return frame._replace(id=frame.id ^ 1 << bit)
        if bit == 11:
            return frame._replace(data=frame.data[: int(self._rng.integers(len(frame.data) + 1))])
        data = bytearray(frame.data)
        data[(bit - 12) // 8] ^= 1 << (bit - 12) % 8
        return frame._replace(data=bytes(data))

    def _finger(self, frame: Frame, hand: Firmware) -> int | None:
        try:
            message = hand.codec.decode(frame)
        except ProtocolError:
            return None
        return message.finger if isinstance(message, FingerPosition) else None

    def _recover(self, hands: Sequence[Firmware]) -> None:
        self.cut = self.bus_off = False
        self._silent.clear()
        for hand in hands:
            hand.failed = StatusBits(0)
            hand.motors.temperature[:] = np.minimum(hand.motors.temperature, 30.0)


class Sufferer(Protocol):
    """A hand with which something can go wrong."""

    def suffer(self, what: Ailment, joint: int, amount: float) -> None: ...


def _tip(hand: Firmware, joint: int) -> int:
    """The last joint of its finger."""
    spec = hand.backend.spec
    return spec.fingers[spec.finger_of(joint)].joints[-1]


def _suffer(hands: Sequence[Firmware], what: Ailment, joint: int, amount: float) -> None:
    for hand in hands:
        if not hasattr(hand.backend, "suffer"):
            raise ConfigError(f"faults: {what} needs a simulated hand behind the bus")
        cast(Sufferer, hand.backend).suffer(what, joint, amount)
