"""From rows to the answer."""

from __future__ import annotations

import pytest

from studies.preemption.analysis import analysed, choices, chosen
from studies.preemption.outcomes import control_of, outcomes_of
from studies.preemption.page import page
from studies.preemption.protocol import Study, load_study
from studies.preemption.report_text import answer_of, by_definition, choices_of, sentence
from tests.studies.small import rows

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


def test_how_settled_the_choice_is_shows_when_training_pairs_are_drawn_again(full: Study) -> None:
    alike = outcomes_of(rows(full, ALIKE), full, "sih", "train")
    assert choices(alike, full.analysis, 0) == {"P25": 0.0, "P50": 0.0, "P75": 0.0, "P90": 1.0}
    near = outcomes_of(rows(full, ALIKE | {"P90": 0.78}), full, "sih", "train")
    shares = choices(near, full.analysis, 0)
    assert sum(shares.values()) == pytest.approx(1.0)
    assert 0.05 < shares["P90"] < 0.95
    lost = sum(a and not b for a, b in zip(near.held("P0e"), near.held("P90"), strict=True))
    assert lost > 0
    # P90 is chosen where at most one of those that it lost is drawn: 2 points of 60 are 1.2 pairs.
    share, n = lost / 60, 60
    expected = (1 - share) ** n + n * share * (1 - share) ** (n - 1)
    assert shares["P90"] == pytest.approx(expected, abs=0.02)
    assert choices(near, full.analysis, 0) == shares


def test_what_an_overlap_saves_by_definition_is_said_beside_what_was_saved(full: Study) -> None:
    answer = analysed(rows(full, ALIKE), full)
    (found,) = answer.findings
    assert by_definition(found, full) == pytest.approx(0.9 * 0.8)
    assert "of it -0.72 s by definition" in sentence(found, answer, full)
    assert choices_of(found) == "Of 60 pairs of train drawn again: P90 100 %."
