"""The laws are the textbook's, broadcast over batches, and do not wind up."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from allegro_twin.control import laws
from allegro_twin.types import Array

N = 5
ROW = arrays(float, N, elements=st.floats(-2, 2))
BATCH = arrays(float, (4, 3, N), elements=st.floats(-2, 2))
KP, KI, KD = np.full(N, 3.0), np.full(N, 10.0), np.full(N, 0.1)
CLAMP, LIMIT = np.full(N, 0.2), np.full(N, 0.5)


@given(BATCH, BATCH)
def test_pd_of_a_batch_is_the_batch_of_pds(error: Array, rate: Array) -> None:
    whole = laws.pd(error, rate, KP, KD)
    for index in np.ndindex(4, 3):
        np.testing.assert_array_equal(whole[index], laws.pd(error[index], rate[index], KP, KD))


@given(BATCH, BATCH, arrays(float, (4, 3, N), elements=st.floats(-0.2, 0.2)))
def test_pid_of_a_batch_is_the_batch_of_pids(error: Array, rate: Array, integral: Array) -> None:
    whole = laws.pid(error, rate, integral, 0.003, KP, KI, KD, CLAMP, LIMIT)
    for index in np.ndindex(4, 3):
        one = laws.pid(error[index], rate[index], integral[index], 0.003, KP, KI, KD, CLAMP, LIMIT)
        np.testing.assert_array_equal(whole.torque[index], one.torque)
        np.testing.assert_array_equal(whole.integral[index], one.integral)


@given(st.lists(ROW, min_size=1, max_size=50))
def test_the_integral_never_leaves_its_clamp(errors: list[Array]) -> None:
    integral = np.zeros(N)
    for error in errors:
        integral = laws.pid(error, np.zeros(N), integral, 0.05, KP, KI, KD, CLAMP, LIMIT).integral
        assert (np.abs(integral) <= CLAMP).all()


def test_the_integral_does_not_grow_while_the_torque_is_beyond_its_limit() -> None:
    result = laws.pid(np.full(N, 1.0), np.zeros(N), np.zeros(N), 0.003, KP, KI, KD, CLAMP, LIMIT)
    np.testing.assert_array_equal(result.integral, np.zeros(N))


def test_the_integral_may_shrink_while_the_torque_is_beyond_its_limit() -> None:
    result = laws.pid(np.full(N, -0.01), np.full(N, 20.0), np.full(N, 0.1), 0.003, KP, KI, KD, CLAMP, LIMIT)
    assert (result.integral < 0.1).all()


@given(ROW)
def test_without_an_integral_gain_pid_is_pd(error: Array) -> None:
    rate = -error
    result = laws.pid(error, rate, np.zeros(N), 0.003, KP, 0 * KI, KD, CLAMP, LIMIT, 0.05)
    np.testing.assert_array_equal(result.torque, laws.pd(error, rate, KP, KD, 0.05))
