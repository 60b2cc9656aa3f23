"""Each rule of the published contract says no to a backend that breaks it, and says how."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from allegro_twin.backend import limp_of, position_of, torque_of
from allegro_twin.device import device_of
from allegro_twin.errors import CommandError, EndOfRecording, HandFault
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.safety import Guard, Limits
from allegro_twin.spec import HandSpec
from allegro_twin.testing import check_backend, rules
from allegro_twin.testing.rules import RULES, ContractViolation, DoesNotApply
from allegro_twin.types import Command, HandState, TorqueCommand, frozen

PERIOD = 0.003


class Good:
    """A hand without mass: a joint goes with the torque on it."""

    live: Any = False

    def __init__(self, spec: HandSpec | None = None) -> None:
        self.spec: Any = spec or load_spec()
        self.period: Any = PERIOD
        self.closed = False
        self.begin()
        vars(self).update(self.said)

    said: dict[str, Any] = {}  # noqa: RUF012  # Never changed in place.
    """What it says of itself in place of the truth."""

    def begin(self) -> None:
        self.tick, self.position = 0, np.zeros(self.spec.n_joints)
        self.command: Command = limp_of(self.spec)

    def reset(self) -> HandState:
        self.closed = False
        self.begin()
        return self.state()

    def write(self, command: Command) -> None:
        (torque_of if "torque" in self.spec.commands else position_of)(command, self.spec)
        self.command = command

    def read(self) -> HandState:
        self.tick += 1
        if isinstance(self.command, TorqueCommand):
            self.position = self.position + 0.001 * self.command.torque
        return self.state()

    def close(self) -> None:
        self.closed = True

    def torque(self) -> Any:
        return self.command.torque if isinstance(self.command, TorqueCommand) else np.zeros(self.spec.n_joints)

    def state(self) -> HandState:
        n = self.spec.n_joints
        return HandState(
            self.tick * self.period, self.tick, frozen(self.position), frozen(np.zeros(n)), frozen(self.torque()),
            temperature=frozen(np.full(n, np.nan)), gravity=frozen(np.full(3, np.nan)),
        )  # fmt: skip


def changed(**members: Any) -> type[Good]:
    """The good hand with other members."""
    return type("Bad", (Good,), members)


def state_with(**parts: Callable[[Good], Any]) -> type[Good]:
    """The good hand whose states differ in some parts."""
    return changed(state=lambda self: replace(Good.state(self), **{name: of(self) for name, of in parts.items()}))


class Shared(Good):
    """All states share one array."""

    def state(self) -> HandState:
        self.kept = getattr(self, "kept", np.zeros(16))
        self.kept[:] = self.position
        view = self.kept.view()
        view.setflags(write=False)
        return replace(super().state(), position=view)


class Drifting(Good):
    """What it does depends on what was before."""

    count = 0.0

    def read(self) -> HandState:
        Drifting.count += 1e-9
        state = super().read()
        return replace(state, position=frozen(state.position + Drifting.count))


class LimpAfterRefusal(Good):
    """A wrong command drops what it holds."""

    def write(self, command: Command) -> None:
        self.command = limp_of(self.spec)
        super().write(command)


class EndsAfterRefusal(Good):
    """A wrong command ends the session."""

    refused: CommandError | None = None

    def write(self, command: Command) -> None:
        try:
            super().write(command)
        except CommandError as error:
            self.refused = error
            raise

    def read(self) -> HandState:
        if self.refused is not None:
            raise self.refused
        return super().read()


class LiveWithoutEnd(Good):
    live = True


class Live(Good):
    live = True

    def write(self, command: Command) -> None:
        if self.closed:
            raise HandFault("the hand is closed; reset() opens it again")
        super().write(command)


class Ending(Good):
    def read(self) -> HandState:
        if self.tick == 100:
            raise EndOfRecording("over")
        return super().read()


def lost(self: Good) -> None:
    raise OSError("no such port")


# fmt: off
BAD: list[tuple[rules.Rule, type[Good], str]] = [
    (rules.says_which_hand_it_is, changed(said={"period": 0}), "period is 0, not a number of s above 0"),
    (rules.says_which_hand_it_is, changed(said={"spec": "allegro"}), "spec is a str, not a HandSpec"),
    (rules.says_whether_it_is_live, changed(live="yes"), "live is 'yes', not True or False"),
    (rules.reset_begins_at_zero, state_with(t=lambda hand: hand.tick * PERIOD + 1e-4), "gives t 0.0001 s, tick 0"),
    (rules.time_increases, state_with(tick=lambda hand: hand.tick // 2), "tick went from 0 to 0"),
    (rules.time_increases, state_with(t=lambda hand: hand.tick * 0.01), "whose time is 0.003 s"),
    (rules.time_increases, state_with(tick=lambda hand: min(hand.tick, 100)), "tick went from 100 to 100"),
    (rules.a_state_is_whole, state_with(velocity=lambda hand: frozen(np.full(16, np.nan))),
     "velocity is .*: not finite"),
    (rules.a_state_is_whole, state_with(torque=lambda hand: frozen(np.zeros(4))), r"float64 of shape \(4,\)"),
    (rules.a_state_is_whole, state_with(position=lambda hand: hand.position.astype(np.float32)), "position is float32"),
    (rules.a_state_cannot_be_changed, state_with(position=lambda hand: hand.position.copy()), "can be written to"),
    (rules.a_state_does_not_change, Shared, "position of tick 0 changed afterwards"),
    (rules.reading_holds_the_last_command, state_with(tick=lambda hand: min(hand.tick, 2)),
     r"ticks are \[1, 2, 2, 2\]"),
    (rules.a_session_is_repeatable, Drifting, "a second session has another position"),
    (rules.an_instance_repeats_another, Drifting, "a second backend has another position"),
    (rules.wrong_commands_are_refused, changed(write=lambda self, command: None),
     "a TorqueCommand of 15 values.* is taken"),
    (rules.a_refused_command_has_no_effect, LimpAfterRefusal, "a hand that has refused a command has another"),
    (rules.a_refused_command_has_no_effect, EndsAfterRefusal, "after a refused command it raises CommandError"),
    (rules.a_refused_command_has_no_effect, changed(write=lambda self, command: None), "of another length is taken"),
    (rules.the_limp_command_ends_all_torque, changed(torque=lambda self: np.full(16, 0.1)), "after the limp command"),
    (rules.closing_twice_is_harmless, changed(close=lost), "close raises OSError: no such port"),
    (rules.reset_leads_out, LiveWithoutEnd, "write after close is taken"),
    (rules.only_a_recording_ends, Ending, "ends with EndOfRecording, though it is no recording"),
]
# fmt: on


@pytest.mark.parametrize(("rule", "bad", "said"), BAD)
def test_a_backend_that_breaks_a_rule_is_told_how(rule: rules.Rule, bad: type[Good], said: str) -> None:
    with pytest.raises(ContractViolation, match=said):
        rule(bad)


def test_a_hand_that_takes_parts_its_spec_does_not_have_is_told() -> None:
    leap = load_spec("leap")

    class Everything(Good):
        def write(self, command: Command) -> None:
            self.command = command

    with pytest.raises(ContractViolation, match="it takes a timed_position, which its spec does not"):
        rules.parts_that_it_does_not_take_are_refused(lambda: Everything(leap))


def test_every_rule_has_been_seen_to_say_no() -> None:
    assert {rule for rule, _, _ in BAD} | {rules.parts_that_it_does_not_take_are_refused} == set(RULES)


def test_behind_a_guard_a_refused_command_leaves_the_hand_limp_until_reset() -> None:
    spec = load_spec()
    limits = Limits(spec.actuation.torque_limit, np.full(16, 12.0), spec.lower, spec.upper)
    inner = Good()
    guard = Guard(inner, limits)
    rules.a_refused_command_has_no_effect(lambda: guard)
    with pytest.raises(CommandError):
        guard.read()
    assert not inner.torque().any()
    guard.reset()
    guard.read()


def test_a_good_backend_keeps_every_rule_that_applies() -> None:
    found = {result.rule: result.outcome for result in check_backend(Good)}
    assert set(found.values()) == {"kept", "does not apply"}
    assert [rule for rule, outcome in found.items() if outcome != "kept"] == ["parts that it does not take are refused"]


def test_a_live_backend_need_not_repeat_itself() -> None:
    found = {result.rule: result.outcome for result in check_backend(Live)}
    assert found["a session is repeatable"] == found["an instance repeats another"] == "does not apply"
    assert "broken" not in found.values()


def test_what_says_nothing_of_its_time_is_taken_for_live_behind_a_guard_too() -> None:
    class Silent(Good):
        def __getattribute__(self, name: str) -> Any:
            if name in ("live", "unconfirmed", "calibration", "warnings", "listen"):
                raise AttributeError(name)
            return super().__getattribute__(name)

    silent, spec = Silent(), load_spec()
    limits = Limits(spec.actuation.torque_limit, np.full(16, 12.0), spec.lower, spec.upper)
    device = device_of(Guard(Guard(silent, limits), limits))
    assert device.live
    assert (device.unconfirmed, device.warnings(), device.calibration) == ("", (), {})
    assert not device.listen(print)
    with pytest.raises(DoesNotApply, match="taken for live"):
        rules.says_whether_it_is_live(Silent)


def test_a_live_hand_that_stands_in_front_of_a_simulation_is_live() -> None:
    """It may call what is behind it as it likes: only a guard passes on what is behind it."""

    class InFrontOfSimulation(Good):
        def __init__(self) -> None:
            super().__init__()
            self.inner = Good()

        def __getattribute__(self, name: str) -> Any:
            if name == "live":
                raise AttributeError(name)
            return super().__getattribute__(name)

    assert device_of(InFrontOfSimulation()).live


def test_whatever_a_factory_raises_is_a_row_of_the_table() -> None:
    def broken() -> Good:
        raise ValueError("what is this")

    results = list(check_backend(broken))
    assert {result.outcome for result in results} == {"broken"}
    assert results[0].text == "ValueError, which is no HandError: what is this"
