"""The answers of many servos as one array: what they are one by one, or nothing."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.drivers.dynamixel.codec.packet import status
from allegro_twin.drivers.dynamixel.codec.rows import AROUND, answers, clean

IDS, SIZE = (2, 1, 3, 252), 10


def drawn(seed: int) -> list[bytes]:
    return [bytes(row) for row in np.random.default_rng(seed).integers(0, 256, (len(IDS), SIZE), np.uint8)]


def one_by_one(data: list[bytes]) -> bytes:
    return b"".join(status(each, 0, said).encoded() for each, said in zip(IDS, data, strict=True))


@pytest.mark.parametrize("seed", range(50))
def test_all_at_once_is_one_after_the_other_and_back(seed: int) -> None:
    data = drawn(seed)
    said = one_by_one(data)
    assert len(said) == len(IDS) * (AROUND + SIZE)
    assert answers(IDS, data) == said
    assert clean(said, IDS, SIZE) == b"".join(data)


def test_no_changed_bit_is_let_pass() -> None:
    said = one_by_one(drawn(0))
    for place in range(8 * len(said)):
        changed = bytearray(said)
        changed[place // 8] ^= 1 << place % 8
        assert clean(bytes(changed), IDS, SIZE) is None


def test_what_is_not_as_nearly_always_is_left_to_others() -> None:
    data = drawn(1)
    said = one_by_one(data)
    assert clean(said[:-1], IDS, SIZE) is None
    assert clean(said + b"\0", IDS, SIZE) is None
    assert clean(said, IDS[::-1], SIZE) is None
    alert = status(IDS[0], 0x80, data[0]).encoded() + said[AROUND + SIZE :]
    assert clean(alert, IDS, SIZE) is None
    stuffed = [b"\xff\xff\xfd" + data[0][3:], *data[1:]]
    assert answers(IDS, stuffed) is None
    assert clean(one_by_one(stuffed), IDS, SIZE) is None
