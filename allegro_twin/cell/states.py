"""The state machine: from where it is and what is known to where it goes next. Pure; nothing moves here.

ToSecurityPose → Look → ToTargetPose → Approach → ClosingHand → ToLiftedPose → Validate, and from there to an end. The
report has four of them; looking, the last stretch and the check stand in states of their own, so that each has a time.
An arm that stopped by itself is led away from what it met, Retreat, and then all begins anew, or ends.

Where a table is to be cleared, what is held goes on to ToReleasePose → OpeningHand and the next look; what was missed
as often as the rules say is left for later, until a look finds nothing, or only what was left. The table is cleared
where the last look finds nothing at all, and as many objects were put away as were seen. What there is no way to
the tray for, or of what nobody can say whether it is in the hand, is put back where it stood, PutBack, and so is, on
every table, what was missed while something is felt to hang on the hand. Then all begins anew. While something is
carried the hand does not open elsewhere: what goes wrong there begins anew with ToReleasePose or PutBack, or ends with
it in the hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

StateName = Literal[
    "ToSecurityPose", "Look", "ToTargetPose", "Approach", "ClosingHand", "ToLiftedPose", "Validate", "ToReleasePose",
    "PutBack", "OpeningHand", "Retreat", "Done"
]  # fmt: skip
OutcomeKind = Literal["held", "cleared", "missed", "refused", "fault"]
_NEXT: dict[StateName, StateName] = {
    "ToSecurityPose": "Look",
    "ToTargetPose": "Approach",
    "Approach": "ClosingHand",
    "ClosingHand": "ToLiftedPose",
    "ToReleasePose": "OpeningHand",
    "PutBack": "OpeningHand",
    "ToLiftedPose": "Validate",
}


_UNSURE = ("not confirmed", "checks disagree")
"""Faults of a check, not of a device: nobody knows whether it is in the hand."""
_LATE = 0.2
"""s. A machine that is asked by a slow clock leaves a state so much later."""


@dataclass(frozen=True, slots=True)
class CellOutcome:
    """Outcome of a run of the cell."""

    kind: OutcomeKind
    reason: str = ""
    """One word for a program: of a refusal perception's, of a fault what it was."""
    sentence: str = ""
    """For a person: what, and what to do."""

    def __str__(self) -> str:
        return f"{self.kind}: {self.reason}" if self.reason else self.kind


@dataclass(frozen=True, slots=True)
class MachineState:
    """State of the state machine."""

    state: StateName
    since: float
    """s."""
    tries: int = 1
    """Counting this one."""
    end: CellOutcome | None = None
    cause: CellOutcome | None = None
    """Cause of a retreat: the contact of the arm."""
    released: int = 0
    """Objects that were put where they belong."""
    left: tuple[CellOutcome, ...] = ()
    """Why objects were left for later, since something was put away last."""
    carries: bool = False
    """What was checked is on its way to the tray, or back."""
    put_back: CellOutcome | None = None
    """Why it is on its way back."""
    earlier: tuple[CellOutcome, ...] = ()
    """What the tries before this one came to, in order."""


@dataclass(frozen=True, slots=True)
class Observation:
    """Observations at one moment, on which the state machine decides."""

    t: float
    """s."""
    done: bool = False
    """What the state was for has happened: the arm is there, the hand is closed, there is a grasp."""
    held: bool | None = None
    """What the check says, once it has enough samples."""
    loaded: bool = False
    """Whether something seems to be in the hand that is not held by that check."""
    warning: str = ""
    """What is told with it: of a sensor that does not decide."""
    landed: bool = False
    """Whether an object that had left the hand over the tray is seen to be in it, at this look."""
    refused: CellOutcome | None = None
    """Why there is nothing to grasp, by the newest picture, or no way to the tray."""
    fault: CellOutcome | None = None
    reflex: CellOutcome | None = None
    """Why the arm has stopped by itself; it takes commands again."""


