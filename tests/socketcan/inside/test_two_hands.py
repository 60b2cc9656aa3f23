"""Two v4 hands on one bus, each with a driver of its own."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.patience import comes_true
from tests.socketcan.inside.rigs import assert_recorded, command, config, delayed, exit_code, forked, hand_on

PERIOD = 0.04
"""s: six processes share one slow processor there."""


@pytest.mark.parametrize(("here", "there", "seconds"), [("vcan0", "vcan0", 1.0), ("vxcan0", "vxcan1", 3.0)])
def test_two_hands_share_a_bus_and_each_driver_hears_its_own(
    here: str, there: str, seconds: float, tmp_path: Path
) -> None:
    """The second pair is a bus of 1 Mbit/s, for netem takes a frame for 128 bits. How many periods are used is asked
    where time is steady: tests/socketcan/timed."""
    recordings = [tmp_path / f"run{device}.arrow" for device in (0, 1)]
    with ExitStack() as stack:
        if here != there:
            for channel in (here, there):
                stack.enter_context(delayed(channel, "rate", "1mbit", "limit", "10"))
        hands = [stack.enter_context(hand_on(there, device, PERIOD)) for device in (0, 1)]
        runs = []
        for device, hand in enumerate(hands):
            words = ("run", config(tmp_path, here, device, PERIOD, deadman=1.0), "--seconds", seconds)
            runs.append(stack.enter_context(forked(command(*words, "--record", recordings[device]))))
            assert comes_true(lambda hand=hand: hand.pushes, 40.0)  # type: ignore[misc]  # mypy: no types for defaults.
        assert [exit_code(run) for run in runs] == [0, 0]
        assert all(hand.seen.limp_since for hand in hands)
    for device, recording in enumerate(recordings):
        assert_recorded(recording, device)
