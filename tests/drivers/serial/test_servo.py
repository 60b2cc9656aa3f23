"""A servo refuses what the manual says it refuses, and does by itself what the manual says it does."""

from __future__ import annotations

import pytest

from allegro_twin.drivers.dynamixel.codec.packet import PacketError
from allegro_twin.drivers.dynamixel.codec.table import (
    CURRENT_POSITION,
    EXTENDED,
    MODELS,
    TRIPPED,
    XC330_M288,
    XM430_W350,
    Model,
    model_named,
)
from allegro_twin.drivers.dynamixel.virtual.servo import Servo
from allegro_twin.errors import ConfigError


@pytest.fixture
def servo() -> Servo:
    made = Servo(XM430_W350, 1, 57_600)
    made.reboot()
    made.sense(2048, 0, 0)
    return made


def put(servo: Servo, name: str, value: int) -> int:
    """Write an item by its name; the error number."""
    item = servo.model.named[name]
    return servo.write(item.address, item.bytes_of(value))


def got(servo: Servo, name: str) -> int:
    item = servo.model.named[name]
    error, data = servo.read(item.address, item.size)
    assert error == 0
    return item.value_of(data)


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_the_items_of_a_table_neither_overlap_nor_leave_their_ranges(model: Model) -> None:
    end = 0
    for item in model.fields:
        assert item.address >= end
        assert item.size in (1, 2, 4)
        assert item.low <= item.default <= item.high
        end = item.address + item.size
    assert model_named(model.name) is model


def test_a_model_that_is_not_known_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="XM430-W350"):
        model_named("XM430-W35")
    assert XC330_M288.number == 1240
    assert XC330_M288.current_unit == 1e-3
    assert "acceleration_limit" not in XC330_M288.named


def test_a_new_servo_has_the_factorys_values(servo: Servo) -> None:
    assert got(servo, "model_number") == 1020
    assert (got(servo, "id"), servo.baud, got(servo, "return_delay")) == (1, 57_600, 250)
    assert got(servo, "operating_mode") == 3
    assert got(servo, "current_limit") == got(servo, "goal_current") == 1193
    assert got(servo, "position_p_gain") == 800
    assert got(servo, "shutdown") == 52


def test_the_eeprom_is_locked_while_torque_is_on(servo: Servo) -> None:
    assert put(servo, "torque_enable", 1) == 0
    assert put(servo, "operating_mode", 5) == PacketError.ACCESS
    assert put(servo, "id", 2) == PacketError.ACCESS
    assert put(servo, "torque_enable", 0) == 0
    assert put(servo, "id", 2) == 0
    assert servo.id == 2


def test_writes_are_refused_with_the_manuals_reasons(servo: Servo) -> None:
    assert put(servo, "present_position", 0) == PacketError.ACCESS
    assert servo.write(500, b"\x00") == PacketError.ACCESS
    assert servo.write(116, b"\x00\x00") == PacketError.LENGTH
    assert servo.write(117, b"\x00\x00\x00\x00") == PacketError.LENGTH
    assert servo.write(116, b"") == PacketError.LENGTH
    assert put(servo, "operating_mode", 2) == PacketError.RANGE
    assert put(servo, "baud_rate", 9) == PacketError.RANGE
    assert put(servo, "goal_current", 1194) == PacketError.RANGE
    assert put(servo, "current_limit", 100) == 0
    assert put(servo, "goal_current", 101) == PacketError.LIMIT
    assert put(servo, "goal_current", -101) == PacketError.LIMIT
    assert put(servo, "goal_current", 100) == 0
    assert put(servo, "goal_position", 4096) == PacketError.LIMIT
    assert servo.read(500, 1) == (PacketError.ACCESS, b"")
    assert servo.read(116, 0) == (PacketError.LENGTH, b"")


