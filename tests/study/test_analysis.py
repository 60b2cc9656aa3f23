"""From rows to the answer."""

from __future__ import annotations

import pytest

from allegro_twin.study.analysis import analysed, chosen
from allegro_twin.study.outcomes import control_of, outcomes_of
from allegro_twin.study.page import page
from allegro_twin.study.protocol import Study, load_study
from allegro_twin.study.told import answer_of
from tests.study.small import rows

ALIKE = dict.fromkeys(("P0", "P0e", "P25", "P50", "P75", "P90", "Pd", "Pc"), 0.8)


@pytest.fixture(scope="module")
def full() -> Study:
    return load_study("preemption").model_copy(update={"hands": {"sih": "sih_{object}"}})


def test_where_success_is_the_same_the_longest_overlap_beats(full: Study) -> None:
    answer = analysed(rows(full, ALIKE), full)
    (found,) = answer.findings
    assert found.chosen == "P90"
    assert found.primary.counts.draws == 1512
    assert found.primary.seconds == pytest.approx(-0.72)
    assert answer.beats == {"sih": True}
    assert "beats reach-then-grasp with sih" in answer_of(answer, full)


def test_where_success_falls_it_does_not_beat_however_fast_it_is(full: Study) -> None:
    answer = analysed(rows(full, ALIKE | dict.fromkeys(("P25", "P50", "P75", "P90"), 0.7)), full)
    (found,) = answer.findings
    assert found.chosen == "P25"  # None is good on train.
    assert answer.beats == {"sih": False}
    assert found.primary.p_value < 1e-6
    assert found.primary.counts.only_first == 0
    assert "success is worse with sih" in answer_of(answer, full)


def test_a_loss_that_nobody_can_tell_is_not_called_none(full: Study) -> None:
    few = full.model_copy(update={"pairs": full.pairs.model_copy(update={"test": 84})})
    answer = analysed(rows(few, ALIKE | {"P90": 0.78}), few)
    assert answer.findings[0].primary.inferior > 0.0
    assert answer.mcnemar["sih"] <= 1.0


def test_only_whole_blocks_count(full: Study) -> None:
    made = [row for row in rows(full, ALIKE) if not (row["trial"] >= 100 and row["policy"] == "Pc")]
    assert len(outcomes_of(made, full, "sih", "test").trials) == 84
    holed = [row for row in made if not (row["trial"] == 3 and row["set"] == "test" and row["policy"] == "P0")]
    assert outcomes_of(holed, full, "sih", "test").trials == ()
    assert analysed(holed, full).findings == ()


def test_the_overlap_is_chosen_on_train_alone(full: Study) -> None:
    falls = ALIKE | {"P75": 0.5, "P90": 0.5}
    train = [row for row in rows(full, falls) if row["set"] == "train"]
    test = [row for row in rows(full, ALIKE) if row["set"] == "test"]
    assert chosen(outcomes_of(train, full, "sih", "train"), full.analysis) == "P50"
    assert analysed(train + test, full).findings[0].chosen == "P50"


def test_a_page_of_nothing_says_so(full: Study) -> None:
    assert "Nothing can be said" in page([], full, {})


def test_a_control_is_none_of_the_studys_own_trials(full: Study) -> None:
    made = rows(full, ALIKE)
    frozen = [row | {"control": "frozen", "held": False} for row in made if row["set"] == "test"]
    assert sum(outcomes_of(made + frozen, full, "sih", "test").held("P0e")) > 1000
    (first, *_) = control_of(made + frozen, full, "sih", "frozen")
    assert first[0]["held"] is False
    assert first[1] is not None
    assert first[1]["trial"] == first[0]["trial"]
