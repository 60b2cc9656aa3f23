"""What a guest does as its first and only process: `python -m tests.socketcan.first MODULES ARGUMENTS…`.

`MODULES`: the folder of the kernel's modules, `-` where they are loaded; `ARGUMENTS`: pytest's.
"""

from __future__ import annotations

import ctypes
import os
import socket
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_MODULES = ("net/can/can", "drivers/net/can/dev/can-dev", "net/can/can-raw", "drivers/net/can/vcan",
            "drivers/net/can/vxcan", "drivers/net/can/slcan/slcan", "net/sched/sch_netem")  # fmt: skip
_MADE = ("link add vcan0 type vcan", "link add vxcan0 type vxcan peer name vxcan1")
_CARD = "type can bitrate 1000000"
_PLACE = "/mnt"
"""Every computer has it: where the guest keeps what it writes, in memory."""
_MOUNTS = {"/proc": "proc", "/sys": "sysfs", _PLACE: "tmpfs", "/dev": "devtmpfs", "/dev/pts": "devpts"}
_FINIT_MODULE, _POWER_OFF = 313, 0x4321FEDC  # x86-64's number; linux/reboot.h


def status_of(said: str) -> int:
    """Pytest's exit status, from what the guest printed; 1 where it did not come so far."""
    found = [line.strip().removeprefix("rc ") for line in said.splitlines() if line.startswith("rc ")]
    return int(found[-1]) if found else 1


def path() -> str:
    """Where programs are, `ip` and `tc` too."""
    return f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/bin:/sbin:/bin"


def main() -> None:
    system = ctypes.CDLL(None, use_errno=True)
    for where, kind in _MOUNTS.items():
        if where.startswith("/dev/"):
            Path(where).mkdir(exist_ok=True)
        system.mount(kind.encode(), where.encode(), kind.encode(), 0, None)
    os.environ |= {"PATH": path(), "TMPDIR": _PLACE, "HOME": _PLACE, "PYTHONDONTWRITEBYTECODE": "1"}
    folder, *arguments = sys.argv[1:]
    for module in _MODULES if folder != "-" else ():
        descriptor = os.open(Path(folder) / f"{module}.ko", os.O_RDONLY)
        if system.syscall(_FINIT_MODULE, descriptor, b"", 0):
            print(f"{module}: {os.strerror(ctypes.get_errno())}")
    _interfaces()
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:hypothesispytest"]
    done = subprocess.run([*command, *arguments], stderr=subprocess.STDOUT)
    print(f"rc {done.returncode}", flush=True)
    system.reboot(_POWER_OFF)


def _interfaces() -> None:
    """Make those without hardware, and bring all up."""
    cards = [name for _, name in socket.if_nameindex() if name.startswith("can")]
    for words in _MADE:
        subprocess.run(["ip", *words.split()], check=True)
    for name in ("lo", "vcan0", "vxcan0", "vxcan1", *cards):
        more = _CARD.split() if name in cards else []
        subprocess.run(["ip", "link", "set", name, "up", *more], check=True)


if __name__ == "__main__":
    main()
