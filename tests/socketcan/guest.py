"""Run the tests of `inside` on a kernel that has SocketCAN: user-mode Linux.

`python -m tests.socketcan.guest [pytest's arguments]`. User-mode Linux is a kernel that runs as an ordinary program, as
any user, and sees this computer's files read-only; Debian's package is `user-mode-linux`. Set ALLEGRO_UML to a folder
where that package was unpacked to use it without installing it. `xstate.c` is for processors with AMX, and needs a C
compiler.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.socketcan.first import ROOT, path, status_of
from tests.socketcan.process_group import run_group


def kernel() -> tuple[Path, Path] | None:
    """The program that is user-mode Linux, and its modules; None where it is not installed."""
    root = Path(os.environ.get("ALLEGRO_UML", "/"))
    program = next(iter(sorted(root.glob("usr/bin/linux.uml"))), None)
    modules = next(iter(sorted(root.glob("usr/lib/uml/modules/*/kernel"))), None)
    return None if program is None or modules is None or shutil.which("ip", path=path()) is None else (program, modules)


def missing() -> str | None:
    """The packages that are missing."""
    if kernel() is None:
        return "user-mode-linux iproute2"
    return "gcc libc6-dev" if _has_tiles() and shutil.which("cc") is None else None


def _has_tiles() -> bool:
    """Whether this processor has AMX."""
    return " amx_tile " in Path("/proc/cpuinfo").read_text()


def _preloaded(folder: Path) -> dict[str, str]:
    """What user-mode Linux's environment needs on this processor."""
    if not _has_tiles():
        return {}
    library = folder / "xstate.so"
    source = Path(__file__).with_name("xstate.c")
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    return {"LD_PRELOAD": str(library)}


def run(arguments: list[str]) -> tuple[int, str]:
    """Boot, run pytest with these arguments on `inside`, power off: its exit status and what it printed."""
    found = kernel()
    assert found is not None
    program, modules = found
    with tempfile.TemporaryDirectory() as name:
        init = Path(name) / "init"
        words = [sys.executable, "-m", "tests.socketcan.first", str(modules), "tests/socketcan/inside", *arguments]
        init.write_text(f"#!/bin/sh\ncd {ROOT}\nexec {' '.join(words)}\n")
        init.chmod(0o755)
        Path(name).chmod(0o755)
        said = run_group(
            [str(program), "mem=768M", "rootfstype=hostfs", "root=/dev/root", "ro", f"init={init}", "con=null",
             "con0=fd:0,fd:1", "quiet", "panic=-1"],
            env={**os.environ, "TMPDIR": name, "HOME": "/mnt", **_preloaded(Path(name))},
        )  # fmt: skip
    return status_of(said), said


def main() -> int:
    if packages := missing():
        print(f"SocketCAN was not tried: apt-get install {packages}")
        return int("CI" in os.environ)  # CI installs them.
    status, said = run(sys.argv[1:])
    print(said)
    return status


if __name__ == "__main__":
    sys.exit(main())
