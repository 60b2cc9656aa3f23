"""Parameters are found finger by finger: one that is stuck or mad holds up no other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from allegro_twin.twin.identify.fitting.fit import UNSEEN_BUMPS, _vagueness
from allegro_twin.twin.identify.fitting.levenberg_marquardt import LONGEST, DescentResult, _step, descend
from allegro_twin.twin.identify.fitting.problem import Problem
from allegro_twin.types import Array, Vector

W, ROWS = 12, 5
TRUTH = np.array([0.7, 2.0, 0.3])
"""Of finger 0, of finger 1, and the delay of both."""


class Toy:
    """Two fingers with a parameter each and one that they share: r = a (x - truth) + b (delay - truth), a row a piece
    and moment. Of finger 1 the derivatives point the wrong way if it is `mad`; in piece 3 something else happened."""

    fingers = ((0,), (1,))
    active = np.arange(3)
    shared = np.array([2])
    prior = 1e-3 * np.eye(3)
    cuts = SimpleNamespace(recording=np.zeros(W))

    def __init__(self, *, mad: bool = False, odd: float = 0.0, lever: float = 1.0, least: float = -9.0) -> None:
        rng = np.random.default_rng(2)
        self._a, self._b = 1.0 + rng.uniform(0.0, 1.0, (2, W * ROWS)), rng.uniform(-1.0, 1.0, (2, W * ROWS))
        self._a[0][3 * ROWS : 4 * ROWS] *= lever
        self._mad, self._odd, self.least = mad, odd, np.full(3, least)
        self.forgot = 0
        self.shooting = SimpleNamespace(
            prepare=lambda drive: None,
            improve_starts=lambda drive: None,
            rows=lambda finger: ROWS,
            reset_sensitivities=self._forget,
        )

    def _forget(self) -> None:
        self.forgot += 1

    def x_of(self, drive: Vector) -> Vector:
        return drive

    drive_of = x_of

    def columns(self, finger: int) -> Any:
        return np.array([finger])

    def parts(self) -> list[tuple[int, slice]]:
        return [(f, slice(f * W * ROWS, (f + 1) * W * ROWS)) for f in range(2)]

    def residuals(self, x: Vector) -> Vector:
        off = x - TRUTH
        rows = [self._a[f] * off[f] + self._b[f] * off[2] for f in range(2)]
        rows[0][3 * ROWS : 4 * ROWS] += self._odd
        return np.concatenate([*rows, self.prior @ x])

    def jacobian(self, x: Vector) -> Array:
        found = np.zeros((2 * W * ROWS + 3, 3))
        for f, rows in self.parts():
            found[rows, f], found[rows, 2] = self._a[f], self._b[f]
        if self._mad:
            found[W * ROWS : 2 * W * ROWS, 1] *= -1.0
        found[2 * W * ROWS :] = self.prior
        return found


def found(toy: Toy, *, anew: bool = False) -> tuple[Vector, DescentResult]:
    last = descend(cast(Problem, toy), cast(Any, np.zeros(3)), 4, 0.01, anew=anew)
    return cast(Vector, last.drive), last


def test_all_is_found_where_nothing_is_wrong() -> None:
    np.testing.assert_allclose(found(Toy())[0], TRUTH, atol=1e-3)


def test_what_was_known_before_draws_a_drive_away_from_where_the_data_alone_are_best() -> None:
    toy = Toy()
    toy.prior = 5.0 * np.eye(3)
    drive = cast(Vector, descend(cast(Problem, toy), cast(Any, TRUTH.copy()), 4, 0.01).drive)
    J = toy.jacobian(TRUTH)
    best = TRUTH - np.linalg.lstsq(J, toy.residuals(TRUTH), rcond=None)[0]
    assert np.linalg.norm(best - TRUTH) > 0.2
    np.testing.assert_allclose(drive, best, atol=0.1)


def test_a_finger_whose_derivatives_mislead_stays_and_the_other_arrives() -> None:
    drive, _ = found(Toy(mad=True))
    assert abs(drive[0] - TRUTH[0]) < 0.05
    assert drive[1] >= -0.01  # It went no further from where it should be than it was.


def test_a_piece_that_is_off_by_tens_of_the_noise_hardly_counts() -> None:
    drive, last = found(Toy(odd=40.0))
    np.testing.assert_allclose(drive, TRUTH, atol=0.02)
    weights = last.weight[: W * ROWS].reshape(W, ROWS)[:, 0]
    assert weights[3] < 0.1
    assert (np.delete(weights, 3) > 0.85).all()


def test_a_piece_that_answers_to_the_smallest_change_hardly_counts_either() -> None:
    drive, last = found(Toy(odd=2.0, lever=30.0))
    weights = last.weight[: W * ROWS].reshape(W, ROWS)[:, 0]
    assert weights[3] < 0.3 * np.delete(weights, 3).min()
    np.testing.assert_allclose(drive, TRUTH, atol=0.02)


def test_no_step_is_longer_than_derivatives_are_trusted_for() -> None:
    toy = Toy()
    tried: list[Vector] = []
    inner = toy.residuals

    def watched(x: Vector) -> Vector:
        tried.append(x)
        return inner(x)

    toy.residuals = watched  # type: ignore[method-assign]  # To see where it is asked.
    np.testing.assert_allclose(found(toy)[0], TRUTH, atol=1e-3)
    assert tried[1][1] == pytest.approx(LONGEST)  # The first step of finger 1, which has 2 to go.


def test_what_would_leave_its_range_ends_at_its_end() -> None:
    drive, _ = found(Toy(least=1.0))
    assert drive[0] == 1.0
    assert drive[2] == 1.0
    assert drive[1] > 1.0


def test_derivatives_of_single_joints_are_found_anew_in_every_round_only_where_that_is_asked_for() -> None:
    plain, anew = Toy(), Toy()
    found(plain)
    found(anew, anew=True)
    assert plain.forgot == 0
    assert 2 <= anew.forgot <= 4


def bounded(least: list[float], active: list[int] | None = None) -> Any:
    """What a step asks of a problem: two fingers with a parameter each, and the delay."""
    return SimpleNamespace(
        columns=lambda finger: np.array([finger]), active=np.array(active or [0, 1, 2]), least=np.array(least),
        shared=np.array([2]),
    )  # fmt: skip


NORMAL = np.array([[2.0, 0.0, 0.5], [0.0, 1.0, -0.3], [0.5, -0.3, 4.0]])
GRADIENT = np.array([0.8, -0.4, 0.6])


def test_a_step_solves_for_all_at_once_with_each_finger_damped_by_itself() -> None:
    damped = NORMAL + np.diag([0.5 * 2.0, 0.25 * 1.0, 0.0])
    step = _step(bounded([-9.0] * 3), np.zeros(3), NORMAL, GRADIENT, np.array([0.5, 0.25]))
    np.testing.assert_allclose(step, np.linalg.solve(damped, -GRADIENT))


def test_what_would_leave_its_range_goes_to_its_end_and_the_others_are_solved_for_again() -> None:
    free = np.linalg.solve(NORMAL, -GRADIENT)
    assert free[0] < -0.2
    step = _step(bounded([-0.1, -9.0, -9.0]), np.array([0.1, 0.0, 0.0]), NORMAL, GRADIENT, np.zeros(2))
    assert step[0] == pytest.approx(-0.2)
    others = np.linalg.solve(NORMAL[1:, 1:], -GRADIENT[1:] - NORMAL[1:, 0] * -0.2)
    np.testing.assert_allclose(step[1:], others)
    wide = _step(bounded([-0.9, -9.0, -9.0]), np.zeros(3), NORMAL, GRADIENT, np.zeros(2))
    np.testing.assert_allclose(wide, free)


def test_what_is_held_does_not_move_and_a_finger_goes_a_unit_at_most() -> None:
    step = _step(bounded([-9.0] * 3, [1, 2]), np.zeros(3), NORMAL, GRADIENT, np.zeros(2))
    assert step[0] == 0.0
    np.testing.assert_allclose(step[1:], np.linalg.solve(NORMAL[1:, 1:], -GRADIENT[1:]))
    far = _step(bounded([-99.0] * 3), np.zeros(3), NORMAL, 10.0 * GRADIENT, np.zeros(2))
    free = np.linalg.solve(NORMAL, -10.0 * GRADIENT)
    assert np.abs(free[:2]).min() > LONGEST
    np.testing.assert_allclose(far[:2], np.sign(free[:2]) * LONGEST)
    assert far[2] == pytest.approx(free[2]), "the delay is all fingers'"


AWAY = np.array([-2.0, -1.0, -0.5, 0.5, 1.0, 2.0]) * 1e-3
VALLEY = (AWAY / 1e-3) ** 2


def test_a_delay_is_vague_only_where_the_cost_beside_it_falls_again() -> None:
    assert _vagueness(AWAY, VALLEY) == 0.0
    assert _vagueness(AWAY, np.sqrt(VALLEY)) == 0.0, "however it rises"
    bumpy = VALLEY + np.array([0.0, 0.0, 1.25, 0.0, 0.0, 0.0])  # 1.5 at -0.5 ms, and 1 at -1 ms.
    assert _vagueness(AWAY, bumpy) == pytest.approx(1e-3 * np.sqrt(UNSEEN_BUMPS * 0.5))
    lower = VALLEY - np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0])  # A descent from there came back.
    assert _vagueness(AWAY, lower) == pytest.approx(1e-3 * np.sqrt(UNSEEN_BUMPS * 0.25))
    flat = np.zeros(6)
    assert _vagueness(AWAY, flat) == 0.0
    assert _vagueness(AWAY, np.array([0.0, 0.9, 0.5, 0.5, 0.9, 0.0])) == 2e-3, "no more than was tried"


def test_a_delay_at_the_end_of_its_range_is_judged_by_the_other_side() -> None:
    away = np.array([0.0, 0.0, 0.0, 0.5, 1.0, 2.0]) * 1e-3
    rises = np.array([0.0, 0.0, 0.0, 1.5, 1.0, 4.0])
    assert _vagueness(away, rises) == pytest.approx(1e-3 * np.sqrt(UNSEEN_BUMPS * 0.5))
