"""One servo: its table, its watchdog, its shutdown. What its shaft does is told to it; what it wants is asked of it."""

from __future__ import annotations

import struct
from typing import NamedTuple

from allegro_twin.drivers.dynamixel.codec.packet import ALERT, PacketError
from allegro_twin.drivers.dynamixel.codec.table import (
    BAUDS,
    CURRENT_POSITION,
    EEPROM_END,
    EXTENDED,
    POSITION,
    TRIPPED,
    TURN,
    WATCHDOG_UNIT,
    Field,
    Model,
)
from allegro_twin.drivers.dynamixel.virtual.memory import Memory, Refused

_PRESENT = struct.Struct("<hii")
"""Current, velocity, position, from address 126 on."""
_GOALS = struct.Struct("<hh12xi")
"""Goal PWM, Goal Current and Goal Position, from address 100 on."""
_CURRENT_LIMIT = struct.Struct("<H")
_RAM = range(EEPROM_END, 1 << 16)
_GAINS = (
    "velocity_i_gain", "velocity_p_gain", "position_d_gain", "position_i_gain", "position_p_gain",
    "feedforward_2nd_gain", "feedforward_1st_gain", "profile_acceleration", "profile_velocity",
)  # fmt: skip
_FAR_REACHING = {"operating_mode", "id", "baud_rate", "homing_offset", "drive_mode"}
"""Items that change more than themselves."""
_OVERHEATED = 1 << 2
_MULTI_TURN = bytes((0x01, 0x44, 0x58, 0x4C, 0x22))
"""What a Clear must say. e-Manual, protocol2."""


class Wants(NamedTuple):
    """Targets of a servo's firmware for its shaft."""

    goal: int
    """Tick of the shaft."""
    current: int
    """The most it draws for it, counts; 0: nothing, it is limp."""


