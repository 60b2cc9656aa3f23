"""The palm's orientation tells where down is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.imu import STANDARD_GRAVITY, gravity_of, orientation_of
from allegro_twin.drivers.can.codec.versions import make_codec

UNIT = st.tuples(*[st.floats(-1.0, 1.0)] * 3)


@given(UNIT)
def test_gravity_becomes_an_orientation_and_gravity_again(direction: tuple[float, float, float]) -> None:
    length = float(np.linalg.norm(direction))
    assume(length > 0.1)
    gravity = STANDARD_GRAVITY * np.array(direction) / length
    quaternion = orientation_of(gravity)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0)
    np.testing.assert_allclose(
        gravity_of(quaternion), gravity, atol=5e-4
    )  # √2e-9 of it where the turn is taken for a half.


@given(UNIT)
def test_on_the_wire_gravity_keeps_a_part_in_ten_thousand(direction: tuple[float, float, float]) -> None:
    length = float(np.linalg.norm(direction))
    assume(length > 0.1)
    gravity = STANDARD_GRAVITY * np.array(direction) / length
    codec = make_codec("v4")
    read = codec.decode(codec.encode(m.Imu(orientation_of(gravity))))
    assert isinstance(read, m.Imu)
    np.testing.assert_allclose(gravity_of(read.orientation), gravity, atol=1e-3)


def test_how_the_hand_is_turned_is_where_its_gravity_points() -> None:
    half = np.sqrt(0.5)
    np.testing.assert_allclose(gravity_of((1.0, 0.0, 0.0, 0.0)), [0, 0, -9.81])  # Fingers up.
    np.testing.assert_allclose(gravity_of((0.0, 1.0, 0.0, 0.0)), [0, 0, 9.81], atol=1e-15)  # Fingers down.
    np.testing.assert_allclose(gravity_of((half, half, 0.0, 0.0)), [0, -9.81, 0], atol=1e-12)  # Turned about x.


def test_what_is_no_quaternion_says_nothing_of_gravity() -> None:
    assert np.isnan(gravity_of((0.0, 0.0, 0.0, 0.0))).all()
