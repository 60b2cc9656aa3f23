"""A computer that drives a hand is kept awake where its system allows it, and a sleep is noticed where it does not."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from allegro_twin.drivers.base import suspend
from allegro_twin.drivers.base.suspend import JUMP, Inhibitor, SuspendWatch, asleep
from tests.patience import wait_for


def clocks(monkeypatch: pytest.MonkeyPatch, **seconds: float) -> None:
    monkeypatch.setattr(time, "clock_gettime", lambda clock: seconds[{time.CLOCK_BOOTTIME: "boot"}.get(clock, "mono")])


def test_a_sleep_is_what_one_clock_counts_and_the_other_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    clocks(monkeypatch, boot=107.5, mono=100.0)
    assert asleep() == 7.5


def test_where_no_clock_counts_a_sleep_there_was_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(clock: int) -> float:
        raise OSError("no such clock")

    monkeypatch.setattr(time, "clock_gettime", fails)
    assert asleep() == 0.0


def test_a_sleep_of_a_twentieth_of_a_second_is_a_fault_and_a_shorter_one_is_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [3.0]
    monkeypatch.setattr(suspend, "asleep", lambda: now[0])
    watch = SuspendWatch()
    assert JUMP == 0.05
    now[0] = 3.049
    assert watch.fault() is None
    now[0] = 5.35
    assert "this computer was suspended for 2.3 s while it drove the hand" in str(watch.fault())
    watch.restart()
    assert watch.fault() is None


def installed(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    program = folder / "systemd-inhibit"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")


def test_a_system_that_agrees_holds_the_computer_awake_until_it_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed(tmp_path, monkeypatch, f'echo "$@" > {tmp_path}/asked; exec cat')
    inhibitor = Inhibitor()
    wait_for((tmp_path / "asked").is_file, "the question")
    assert inhibitor.holds
    process = inhibitor._process
    assert process is not None
    inhibitor.close()
    assert process.returncode == 0, "it ends with its standard input"
    assert not inhibitor.holds
    inhibitor.close()
    asked = (tmp_path / "asked").read_text()
    assert "--what=sleep:handle-lid-switch" in asked
    assert asked.rstrip().endswith("--mode=block cat")


def test_a_system_that_refuses_or_has_nobody_to_ask_is_let_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed(tmp_path, monkeypatch, "exit 1")
    refused = Inhibitor()
    wait_for(lambda: not refused.holds, "the refusal")
    refused.close()
    monkeypatch.setenv("PATH", str(tmp_path / "nowhere"))
    nobody = Inhibitor()
    assert not nobody.holds
    nobody.close()
