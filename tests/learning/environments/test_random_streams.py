"""Random numbers of a batch: each simulation's own, and those of a key and a counter are splitmix64's."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.learning.environments.random_streams import COLUMNS, Draws, _mix, jitter

STEP, MASK = 0x9E3779B97F4A7C15, 2**64 - 1


def splitmix(state: int) -> int:
    """One step of Steele, Lea and Flood, OOPSLA 2014, in whole numbers of any length."""
    z = (state + STEP) & MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


def test_what_mixes_is_splitmix64() -> None:
    """Its first three outputs from the state 0, as published programs have them."""
    known = [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F]
    states = np.array([0, STEP, (2 * STEP) & MASK], np.uint64)
    assert [int(x) for x in _mix(states)] == known == [splitmix(int(x)) for x in states]


def test_jitter_is_of_its_key_its_counter_its_stream_and_its_column() -> None:
    keys, counters = np.array([1, 2**53 - 1], np.uint64), np.array([0, 77], np.int64)
    found = jitter(keys, counters, 3, 4)
    assert found.shape == (2, 4)
    for row, (key, counter) in enumerate(zip(keys.tolist(), counters.tolist(), strict=True)):
        seed = splitmix((key * STEP + counter) & MASK)
        for column in range(4):
            expected = (splitmix((seed + 3 * 1024 + column) & MASK) >> 11) * 2.0**-52 - 1.0
            assert found[row, column] == expected
    many = jitter(np.arange(500, dtype=np.uint64), np.zeros(500, np.int64), 0, 20)
    assert -1.0 <= many.min() < -0.99
    assert 0.99 < many.max() < 1.0
    assert abs(many.mean()) < 0.02
    assert many.std() == pytest.approx(3**-0.5, abs=0.01)


def dealt(*columns: float) -> Draws:
    """Two simulations that drew the same, but the second half of it."""
    row = np.array([*columns, *np.zeros(COLUMNS - len(columns))])
    return Draws(np.stack([row, row / 2.0]))


def test_numbers_are_dealt_column_by_column() -> None:
    draws = dealt(0.5, 0.25, 0.75, 0.9)
    assert len(draws) == 2
    np.testing.assert_allclose(draws.uniform(2.0, 4.0), [[3.0], [2.5]])
    np.testing.assert_allclose(draws.uniform(-1.0, 1.0, 2), [[-0.5, 0.5], [-0.75, -0.25]])
    assert draws.integers(10).tolist() == [9, 4]
    assert draws.uniform(0.0, 1.0).tolist() == [[0.0], [0.0]]


@pytest.mark.parametrize(("drawn", "number", "whole"), [(0.0, 0, 3.0), (0.26, 1, 4.0), (0.51, 2, 5.0), (0.76, 3, 6.0)])
def test_whole_numbers_are_as_likely_as_each_other(drawn: float, number: int, whole: float) -> None:
    assert dealt(drawn).integers(4)[0] == number
    assert dealt(drawn).integers_between(3.0, 6.0)[0, 0] == whole
    assert dealt(1.0).integers(4)[0] == 3
    assert dealt(1.0).integers_between(3.0, 6.0)[0, 0] == 6.0


def test_a_sign_is_of_the_half_in_which_a_number_lies() -> None:
    np.testing.assert_array_equal(dealt(0.4, 0.6, 0.5).signs(3), [[-1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]])


def test_directions_are_unit_vectors_all_over_the_sphere() -> None:
    np.testing.assert_allclose(dealt(1.0, 0.3).directions()[0], [0.0, 0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(dealt(0.5, 0.25).directions()[0], [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(dealt(0.8, 0.5).directions()[0], [-0.8, 0.0, 0.6], atol=1e-15)
    many = Draws.from_counters(np.arange(4000, dtype=np.uint64), np.zeros(4000, np.int64)).directions()
    np.testing.assert_allclose(np.linalg.norm(many, axis=1), 1.0)
    np.testing.assert_allclose(many.mean(axis=0), 0.0, atol=0.04)
    np.testing.assert_allclose(many.T @ many / 4000, np.eye(3) / 3.0, atol=0.03)


def test_a_key_is_a_whole_number_of_its_own_column() -> None:
    draws = dealt(0.0, 0.75, 0.25)
    draws.uniform(0.0, 1.0)
    assert draws.keys().tolist() == [round(0.75 * 2**53), round(0.375 * 2**53)]
    assert draws.keys().dtype == np.uint64
    assert draws.uniform(0.0, 1.0)[0, 0] == 0.0


def test_each_simulation_has_its_own_numbers_whatever_batch_it_stands_in() -> None:
    alone = Draws.from_generators([np.random.default_rng(5)]).uniform(0.0, 1.0, 3)
    beside = Draws.from_generators([np.random.default_rng(4), np.random.default_rng(5)]).uniform(0.0, 1.0, 3)
    np.testing.assert_array_equal(alone[0], beside[1])
    np.testing.assert_array_equal(alone[0], np.random.default_rng(5).random(COLUMNS)[:3])
    key, episode = np.array([8, 9], np.uint64), np.array([3, 4], np.int64)
    both = Draws.from_counters(key, episode).uniform(0.0, 1.0, 3)
    np.testing.assert_array_equal(Draws.from_counters(key[1:], episode[1:]).uniform(0.0, 1.0, 3)[0], both[1])
    np.testing.assert_allclose(both, (jitter(key, episode, 15, 3) + 1.0) / 2.0)
    assert not np.array_equal(Draws.from_counters(key, episode + 1).uniform(0.0, 1.0, 3), both)
