"""Whatever bytes come from either side: errors of the tree, and never a state that is put together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("dynamixel_sdk", reason="pip install 'allegro-twin[dynamixel]'")

from allegro_twin.drivers.dynamixel.codec.packet import HEADER, DynamixelPacket, DynamixelParser, Instruction, status
from allegro_twin.drivers.dynamixel.codec.table import XM430_W350
from allegro_twin.drivers.dynamixel.config import ServoFaultSettings
from allegro_twin.drivers.dynamixel.virtual.bus import Bus
from allegro_twin.drivers.dynamixel.virtual.servo import Servo
from allegro_twin.errors import HandError
from tests.drivers.serial.rigs import BAUD, Bench

FEW, MANY = 40_000, 1_000_000
"""Bytes."""
instructions = st.builds(
    DynamixelPacket,
    st.sampled_from([3, 4, 5, 6, 0xFE, 99]),
    st.sampled_from([*Instruction, 0x55, 0x77]),
    st.binary(max_size=40),
)


def pieces(rng: np.random.Generator, total: int) -> list[bytes]:
    """Noise, headers with noise after them, true packets with nonsense inside, and true packets that were spoilt."""
    made, size = list[bytes](), 0
    kinds = [*Instruction, 0x55, 0x77]
    while size < total:
        noise = rng.bytes(int(rng.integers(1, 60)))
        packet = DynamixelPacket(int(rng.choice([1, 2, 3, 4, 5, 6, 0xFE])), int(rng.choice(kinds)), noise).encoded()
        cut = bytearray(packet)
        cut[int(rng.integers(len(cut)))] ^= 1 << int(rng.integers(8))
        ways = [noise, HEADER + noise, packet, bytes(cut), packet[: int(rng.integers(len(packet)))]]
        made.append(ways[int(rng.integers(len(ways)))])
        size += len(made[-1])
    return made


def fuzzed_bus(total: int, seed: int) -> int:
    """Bytes that a bus was given; its servos stay servos."""
    rng, size = np.random.default_rng(seed), 0
    bus = Bus([Servo(XM430_W350, identifier, BAUD) for identifier in (1, 2, 3)])
    for piece in pieces(rng, total):
        bus.receive(piece, BAUD)
        size += len(piece)
        for servo in bus.servos:
            servo.elapse(0.001)
            assert servo.wants.current >= 0
    for servo in bus.servos:
        for item in servo.model.fields:
            assert item.low <= servo.memory.get(item.name) <= item.high
    return size


def fuzzed_host(total: int, seed: int) -> int:
    """Bytes of noise that a backend met among true answers; its states are the hand's or there are none."""
    rng, size = np.random.default_rng(seed), 0
    noise = iter(pieces(rng, 2 * total))
    bench = Bench()
    receive = bench.hand.receive

    def noisy(data: bytes, baud: int) -> bytes:
        nonlocal size
        answer, chance = receive(data, baud), rng.random()
        if chance > 0.3 or size >= total:
            return answer
        spoilt = next(noise)
        size += len(spoilt)
        where = int(rng.integers(len(answer) + 1))
        return [spoilt, spoilt + answer, answer[:where] + spoilt + answer[where:], answer[:where]][int(rng.integers(4))]

    bench.hand.receive = noisy  # type: ignore[method-assign]  # The line is where the noise is.
    states = 0
    while size < total:
        try:
            bench.backend.reset()
            for k in range(50):
                state = bench.go(0.3 * np.sin(0.1 * k))
                states += 1
                np.testing.assert_allclose(state.position, bench.hand.state.position, atol=np.pi / 4096 + 1e-9)
        except HandError:
            continue
    assert states > 0
    return size


def test_a_bus_survives_any_bytes() -> None:
    assert fuzzed_bus(FEW, seed=1) >= FEW


def test_a_backend_survives_any_bytes_with_errors_of_the_tree_and_no_torn_state() -> None:
    assert fuzzed_host(FEW, seed=2) >= FEW


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_a_million_bytes_each_way(seed: int) -> None:
    assert fuzzed_bus(MANY, seed=10 + seed) >= MANY
    assert fuzzed_host(MANY, seed=20 + seed) >= MANY


@settings(max_examples=200)
@given(st.lists(instructions, max_size=12))
def test_a_bus_answers_only_whole_packets_of_those_who_are_there(said: list[DynamixelPacket]) -> None:
    bus = Bus([Servo(XM430_W350, identifier, BAUD) for identifier in (3, 4, 5, 6)])
    for packet in said:
        answer = bus.receive(packet.encoded(), BAUD)
        heard = DynamixelParser().feed(answer)
        assert (
            b"".join(each.encoded() for each in heard if isinstance(each, DynamixelPacket)) == answer
            or len({servo.id for servo in bus.servos}) < 4
        )  # Servos that were given one id speak over each other.


@settings(max_examples=60)
@given(st.lists(st.one_of(st.binary(max_size=40), st.just(status(3, 0, bytes(10)).encoded())), max_size=6))
def test_answers_that_nobody_gave_are_no_state(noise: list[bytes]) -> None:
    bench = Bench()
    bench.backend.reset()
    queue = list(noise)
    receive = bench.hand.receive
    bench.hand.receive = lambda data, baud: queue.pop(0) if queue else receive(data, baud)  # type: ignore[method-assign]
    try:
        state = bench.backend.read()
    except HandError:
        return
    assert state.position.shape == (4,)


def test_noise_on_every_byte_ends_in_an_error_of_the_tree() -> None:
    bench = Bench(plan=ServoFaultSettings(garble=0.0))
    bench.backend.reset()
    bench.hand.faults.spoil = lambda data: bytes(len(data))  # type: ignore[assignment]  # A line that is held low.
    with pytest.raises(HandError):
        bench.go(0.1)
