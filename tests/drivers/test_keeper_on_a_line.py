"""What a keeper says on a serial line where nobody answers it, without a hand."""

from __future__ import annotations

import os
import signal
import sys
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

if sys.platform == "win32":
    pytest.skip("Windows has no pseudo-terminals", allow_module_level=True)

from allegro_twin.drivers.base.keeper.keeper import Keeper
from tests.drivers.keeper import second_of
from tests.patience import comes_true

WORDS = b"limp!"


@pytest.fixture
def line() -> Iterator[tuple[int, int]]:
    """Both ends of a terminal."""
    ends = os.openpty()
    tty.setraw(ends[1])
    os.set_blocking(ends[0], False)
    yield ends
    for end in ends:
        os.close(end)


def armed(line: tuple[int, int]) -> Keeper:
    keeper = Keeper({"kind": "bytes", "fd": line[1], "shutdown_frames": WORDS.hex()})
    keeper.arm()
    return keeper


def heard(line: tuple[int, int]) -> bytes:
    try:
        return os.read(line[0], 4096)
    except BlockingIOError:
        return b""


def gone(keeper: Keeper) -> bool:
    return comes_true(lambda: not Path(f"/proc/{keeper.process}").exists())


def test_its_words_are_said_25_times_and_it_is_gone_when_the_program_goes_on(line: tuple[int, int]) -> None:
    keeper = armed(line)
    assert heard(line) == b""
    keeper.take_over(wait=True)
    assert heard(line) == 25 * WORDS
    assert gone(keeper)


def test_let_go_while_the_motors_may_be_on_it_says_them_too(line: tuple[int, int]) -> None:
    keeper = armed(line)
    keeper.close()
    assert gone(keeper)
    assert heard(line) == 25 * WORDS


def test_dismissed_it_goes_without_a_word(line: tuple[int, int]) -> None:
    keeper = armed(line)
    keeper.dismiss()
    assert gone(keeper)
    assert heard(line) == b""


def test_the_words_of_the_second_of_one_that_was_killed_are_said_to_the_end(line: tuple[int, int]) -> None:
    keeper = armed(line)
    second = second_of(keeper.process)
    os.kill(keeper.process, signal.SIGKILL)
    assert comes_true(lambda: not keeper.alive)
    keeper.dismiss()
    assert heard(line) == 25 * WORDS
    assert comes_true(lambda: not Path(f"/proc/{second}").exists())


def test_where_no_second_is_left_nobody_waits_for_its_words(line: tuple[int, int]) -> None:
    keeper = armed(line)
    second = second_of(keeper.process)
    os.kill(keeper.process, signal.SIGSTOP)  # Or it would make another.
    os.kill(second, signal.SIGKILL)
    os.kill(keeper.process, signal.SIGKILL)
    assert comes_true(lambda: not keeper.alive)
    keeper.dismiss()
    assert heard(line) == b""


def test_dismissed_while_it_speaks_it_is_silent_from_then_on(line: tuple[int, int]) -> None:
    keeper = armed(line)
    keeper.take_over()
    assert comes_true(lambda: heard(line) != b"")
    keeper.dismiss()
    heard(line)
    assert gone(keeper)
    assert heard(line) == b""
