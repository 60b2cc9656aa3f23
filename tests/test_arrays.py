"""A line that is written once reckons the same with NumPy's arrays and with PyTorch's tensors."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from allegro_twin.array_api import TensorNamespace, array_namespace, cross, fetch, take, tensor_namespace, to_numpy
from allegro_twin.learning.environments.random_streams import Draws, jitter

ROWS = 5


@pytest.fixture
def xp() -> TensorNamespace:
    pytest.importorskip("torch", reason="torch is not installed: pip install 'allegro-twin[warp]'")
    return tensor_namespace("cpu")


def test_every_function_says_what_numpy_says(xp: TensorNamespace) -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.9, 0.9, (2, ROWS, 3)).astype(np.float32)
    for name in ("exp", "abs", "sin", "cos", "arccos", "floor", "rint", "isfinite", "copy", "nan_to_num"):
        np.testing.assert_allclose(to_numpy(getattr(xp, name)(xp.asarray(x))), getattr(np, name)(x), rtol=1e-5)
    for name in ("arctan2", "minimum", "maximum", "cross"):
        both = getattr(xp, name)(xp.asarray(x), xp.asarray(y))
        np.testing.assert_allclose(to_numpy(both), getattr(np, name)(x, y), atol=1e-6)
    for name in ("minimum", "maximum"):
        np.testing.assert_array_equal(
            to_numpy(getattr(xp, name)(xp.asarray(x), 0.1)), getattr(np, name)(x, np.float32(0.1))
        )
    for name in ("concatenate", "stack"):
        parts = getattr(xp, name)([xp.asarray(x), xp.asarray(y)], axis=-1)
        np.testing.assert_array_equal(to_numpy(parts), getattr(np, name)([x, y], axis=-1))
    np.testing.assert_array_equal(
        to_numpy(xp.clip(xp.asarray(x), -0.2, 0.3)), np.clip(x, np.float32(-0.2), np.float32(0.3))
    )
    np.testing.assert_array_equal(to_numpy(xp.max(xp.asarray(x), axis=-1)), np.max(x, axis=-1))
    np.testing.assert_array_equal(to_numpy(xp.flatnonzero(xp.asarray(x[:, 0] > 0))), np.flatnonzero(x[:, 0] > 0))


def test_a_tensor_is_a_copy_of_what_it_was_made_from(xp: TensorNamespace) -> None:
    given = np.zeros(3, np.float32)
    made = xp.asarray(given)
    made[0] = 1.0
    assert given[0] == 0.0
    assert array_namespace(made) is xp
    assert array_namespace(given) is np


def test_the_noise_of_a_key_is_the_same_numbers_on_both(xp: TensorNamespace) -> None:
    key = np.array([0, 1, 2**52 + 7, 2**53 - 1], np.uint64)
    counter = np.arange(4)
    ours = jitter(key, counter, 8, 16)
    theirs = to_numpy(jitter(xp.asarray(key), xp.asarray(counter), 8, 16))
    np.testing.assert_array_equal(theirs, ours.astype(np.float32))


def test_episodes_that_are_counted_are_the_same_on_both_and_all_different(xp: TensorNamespace) -> None:
    key, episode = np.arange(4, dtype=np.uint64), np.ones(4, np.int64)
    ours = Draws.from_counters(key, episode)
    theirs = Draws.from_counters(xp.asarray(key), xp.asarray(episode))
    np.testing.assert_allclose(to_numpy(theirs.uniform(0.0, 1.0, 8)), ours.uniform(0.0, 1.0, 8), atol=1e-6)
    np.testing.assert_array_equal(to_numpy(theirs.keys()), ours.keys().astype(np.int64))
    assert len(np.unique(ours.uniform(0.0, 1.0, 8))) == 32
    again = Draws.from_counters(key, episode + 1).uniform(0.0, 1.0, 8)
    assert not np.isin(again, Draws.from_counters(key, episode).uniform(0.0, 1.0, 8)).any()


class Pair(NamedTuple):
    number: Any
    flags: Any


def test_what_is_fetched_from_a_device_comes_in_one_copy(xp: TensorNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    copies: list[object] = []

    def counted(x: Any) -> Any:
        copies.append(x)
        return x.numpy()

    monkeypatch.setattr("allegro_twin.array_api.to_numpy", counted)
    numbers = xp.arange(ROWS)
    tree = ({"x": xp.ones((ROWS, 2)), "deep": {"y": xp.zeros((ROWS, 2, 3))}}, Pair(numbers, numbers > 2))
    (first, second) = fetch(tree)
    assert len(copies) == 1
    assert isinstance(second, Pair)
    assert (first["x"].shape, first["deep"]["y"].shape) == ((ROWS, 2), (ROWS, 2, 3))
    assert (second.number.dtype, second.flags.dtype, first["x"].dtype) == (np.int64, np.bool_, np.float32)
    np.testing.assert_array_equal(second.flags, np.arange(ROWS) > 2)


def test_numpy_s_own_arrays_are_fetched_as_they_are() -> None:
    tree = {"x": np.zeros(2)}
    assert fetch(tree) is tree


def test_a_cross_product_is_numpy_s_to_the_bit() -> None:
    x, y = np.random.default_rng(0).normal(size=(2, ROWS, 3))
    np.testing.assert_array_equal(cross(x, y), np.cross(x, y))


def test_what_is_taken_is_what_indexing_finds_on_both(xp: TensorNamespace) -> None:
    x, rows, columns = np.random.default_rng(0).normal(size=(ROWS, 3)), np.array([[3], [0]]), np.array([[2, 0], [1, 1]])
    for array in (x, xp.asarray(x)):
        np.testing.assert_array_equal(to_numpy(take(array, rows, 0)), to_numpy(array[rows]))
        np.testing.assert_array_equal(to_numpy(take(array, columns, -1)), to_numpy(array[..., columns]))
