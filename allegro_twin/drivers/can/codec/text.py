"""Messages in words, for people who look at a bus."""

from __future__ import annotations

from typing import NamedTuple

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import FINGERS
from allegro_twin.drivers.can.codec.messages import Message, StatusBits


class Description(NamedTuple):
    """A message: what it is, and what it says."""

    name: str
    text: str


def describe(message: Message) -> Description:
    """In radians, N·m, °C, seconds and Pa."""
    match message:
        case m.FingerPosition(finger, position):
            return Description(f"position {FINGERS[finger]}", _row(position, "+.4f", "rad"))
        case m.SetTorque(finger, torque):
            return Description(f"torque {FINGERS[finger]}", _row(torque, "+.4f", "N·m"))
        case m.SetPosition(finger, position):
            return Description(f"set-point {FINGERS[finger]}", _row(position, "+.4f", "rad"))
        case m.FingerTemperature(finger, temperature):
            return Description(f"temperature {FINGERS[finger]}", _row(temperature, ".0f", "°C"))
        case m.FingertipPressure((first, second), pressure):
            return Description(f"pressure {FINGERS[first]} {FINGERS[second]}", _row(pressure, ".0f", "Pa"))
        case m.Imu(orientation):
            return Description("imu", _row(orientation, "+.3f", "(w x y z)"))
        case m.Request(topic, finger):
            return Description(f"ask {topic.value}{'' if finger is None else f' {FINGERS[finger]}'}", "")
        case m.SetPeriod():
            parts = [f"{key} {s:g} s" for key, s in message._asdict().items() if s is not None]
            return Description("set period", ", ".join(parts))
        case m.Status(bits):
            return Description("status", status(bits))
        case m.Information():
            return Description("information", _information(message))
        case m.Serial(text):
            return Description("serial", text)
        case m.ServoOn() | m.ServoOff():
            return Description("servo on" if isinstance(message, m.ServoOn) else "servo off", "")
        case _:
            parts = [f"{key} {value}" for key, value in message._asdict().items()]
            return Description(type(message).__name__, ", ".join(parts))


def status(bits: StatusBits | None) -> str:
    """Status bits by their names."""
    if bits is None:
        return ""
    return " ".join(str(bit.name) for bit in StatusBits if bits & bit) or "motors off"


def _information(message: m.Information) -> str:
    parts = (
        f"hardware {message.hardware:#06x}, firmware {message.firmware:#06x}",
        message.side or "",
        "" if message.temperature != message.temperature else f"{message.temperature:.0f} °C",
        status(message.bits),
    )
    return ", ".join(filter(None, parts))


def _row(values: tuple[float, ...], layout: str, unit: str) -> str:
    return f"{' '.join(format(value, layout) for value in values)} {unit}"
