"""The report says what the rows say: its charts and words are looked at once and kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from allegro_twin.viewing.report import IntervalRow, interval_chart
from studies.preemption.dose_response import Dose
from studies.preemption.page import _apart, _dose_chart, page
from tests.snapshots import assert_snapshot
from tests.studies import small

SNAPSHOTS = Path(__file__).with_name("snapshots")


def test_differences_lie_on_their_intervals_about_a_line_at_nought() -> None:
    rows = [
        IntervalRow("sih, P50", 2.5, -1.0, 6.0, "p 0.2"),
        IntervalRow("<o>, P25", -4.0, -9.5, 0.5, "p 1"),
    ]
    assert_snapshot(interval_chart(rows, "Success", "pp", limit=-5.0), SNAPSHOTS / "differences.svg")
    assert_snapshot(interval_chart(rows[:1], "Success", "pp"), SNAPSHOTS / "difference.svg")
    assert "stroke-dasharray" not in interval_chart(rows, "Success", "pp")
    assert_snapshot(
        interval_chart([IntervalRow("none", 0.0, 0.0, 0.0, "")], "None", "s"), SNAPSHOTS / "no_difference.svg"
    )


def test_a_curve_of_rates_has_its_dots_and_its_name_at_its_end() -> None:
    curves = {
        "σ 0 mm": (Dose(3.0, -2.0), [(0.0, 19, 20), (0.5, 18, 20), (0.9, 0, 0)]),
        "σ 9 mm": (Dose(2.0, -4.0), [(0.25, 7, 10)]),
    }
    assert_snapshot(_dose_chart(curves, "Success"), SNAPSHOTS / "doses.svg")


def test_names_at_the_same_height_are_written_one_below_the_other() -> None:
    assert _apart({"b": 50.0, "a": 49.0, "c": 100.0}, 14.0) == {"a": 49.0, "b": 63.0, "c": 100.0}


@pytest.mark.parametrize(("a", "b", "half"), [(0.0, -2.0, np.log(3.0) / 2.0), (2.0, -3.0, 0.7465149)])
def test_half_of_the_success_is_gone_where_the_curve_says(a: float, b: float, half: float) -> None:
    """With a = 0 the rate at 0 is a half, and e^(-b φ) = 1/3 where it is a quarter."""
    dose = Dose(a, b)
    assert dose.half == pytest.approx(half, abs=1e-6)
    assert dose.rate(dose.half) == pytest.approx(0.5 * dose.rate(0.0))
    assert Dose(a, 0.0).half == np.inf


def test_the_report_is_as_it_was_when_somebody_looked_at_it() -> None:
    """Of two hands: with one success falls where the overlap grows, and with the other nearly nothing is held."""
    full = small.study(hands={"sih": "sih_{object}", "model_o": "model_o_{object}"}, pairs={"train": 8, "test": 24})
    falls = {"P0": 0.55, "P0e": 0.6, "P25": 0.9, "P50": 0.9, "P75": 0.7, "P90": 0.3, "Pd": 0.8, "Pc": 0.85}
    made = small.rows(full, falls, seed=3)
    for number, row in enumerate(made):
        row |= {"premature_s": 0.01 * (number % 7), "carried_mm": 0.5 * (number % 5), "peak_n": 1.0 + number % 11}
        row |= {"said_held": number % 6 > 0, "held": row["held"] and (row["hand"] == "sih" or number % 3 > 0)}
    for name, control in full.controls.items():
        base = [row for row in made if row["set"] == "test" and row["policy"] in control.policies]
        made += [row | {"control": name, "held": row["trial"] % 4 > 0} for row in base if row["trial"] % 2 == 0]
    assert_snapshot(page(made, full, {"engine": "mujoco", "protocol": "<a>"}), SNAPSHOTS / "report.html")
