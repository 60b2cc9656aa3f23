"""Learning when to close: by what is known before a trial, and by nothing that came of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from studies.preemption.analysis import analysed
from studies.preemption.learning import context, learn
from studies.preemption.outcomes import outcomes_of
from tests.studies.small import arm_study, rows

STUDY = arm_study(
    train=["train_box", "train_cylinder", "train_ball", "train_egg"], test=["small_ball", "tall_box"],
    pairs={"train": 96, "test": 8}, strata={"position": [0.0, 0.005, 0.01, 0.02], "yaw": [0.0], "friction": [0.7],
                                            "approach": [0.8], "contacts": {"elliptic": {}}},
)  # fmt: skip
SECONDS = {"A": 3.2, "P50": 2.8, "P75": 2.6, "F0": 2.8, "F50": 2.6, "F75": 2.5}


def train(fails: dict[str, float]) -> dict[str, list[dict[str, Any]]]:
    """Policies fail where the error to expect is above their own, mm; the others always hold."""
    names = list(STUDY.trained)
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for each in rows(STUDY, dict.fromkeys([policy.name for policy in STUDY.policies], 1.0)):
        if each["set"] == "train" and each["policy"] in found:
            held = each["sigma_mm"] <= fails.get(each["policy"], 99.0)
            found[each["policy"]].append(each | {"held": held, "cycle_s": SECONDS[each["policy"]] if held else np.nan})
    return found


def asked(sigma: float, thing: str = "small_ball") -> dict[str, Any]:
    return {"object": thing, "sigma_mm": sigma, "sigma_deg": 0.0, "approach_s": 0.8}


def test_the_fastest_is_chosen_where_all_hold_and_a_slower_one_where_the_fast_ones_fail() -> None:
    assert learn(STUDY, train({})).policy(asked(20.0)) == "F75"
    careful = learn(STUDY, train({"F75": 7.0, "F50": 7.0, "F0": 7.0, "P75": 7.0}))
    assert careful.policy(asked(0.0)) == "F75"
    assert careful.policy(asked(20.0)) == "P50"


def test_the_baseline_is_chosen_where_every_other_one_costs_success_and_where_nothing_ever_held() -> None:
    risky = learn(STUDY, train({name: 3.0 for name in STUDY.learned.options if name != "A"}))
    assert risky.policy(asked(20.0)) == "A"
    nothing = learn(STUDY, train(dict.fromkeys(STUDY.trained, -1.0)))
    assert nothing.policy(asked(0.0)) == "A"


def test_what_costs_success_is_not_chosen_however_much_time_it_saves() -> None:
    """One in ten lost saves a fifth of the time: more successes a second, and more than the allowance below."""
    made, draws = train({}), np.random.default_rng(4)
    for name in made:
        if name != "A":
            made[name] = [each | {"held": bool(draws.uniform() > 0.1)} for each in made[name]]
    choice, trial = learn(STUDY, made), asked(5.0, "train_cylinder")
    success, chosen = choice.success(trial), choice.policy(trial)
    most = max(success, key=lambda name: success[name] / choice.seconds[name])
    assert success[most] < success["A"] - 0.02 <= success[chosen]
    assert success[most] / choice.seconds[most] > success[chosen] / choice.seconds[chosen]


def test_nothing_that_came_of_a_trial_is_known_to_the_choice() -> None:
    choice = learn(STUDY, train({"F75": 7.0}))
    plain = asked(5.0)
    told = plain | {"held": False, "cycle_s": 1.0, "off_mm": 44.0, "friction": 0.1, "peak_n": 9.0, "why": "lost"}
    np.testing.assert_array_equal(context(STUDY, plain), context(STUDY, told))
    assert choice.success(plain) == choice.success(told)


def test_a_predicted_rate_is_a_rate_and_falls_with_the_error_that_it_was_taught() -> None:
    choice = learn(STUDY, train({"F75": 7.0}))
    rates = [choice.success(asked(sigma))["F75"] for sigma in (0.0, 5.0, 10.0, 20.0)]
    assert all(0.0 <= rate <= 1.0 for rate in rates)
    assert rates == sorted(rates, reverse=True)
    assert rates[0] - rates[-1] > 0.5


def test_trials_of_the_learned_policy_are_those_of_the_policies_that_it_chooses() -> None:
    all_rows = [
        each for each in rows(STUDY, dict.fromkeys([p.name for p in STUDY.policies], 1.0)) if each["set"] == "test"
    ]
    all_rows += [each for name in STUDY.trained for each in train({"F75": 7.0})[name]]
    test = outcomes_of(all_rows, STUDY, "allegro", "test")
    choice = learn(STUDY, train({"F75": 7.0}))
    mine = test.rows["L"]
    assert len(mine) == len(test.trials) == 8
    assert [each["policy"] for each in mine] == [choice.policy(each) for each in test.rows["A"]]
    assert len({each["policy"] for each in mine}) > 1
    assert all(each["trial"] == trial for each, trial in zip(mine, test.trials, strict=True))
    finding = analysed(all_rows, STUDY).findings[0]
    assert [arm.policy for arm in finding.arms][-1] == "L"
    compared = {(each.first, each.second) for each in finding.versus}
    assert {("L", "A"), ("L", "F0"), ("P75", "F0")} <= compared


def test_without_trials_of_train_there_is_no_learned_policy() -> None:
    only = [each for each in rows(STUDY, dict.fromkeys([p.name for p in STUDY.policies], 1.0)) if each["set"] == "test"]
    with pytest.raises(KeyError):
        outcomes_of(only, STUDY, "allegro", "test").rows["L"]