def test_a_write_of_several_items_is_done_whole_or_not_at_all(servo: Servo) -> None:
    put(servo, "operating_mode", CURRENT_POSITION)
    before = got(servo, "goal_position")
    row = (2000).to_bytes(2, "little") + bytes(12) + (77).to_bytes(4, "little")  # Goal Current … Goal Position.
    assert servo.write(102, row) == PacketError.RANGE
    assert got(servo, "goal_position") == before
    row = (20).to_bytes(2, "little") + row[2:]
    assert servo.write(102, row) == 0
    assert (got(servo, "goal_current"), got(servo, "goal_position")) == (20, 77)


def test_a_change_of_mode_resets_gains_profile_and_goals(servo: Servo) -> None:
    put(servo, "current_limit", 300)
    put(servo, "position_p_gain", 111)
    put(servo, "profile_velocity", 50)
    assert put(servo, "operating_mode", CURRENT_POSITION) == 0
    assert got(servo, "position_p_gain") == 800
    assert got(servo, "profile_velocity") == 0
    assert got(servo, "goal_current") == 300
    assert put(servo, "goal_position", 100_000) == 0  # It counts turns now.
    assert put(servo, "goal_position", 2_000_000) == PacketError.RANGE


def test_what_it_wants_is_its_goal_with_the_smaller_of_both_currents(servo: Servo) -> None:
    put(servo, "current_limit", 300)
    put(servo, "operating_mode", CURRENT_POSITION)
    put(servo, "goal_position", 3000)
    assert servo.wants.current == 0
    put(servo, "torque_enable", 1)
    put(servo, "goal_position", 3000)
    put(servo, "goal_current", 120)
    assert servo.wants == (3000, 120)
    put(servo, "goal_current", -120)
    assert servo.wants == (3000, 120)
    put(servo, "torque_enable", 0)
    put(servo, "current_limit", 50)
    put(servo, "torque_enable", 1)
    assert servo.wants.current == 50
    put(servo, "torque_enable", 0)
    put(servo, "current_limit", 300)
    put(servo, "operating_mode", EXTENDED)
    put(servo, "torque_enable", 1)
    assert servo.wants.current == 300
    put(servo, "torque_enable", 0)
    put(servo, "operating_mode", 0)
    put(servo, "torque_enable", 1)
    assert servo.wants.current == 0  # A mode without a goal position moves nothing here.


def test_torque_on_stays_where_the_shaft_is(servo: Servo) -> None:
    put(servo, "goal_position", 100)
    put(servo, "torque_enable", 1)
    assert got(servo, "goal_position") == 2048


def test_the_watchdog_stops_it_where_it_is_with_torque_on_and_locks_the_goals(servo: Servo) -> None:
    put(servo, "operating_mode", CURRENT_POSITION)
    put(servo, "bus_watchdog", 5)
    servo.elapse(1.0)
    assert got(servo, "bus_watchdog") == 5  # It does not run while torque is off.
    put(servo, "torque_enable", 1)
    put(servo, "goal_position", 3000)
    servo.elapse(0.06)
    servo.heard()
    servo.elapse(0.06)
    assert got(servo, "bus_watchdog") == 5
    servo.sense(2500, 10, 100)
    servo.elapse(0.06)
    assert got(servo, "bus_watchdog") == TRIPPED
    assert (servo.on, servo.wants.goal) == (True, 2500)
    assert put(servo, "goal_position", 3000) == PacketError.RANGE
    assert put(servo, "goal_current", 10) == PacketError.RANGE
    assert put(servo, "bus_watchdog", -1) == PacketError.RANGE
    assert put(servo, "bus_watchdog", 0) == 0
    assert put(servo, "goal_position", 3000) == 0


def test_too_hot_it_shuts_down_until_a_reboot(servo: Servo) -> None:
    put(servo, "torque_enable", 1)
    servo.heat(80.0)
    assert servo.on
    servo.heat(81.0)
    assert not servo.on
    assert (got(servo, "hardware_error_status"), servo.alert) == (4, 0x80)
    assert put(servo, "torque_enable", 1) == PacketError.RESULT
    servo.heat(30.0)
    assert put(servo, "torque_enable", 1) == PacketError.RESULT
    servo.reboot()
    assert put(servo, "torque_enable", 1) == 0


