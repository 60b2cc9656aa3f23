"""Straight lines through recordings: where the fit begins, with and without friction that breaks away."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from allegro_twin.sim.open_loop import OpenLoopPlayer
from allegro_twin.twin.identify.fitting.regress import (
    _solve_near_likely,
    friction_side,
    regress,
    regress_breakaway,
    regress_presliding,
    shifted_duty,
)
from allegro_twin.twin.identify.motions.motion import read_motion
from allegro_twin.types import Array, Vector
from tests.twin.identify import hidden


@pytest.mark.slow
def test_friction_that_breaks_away_and_grows_with_the_torque_has_a_line_of_its_own() -> None:
    motions = [read_motion(path) for path in hidden.recordings(breaking=True)]
    player = OpenLoopPlayer(motions[0].spec, motions[0].period)
    start = regress(motions, player, np.ones(16))
    found = regress_breakaway(motions, player, start)
    off = [np.abs(each.torque_constant / hidden.CONSTANT - 1.0) for each in (start, found)]
    assert np.median(off[1]) < 0.04
    assert np.median(off[1]) < 0.7 * np.median(off[0])
    assert np.median(np.abs(found.frictionloss - hidden.FRICTION)) < 1.5e-3
    assert np.median(np.abs(found.damping / hidden.DAMPING - 1.0)) < 0.05
    assert 1.2 < np.median(found.stiction) < 1.6  # The filter rounds its peak off.
    assert (found.load_friction > 0.02).mean() > 0.7


PERIOD = 0.003
K, A, B, F, DELAY = (np.array([0.9, 1.2]), np.array([2e-3, 4e-3]), np.array([0.06, 0.1]), np.array([0.02, 0.03]), 0.004)


class Links:
    """A pendulum a joint."""

    def links_only(self, mass_scale: Any, weight: Any) -> None:
        self.scale = mass_scale

    def link_torque(self, q: Vector, v: Vector, a: Vector, gravity: Vector) -> Vector:
        return np.asarray(0.25 * np.sin(q) + 1e-3 * a)


def moved(seed: int, friction: Any) -> Any:
    """Two joints on sums of sines, and the part of full PWM that moves them so, a delay before it acts."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(2400)
    hertz, phase = rng.uniform(0.3, 3.5, (5, 2)), rng.uniform(0.0, 6.0, (5, 2))

    def at(when: Any) -> tuple[Array, Array, Array]:
        turn = 2 * np.pi * hertz * when[:, None, None] + phase
        w = 2 * np.pi * hertz
        sums = (np.sin(turn), w * np.cos(turn), -(w**2) * np.sin(turn))
        q, v, a = (0.2 * each.sum(axis=1) for each in sums)
        return q, v, a

    q, v, a = at(t - PERIOD / 2 + DELAY)  # A period's duty acts from the row before it on, and later by the delay.
    torque = 0.25 * np.sin(q) + 1e-3 * a + A * a + B * v
    duty = friction(torque, v)
    return SimpleNamespace(
        position=at(t)[0], period=PERIOD, duty=duty, good=np.ones((len(t), 2)), spec=SimpleNamespace(n_joints=2),
        weight=np.ones(2), gravity=np.array([0.0, 0.0, -9.81]),
    )  # fmt: skip


def test_a_straight_line_finds_what_made_the_motion() -> None:
    motions: Any = [moved(seed, lambda torque, v: (torque + F * np.tanh(v / 0.02)) / K) for seed in (1, 2)]
    player: Any = Links()
    found = regress(motions, player, np.full(2, 0.7))
    np.testing.assert_array_equal(player.scale, [0.7, 0.7])
    np.testing.assert_allclose(found.torque_constant, K, rtol=0.02)
    np.testing.assert_allclose(found.armature, A, rtol=0.06)
    np.testing.assert_allclose(found.damping, B, rtol=0.03)
    np.testing.assert_allclose(found.frictionloss, F, rtol=0.06)
    np.testing.assert_allclose(found.delay, [DELAY, DELAY], atol=5.1e-4)
    assert (found.offset == 0.0).all()
    assert (found.stiction == 1.3).all()
    np.testing.assert_array_equal(found.mass_scale, [0.7, 0.7])


def test_rows_that_are_no_good_or_too_slow_do_not_count_and_too_few_say_nothing() -> None:
    (motion,) = motions = [moved(3, lambda torque, v: (torque + F * np.tanh(v / 0.02)) / K)]
    motion.duty[1200:] = 5.0  # Nonsense, which is known to be.
    motion.good[1150:] = 0.0
    found = regress(motions, Links(), np.ones(2))  # type: ignore[arg-type]  # All that is asked of it.
    np.testing.assert_allclose(found.torque_constant, K, rtol=0.1)
    motion.good[:] = 0.0
    nothing = regress(motions, Links(), np.ones(2))  # type: ignore[arg-type]  # Likewise.
    np.testing.assert_allclose(nothing.torque_constant, [1.0, 1.0])
    np.testing.assert_allclose(nothing.armature, [3e-3, 3e-3])
    np.testing.assert_allclose(nothing.damping, [0.07, 0.07])
    np.testing.assert_allclose(nothing.frictionloss, [0.02, 0.02])


