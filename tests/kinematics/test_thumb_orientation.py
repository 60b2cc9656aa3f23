"""The thumb's closed form for an orientation that it cannot have: sure in a few steps, and right where it is sure."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.kinematics.closed_form.forms.thumb import ThumbForms
from allegro_twin.kinematics.closed_form.geometry import load_geometry
from allegro_twin.kinematics.maths import ARRAYS, FLOATS
from allegro_twin.kinematics.orientation import entries_of_matrix, matrix_from_quaternion, quaternion_from_vector
from allegro_twin.types import Array
from tests.kinematics.hands import SPECS

SPEC = SPECS["right"]
JOINTS = list(SPEC.finger("thumb").joints)
THUMB = ThumbForms(load_geometry(SPEC.model, "thumb"), SPEC.lower[JOINTS], SPEC.upper[JOINTS])
COUNT = 1000


def asked(noise: float) -> tuple[tuple[Array, Array, Array], tuple[Array, ...]]:
    """Points of postures in the middle of the ranges, and orientations that are off theirs by an angle, rad."""
    random = np.random.default_rng(23)
    low, high = SPEC.lower[JOINTS], SPEC.upper[JOINTS]
    q = np.moveaxis(random.uniform(low + 0.25 * (high - low), high - 0.25 * (high - low), (COUNT, 4)), -1, 0)
    axes = random.normal(size=(COUNT, 3))
    turn = quaternion_from_vector(axes * (noise / np.linalg.norm(axes, axis=1, keepdims=True)))
    wanted = THUMB.rotation(q)
    x, y, z = THUMB.tip(q)
    return (x, y, z), THUMB.view(ARRAYS, entries_of_matrix(wanted @ matrix_from_quaternion(turn)))


@pytest.mark.parametrize(("noise", "count"), [(0.001, 1000), (0.02, 941), (0.1, 441)])
def test_a_few_steps_make_it_sure_of_all_that_it_was_sure_of(noise: float, count: int) -> None:
    """A slope that is taken wrongly still ends at the minimum or is not sure: what is lost is seen in how many are."""
    point, view = asked(noise)
    _, _, sure = THUMB.turned_nearer(ARRAYS, point, view, np.full(COUNT, noise))
    assert np.asarray(sure).sum() == pytest.approx(count, abs=2)  # For rounding elsewhere.


def test_where_it_is_sure_no_posture_beside_it_is_turned_nearer_and_one_target_is_as_many() -> None:
    point, view = asked(0.02)
    q, angle, sure = THUMB.turned_nearer(ARRAYS, point, view, np.full(COUNT, 0.02))
    rows = np.flatnonzero(np.asarray(sure))
    np.testing.assert_allclose(np.array(THUMB.tip(np.array(q)))[:, rows], np.array(point)[:, rows], rtol=0, atol=1e-14)
    assert (angle[rows] <= 0.02).all()
    for step in (-1e-4, 1e-4):
        beside = THUMB.at_q0(ARRAYS, *point, q[0] + step)
        turned = [THUMB.angle_to(ARRAYS, branch, view) for branch in beside]
        off = np.min(np.where(np.isnan(turned), np.inf, turned), axis=0)
        assert (angle[rows] < off[rows]).all()
    for row in range(0, COUNT, 10):
        one = tuple(float(part[row]) for part in view)
        alone, left, certain = THUMB.turned_nearer(FLOATS, tuple(float(part[row]) for part in point), one, 0.02)  # type: ignore[arg-type]
        assert bool(certain) == np.asarray(sure)[row]
        if certain:
            np.testing.assert_allclose(alone, [joint[row] for joint in q], rtol=0, atol=1e-10)
            assert left == pytest.approx(angle[row], abs=1e-10)


def test_a_target_that_is_done_early_waits_for_the_rest_of_its_batch() -> None:
    """Its steps are then of the size of rounding, and nothing is made of their slopes."""
    parts = [asked(noise) for noise in (1e-6, 1e-4, 0.001, 0.1)]
    noises = np.repeat([1e-6, 1e-4, 0.001, 0.1], COUNT)
    point = tuple(np.concatenate(each) for each in zip(*(part[0] for part in parts), strict=True))
    view = tuple(np.concatenate(each) for each in zip(*(part[1] for part in parts), strict=True))
    _, _, together = THUMB.turned_nearer(ARRAYS, point, view, noises)  # type: ignore[arg-type]
    for row in range(0, 3 * COUNT, 10):
        here = tuple(float(part[row]) for part in point)
        _, _, alone = THUMB.turned_nearer(FLOATS, here, tuple(float(part[row]) for part in view), float(noises[row]))  # type: ignore[arg-type]
        assert bool(alone) == np.asarray(together)[row]
    assert np.asarray(together)[: 3 * COUNT].all()