def test_an_error_that_shutdown_leaves_out_only_alerts(servo: Servo) -> None:
    put(servo, "shutdown", 0)
    put(servo, "torque_enable", 1)
    servo.fail(1 << 5)
    assert servo.on
    assert servo.alert == 0x80


def test_a_reboot_forgets_ram_and_whole_turns_and_keeps_the_eeprom(servo: Servo) -> None:
    put(servo, "operating_mode", CURRENT_POSITION)
    put(servo, "led", 1)
    servo.sense(2048 + 3 * 4096, 0, 0)
    servo.reboot()
    assert got(servo, "led") == 0
    assert got(servo, "operating_mode") == CURRENT_POSITION
    assert got(servo, "present_position") == 2048
    put(servo, "torque_enable", 1)
    put(servo, "goal_position", 3000)
    assert servo.wants.goal == 3000 + 3 * 4096  # Of the shaft, which knows its turns.


@pytest.mark.parametrize(("option", "kept"), [(0xFF, (1, 57_600)), (0x01, (9, 57_600)), (0x02, (9, 1_000_000))])
def test_a_factory_reset_keeps_what_it_is_told_to(option: int, kept: tuple[int, int]) -> None:
    servo = Servo(XM430_W350, 9, 1_000_000)
    put(servo, "current_limit", 10)
    assert servo.factory_reset(option) == 0
    assert (servo.id, servo.baud) == kept
    assert got(servo, "current_limit") == 1193
    assert servo.factory_reset(7) == PacketError.RANGE


def test_clear_forgets_whole_turns_of_a_servo_that_stands_still(servo: Servo) -> None:
    words = bytes((0x01, 0x44, 0x58, 0x4C, 0x22))
    servo.sense(5000, 3, 0)
    assert servo.clear(words) == PacketError.RESULT
    servo.sense(5000, 0, 0)
    assert servo.clear(b"\x01") == PacketError.RANGE
    assert servo.clear(words) == 0
    assert got(servo, "present_position") == 5000 - 4096


def test_homing_offset_and_drive_mode_are_between_its_ticks_and_its_shaft(servo: Servo) -> None:
    put(servo, "homing_offset", 100)
    assert got(servo, "present_position") == 2148
    put(servo, "drive_mode", 1)
    assert got(servo, "present_position") == 100 - 2048
    put(servo, "operating_mode", CURRENT_POSITION)
    put(servo, "torque_enable", 1)
    put(servo, "goal_position", -900)
    assert servo.wants.goal == 1000
    servo.sense(1000, 5, 7)
    assert (got(servo, "present_velocity"), got(servo, "present_current")) == (-5, -7)


def test_a_registered_write_waits_for_its_action(servo: Servo) -> None:
    assert servo.act() == PacketError.INSTRUCTION
    assert servo.register(65, b"\x02") == PacketError.RANGE
    assert servo.register(65, b"\x01") == 0
    assert (got(servo, "registered_instruction"), got(servo, "led")) == (1, 0)
    assert servo.act() == 0
    assert (got(servo, "registered_instruction"), got(servo, "led")) == (0, 1)


def test_indirect_addresses_bring_scattered_items_together(servo: Servo) -> None:
    servo.heat(41.0)
    for k, address in enumerate((146, 132, 133, 134, 135, 65)):
        assert servo.write(168 + 2 * k, address.to_bytes(2, "little")) == 0
    assert servo.read(224, 6) == (0, bytes((41, 0, 8, 0, 0, 0)))
    assert servo.write(229, b"\x01") == 0
    assert got(servo, "led") == 1
    assert servo.write(224, b"\x01") == PacketError.ACCESS
    assert servo.write(168, (9).to_bytes(2, "little")) == PacketError.RANGE
    assert servo.write(168, b"\x40") == PacketError.LENGTH
    assert servo.read(634, 1) == (0, b"\x00")


def test_its_clock_counts_milliseconds(servo: Servo) -> None:
    servo.elapse(1.5)
    assert got(servo, "realtime_tick") == 1500
    servo.elapse(32.0)
    assert got(servo, "realtime_tick") == (33500 % 32768)