def test_friction_that_is_larger_when_slow_is_found_beside_that_of_a_load() -> None:
    def rubbed(torque: Array, v: Array) -> Array:
        side, slow = np.tanh(v / 0.02), np.exp(-np.square(v / 0.14))
        dry = F * (1.0 + 0.5 * slow)
        return np.asarray((torque + side * (dry + 0.04 * np.abs(torque))) / K)

    motions: Any = [moved(seed, rubbed) for seed in (1, 2, 3)]
    start = regress(motions, Links(), np.ones(2))  # type: ignore[arg-type]  # Likewise.
    found = regress_breakaway(motions, Links(), start)  # type: ignore[arg-type]  # Likewise.
    np.testing.assert_allclose(found.torque_constant, K, rtol=0.05)
    np.testing.assert_allclose(found.frictionloss, F, rtol=0.2)
    assert ((found.stiction > 1.15) & (found.stiction < 2.0)).all()
    assert set(found.stribeck_speed) <= {0.07, 0.1, 0.14, 0.2}
    assert ((found.load_friction > 0.01) & (found.load_friction < 0.08)).all()
    assert found.delay.tolist() == start.delay.tolist()


@pytest.mark.parametrize(("give", "found"), [(0.01, True), (0.0, False)])
def test_friction_that_gives_far_before_it_slides_is_told_from_one_that_does_not(give: float, *, found: bool) -> None:
    def rubbed(torque: Array, v: Array) -> Array:
        return np.asarray((torque + 5.0 * F * friction_side(v, np.full(2, give), PERIOD)) / K)

    motions: Any = [moved(seed, rubbed) for seed in (1, 2, 3)]
    start = regress(motions, Links(), np.ones(2))  # type: ignore[arg-type]  # Likewise.
    far = regress_presliding(motions, Links(), start)  # type: ignore[arg-type]  # Likewise.
    assert (far is not None) == found
    if far is not None:
        np.testing.assert_allclose(far.bristle, give, rtol=0.5)  # The filter shortens it.
        np.testing.assert_allclose(far.frictionloss, 5.0 * F, rtol=0.15)
        np.testing.assert_allclose(far.torque_constant, K, rtol=0.05)


def test_friction_acts_against_the_motion_and_where_it_gives_by_the_way_come_so_far() -> None:
    velocity = np.tile([[0.1, 0.1]], (40, 1))  # 0.3 mrad a period, 12 in all.
    share = friction_side(velocity, np.array([0.0, 0.006]), 0.003)
    np.testing.assert_allclose(share[:, 0], 1.0, atol=1e-4)
    np.testing.assert_allclose(share[:, 1], 1.0 - np.exp(-np.arange(1, 41) * 0.0003 / 0.006))
    back = friction_side(np.concatenate([velocity, -velocity]), np.array([0.0, 0.006]), 0.003)
    assert (back[40:, 0] < -0.99).all()
    assert back[40, 1] > 0.7  # It still pulls the other way.
    assert back[-1, 1] < -0.7


def test_what_acted_around_a_row_is_the_mean_of_the_periods_beside_it_earlier_by_the_delay() -> None:
    duty = np.array([[0.0], [1.0], [3.0], [2.0]])
    np.testing.assert_allclose(shifted_duty(duty, 0.0), [[0.5], [2.0], [2.5], [2.0]])
    np.testing.assert_allclose(shifted_duty(duty, 1.0), [[0.5], [0.5], [2.0], [2.5]])
    np.testing.assert_allclose(shifted_duty(duty, 0.5), [[0.5], [1.25], [2.25], [2.25]])


def test_a_motor_that_is_likely_is_held_as_firmly_as_what_is_left_is_large() -> None:
    """1/k is pulled to 1 by a row of weight 10 · left / 0.15, a load's share to 0.03 by one of 10 · left / 0.03."""
    rng = np.random.default_rng(4)
    a = rng.normal(size=(50, 6))
    b = a @ np.array([0.8, 0.1, 0.2, 0.3, 0.4, 0.1]) + 0.01 * rng.normal(size=50)
    left = 0.5
    weights = np.array([10.0 * left / 0.15, 10.0 * left / 0.03])
    normal, right = a.T @ a, a.T @ b
    normal[0, 0] += weights[0] ** 2
    normal[5, 5] += weights[1] ** 2
    right[[0, 5]] += weights**2 * np.array([1.0, 0.03])
    np.testing.assert_allclose(_solve_near_likely(a, b, left), np.linalg.solve(normal, right))
