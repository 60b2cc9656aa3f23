"""Run the tests of `inside` on a kernel that has SocketCAN: this one where it has, else user-mode Linux.

`python -m tests.socketcan.guest [pytest's arguments]`. User-mode Linux is a kernel that runs as an ordinary program, as
any user, and sees this computer's files read-only; Debian's package is `user-mode-linux`. Set ALLEGRO_UML to a folder
where that package was unpacked to use it without installing it.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MODULES = ("net/can/can", "drivers/net/can/dev/can-dev", "net/can/can-raw", "drivers/net/can/vcan",
           "drivers/net/can/vxcan", "net/sched/sch_netem")  # fmt: skip
INTERFACES = (
    "link add vcan0 type vcan",
    "link add vxcan0 type vxcan peer name vxcan1",
    *(f"link set {name} up" for name in ("lo", "vcan0", "vxcan0", "vxcan1")),
)
_FINIT_MODULE, _POWER_OFF = 313, 0x4321FEDC  # x86-64's number; linux/reboot.h
_PLACE = "/mnt"
"""Every computer has it: where the guest keeps what it writes, in memory."""


def kernel() -> tuple[Path, Path] | None:
    """The program that is user-mode Linux, and its modules; None where it is not installed."""
    root = Path(os.environ.get("ALLEGRO_UML", "/"))
    program = next(iter(sorted(root.glob("usr/bin/linux.uml"))), None)
    modules = next(iter(sorted(root.glob("usr/lib/uml/modules/*/kernel"))), None)
    return (
        None if program is None or modules is None or shutil.which("ip", path=_paths()) is None else (program, modules)
    )


def run(arguments: list[str]) -> tuple[int, str]:
    """Boot, run pytest with these arguments on `inside`, power off: its exit status and what it printed."""
    found = kernel()
    assert found is not None
    program, modules = found
    with tempfile.TemporaryDirectory() as name:
        init = Path(name) / "init"
        words = [sys.executable, "-m", "tests.socketcan.guest", "--init", str(modules), *arguments]
        init.write_text(f"#!/bin/sh\ncd {ROOT}\nexec {' '.join(words)}\n")
        init.chmod(0o755)
        Path(name).chmod(0o755)
        done = subprocess.run(
            [str(program), "mem=768M", "rootfstype=hostfs", "root=/dev/root", "ro", f"init={init}", "con=null",
             "con0=fd:0,fd:1", "quiet", "panic=-1"],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
            env={**os.environ, "TMPDIR": name, "HOME": _PLACE},
        )  # fmt: skip
    lines = done.stdout.splitlines()
    status = next((line.removeprefix("rc ") for line in reversed(lines) if line.startswith("rc ")), None)
    return (1, done.stdout) if status is None else (int(status), done.stdout)


def inside(modules: Path, arguments: list[str]) -> None:
    """What the guest does as its first and only process."""
    system = ctypes.CDLL(None, use_errno=True)
    for kind, where in (("proc", "/proc"), ("sysfs", "/sys"), ("tmpfs", _PLACE)):
        system.mount(kind.encode(), where.encode(), kind.encode(), 0, None)
    os.environ |= {"PATH": _paths(), "TMPDIR": _PLACE, "HOME": _PLACE, "PYTHONDONTWRITEBYTECODE": "1"}
    for module in MODULES:
        descriptor = os.open(modules / f"{module}.ko", os.O_RDONLY)
        if system.syscall(_FINIT_MODULE, descriptor, b"", 0):
            print(f"{module}: {os.strerror(ctypes.get_errno())}")
    for words in INTERFACES:
        subprocess.run(["ip", *words.split()], check=True)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:hypothesispytest"]
    done = subprocess.run([*command, "tests/socketcan/inside", *arguments], stderr=subprocess.STDOUT)
    print(f"rc {done.returncode}", flush=True)
    system.reboot(_POWER_OFF)


def _paths() -> str:
    return f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/bin:/sbin:/bin"


def main() -> int:
    if sys.argv[1:2] == ["--init"]:
        inside(Path(sys.argv[2]), sys.argv[3:])
        return 0
    if kernel() is None:
        print("SocketCAN was not tried: apt-get install user-mode-linux iproute2")
        return 0
    status, said = run(sys.argv[1:])
    print(said)
    return status


if __name__ == "__main__":
    sys.exit(main())
