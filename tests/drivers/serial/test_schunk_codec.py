"""Frames of our Schunk layout: the checksum that is known, and the layout that is ours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allegro_twin.drivers.schunk import codec
from allegro_twin.drivers.schunk.codec import SIZE, START, SUMMED, Kind, Question, State, Who, fletcher16, frames

ticks = st.integers(0, codec.TICKS)
questions = st.builds(
    Question, st.integers(0, 255), st.booleans(), st.booleans(), st.integers(0, 255), st.integers(0, 255),
    st.tuples(*[ticks] * 5), st.sampled_from(Kind),
)  # fmt: skip
states = st.builds(
    State, st.integers(0, 255), st.integers(0, 255), st.tuples(*[st.integers(-128, 127)] * 5), st.tuples(*[ticks] * 5),
    st.integers(0, 255),
)  # fmt: skip


@pytest.mark.parametrize(
    ("data", "sums"),
    [(bytes(range(1, 22)), (231, 241)), (bytes(21), (0, 0)), (b"abcde", (0xF0, 0xC8))],
)
def test_the_checksum_is_the_reports(data: bytes, sums: tuple[int, int]) -> None:
    assert fletcher16(data) == sums


def test_the_checksum_cannot_tell_nothing_from_all_ones() -> None:
    """Modulo 255 a byte FF is a byte 00: the blind spot of the report's algorithm, not of ours."""
    assert fletcher16(b"\xff" + bytes(20)) == fletcher16(bytes(21))


def test_one_byte_that_was_changed_is_nearly_always_seen() -> None:
    """But for 00 ↔ FF, every change of one byte is seen: 2 of the 65,280 ways for each place."""
    rng, missed = np.random.default_rng(1), 0
    for _ in range(20_000):
        frame = bytearray(rng.bytes(21))
        before = fletcher16(bytes(frame))
        place, new = int(rng.integers(21)), int(rng.integers(256))
        blind = {frame[place], new} in ({0, 255},)
        changed, frame[place] = frame[place] != new, new
        if changed and fletcher16(bytes(frame)) == before:
            missed += 1
            assert blind
    assert missed <= 6


@given(questions)
def test_a_question_comes_back_as_it_was(asked: Question) -> None:
    frame = asked.encoded()
    assert len(frame) == SIZE
    assert (frame[0], tuple(frame[22:])) == (START, fletcher16(frame[SUMMED]))
    assert codec.question(frame) == asked


@given(states)
def test_an_answer_comes_back_as_it_was_and_to_its_own_question_alone(said: State) -> None:
    frame = said.encoded()
    assert len(frame) == SIZE
    assert codec.state(frame, said.counter) == said
    assert codec.state(frame, (said.counter + 1) % 256) is None
    assert codec.who(frame, said.counter) is None


def test_a_frame_of_another_layout_is_no_question_and_says_so_when_asked_who() -> None:
    later = Question(3).encoded()
    body = bytes((later[0], later[1] + 0x10)) + later[2:22]
    assert codec.question(body + bytes(fletcher16(body[1:22]))) is None
    assert codec.who(Who(3, layout=2).encoded(), 3) == Who(3, layout=2)


@given(st.lists(questions, max_size=5), st.binary(max_size=30))
def test_frames_are_found_behind_noise_and_damaged_ones_are_not(said: list[Question], noise: bytes) -> None:
    data = b"".join(each.encoded() for each in said)
    found, _ = frames(data)
    assert [codec.question(frame) for frame in found] == said
    behind, _ = frames(noise.replace(bytes((START,)), b"") + data)
    assert behind == found


def test_half_a_frame_is_kept_until_the_rest_comes() -> None:
    frame = Question(9).encoded()
    found, left = frames(b"\x00" + frame[:10])
    assert (found, left) == ([], frame[:10])
    assert frames(left + frame[10:]) == ([frame], b"")
