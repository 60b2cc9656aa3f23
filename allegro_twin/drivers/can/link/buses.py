"""Getting on a bus: which driver speaks to an adapter, and what to do when it does not open."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from typing import Any, TypeAlias

import can

from allegro_twin.drivers.can.link.adapter import AdapterLink, PortTaken, number
from allegro_twin.drivers.can.link.shared_bus import Link
from allegro_twin.errors import ConfigError, LinkError

Bus: TypeAlias = can.BusABC
"""Any bus that python-can knows."""
LOCAL = ("socketcan",)
"""Interfaces that hand over what other programs of this computer send, marked as sent, and not what we send."""
_FORBIDDEN = {errno.EACCES, errno.EPERM}
_open: dict[tuple[str, str], Link] = {}


def shared(interface: str, channel: str, bitrate: int, options: Mapping[str, Any]) -> Link:
    """The link on a bus: hands of one program on one bus share it, for most adapters open only once."""
    key = (interface, channel)
    if key not in _open:
        bus = open_bus(interface, channel, bitrate, options)
        closed = lambda: _open.__delitem__(key)  # noqa: E731  # A name for what stands in the call below.
        address = (
            {"kind": "socketcan", "channel": channel} if interface == "socketcan" else getattr(bus, "address", None)
        )
        _open[key] = AdapterLink(
            bus, bitrate, f"{interface} {channel}", closed, local=interface in LOCAL, address=address
        )
    return _open[key]


def open_bus(interface: str, channel: str, bitrate: int, options: Mapping[str, Any]) -> can.BusABC:
    """A python-can bus. Raises LinkError with the way out; never opens anything else in its place."""
    where = f"{interface} {channel}".strip()
    try:
        return _bus(interface, channel, bitrate, dict(options))
    except (can.CanInterfaceNotImplementedError, ImportError) as error:
        raise LinkError(
            f"{where}: the driver is missing ({error}); install python-can[{interface}] or the adapter's own driver"
        ) from error
    except NotImplementedError as error:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise ConfigError(f"python-can has no interface {interface!r}; there are: {known}") from error
    except PortTaken as error:
        raise LinkError(f"{where} does not open: {error}") from error
    except (can.CanError, OSError) as error:
        if number(error) in _FORBIDDEN:
            raise LinkError(f"{where}: no permission ({error}); on a serial port, join the group dialout") from error
        raise LinkError(f"{where} does not open: {error}; {_remedy(interface, channel, bitrate)}") from error
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where}: python-can does not take these settings: {error}") from error


def _bus(interface: str, channel: str, bitrate: int, options: dict[str, Any]) -> can.BusABC:
    match interface:
        case "slcan":
            from allegro_twin.drivers.can.link.slcan import SlcanBus

            return SlcanBus(channel, bitrate=bitrate, **options)
        case "socketcand":
            from allegro_twin.drivers.can.link.socketcand import SocketcandBus

            return SocketcandBus(channel, **options)
    return can.Bus(channel=channel or None, interface=interface, bitrate=bitrate, ignore_config=True, **options)


def _remedy(interface: str, channel: str, bitrate: int) -> str:
    """What to do about a bus that does not open."""
    match interface:
        case "socketcan":
            return f"plug the adapter in, then: ip link set {channel} up type can bitrate {bitrate}"
        case "slcan":
            return "is the adapter plugged in, or `allegro-twin firmware` running, and is this its port?"
        case "socketcand":
            return "is the daemon, or `allegro-twin firmware`, running there?"
    return "is the adapter plugged in, and its driver installed?"
