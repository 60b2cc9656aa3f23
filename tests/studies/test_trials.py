"""Trials: what is simulated is what the protocol says, and does not depend on what else is simulated."""

from __future__ import annotations

from typing import Any

import pytest

from studies.preemption.draws import case
from studies.preemption.jobs import made
from studies.preemption.protocol import SpringStudy
from studies.preemption.scenes import Bench, Job
from tests.studies.small import content, study


def item(policy: str, trial: int = 0, control: str = "") -> dict[str, Any]:
    return {"hand": "model_o", "set": "test", "trial": trial, "policy": policy, "control": control}


@pytest.fixture(scope="module")
def of() -> SpringStudy:
    return study()


@pytest.fixture(scope="module")
def table(of: SpringStudy) -> list[dict[str, Any]]:
    items = [item(policy.name) for policy in of.policies] + [item(p, 1) for p in ("P0", "P0e", "P50")]
    items += [item("P0e", 0, control) for control in of.controls]
    return made({"study": content()}, items)


def row(table: list[dict[str, Any]], policy: str, trial: int = 0, control: str = "") -> dict[str, Any]:
    return next(r for r in table if (r["policy"], r["trial"], r["control"]) == (policy, trial, control))


@pytest.mark.slow
def test_a_hand_that_can_grasp_it_has_it_at_the_end(table: list[dict[str, Any]]) -> None:
    one = row(table, "P0e")
    assert one["held"]
    assert one["why"] == ""
    assert one["slip_mm"] < 10.0
    assert one["felt_g"] == pytest.approx(97.0, abs=45.0)  # The gelatin box, by a spring and a noisy sensor.


@pytest.mark.slow
def test_a_frozen_hand_never_has_it(table: list[dict[str, Any]]) -> None:
    one = row(table, "P0e", control="frozen")
    assert not one["held"]
    assert one["why"] == "not lifted"
    assert one["peak_n"] < 5.0


@pytest.mark.slow
def test_without_error_and_weight_nothing_is_lost(table: list[dict[str, Any]]) -> None:
    assert row(table, "P0e", control="weightless")["held"]


@pytest.mark.slow
def test_overlap_begins_when_it_says_and_saves_that_time(of: SpringStudy, table: list[dict[str, Any]]) -> None:
    late, early = row(table, "P0e"), row(table, "P50")
    assert early["begun_s"] == pytest.approx(0.6 - 0.5 * of.motion.close, abs=1e-9)
    assert late["begun_s"] >= 0.6 - 1e-9
    assert early["overlap"] == pytest.approx(0.5)
    assert late["cycle_s"] - early["cycle_s"] == pytest.approx(late["begun_s"] - early["begun_s"], abs=0.0041)


@pytest.mark.slow
def test_the_state_machine_costs_up_to_a_tenth_of_a_second_at_each_decision(table: list[dict[str, Any]]) -> None:
    for trial in (0, 1):
        waits = row(table, "P0", trial)["begun_s"] - row(table, "P0e", trial)["begun_s"]
        late = row(table, "P0", trial)["cycle_s"] - row(table, "P0e", trial)["cycle_s"]
        assert 0.0 <= waits < 0.1
        assert waits - 1e-9 <= late < 0.2


@pytest.mark.slow
def test_policies_have_the_same_errors(table: list[dict[str, Any]]) -> None:
    assert len({(r["off_mm"], r["off_deg"], r["friction"]) for r in table if r["trial"] == 1}) == 1
    assert row(table, "P0", 1)["off_mm"] > 0.0
    assert row(table, "P0", 0)["off_mm"] == 0.0


@pytest.mark.slow
def test_a_trial_is_the_same_alone_to_the_last_bit(table: list[dict[str, Any]]) -> None:
    alone = made({"study": content()}, [item("P50", 1)])[0]
    assert alone == row(table, "P50", 1)


def test_the_palm_hangs_on_the_protocols_spring(of: SpringStudy) -> None:
    setup = Bench(of, "model_o").setup(Job(of.policy("P0e"), case(of, "test", 0)))
    model, load = setup.model, setup.weight / 9.81
    motor, dof = model.actuator("wrist_z").id, model.joint("wrist_z").dofadr[0]
    assert model.actuator_gainprm[motor, 0] == -model.actuator_biasprm[motor, 1] == 1000.0
    assert model.dof_armature[dof] == pytest.approx(4.0)  # The arm's; the hand's own mass is its bodies'.
    assert -model.actuator_biasprm[motor, 2] == pytest.approx(2.0 * (1000.0 * (4.0 + load)) ** 0.5)
