"""Run the tests of `timed` on a computer that QEMU emulates: two CAN cards, and a clock that counts instructions.

`python -m tests.socketcan.emulated [pytest's arguments]`. One instruction takes one nanosecond there, whatever else
this computer does, so that periods can be counted on a busy one. Debian's packages are `qemu-system-x86`,
`linux-image-amd64` and `busybox-static`; set ALLEGRO_LINUX to a folder where the last two were unpacked to use them
without installing them.
"""

from __future__ import annotations

import lzma
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from tests.socketcan.first import ROOT, path, status_of
from tests.socketcan.process_group import run_group

_NEEDED = {
    "virtio_pci": "", "9pnet_virtio": "", "9p": "", "can-raw": "", "kvaser_pci": "", "vcan": "echo=1", "vxcan": "",
    "sch_netem": "",
}  # fmt: skip
"""Modules and their options. With `echo` vcan's frames pass its queue before anybody hears them, as on a real bus."""
_INIT = """#!/bin/busybox sh
busybox=/bin/busybox
$busybox mkdir -p /host
{load}
$busybox mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=262144 host /host
exec $busybox chroot /host /bin/sh {script}
"""
_LONGEST = 3600.0
"""s after which it hangs; a test takes minutes."""


class Kernel(NamedTuple):
    """Where a kernel is."""

    image: Path
    modules: Path
    busybox: Path


def kernel() -> Kernel | str:
    """The newest kernel that has drivers for CAN, or what is missing."""
    root = Path(os.environ.get("ALLEGRO_LINUX", "/"))
    for program, package in (("qemu-system-x86_64", "qemu-system-x86"), ("ip", "iproute2")):
        if shutil.which(program, path=path()) is None:
            return f"apt-get install {package}"
    busybox = next(filter(_stands_alone, (root / "bin/busybox", Path("/bin/busybox"))), None)
    for modules in sorted(root.glob("lib/modules/*/kernel"), reverse=True):
        image = root / "boot" / f"vmlinuz-{modules.parent.name}"
        if image.exists() and any(modules.glob("drivers/net/can/**/kvaser_pci.ko*")):
            return "apt-get install busybox-static" if busybox is None else Kernel(image, modules, busybox)
    return "apt-get install linux-image-amd64"


def _stands_alone(program: Path) -> bool:
    """Whether a program needs no libraries."""
    return program.exists() and b"/ld-linux" not in program.read_bytes()


def run(arguments: list[str]) -> tuple[int, str]:
    """Boot, run pytest with these arguments, power off: its exit status and what it printed."""
    found = kernel()
    assert isinstance(found, Kernel)
    with tempfile.TemporaryDirectory() as name:
        script, initrd = Path(name) / "script", Path(name) / "initrd"
        words = [sys.executable, "-m", "tests.socketcan.first", "-", *arguments]
        script.write_text(f"export PATH={os.environ['PATH']} PYTHONPATH={ROOT}\ncd {ROOT}\nexec {' '.join(words)}\n")
        initrd.write_bytes(_archive(found, str(script)))
        said = run_group(_command(found, initrd), timeout=_LONGEST)
    return status_of(said), said


def _command(kernel: Kernel, initrd: Path) -> list[str]:
    return [
        "qemu-system-x86_64", "-cpu", "max", "-m", "1024", "-smp", "1", "-accel", "tcg,thread=single",
        "-icount", "shift=0,sleep=on", "-nographic", "-no-reboot", "-nic", "none",
        "-kernel", str(kernel.image), "-initrd", str(initrd),
        "-append", "console=ttyS0 quiet panic=-1 mitigations=off tsc=reliable",
        "-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap",
        "-object", "can-bus,id=cable",
        "-device", "kvaser_pci,canbus=cable", "-device", "kvaser_pci,canbus=cable",
    ]  # fmt: skip


def _archive(kernel: Kernel, script: str) -> bytes:
    """The first file system, as the kernel wants it (its documentation, initramfs-buffer-format)."""
    modules = _modules(kernel.modules)
    load = "\n".join(f"$busybox insmod /modules/{name}.ko {_NEEDED.get(name, '')}" for name in modules)
    files = {"bin/busybox": kernel.busybox.read_bytes(), "init": _INIT.format(load=load, script=script).encode()}
    files |= {f"modules/{name}.ko": content for name, content in modules.items()}
    entries = [_entry(folder, b"", 0o040755) for folder in ("bin", "modules", "dev")]
    entries += [_entry(name, content, 0o100755) for name, content in files.items()]
    entries += [_entry("dev/console", b"", 0o020600, device=(5, 1)), _entry("TRAILER!!!", b"", 0)]
    return b"".join(entries)


def _entry(name: str, content: bytes, mode: int, device: tuple[int, int] = (0, 0)) -> bytes:
    numbers = (0, mode, 0, 0, 1, 0, len(content), 0, 0, *device, len(name) + 1, 0)
    head = b"070701" + b"".join(b"%08X" % number for number in numbers) + name.encode() + b"\0"
    return b"".join(part + b"\0" * (-len(part) % 4) for part in (head, content))


def _modules(folder: Path) -> dict[str, bytes]:
    """What is needed, each after what it needs itself."""
    files = {path.name.split(".ko")[0]: path for path in folder.rglob("*.ko*")}
    found: dict[str, bytes] = {}

    def take(name: str) -> None:
        name = name if name in files else name.replace("_", "-")
        if name in found or name not in files:  # What is not there is part of the kernel itself.
            return
        content = files[name].read_bytes()
        if files[name].suffix == ".xz":
            content = lzma.decompress(content)
        depends = re.search(rb"\0depends=([^\0]*)\0", content)
        for other in depends[1].decode().split(",") if depends else ():
            take(other)
        found[name] = content

    for name in _NEEDED:
        take(name)
    return found


def main() -> int:
    found = kernel()
    if isinstance(found, str):
        print(f"SocketCAN's timing was not tried: {found}")
        return 0
    status, said = run(["tests/socketcan/timed", "-rP", *sys.argv[1:]])
    print(said)
    return status


if __name__ == "__main__":
    sys.exit(main())
