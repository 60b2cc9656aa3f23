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
    ended,
    initial_state,
    next_state,
    watch_outcome,
)

RULES = StateRules(
    {"ToSecurityPose": 6.0, "Look": 1.0, "ToTargetPose": 6.0, "Approach": 4.0, "ClosingHand": 6.0, "ToLiftedPose": 4.0,
     "Validate": 3.0, "Retreat": 2.0, "PutBack": 4.0, "OpeningHand": 4.0},
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


@pytest.mark.parametrize("state", ["ToSecurityPose", "ToTargetPose", "Approach", "ClosingHand"])
def test_a_motion_that_takes_too_long_begins_anew_and_then_ends_by_its_name(state: StateName) -> None:
    late = Observation(RULES.timeouts[state])
    again = next_state(MachineState(state, 0.0), late, RULES)
    assert (again.state, again.since, again.tries) == ("ToSecurityPose", late.t, 2)
    last = next_state(MachineState(state, 0.0, 2), late, RULES).end
    assert last is not None
    assert str(last) == f"fault: timeout in {state}"


def test_a_lift_that_takes_too_long_puts_back_what_is_in_the_hand_before_it_begins_anew() -> None:
    late = Observation(RULES.timeouts["ToLiftedPose"])
    back = next_state(MachineState("ToLiftedPose", 0.0), late, RULES)
    assert (back.state, back.tries) == ("PutBack", 1)
    opens = next_state(back, Observation(late.t + 1.0, done=True), RULES)
    again = next_state(opens, Observation(late.t + 2.0, done=True), RULES)
    assert (opens.state, again.state, again.tries) == ("OpeningHand", "ToSecurityPose", 2)
    last = next_state(MachineState("ToLiftedPose", 0.0, 2), late, RULES).end
    assert str(last) == "fault: timeout in ToLiftedPose"


def test_a_check_that_is_not_over_in_time_says_so_and_keeps_or_puts_back_what_is_in_the_hand() -> None:
    late = Observation(RULES.timeouts["Validate"])
    end = next_state(MachineState("Validate", 0.0), late, RULES).end
    assert end is not None
    assert (str(end), "was not over after its 3 s" in end.sentence) == ("fault: not confirmed", True)
    back = next_state(MachineState("Validate", 0.0), late, CLEARING)
    assert (back.state, str(back.put_back)) == ("PutBack", "fault: not confirmed")


def test_what_is_not_held_is_tried_again_as_often_as_the_rules_say() -> None:
    missed = Observation(1.0, held=False)
    again = next_state(MachineState("Validate", 0.0), missed, RULES)
    assert again == MachineState(
        "ToSecurityPose", 1.0, 2, earlier=(CellOutcome("missed", "", "the thing is not in the hand"),)
    )
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


@pytest.mark.parametrize("state", [each for each in ORDER if each not in ("ToLiftedPose", "Validate")])
def test_an_arm_that_stopped_by_itself_is_led_away_from_every_state_and_begins_anew(state: StateName) -> None:
    back = next_state(MachineState(state, 0.0), Observation(0.1, done=True, reflex=REFLEX), RULES)
    assert back == MachineState("Retreat", 0.1, 1, cause=REFLEX)
    assert next_state(back, Observation(0.2), RULES) is back
    again = MachineState("ToSecurityPose", 0.9, 2, earlier=(REFLEX,))
    assert next_state(back, Observation(0.9, done=True), RULES) == again
    assert next_state(back, Observation(2.2), RULES) == replace(again, since=2.2)


@pytest.mark.parametrize("state", ["ToLiftedPose", "Validate"])
def test_an_arm_that_stopped_by_itself_with_something_in_the_hand_puts_it_back_first(state: StateName) -> None:
    led_away = next_state(MachineState(state, 0.0), Observation(0.1, reflex=REFLEX), RULES)
    assert next_state(led_away, Observation(0.2), RULES) is led_away
    back = next_state(led_away, Observation(0.9, done=True), RULES)
    assert (led_away.state, back.state, back.tries) == ("Retreat", "PutBack", 1)
    other = replace(REFLEX)  # It reads the same, and is another one.
    met = next_state(next_state(back, Observation(1.0, reflex=other), RULES), Observation(2.0, done=True), RULES)
    assert (met.state, met.tries) == ("PutBack", 2)
    opens = next_state(back, Observation(2.0, done=True), RULES)
    again = next_state(opens, Observation(3.0, done=True), RULES)
    assert again == MachineState("ToSecurityPose", 3.0, 2, earlier=(REFLEX,))


def test_after_the_retries_a_reflex_is_the_end_and_so_is_one_on_the_way_back() -> None:
    last = MachineState("Retreat", 0.0, 2, cause=REFLEX)
    assert next_state(last, Observation(0.9, done=True), RULES).end == REFLEX
    other = replace(REFLEX, reason="joint_reflex")
    first = MachineState("Retreat", 0.0, 1, cause=REFLEX)
    assert next_state(first, Observation(0.1, reflex=other), RULES) == MachineState("Done", 0.1, 1, other, REFLEX)


CLEARING = replace(RULES, objects=3, timeouts=RULES.timeouts | {"ToReleasePose": 12.0})
MISSED = Observation(1.0, held=False)


def test_on_a_table_that_is_cleared_what_is_held_goes_to_the_tray_and_the_next_look_follows() -> None:
    now = next_state(MachineState("Validate", 0.0, 2), Observation(1.0, held=True), CLEARING)
    assert (now.state, now.tries, now.carries) == ("ToReleasePose", 2, True)
    now = next_state(now, Observation(2.0, done=True), CLEARING)
    assert now.state == "OpeningHand"
    assert next_state(now, Observation(3.0, done=True), CLEARING) == MachineState("ToSecurityPose", 3.0, released=1)


def test_what_is_lost_on_the_way_to_the_tray_is_a_miss() -> None:
    lost = next_state(MachineState("ToReleasePose", 0.0), MISSED, CLEARING)
    assert (lost.state, lost.tries, lost.released) == ("ToSecurityPose", 2, 0)


def test_what_there_is_no_way_to_the_tray_for_is_put_back_and_tried_again_and_left_for_later() -> None:
    no_way = CellOutcome("refused", "in the way", "fer does not get to the tray")
    now = next_state(MachineState("ToReleasePose", 0.0, released=1), Observation(1.0, refused=no_way), CLEARING)
    assert (now.state, now.put_back) == ("PutBack", no_way)
    now = next_state(now, Observation(2.0, done=True), CLEARING)
    assert (now.state, now.put_back) == ("OpeningHand", no_way)
    now = next_state(now, Observation(3.0, done=True), CLEARING)
    assert now == MachineState("ToSecurityPose", 3.0, 2, released=1, earlier=(no_way,))  # Not released.
    second = replace(now, state="OpeningHand", carries=True, put_back=no_way)
    left = next_state(second, Observation(4.0, done=True), CLEARING)
    assert left == MachineState("ToSecurityPose", 4.0, released=1, left=(no_way,))
    last = replace(second, left=(no_way, no_way))
    assert next_state(last, Observation(4.0, done=True), CLEARING).end == no_way  # As many as may be were tried.


@pytest.mark.parametrize("rules", ["RULES", "CLEARING"])
def test_what_meets_something_on_its_way_back_is_put_back_at_the_next_try_and_never_brought_to_a_tray(
    rules: str,
) -> None:
    going, missed = {"RULES": RULES, "CLEARING": CLEARING}[rules], CellOutcome("missed", "", "it is not in the hand")
    now = MachineState("PutBack", 0.0, released=1, carries=True, put_back=missed)
    now = next_state(next_state(now, Observation(1.0, reflex=REFLEX), going), Observation(2.0, done=True), going)
    assert (now.state, now.tries, now.put_back) == ("PutBack", 2, missed)
    now = next_state(next_state(now, Observation(3.0, done=True), going), Observation(4.0, done=True), going)
    assert (now.released, now.carries, now.put_back) == (1, False, None)
    assert [each.sentence.split("; ")[0] for each in (*now.left, now.end) if each] == [missed.sentence]


@pytest.mark.parametrize("rules", ["RULES", "CLEARING"])
def test_what_was_missed_while_something_hangs_on_the_hand_is_put_back_before_the_hand_opens(rules: str) -> None:
    going = {"RULES": RULES, "CLEARING": CLEARING}[rules]
    now = next_state(MachineState("Validate", 0.0), Observation(1.0, held=False, loaded=True), going)
    assert (now.state, str(now.put_back)) == ("PutBack", "missed")
    now = next_state(now, Observation(2.0, done=True), going)
    assert now.state == "OpeningHand"
    again = next_state(now, Observation(3.0, done=True), going)
    assert (again.state, again.tries, again.carries) == ("ToSecurityPose", 2, False)
    last = next_state(replace(now, tries=2), Observation(3.0, done=True), going)
    assert [str(each) for each in (*last.left, last.end) if each] == ["missed"]


CARRIES = MachineState("ToReleasePose", 0.0, released=1, carries=True)


def test_what_is_carried_is_not_let_go_where_the_arm_meets_something_or_is_late_but_led_on_or_held() -> None:
    back = next_state(CARRIES, Observation(1.0, reflex=REFLEX), CLEARING)
    again = next_state(back, Observation(2.0, done=True), CLEARING)
    assert (back.state, again.state, again.tries, again.carries) == ("Retreat", "ToReleasePose", 2, True)
    end = next_state(replace(again, state="Retreat", cause=REFLEX), Observation(3.0, done=True), CLEARING)
    assert (end.state, end.end) == ("Done", REFLEX)  # With it in the hand.
    late = next_state(CARRIES, Observation(12.0), CLEARING)
    assert (late.state, late.tries) == ("ToReleasePose", 2)
    lost = next_state(CARRIES, Observation(1.0, held=False), CLEARING)
    assert (lost.state, lost.carries) == ("ToSecurityPose", False)


@pytest.mark.parametrize("reason", ["not confirmed", "checks disagree"])
def test_of_what_nobody_knows_whether_it_is_held_is_put_back_and_left_and_a_single_one_is_a_fault(reason: str) -> None:
    unsure = Observation(1.0, fault=CellOutcome("fault", reason, "the fingers press, and nothing confirms that"))
    assert next_state(MachineState("Validate", 0.0), unsure, RULES).end == unsure.fault
    back = next_state(MachineState("Validate", 0.0), unsure, CLEARING)
    assert (back.state, back.put_back) == ("PutBack", unsure.fault)
    late = next_state(back, Observation(6.0), CLEARING)
    assert (late.state, late.tries) == ("PutBack", 2)  # The hand does not open on the way.
    opened = next_state(back, Observation(2.0, done=True), CLEARING)
    assert opened.state == "OpeningHand"
    assert next_state(opened, Observation(7.0, done=True), CLEARING).tries == 2
    power = Observation(1.0, fault=CellOutcome("fault", "hand without torque", "joint 3"))
    assert next_state(MachineState("Validate", 0.0), power, CLEARING).end == power.fault


@pytest.mark.parametrize(("released", "count"), [(2, "2 objects"), (0, "0 objects")])
def test_a_table_on_which_more_was_seen_than_was_put_away_is_not_cleared(released: int, count: str) -> None:
    nothing = CellOutcome("refused", "no_object", "nothing stands on the table")
    seen = Observation(1.0, refused=nothing, warning="3 objects were seen: see what has become of 1")
    end = next_state(MachineState("Look", 0.0, released=released), seen, CLEARING).end
    said = f"{count} put away; left: 3 objects were seen: see what has become of 1"
    assert end == CellOutcome("missed", "left", said)


def test_what_is_seen_and_too_small_to_be_known_is_left_and_named() -> None:
    small = CellOutcome("refused", "small", "something at (0.100, 0.100, 0.010) is too small to be known from there")
    end = next_state(MachineState("Look", 0.0, released=2), Observation(1.0, refused=small), CLEARING).end
    assert end == CellOutcome("missed", "left", f"2 objects put away; left: {small.sentence}")


def test_a_table_that_is_not_where_the_cell_has_it_is_a_fault_whatever_was_put_away() -> None:
    table = CellOutcome("fault", "table", "the table stands 30 mm higher than the cell's")
    assert next_state(MachineState("Look", 0.0, released=2), Observation(1.0, refused=table), CLEARING).end == table


def test_what_was_missed_as_often_as_may_be_is_left_for_later_and_looked_for_again_once_something_is_put_away() -> None:
    now = next_state(MachineState("Validate", 0.0, 2, released=1), MISSED, CLEARING)
    assert (now.state, now.tries, now.released) == ("ToSecurityPose", 1, 1)
    assert [str(each) for each in now.left] == ["missed"]
    assert next_state(replace(now, state="OpeningHand"), Observation(3.0, done=True), CLEARING).left == ()


def test_a_table_is_cleared_when_a_look_finds_nothing_and_nothing_was_left() -> None:
    nothing = Observation(1.0, refused=CellOutcome("refused", "no_object", "nothing stands on the table"))
    end = next_state(MachineState("Look", 0.0, released=2), nothing, CLEARING).end
    assert end == CellOutcome("cleared", "", "2 objects put away")
    assert next_state(MachineState("Look", 0.0), nothing, CLEARING).end == nothing.refused  # It was empty.
    left = (CellOutcome("missed", "", "the thing is not in the hand"),)
    end = next_state(MachineState("Look", 0.0, released=1, left=left), nothing, CLEARING).end
    assert str(end) == "missed: left"


def test_what_left_the_hand_over_the_tray_and_is_seen_in_it_counts_as_put_away_and_the_next_has_its_own_tries() -> None:
    lost = CellOutcome("missed", "", "it was lost on the way to the tray")
    now = MachineState("Look", 0.5, 2, released=4, left=(lost,), earlier=(lost,))
    nothing = CellOutcome("refused", "no_object", "nothing stands on the table")
    seen = Observation(0.6, landed=True, refused=nothing)
    assert next_state(now, seen, CLEARING) is now
    assert next_state(now, replace(seen, t=1.5), replace(CLEARING, objects=9)).end == CellOutcome(
        "cleared", "", "5 objects put away"
    )
    after = next_state(now, Observation(0.6, done=True, landed=True), replace(CLEARING, objects=9))
    assert after == MachineState("ToTargetPose", 0.6, released=5)


def test_what_is_left_is_named_with_what_the_last_look_and_every_miss_said() -> None:
    unclear = Observation(1.0, refused=CellOutcome("refused", "unclear", "the thing at (0, 0) is no ball"))
    left = (CellOutcome("missed", "", "it slipped"), CellOutcome("missed", "", "it slipped"))
    end = next_state(MachineState("Look", 0.0, released=1, left=left), unclear, CLEARING).end
    assert end == CellOutcome("missed", "left", "1 object put away; left: it slipped; the thing at (0, 0) is no ball")


def test_a_camera_that_is_out_is_a_fault_whatever_was_put_away() -> None:
    assert str(next_state(MachineState("Look", 0.0, released=2), Observation(1.0), CLEARING).end) == "fault: camera"


def test_after_as_many_objects_as_may_be_a_last_look_says_whether_the_table_is_cleared() -> None:
    last = MachineState("OpeningHand", 0.0, released=2)
    back = next_state(last, Observation(1.0, done=True), CLEARING)
    assert back == MachineState("ToSecurityPose", 1.0, released=3)
    look = replace(back, state="Look")
    nothing = CellOutcome("refused", "no_object", "nothing stands on the table")
    assert str(next_state(look, Observation(2.0, refused=nothing), CLEARING).end) == "cleared"
    end = next_state(look, Observation(1.5, done=True), CLEARING).end
    assert str(end) == "missed: left"
    assert end is not None
    assert "3 objects put away; left: more stands on the table" in end.sentence
    assert "`tray.objects`" in end.sentence


def test_clearing_ends_after_as_many_misses_as_objects_may_be() -> None:
    left = (CellOutcome("missed", "", "it slipped"),) * 2
    assert str(next_state(MachineState("Validate", 0.0, 2, left=left), MISSED, CLEARING).end) == "missed"


DOWN = CellOutcome("missed", "", "the thing is not in the hand; it stood here, and an object is on the table there")


def missed_once() -> MachineState:
    checked = Observation(1.0, held=False, warning="it stood here, and an object is on the table there")
    now = next_state(MachineState("Validate", 0.0), checked, RULES)
    assert (now.state, now.earlier) == ("ToSecurityPose", (DOWN,))
    return now


def test_a_look_that_finds_nothing_to_take_ends_with_what_the_try_before_came_to() -> None:
    refused = CellOutcome("refused", "cut_off", "move it to the middle")
    now = next_state(replace(missed_once(), state="Look"), Observation(3.0, refused=refused), RULES)
    assert now.end is not None
    assert str(now.end) == "refused: cut_off"
    assert now.end.sentence == f"move it to the middle; try 1: missed, {DOWN.sentence}"


def test_a_device_that_stops_in_the_second_try_ends_with_what_the_first_came_to() -> None:
    now = ended(missed_once(), 3.0, CellOutcome("fault", "hand stopped", "it is hot"))
    assert now.end is not None
    assert now.end.sentence == f"it is hot; try 1: missed, {DOWN.sentence}"


def test_what_is_held_at_the_second_try_and_then_dropped_ends_with_both() -> None:
    held = next_state(replace(missed_once(), state="Validate"), Observation(3.0, held=True), RULES)
    assert held.end == CellOutcome("held")
    end = watch_outcome(held, Observation(3.5, held=False), RULES).end
    assert end is not None
    assert end.sentence.startswith("it was held after the lift, and is no longer; try 1: missed, ")


def test_a_try_that_came_to_the_same_is_told_once() -> None:
    assert (
        next_state(
            replace(missed_once(), state="Validate"),
            Observation(3.0, held=False, warning=DOWN.sentence.split("; ")[1]),
            RULES,
        ).end
        == DOWN
    )
