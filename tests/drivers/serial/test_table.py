"""The control tables of both kinds of servo, item by item."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from allegro_twin.drivers.dynamixel.codec.table import (
    BAUDS,
    ERRORS,
    FARTHEST,
    MODELS,
    MODES,
    RPM,
    TURN,
    WATCHDOG_UNIT,
    XC330_M288,
    XM430_W350,
    Field,
)
from tests.snapshots import assert_snapshot

SNAPSHOTS = Path(__file__).with_name("snapshots")


@pytest.mark.parametrize("name", MODELS)
def test_every_item_is_what_it_was_when_it_was_taken_from_the_manual(name: str) -> None:
    """Address, size, name, whether it can be written, initial value, range and whether it is signed."""
    rows = [" ".join(str(each) for each in item) for item in MODELS[name].fields]
    assert_snapshot("\n".join(rows), SNAPSHOTS / f"{name}.txt")


def test_items_do_not_overlap_and_defaults_are_in_their_ranges() -> None:
    for model in MODELS.values():
        addresses = [item.address + k for item in model.fields for k in range(item.size)]
        assert len(set(addresses)) == len(addresses) == len(model.at)
        assert all(item.low <= item.default <= item.high for item in model.fields)
        assert all(model.at[item.address + item.size - 1] is item for item in model.fields)


def test_what_a_count_is_worth_is_of_the_data_sheet() -> None:
    assert pytest.approx(2.0 * math.pi / 60.0) == RPM
    assert (XM430_W350.current_unit, XC330_M288.current_unit) == (2.69e-3, 1e-3)
    assert XM430_W350.torque_per_ampere == pytest.approx(4.1 / 2.3)  # Stall: 4.1 N·m at 2.3 A.
    assert XC330_M288.torque_per_ampere == pytest.approx(0.93 / 1.8)
    assert XM430_W350.velocity_unit == XC330_M288.velocity_unit == pytest.approx(0.229 * RPM)
    assert (XM430_W350.number, XC330_M288.number) == (1020, 1240)
    assert XM430_W350.indirect == ((168, 224, 28), (578, 634, 28))
    assert XC330_M288.indirect == ((168, 208, 20),)
    assert XM430_W350.bauds == BAUDS == (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
    assert XC330_M288.bauds == BAUDS[:7]
    assert (TURN, FARTHEST, WATCHDOG_UNIT) == (4096, 256 * 4096 - 1, 0.02)
    assert MODES == (0, 1, 3, 4, 5, 16)
    assert sorted(ERRORS) == [0, 2, 3, 4, 5]


def test_a_value_stands_in_the_table_with_its_lowest_byte_first() -> None:
    signed, plain = Field(0, 2, "a", True, 0, -500, 500, True), Field(0, 4, "b", True, 0, 0, 1 << 20, False)
    assert signed.bytes_of(-2) == b"\xfe\xff"
    assert signed.value_of(b"\xfe\xff") == -2
    assert signed.bytes_of(258) == b"\x02\x01"
    assert plain.bytes_of(0x00010203) == b"\x03\x02\x01\x00"
    assert plain.value_of(b"\xff\xff\xff\xff") == (1 << 32) - 1