class Servo:
    """A servo that does not exist. It speaks in its own ticks and counts; its shaft has a direction and an offset."""

    def __init__(self, model: Model, identifier: int, baud: int) -> None:
        self.model, self.memory = model, Memory(model)
        self.memory.put("id", identifier)
        self.memory.put("baud_rate", BAUDS.index(baud))
        self.id, self.baud = identifier, baud
        """As its table has them."""
        self.registered: tuple[int, bytes] | None = None
        """A write that waits for an Action."""
        self.dead = False
        """Whether its motor turns no more, for whatever it is told."""
        self.mute = False
        """Whether it is off the bus: no power, or its plug is out."""
        self._silent = self._time = 0.0
        self._shaft = self._turns = 0
        self._sign, self._offset = 1, 0
        """Map from its ticks to the shaft's: Drive Mode, Homing Offset and turns that were forgotten."""

    @property
    def return_delay(self) -> int:
        return self.memory.bytes[9]

    @property
    def return_level(self) -> int:
        return self.memory.bytes[68]

    @property
    def on(self) -> bool:
        """Whether its torque is enabled."""
        return bool(self.memory.bytes[64])

    @property
    def alert(self) -> int:
        """What every status packet of it adds to its error."""
        return ALERT if self.memory.bytes[70] else 0

    @property
    def shaft(self) -> int:
        """Where it is, tick."""
        return self._shaft

    @property
    def wants(self) -> Wants:
        table = self.memory.bytes
        mode = table[11]
        pwm, allowed, goal = _GOALS.unpack_from(table, 100)
        if not table[64] or self.dead or not pwm or mode not in (POSITION, EXTENDED, CURRENT_POSITION):
            return Wants(self._shaft, 0)  # Of the modes only those with a goal position are modelled.
        (current,) = _CURRENT_LIMIT.unpack_from(table, 38)
        if mode == CURRENT_POSITION:
            current = min(current, abs(allowed))
        return Wants(self._sign * (goal - self._offset), current)

    def sense(self, position: int, velocity: int, current: int) -> None:
        """Where its shaft is now, in ticks and counts of the shaft."""
        self._shaft = position
        sign = self._sign
        present = sign * position + self._offset
        _PRESENT.pack_into(self.memory.bytes, 126, sign * current, sign * velocity, present)

    def heat(self, celsius: float) -> None:
        """How warm it is, °C. Above its limit it shuts down where Shutdown says so."""
        memory = self.memory
        memory.put("present_temperature", min(max(round(celsius), 0), 255))
        if memory.get("present_temperature") > memory.get("temperature_limit"):
            self.fail(_OVERHEATED)

    def fail(self, bits: int) -> None:
        """A hardware error."""
        memory = self.memory
        memory.bytes[70] |= bits
        if bits & memory.bytes[63]:
            memory.bytes[64] = 0

    def heard(self) -> None:
        """An instruction came that was for it, or for all."""
        self._silent = 0.0

    def elapse(self, seconds: float) -> None:
        """Time passes. The watchdog runs while torque is on."""
        self._time += seconds
        self._silent += seconds
        watchdog = self.memory.bytes[98]
        if 0 < watchdog < 128 and self.on and self._silent > watchdog * WATCHDOG_UNIT:
            self.trip()

    def trip(self) -> None:
        """The watchdog strikes: it stays where it is, with torque on (the manual's "stop"; DynamixelSDK issue 584)."""
        self.memory.put("bus_watchdog", TRIPPED)
        self._stay()

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """The error number and the bytes."""
        if address < 122 <= address + length + 1:
            self.memory.put("realtime_tick", int(1000.0 * self._time) % 32768)
        try:
            return 0, self.memory.read(address, length)
        except Refused as refused:
            return refused.why, b""

    def write(self, address: int, data: bytes) -> int:
        """The error number."""
        try:
            items = self.memory.writes(address, data)
            for item, value in items:
                self._apply(item, value)
        except Refused as refused:
            return refused.why
        return 0

    def register(self, address: int, data: bytes) -> int:
        """Keep a write for an Action. The error number."""
        try:
            self.memory.writes(address, data)
        except Refused as refused:
            return refused.why
        self.registered = address, data
        self.memory.bytes[69] = 1
        return 0

    def act(self) -> int:
        """Do what was registered. The error number."""
        if self.registered is None:
            return PacketError.INSTRUCTION
        (address, data), self.registered = self.registered, None
        self.memory.bytes[69] = 0
        return self.write(address, data)

    def reboot(self) -> None:
        """As after power-up: RAM is new, turns are forgotten, hardware errors are gone."""
        temperature = self.memory.get("present_temperature")
        self.memory.restore(_RAM)
        self.memory.put("goal_current", self.memory.get("current_limit"))
        self.memory.put("goal_pwm", self.memory.get("pwm_limit"))
        self.memory.put("present_temperature", temperature)
        self.registered = None
        self._place()
        self._turns = -((self._sign * self._shaft) // TURN) * TURN
        self._place()
        self._stay()

    def factory_reset(self, option: int) -> int:
        """0xFF: all; 0x01: all but the id; 0x02: all but id and baud rate. The error number."""
        if option not in (0xFF, 0x01, 0x02):
            return PacketError.RANGE
        identifier, baud = self.memory.bytes[7], self.memory.bytes[8]
        self.memory.restore(range(EEPROM_END))
        if option != 0xFF:
            self.memory.bytes[7] = identifier
        if option == 0x02:
            self.memory.bytes[8] = baud
        self._introduce()
        self.reboot()
        return 0

    def clear(self, parameters: bytes) -> int:
        """Forget whole turns, standing still. The error number."""
        if parameters != _MULTI_TURN:
            return PacketError.RANGE
        if self.memory.get("present_velocity"):
            return PacketError.RESULT
        self._turns -= self.memory.get("present_position") // TURN * TURN
        self._place()
        return 0

    def become(self, identifier: int) -> None:
        """It has another id from now on."""
        self.memory.put("id", identifier)
        self._introduce()

    def _introduce(self) -> None:
        self.id, self.baud = self.memory.bytes[7], BAUDS[self.memory.bytes[8]]

    def _place(self) -> None:
        """What lies between its ticks and its shaft has changed."""
        self._sign = -1 if self.memory.bytes[10] & 1 else 1
        self._offset = self._turns + self.memory.get("homing_offset")
        self.sense(self._shaft, 0, 0)

    def _stay(self) -> None:
        self.memory.put("goal_position", self.memory.get("present_position"))

    def _apply(self, item: Field, value: int) -> None:
        memory = self.memory
        if item.name == "torque_enable" and value and not self.on:
            self._silent = 0.0
            self._stay()
        raw = value.to_bytes(item.size, "little", signed=item.signed)
        memory.bytes[item.address : item.address + item.size] = raw
        if item.name not in _FAR_REACHING:
            return
        if item.name == "operating_mode":
            for name in _GAINS:
                memory.put(name, self.model.named[name].default)
            memory.put("goal_pwm", memory.get("pwm_limit"))
            memory.put("goal_current", memory.get("current_limit"))
        elif item.name in ("id", "baud_rate"):
            self._introduce()
        elif item.name in ("homing_offset", "drive_mode"):
            self._place()
