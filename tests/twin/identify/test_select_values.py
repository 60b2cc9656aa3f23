"""What goes into a hand's file fits what does not: values that are doubtful each and sure together."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from allegro_twin.twin.identify.fitting.fit import DriveFit
from allegro_twin.twin.identify.fitting.parameterisation import index, scaling_jacobian, to_scaled, units
from allegro_twin.twin.identify.results import written_drive
from allegro_twin.twin.identify.results.written_drive import select_values
from tests.twin.identify import hidden

JOINT, LOAD = 3, 0.05
ONLY = np.arange(16) == JOINT

pytestmark = pytest.mark.slow  # They begin with a whole identification.


def doubted(between: tuple[str, str] | None = None, correlation: float = 0.0) -> DriveFit:
    """A fit with load friction whose values, as the descent has them, are equally doubtful and of one joint two are
    correlated."""
    fit = hidden.found().fit
    drive = replace(fit.drive, load_friction=np.full(16, LOAD))
    C = np.eye(len(to_scaled(drive)))
    if between:
        one, other = (index(name, 16).start + JOINT for name in between)
        C[one, other] = C[other, one] = correlation
    by = scaling_jacobian(drive)
    return replace(fit, drive=drive, spread=replace(fit.spread, covariance=by @ C @ by.T))


def test_a_file_without_load_friction_has_the_torque_constant_that_fits_none() -> None:
    found = doubted()
    own = select_values(found, {"load_friction": ONLY}, replace(found.drive, load_friction=np.zeros(16)))
    expected = found.drive.torque_constant * np.where(ONLY, 1.0 - LOAD, 1.0)
    np.testing.assert_allclose(own.torque_constant, expected, rtol=1e-9)
    np.testing.assert_array_equal(own.load_friction, np.where(ONLY, 0.0, LOAD))
    np.testing.assert_allclose(own.frictionloss, found.drive.frictionloss, rtol=1e-9)


@pytest.mark.parametrize("correlation", [-0.5, 0.8])
def test_a_value_follows_one_that_stays_as_far_as_both_are_correlated(correlation: float) -> None:
    found = doubted(("offset", "torque_constant"), correlation)
    own = select_values(found, {"offset": ONLY}, replace(found.drive, offset=np.zeros(16)))
    one, other = (index(name, 16).start + JOINT for name in ("offset", "torque_constant"))
    expected = to_scaled(found.drive)
    expected[other] -= correlation * found.drive.offset[JOINT] / units(16)[one]
    expected[one] = 0.0
    np.testing.assert_allclose(to_scaled(own), expected, rtol=1e-9, atol=1e-12)


def test_where_all_is_determined_the_file_has_what_was_found() -> None:
    found = doubted(("offset", "torque_constant"), 0.8)
    own = select_values(found, {"offset": np.zeros(16, dtype=bool)}, found.drive)
    np.testing.assert_allclose(to_scaled(own), to_scaled(found.drive), rtol=1e-9)


def test_a_finger_is_not_put_back_where_it_is_worse_with_the_hands_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    found = hidden.found()
    nominal = replace(found.fit.drive, torque_constant=np.ones(16), delay=np.zeros(16))
    usual = np.array([0, 1, 2, 3])

    class Trial:
        pieces, seconds, fingers = 1, 1.0, [list(range(4 * k, 4 * k + 4)) for k in range(4)]

        def __init__(self, *_: object) -> None: ...

        def errors(self, drive: Any) -> Any:
            wrong = np.full(16, 0.2 if drive.delay[0] == 0.0 else 0.02)
            alone = (drive.torque_constant[usual] == 1.0).all()
            wrong[usual] = (0.01 if drive.delay[0] == 0.0 else 0.5) if alone else 0.1
            return wrong

        def total(self, drive: Any) -> float:
            return float(np.square(self.errors(drive)).sum())

    monkeypatch.setattr(written_drive, "_Trial", Trial)
    monkeypatch.setattr(written_drive, "select_values", lambda *_: found.fit.drive)
    written = written_drive.choose_drive(found.fit, found.values, [], nominal, {})
    assert set(written.source) == {"all"}  # As good as the determined ones, and before them.
    assert written.errors["written"][usual].tolist() == [0.1] * 4
