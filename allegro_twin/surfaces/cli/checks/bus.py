"""CAN: interfaces of the kernel, whether a program may open them, and serial adapters."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

from allegro_twin.surfaces.cli.checks.finding import Finding

_CAN = "280"  # ARPHRD_CAN, linux/if_arp.h.
_UP = 1  # IFF_UP, linux/if.h.
Open = Callable[[str], None]


def socketcan(name: str) -> None:
    """Open an interface as a driver does, and let it go. Raises OSError."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as opened:
        opened.bind((name,))


def interfaces(net: Path = Path("/sys/class/net"), open_: Open = socketcan) -> Iterator[Finding]:
    """Every CAN interface; a finding that there is none."""
    found = [path for path in sorted(net.glob("*")) if _read(path / "type") == _CAN]
    if not found:
        yield Finding(
            "CAN", "absent", "no CAN interface: hands in simulation, and virtual ones (can_virtual), need none",
            "plug an adapter in, then `ip link set can0 up type can bitrate 1000000`; docs/protocol.md",
        )  # fmt: skip
    for path in found:
        yield _interface(path.name, _read(path / "flags"), open_)


def _interface(name: str, flags: str, open_: Open) -> Finding:
    if not int(flags or "0", 16) & _UP:
        return Finding(f"CAN {name}", "broken", "it is down", f"ip link set {name} up type can bitrate 1000000")
    try:
        open_(name)
    except OSError as error:
        return Finding(f"CAN {name}", "broken", f"cannot be opened: {error.strerror}",
                       "run as root, or give the program CAP_NET_RAW")  # fmt: skip
    return Finding(f"CAN {name}", "works", "up, and may be opened")


def may_open(path: Path) -> bool:
    """Whether this user may read and write there."""
    return os.access(path, os.R_OK | os.W_OK)


def adapters(dev: Path = Path("/dev"), may: Callable[[Path], bool] = may_open) -> Iterator[Finding]:
    """Serial adapters (slcan), where there are any."""
    for path in sorted([*dev.glob("ttyACM*"), *dev.glob("ttyUSB*")]):
        allowed = may(path)
        yield Finding(
            f"serial {path.name}", "works" if allowed else "broken",
            "may be opened, for slcan" if allowed else "no permission to open it",
            "" if allowed else "usermod -aG dialout $USER, and log in again",
        )  # fmt: skip


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
