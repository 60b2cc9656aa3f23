"""A hand in one process, its driver in another: what a newcomer can paste works, and works in real time."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from allegro_twin.recording.reader import load
from tests.patience import wait_for

ROOT = Path(__file__).resolve().parents[3]
if sys.platform == "win32":
    pytest.skip("Windows has no pseudo-terminals", allow_module_level=True)

pytestmark = pytest.mark.realtime


def write_config(folder: Path, link: str, *, seconds: float | None) -> Path:
    """The same hand on a serial line or a network, with a scene behind it."""
    path = folder / "hand.yaml"
    path.write_text(
        f"""
hand: {{model: allegro, side: right}}
backend:
  kind: can
  version: v4
  {link}
  imu: 0.1
  timeout: 2.0
  deadman: 2.0
task: {{scenario: rubiks_cube}}
controller: {{kind: pd}}
limits: {{velocity: 12.0}}
{"" if seconds is None else f"seconds: {seconds}"}
"""
    )
    return path


@contextmanager
def program(*arguments: str | Path) -> Iterator[subprocess.Popen[str]]:
    """`allegro-twin …`, ended by Ctrl-C if it does not end itself."""
    command = [sys.executable, "-m", "allegro_twin", *map(str, arguments)]
    started = subprocess.Popen(
        command,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "COLUMNS": "200"},
    )
    try:
        yield started
    finally:
        if started.poll() is None:
            started.send_signal(signal.SIGINT)
        try:
            started.wait(20.0)
        except subprocess.TimeoutExpired:
            started.kill()
            started.wait()


def listening(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@pytest.mark.parametrize("kind", ["slcan", "socketcand"])
def test_a_hand_in_one_process_is_driven_from_another(kind: str, tmp_path: Path) -> None:
    port, tty, recording = free_port(), tmp_path / "hand.tty", tmp_path / "run.arrow"
    there = f"{{host: 127.0.0.1, port: {port}}}"
    links = {
        "slcan": f"interface: slcan\n  channel: {tty}\n  options: {{sleep_after_open: 0.0}}",
        "socketcand": f"interface: socketcand\n  channel: can0\n  options: {there}",
    }
    config = write_config(tmp_path, links[kind], seconds=3.0)
    with program("firmware", config) as hand:
        wait_for(lambda: (tty.exists() if kind == "slcan" else listening(port)) or hand.poll() is not None)
        assert hand.poll() is None
        with program("run", config, "--record", recording) as driver:
            said, _ = driver.communicate()
        assert driver.returncode == 0, said
        hand.send_signal(signal.SIGINT)
        heard, _ = hand.communicate()
    assert "right v4 hand on" in heard
    steps = re.search(r"(\d+) steps, \d+ late, \d+ left out; (\d+) frames heard, (\d+) said", heard)
    assert steps is not None, heard
    ticks = load(recording).columns["tick"].astype(int).tolist()
    assert ticks[-1] >= 990
    assert ticks == sorted(set(ticks))
    assert len(ticks) > 300
    assert int(steps[2]) >= 4 * (len(ticks) - 20)
    assert int(steps[3]) >= 4 * ticks[-1] - 400


@pytest.mark.long
def test_for_a_minute_no_state_is_torn_and_the_grasp_holds() -> None:
    """How many periods are used depends on what else the machine does: benchmarks/two_processes.py has the figures."""
    from benchmarks.two_processes import measure, torn

    found = measure(60.0, realtime=False)
    assert found.used >= 0.5
    assert found.held
    states, mixed = torn(20.0)
    assert states > 3000
    assert mixed == 0
