"""Checks of this computer: rendering without a screen, GPUs, real-time scheduling, cores, cameras, ports."""

from __future__ import annotations

import ctypes
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli.machine.bus import may_open
from allegro_twin.surfaces.cli.machine.finding import Diagnosis
from allegro_twin.surfaces.cli.machine.packages import Imports, import_errors
from allegro_twin.sweep.processors import core_count

_RENDER = """
import mujoco
renderer = mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8)
from OpenGL import GL
print((GL.glGetString(GL.GL_RENDERER) or b"").decode())
renderer.close()
"""
_SECONDS = 60.0
PORTS = {"Rerun's page, --web": 9090, "Rerun's data": 9876, "the panel": 8080}
"""TCP ports on loopback: Rerun's defaults (`viewing.rerun.server`) and `panel --port`. The port of the panel's viser is
random."""
Schedule = Callable[[], None]


def render(backend: str) -> str:
    """Render a picture in a separate process, which a broken driver may end. Returns the renderer. Raises OSError."""
    done = subprocess.run(
        [sys.executable, "-c", _RENDER], env=os.environ | {"MUJOCO_GL": backend}, capture_output=True, text=True,
        timeout=_SECONDS,
    )  # fmt: skip
    if done.returncode != 0:
        raise OSError((done.stderr.strip().splitlines() or [f"it ended with {done.returncode}"])[-1])
    return done.stdout.strip()


def pictures(draw: Callable[[str], str] = render, imports: Imports = import_errors) -> Iterator[Diagnosis]:
    """Rendering, with the MUJOCO_GL that commands have."""
    given = os.environ.get("MUJOCO_GL", "").strip()
    if why := imports(["mujoco"]).get("mujoco"):
        yield Diagnosis("pictures", "broken", f"mujoco cannot be imported: {why}", "mend the packages first")
        return
    if given and given.lower() != "egl":
        try:
            yield Diagnosis("pictures", "works", f"with MUJOCO_GL={given}, by {_drawn(given, draw)}")
        except (ConfigError, OSError, subprocess.TimeoutExpired) as error:
            yield Diagnosis("pictures", "broken", str(error), "unset MUJOCO_GL")
        return
    try:
        who = draw("egl")
    except (OSError, subprocess.TimeoutExpired) as error:
        yield Diagnosis(
            "EGL",
            "broken",
            f"no picture without a screen: {error}",
            "apt-get install libegl1 libopengl0 libgl1-mesa-dri",
        )
        return
    software = " (software: right, and slow)" if "llvmpipe" in who or "softpipe" in who else ""
    yield Diagnosis("EGL", "works", f"pictures without a screen, by {who}{software}")


def _drawn(given: str, draw: Callable[[str], str]) -> str:
    """The renderer with a value of MUJOCO_GL that somebody has set. Raises ConfigError or OSError."""
    from allegro_twin.sim.renderer import OFF  # The package does not load with a value that MuJoCo refuses.

    if given.lower() in OFF:
        raise ConfigError(f"MUJOCO_GL={given} switches pictures off")
    try:
        return draw(given)
    except OSError as error:
        raise OSError(f"no picture with MUJOCO_GL={given}: {error}") from error


def libraries(load: Callable[[str], object] = ctypes.CDLL) -> Iterator[Diagnosis]:
    """System libraries that wheels do not contain: GCC's OpenMP, for Pinocchio."""
    try:
        load("libgomp.so.1")
    except OSError as error:
        yield Diagnosis(
            "libgomp", "broken", f"Pinocchio cannot be loaded without it: {error}", "apt-get install libgomp1"
        )
    else:
        yield Diagnosis("libgomp", "works", "Pinocchio's")


def cards(dev: Path = Path("/dev")) -> Iterator[Diagnosis]:
    """NVIDIA GPUs."""
    found = sorted(path.name for path in dev.glob("nvidia[0-9]*"))
    if found:
        yield Diagnosis("GPU", "works", f"{', '.join(found)}: for `--device warp` and training")
    else:
        yield Diagnosis("GPU", "absent", "no NVIDIA card: everything runs on the processor, `--device warp` slowly")


def request_real_time() -> None:
    """Request real-time scheduling, and release it. Raises OSError."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    os.sched_setscheduler(0, *before)


def scheduling(ask: Schedule = request_real_time) -> Iterator[Diagnosis]:
    """Number of cores, and whether `realtime: true` is permitted."""
    cores = core_count()
    yield Diagnosis("processor", "works" if cores > 1 else "absent", f"{cores} core{'s' if cores > 1 else ''} to use",
                  "" if cores > 1 else "a hand on a bus wants a second core for its keeper")  # fmt: skip
    try:
        ask()
    except (AttributeError, OSError) as error:
        yield Diagnosis("real time", "absent", f"the kernel does not let this user go first: {error}",
                      "`ulimit -r 20`, from /etc/security/limits.conf: `@realtime - rtprio 20`")  # fmt: skip
    else:
        yield Diagnosis("real time", "works", "allowed: set `realtime: true` for a hand on a bus")


def cameras(dev: Path = Path("/dev"), may: Callable[[Path], bool] = may_open) -> Iterator[Diagnosis]:
    """Webcams, for `teleop --from webcam`."""
    for path in sorted(dev.glob("video[0-9]*")):
        allowed = may(path)
        yield Diagnosis(
            f"camera {path.name}", "works" if allowed else "broken",
            "may be opened" if allowed else "no permission to open it",
            "" if allowed else "usermod -aG video $USER, and log in again",
        )  # fmt: skip


def ports(wanted: dict[str, int] | None = None) -> Iterator[Diagnosis]:
    """Free TCP ports."""
    for what, port in (PORTS if wanted is None else wanted).items():
        try:
            with socket.create_server(("127.0.0.1", port)):
                pass
        except OSError as error:
            yield Diagnosis(f"port {port}", "broken", f"{what}: {error.strerror}",
                          f"end who has it: `ss -ltnp | grep {port}`, or choose another with --port")  # fmt: skip
        else:
            yield Diagnosis(f"port {port}", "works", f"{what}: free")
