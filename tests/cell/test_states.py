"""The state machine alone: what leads where, when it is late, how often it begins anew."""

from __future__ import annotations

from dataclasses import replace

import pytest

from allegro_twin.cell.states import (
    CellOutcome,
    MachineState,
    Observation,
    StateName,
    StateRules,
    initial_state,
    next_state,
)

RULES = StateRules(
    {"ToSecurityPose": 6.0, "Look": 1.0, "ToTargetPose": 6.0, "Approach": 4.0, "ClosingHand": 6.0, "ToLiftedPose": 4.0,
     "Validate": 3.0, "Retreat": 2.0},
    retries=1,
)  # fmt: skip
ORDER: list[StateName] = [
    "ToSecurityPose",
    "Look",
    "ToTargetPose",
    "Approach",
    "ClosingHand",
    "ToLiftedPose",
    "Validate",
]


def test_every_state_leads_to_the_next_when_what_it_is_for_has_happened() -> None:
    now, passed = initial_state(0.0), []
    for tenth in range(1, 7):
        passed.append(now.state)
        now = next_state(now, Observation(tenth / 10, done=True), RULES)
    assert [*passed, now.state] == ORDER
    assert next_state(now, Observation(1.0, held=True), RULES) == MachineState("Done", 1.0, 1, CellOutcome("held"))


@pytest.mark.parametrize("state", ORDER)
def test_a_fault_ends_every_state_at_once(state: StateName) -> None:
    fault = CellOutcome("fault", "arm at a limit", "fer_joint4 is at its limit")
    assert next_state(
        MachineState(state, 0.0), Observation(0.1, done=True, held=True, fault=fault), RULES
    ) == MachineState("Done", 0.1, 1, fault)


@pytest.mark.parametrize("state", ORDER)
def test_nothing_changes_while_nothing_has_happened_and_it_is_not_late(state: StateName) -> None:
    now = MachineState(state, 2.0)
    assert next_state(now, Observation(2.0 + RULES.timeouts[state] - 0.01), RULES) is now


@pytest.mark.parametrize("state", ["ToSecurityPose", "ToTargetPose", "Approach", "ClosingHand", "ToLiftedPose"])
def test_a_motion_that_takes_too_long_begins_anew_and_then_ends_by_its_name(state: StateName) -> None:
    late = Observation(RULES.timeouts[state])
    assert next_state(MachineState(state, 0.0), late, RULES) == MachineState("ToSecurityPose", late.t, 2)
    last = next_state(MachineState(state, 0.0, 2), late, RULES).end
    assert last is not None
    assert str(last) == f"fault: timeout in {state}"


def test_what_is_not_held_is_tried_again_as_often_as_the_rules_say() -> None:
    missed = Observation(1.0, held=False)
    again = next_state(MachineState("Validate", 0.0), missed, RULES)
    assert again == MachineState("ToSecurityPose", 1.0, 2)
    assert str(next_state(replace(again, state="Validate"), missed, RULES).end) == "missed"


def test_a_look_that_finds_nothing_goes_on_until_it_is_late_and_ends_as_a_refusal() -> None:
    outside = CellOutcome("refused", "outside", "the ball is outside the workspace")
    now = MachineState("Look", 0.0)
    assert next_state(now, Observation(0.5, refused=outside), RULES) is now
    assert next_state(now, Observation(1.0, refused=outside), RULES).end == outside
    assert str(next_state(now, Observation(1.0), RULES).end) == "fault: camera"


def test_the_end_is_the_end() -> None:
    now = MachineState("Done", 1.0, 1, CellOutcome("held"))
    assert next_state(now, Observation(99.0, done=True, fault=CellOutcome("fault", "x")), RULES) is now


REFLEX = CellOutcome("fault", "cartesian_reflex", "the force on the flange of fer along z is 41 N")


@pytest.mark.parametrize("state", ORDER)
def test_an_arm_that_stopped_by_itself_is_led_away_from_every_state_and_begins_anew(state: StateName) -> None:
    back = next_state(MachineState(state, 0.0), Observation(0.1, done=True, reflex=REFLEX), RULES)
    assert back == MachineState("Retreat", 0.1, 1, cause=REFLEX)
    assert next_state(back, Observation(0.2), RULES) is back
    assert next_state(back, Observation(0.9, done=True), RULES) == MachineState("ToSecurityPose", 0.9, 2)
    assert next_state(back, Observation(2.2), RULES) == MachineState("ToSecurityPose", 2.2, 2)


def test_after_the_retries_a_reflex_is_the_end_and_so_is_one_on_the_way_back() -> None:
    last = MachineState("Retreat", 0.0, 2, cause=REFLEX)
    assert next_state(last, Observation(0.9, done=True), RULES).end == REFLEX
    other = replace(REFLEX, reason="joint_reflex")
    first = MachineState("Retreat", 0.0, 1, cause=REFLEX)
    assert next_state(first, Observation(0.1, reflex=other), RULES) == MachineState("Done", 0.1, 1, other, REFLEX)
