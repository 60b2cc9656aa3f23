"""Whatever bytes come from either side of a hand that answers: errors of the tree, and never a torn state."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.drivers.qb.codec import HEADER, Command, QbPacket
from allegro_twin.drivers.schunk.codec import START, Question, State, Who
from allegro_twin.errors import HandError
from tests.drivers.serial.polled_rigs import BAUD, ID, KINDS, MOTORS, TICKS, Kind, Polled, virtual

FEW, MANY = 30_000, 1_000_000
"""Bytes."""
Rng = np.random.Generator


def sound(kind: Kind, rng: Rng) -> bytes:
    """A true packet with nonsense inside, of either side."""
    noise = rng.bytes(int(rng.integers(0, 20)))
    if kind == "qb":
        return QbPacket(int(rng.choice([0, ID, ID, 9])), int(rng.choice([*Command, 3, 147])), noise).encoded()
    count, bits, mode, watchdog = (int(value) for value in rng.integers(0, 256, 4))
    targets = tuple(int(value) for value in rng.integers(0, 1 << 16, 5))
    currents = tuple(int(value) for value in rng.integers(-128, 128, 5))
    asked = Question(count, bool(bits & 1), bool(bits & 2), mode % 3, watchdog % 3, targets)
    said, told = State(count, bits, currents, targets), Who(count, mode % 16, watchdog)
    ways = [asked.encoded(), asked.encoded(), said.encoded(), told.encoded()]
    return ways[int(rng.integers(len(ways)))]


def pieces(kind: Kind, rng: Rng, total: int) -> list[bytes]:
    """Noise, beginnings with noise after them, true packets, and true packets that were spoilt or cut."""
    mark, made, size = HEADER if kind == "qb" else bytes((START,)), list[bytes](), 0
    while size < total:
        noise, packet = rng.bytes(int(rng.integers(1, 60))), sound(kind, rng)
        spoilt = bytearray(packet)
        spoilt[int(rng.integers(len(spoilt)))] ^= 1 << int(rng.integers(8))
        ways = [noise, mark + noise, packet, bytes(spoilt), packet[: int(rng.integers(len(packet)))]]
        made.append(ways[int(rng.integers(len(ways)))])
        size += len(made[-1])
    return made


def fuzzed_hand(kind: Kind, total: int, seed: int) -> int:
    """Bytes that a virtual hand was given; it stays one."""
    rng, size, hand = np.random.default_rng(seed), 0, virtual(kind)
    for piece in pieces(kind, rng, total):
        hand.receive(piece, BAUD[kind])
        size += len(piece)
        hand.electronics.elapse(0.001)
        wants = hand.electronics.wants
        assert wants is None or (len(wants) == MOTORS[kind] and all(0 <= tick <= TICKS[kind] for tick in wants))
        if rng.random() < 0.01:
            assert np.isfinite(hand.step().position).all()
        if rng.random() < 0.1:
            hand.clear()
    return size


def fuzzed_host(kind: Kind, total: int, seed: int) -> int:
    """Bytes of noise that a backend met among true answers; its states are the hand's or there are none."""
    rng, size, bench = np.random.default_rng(seed), 0, Polled(kind)
    noise, receive = iter(pieces(kind, rng, 2 * total)), bench.hand.receive

    def noisy(data: bytes, baud: int) -> bytes:
        nonlocal size
        answer, chance = receive(data, baud), rng.random()
        if chance > 0.3 or size >= total:
            return answer
        spoilt = next(noise)
        while is_an_answer(kind, spoilt):
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
                np.testing.assert_allclose(state.position, bench.hand.state.position, atol=2.0 / TICKS[kind] + 1e-9)
        except HandError:
            continue
    assert states > 0
    return size


def is_an_answer(kind: Kind, data: bytes) -> bool:
    """A sound packet that the hand itself could have said: no codec in the world tells it from the true one."""
    if kind == "qb":
        return HEADER + bytes((ID,)) in data
    return any(bytes((START, head)) in data for head in (0x19, 0x1A))


@pytest.mark.parametrize("kind", KINDS)
def test_a_hand_survives_any_bytes(kind: Kind) -> None:
    assert fuzzed_hand(kind, FEW, seed=1) >= FEW


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_backend_survives_any_bytes_with_errors_of_the_tree_and_no_torn_state(kind: Kind) -> None:
    assert fuzzed_host(kind, FEW, seed=2) >= FEW


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_million_bytes_each_way(kind: Kind) -> None:
    assert fuzzed_hand(kind, MANY, seed=10) >= MANY
    assert fuzzed_host(kind, MANY, seed=20) >= MANY


@pytest.mark.parametrize("kind", KINDS)
def test_a_line_that_is_held_low_ends_in_an_error_of_the_tree(kind: Kind) -> None:
    bench = Polled(kind)
    bench.backend.reset()
    bench.hand.spoil = lambda data: bytes(len(data))  # type: ignore[assignment]
    with pytest.raises(HandError):
        bench.go(0.1)
