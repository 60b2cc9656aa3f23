"""A bus carries two hands and refuses a third."""

from __future__ import annotations

import pytest

from allegro_twin.drivers.can.codec.frames import bits
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.link.load import check_load, share
from allegro_twin.errors import ConfigError

V4, V5 = make_codec("v4"), make_codec("v5")
MEGABIT = 1_000_000


def test_a_frame_of_eight_bytes_takes_135_bits_at_worst() -> None:
    """111 bits without stuffing, 24 stuffed: (34 + 64 - 1) / 4."""
    assert bits(8) == 135
    assert bits(0) == 55


def test_a_hand_takes_36_percent_of_its_bus_and_a_v5_hand_45() -> None:
    assert share((V4, 0.003), MEGABIT) == pytest.approx(0.36)
    assert share((V5, 0.003), MEGABIT) == pytest.approx(0.45)


def test_two_hands_share_a_bus_and_three_do_not() -> None:
    assert check_load([(V4, 0.003)] * 2, MEGABIT, "can0") == pytest.approx(0.72)
    with pytest.raises(ConfigError, match=r"can0 would be 108% full \(36% \+ 36% \+ 36%; at most 80%\): use a longer"):
        check_load([(V4, 0.003)] * 3, MEGABIT, "can0")


def test_a_slower_bus_or_a_faster_hand_is_counted() -> None:
    with pytest.raises(ConfigError, match="108% full"):
        check_load([(V4, 0.001)], MEGABIT, "can0")
    with pytest.raises(ConfigError, match="144% full"):
        check_load([(V4, 0.003)], 250_000, "can0")
    assert check_load([None, (V4, 0.006)], MEGABIT, "can0") == pytest.approx(0.18)
