"""Checks of CAN interfaces and serial adapters: present, up, permitted."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

from allegro_twin.surfaces.cli.machine.finding import Diagnosis

_CAN = "280"  # ARPHRD_CAN, linux/if_arp.h.
_UP = 1  # IFF_UP, linux/if.h.
Open = Callable[[str], None]


def socketcan(name: str) -> None:
    """Open a CAN interface and close it. Raises OSError."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as opened:
        opened.bind((name,))


def interfaces(net: Path = Path("/sys/class/net"), open_: Open = socketcan) -> Iterator[Diagnosis]:
    """One finding for each CAN interface, or one that there is none."""
    found = [path for path in sorted(net.glob("*")) if _read(path / "type") == _CAN]
    if not found:
        yield Diagnosis(
            "CAN", "absent", "no CAN interface: hands in simulation, and virtual ones (can_virtual), need none",
            "plug in an adapter, `ip link set can0 up type can bitrate 1000000`; docs/how-to/connect_a_can_hand.md",
        )  # fmt: skip
    for path in found:
        yield _interface(path.name, _read(path / "flags"), open_)


def _interface(name: str, flags: str, open_: Open) -> Diagnosis:
    if not int(flags or "0", 16) & _UP:
        return Diagnosis(f"CAN {name}", "broken", "it is down", f"ip link set {name} up type can bitrate 1000000")
    try:
        open_(name)
    except OSError as error:
        return Diagnosis(f"CAN {name}", "broken", f"cannot be opened: {error.strerror}",
                       "run as root, or give the program CAP_NET_RAW")  # fmt: skip
    return Diagnosis(f"CAN {name}", "works", "up, and may be opened")


def may_open(path: Path) -> bool:
    """Whether this user may read and write a device."""
    return os.access(path, os.R_OK | os.W_OK)


def adapters(dev: Path = Path("/dev"), may: Callable[[Path], bool] = may_open) -> Iterator[Diagnosis]:
    """One finding for each serial adapter (slcan)."""
    for path in sorted([*dev.glob("ttyACM*"), *dev.glob("ttyUSB*")]):
        allowed = may(path)
        yield Diagnosis(
            f"serial {path.name}", "works" if allowed else "broken",
            "may be opened, for slcan" if allowed else "no permission to open it",
            "" if allowed else "usermod -aG dialout $USER, and log in again",
        )  # fmt: skip


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
