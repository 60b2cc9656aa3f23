"""One target at a time gives what a batch gives."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.spec import Side
from tests.kinematics.hands import EVERY, FINGERS, postures, solve

Key = tuple[Side, str]


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_a_scalar_fingertip_is_the_batchs(key: Key) -> None:
    finger = FINGERS[key]
    q = postures(finger, 500)
    scalar = [finger.scalar.fk(*row) for row in q.tolist()]
    np.testing.assert_allclose(scalar, finger.fk(q).position, rtol=0, atol=1e-15)


@pytest.mark.parametrize("margin", [0.0, 0.1])
@pytest.mark.parametrize("key", EVERY, ids=str)
def test_a_scalar_solve_finds_the_branches_of_the_batch(key: Key, margin: float) -> None:
    """Points that are reached, and points anywhere, most of which are not."""
    finger, scalar = FINGERS[key], FINGERS[key].scalar
    q = postures(finger, 700, seed=1)
    points = finger.fk(q).position
    points[450:] = np.random.default_rng(2).uniform(-0.1, 0.15, (250, 3))
    thumb = finger.name == "thumb"
    held = {"q0": q[:, 0], "q1": q[:, 1], "psi": q[:, 2] + q[:, 3]} if thumb else {"pitch": q[:, 1:].sum(axis=1)}
    ways = {"pitch": scalar.at_pitch, "q0": scalar.at_q0, "q1": scalar.at_q1, "psi": scalar.at_psi}
    for name, values in held.items():
        for point, value in zip(points, values, strict=True):
            batch = solve(finger, point, {name: value}, margin)
            expected = batch.position[batch.within]
            found = np.array(ways[name](point[0], point[1], point[2], float(value), margin)).reshape(-1, 4)
            assert len(found) == len(expected)
            order = np.lexsort(np.round(found, 5).T), np.lexsort(np.round(expected, 5).T)
            np.testing.assert_allclose(found[order[0]], expected[order[1]], rtol=0, atol=1e-8)


def test_a_scalar_target_out_of_reach_has_no_posture() -> None:
    assert FINGERS["right", "index"].scalar.at_pitch(0.0, 0.0, 0.5, 0.3) == []
    assert FINGERS["right", "thumb"].scalar.at_q0(0.0, 0.0, 0.5, 0.6) == []
    assert FINGERS["right", "thumb"].scalar.at_q1(0.5, 0.0, 0.0, 0.6) == []
    assert FINGERS["right", "thumb"].scalar.at_psi(0.0, 0.0, 0.5, 0.6) == []


def test_a_way_of_another_finger_is_refused() -> None:
    with pytest.raises(ConfigError, match="thumb has no pitch"):
        FINGERS["right", "thumb"].scalar.at_pitch(0.0, 0.0, 0.1, 0.3)
    with pytest.raises(ConfigError, match="use at_pitch"):
        FINGERS["right", "ring"].scalar.at_q0(0.0, 0.0, 0.1, 0.3)