@dataclass(frozen=True, slots=True)
class StateRules:
    """Time limits of the states, s, and the number of new tries."""

    timeouts: dict[StateName, float]
    retries: int
    objects: int = 0
    """So many objects are put away at most; 0: the first that is held is the end."""

    @property
    def longest(self) -> float:
        """s that a run may last in all, whatever its states do: every state at its latest, in every try for every
        object that may be on the table or be left for later, and the check after the end."""
        last = () if self.objects else ("ToReleasePose",)
        each = sum(most + _LATE for name, most in self.timeouts.items() if name not in last)
        objects = max(self.objects * (self.objects + 1) // 2 + 1, 1)  # And the look after the last.
        return objects * (self.retries + 1) * each + self.timeouts["Validate"] + 2.0


def initial_state(t: float) -> MachineState:
    """At the start."""
    return MachineState("ToSecurityPose", t)


def endless_run(now: MachineState, t: float, rules: StateRules, whose: str) -> MachineState:
    """The end of a run that is longer than it can be, by the clock of `whose` periods."""
    said = (
        f"the run was in {now.state} after {rules.longest:.0f} s of the {whose}'s periods, and all states last less: "
        f"the {whose}'s clock or the state machine stands still"
    )
    return ended(now, t, CellOutcome("fault", "endless", said))


def next_state(now: MachineState, observation: Observation, rules: StateRules) -> MachineState:
    """Where it is after what is known; the same `now` while nothing changes."""
    if now.state == "Done":
        return now
    if observation.fault is not None:
        if now.state == "Validate" and rules.objects and observation.fault.reason in _UNSURE:
            return _put_back(now, observation.t, observation.fault)
        return ended(now, observation.t, observation.fault)
    if observation.reflex is not None:
        if now.state == "Retreat":
            return ended(now, observation.t, observation.reflex)  # Whichever way it goes.
        led_away = replace(now, state="Retreat", since=observation.t, cause=observation.reflex)
        lifted = now.state in ("ToLiftedPose", "Validate")
        return replace(led_away, carries=True, put_back=observation.reflex) if lifted else led_away
    late = observation.t - now.since >= rules.timeouts[now.state] - 1e-9
    match now.state:
        case "Look":
            before = now
            if observation.landed:
                now = MachineState("Look", now.since, released=now.released + 1)
            if observation.done and rules.objects and now.released >= rules.objects:
                return ended(now, observation.t, _cleared(now, _full(rules), observation.warning))
            if observation.done:
                return replace(now, state="ToTargetPose", since=observation.t)
            if late:
                refused = observation.refused or CellOutcome("fault", "camera", "no picture has come: see to its cable")
                return ended(
                    now, observation.t, _cleared(now, refused, observation.warning) if rules.objects else refused
                )
            return before
        case "Retreat" if now.cause is not None:
            if not (observation.done or late):
                return now
            if now.put_back is now.cause:  # Led away from the lift, not from putting back: no try is counted yet.
                return replace(now, state="PutBack", since=observation.t, cause=None)
            return _again(now, observation.t, rules, now.cause)
        case "Validate":
            if observation.held is None:
                if not late:
                    return now
                unsure = CellOutcome("fault", "not confirmed", _unchecked(rules))
                return _put_back(now, observation.t, unsure) if rules.objects else ended(now, observation.t, unsure)
            if observation.held and rules.objects:
                return replace(now, state="ToReleasePose", since=observation.t, carries=True)
            if observation.held:
                return ended(now, observation.t, CellOutcome("held", "", observation.warning))
            said = "; ".join(filter(None, ("the thing is not in the hand", observation.warning)))
            missed = CellOutcome("missed", "", said)
            if observation.loaded:
                return _put_back(now, observation.t, missed)
            return _again(now, observation.t, rules, missed)
        case "ToReleasePose" if observation.held is False:
            lost = CellOutcome("missed", "", "it was lost on the way to the tray")
            return _again(replace(now, carries=False), observation.t, rules, lost)
        case "ToReleasePose" if observation.refused is not None:
            return _put_back(now, observation.t, observation.refused)
        case "OpeningHand" if observation.done and now.put_back is not None:
            return _again(replace(now, carries=False, put_back=None), observation.t, rules, now.put_back)
        case "OpeningHand" if observation.done:
            return MachineState("ToSecurityPose", observation.t, released=now.released + 1)
    if observation.done:
        return replace(now, state=_NEXT[now.state], since=observation.t)
    if late and now.state == "ToLiftedPose" and (now.tries <= rules.retries or rules.objects):
        return _put_back(now, observation.t, _stuck(now, rules))  # What is in the hand is not dropped.
    return _again(now, observation.t, rules, _stuck(now, rules)) if late else now


def watch_outcome(now: MachineState, observation: Observation, rules: StateRules) -> MachineState:
    """What an end comes to while arm and hand are watched after it: held for as long as nothing says otherwise."""
    if now.end is None or now.end.kind != "held":
        return now
    if observation.fault is not None:
        return ended(now, observation.t, observation.fault)
    if observation.held is False:
        said = "; ".join(filter(None, ("it was held after the lift, and is no longer", observation.warning)))
        return ended(now, observation.t, CellOutcome("fault", "dropped", said))
    if observation.held is None and observation.t - now.since >= rules.timeouts["Validate"] - 1e-9:
        return ended(
            now,
            observation.t,
            CellOutcome("fault", "not confirmed", "the second check was not over; see to the camera"),
        )
    return now


def _again(now: MachineState, t: float, rules: StateRules, end: CellOutcome) -> MachineState:
    """The next try, or the end; of a table that is cleared, the next object."""
    if now.tries <= rules.retries:
        first: StateName = "ToReleasePose" if now.carries else "ToSecurityPose"
        if now.put_back is not None:
            first = "PutBack"
        return replace(now, state=first, since=t, tries=now.tries + 1, cause=None, earlier=(*now.earlier, end))
    if now.carries:
        return ended(now, t, end)
    return _later(now, t, rules, end)


def _put_back(now: MachineState, t: float, why: CellOutcome) -> MachineState:
    return replace(now, state="PutBack", since=t, carries=True, put_back=why)


def _later(now: MachineState, t: float, rules: StateRules, end: CellOutcome) -> MachineState:
    """The next object of a table that is cleared, or the end."""
    if len(now.left) + 1 < rules.objects:
        return MachineState("ToSecurityPose", t, released=now.released, left=(*now.left, end))
    return ended(now, t, end)


def _cleared(now: MachineState, refused: CellOutcome, doubt: str) -> CellOutcome:
    """What it comes to when a look finds nothing more to take. `doubt`: of what is no longer there."""
    if refused.kind == "fault" or not (now.released or now.left or doubt):
        return refused
    count = put_away(now.released)
    empty = refused.reason == "no_object"
    why = [*dict.fromkeys(each.sentence for each in now.left), *(() if empty else (refused.sentence,)), doubt]
    if not any(why):
        return CellOutcome("cleared", "", count)
    return CellOutcome("missed", "left", f"{count}; left: {'; '.join(dict.fromkeys(filter(None, why)))}")


def put_away(count: int) -> str:
    """How many objects were put away, in words."""
    return f"{count} object{'' if count == 1 else 's'} put away"


def _full(rules: StateRules) -> CellOutcome:
    """Why what the last look found is not taken."""
    said = f"more stands on the table, and {rules.objects} objects are as many as may be put away: set `tray.objects`"
    return CellOutcome("refused", "full", said)


def ended(now: MachineState, t: float, end: CellOutcome) -> MachineState:
    """The end of the run. What the tries before came to is told with it, unless something is held or all is cleared:
    a try that threw the object down is why there is nothing to take."""
    if end.kind not in ("held", "cleared"):
        before = dict.fromkeys(each for each in now.earlier if each != end)
        told = [f"try {now.earlier.index(each) + 1}: {each}, {each.sentence}" for each in before]
        end = replace(end, sentence="; ".join(filter(None, (end.sentence, *told))))
    return replace(now, state="Done", since=t, end=end)


def _unchecked(rules: StateRules) -> str:
    return (
        f"the check of the grasp was not over after its {rules.timeouts['Validate']:g} s of `timeouts`; see to the "
        "camera and the force sensor, and to what is in the hand before it is opened"
    )


def _stuck(now: MachineState, rules: StateRules) -> CellOutcome:
    said = f"{now.state} was not over after its {rules.timeouts[now.state]:g} s of `timeouts`; see what is in the way"
    return CellOutcome("fault", f"timeout in {now.state}", said)
