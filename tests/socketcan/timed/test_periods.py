"""Hands and their drivers as users start them, on a computer of steady speed."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

# What commands import when they need it: once, before any fork.
import allegro_twin.app.serve_can
import allegro_twin.drivers.can.driver.backend
import allegro_twin.sim.engine.backend  # noqa: F401
from allegro_twin.recording.reader import load
from tests.patience import comes_true
from tests.socketcan.inside.rigs import (
    BEGIN,
    SIDES,
    command,
    delayed,
    exit_code,
    forked,
    hand_on,
)

PATIENCE = 60.0
"""s for programs to start and end."""


def config(folder: Path, channel: str, task: str, device: int = 0, period: float = 0.003) -> Path:
    """A hand with the options that a user has by default."""
    path = folder / f"{channel}_{device}.yaml"
    path.write_text(
        f"hand: {{model: allegro, side: {SIDES[device]}}}\n"
        f"backend: {{kind: can, version: v4, interface: socketcan, channel: {channel}, device: {device}, "
        f"gravity: [0, 0, -9.81]}}\n{task}\nperiod: {period}\n"
    )
    return path


def told(path: Path, work: Callable[[], None]) -> Callable[[], None]:
    """The same, but what it prints goes into a file."""

    def quietly() -> None:
        sys.stdout = sys.stderr = path.open("w", buffering=1)
        work()

    return quietly


def used(recording: Path) -> float:
    """The share of the hand's periods of which there was a state."""
    ticks = load(recording).columns["tick"].astype(int)
    print(f"{len(ticks)} states of {ticks[-1] + 1} periods; gaps: {np.bincount(np.diff(ticks)).tolist()}")
    return float((len(ticks) - 1) / ticks[-1])


def test_98_of_100_periods_of_a_hand_with_physics_are_used_for_10_seconds(tmp_path: Path) -> None:
    """One cable between two cards; 3 ms, recorded, with a keeper."""
    said, recording = tmp_path / "hand.txt", tmp_path / "run.arrow"
    task = "task: {posture: home}\ncontroller: {kind: pid, gains: default}"
    with forked(told(said, command("firmware", config(tmp_path, "can1", task)))) as hand:
        assert comes_true(lambda: said.exists() and "Ctrl-C" in said.read_text(), PATIENCE)
        words = ("run", config(tmp_path, "can0", task), "--seconds", 10, "--record", recording)
        with forked(told(tmp_path / "run.txt", command(*words))) as run:
            assert exit_code(run, PATIENCE) == 0
        os.kill(hand, signal.SIGINT)
        assert exit_code(hand, PATIENCE) == 0
    print(said.read_text())
    assert used(recording) >= 0.98


def test_two_hands_that_fill_three_quarters_of_a_bus_lose_nothing_to_each_other(tmp_path: Path) -> None:
    """One queue for everybody, half as fast as a bus of 1 Mbit/s, and periods twice as long, for six processes share
    the processor."""
    period, seconds = 0.006, 5.0
    recordings = [tmp_path / f"run{device}.arrow" for device in (0, 1)]
    task = "controller: {kind: torque, torque: 0.05}"
    with ExitStack() as stack:
        stack.enter_context(delayed("vcan0", "rate", "500kbit", "limit", "40"))
        hands = [stack.enter_context(hand_on("vcan0", device, period)) for device in (0, 1)]
        runs = []
        for device in (0, 1):
            words = ("run", config(tmp_path, "vcan0", task, device, period), "--seconds", seconds)
            work = command(*words, "--record", recordings[device])
            runs.append(stack.enter_context(forked(told(tmp_path / f"run{device}.txt", work))))
        assert [exit_code(run, PATIENCE) for run in runs] == [0, 0]
        assert all(hand.seen.limp_since for hand in hands)
    for recording, begin in zip(recordings, BEGIN, strict=True):
        assert used(recording) >= 0.9
        np.testing.assert_allclose(load(recording).columns["position"][:, 0], begin, atol=0.05)
