"""The answer in words and figures, for people: the same in the terminal and in the report."""

from __future__ import annotations

import math
from collections.abc import Sequence

from allegro_twin.grasping.evaluation import Interval, pairs_needed
from studies.preemption.analysis import Answer, Finding, Versus
from studies.preemption.measures import Row
from studies.preemption.outcomes import control_of
from studies.preemption.protocol import Study


def between(interval: Interval) -> str:
    """Of a rate."""
    return f"{100 * interval.low:.0f}–{100 * interval.high:.0f} %"


def points(interval: Interval) -> str:
    """Of a difference of rates."""
    return f"{100 * interval.low:+.1f} to {100 * interval.high:+.1f}"


def p_of(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def seconds(versus: Versus) -> str:
    return f"{versus.seconds:+.2f} s ({versus.faster.low:+.2f} to {versus.faster.high:+.2f})"


def answer_of(answer: Answer, study: Study) -> str:
    """In two sentences."""
    names = [each.hand for each in answer.findings]
    yes = [name for name in names if answer.beats[name]]
    if not names:
        return "Nothing can be said: there is no whole block of test trials of a hand that was trained on."
    faster = [each.primary.seconds for each in answer.findings]
    head = (
        f"By the rule of the protocol, preemption beats reach-then-grasp with {_listed(yes)}."
        if yes
        else "By the rule of the protocol, preemption is not shown to beat reach-then-grasp with any hand."
    )
    left = [each for each in answer.findings if not answer.beats[each.hand]]
    open_ = [each.hand for each in left if answer.mcnemar[each.hand] >= study.analysis.alpha]
    worse = [each.hand for each in left if each.hand not in open_ and each.primary.counts.difference < 0.0]
    saved = sorted({f"{-each:.2f}" for each in (max(faster), min(faster))})
    time = f"It saves {' to '.join(saved)} s of a cycle"
    rest = [f"success is worse with {_listed(worse)}"] if worse else []
    rest += [f"with {_listed(open_)} so many pairs cannot tell whether success suffers"] if open_ else []
    return f"{head} {time}{'; ' if rest else ''}{', and '.join(rest)}."


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else "none"


def sentence(found: Finding, answer: Answer, study: Study) -> str:
    """The primary comparison of one hand."""
    one, counts = found.primary, found.primary.counts
    needed = pairs_needed(counts) if counts.only_first != counts.only_second else None
    more = "" if needed is None or one.p_value < study.analysis.alpha else f"; about {needed} pairs would show it"
    return (
        f"{found.hand}: {one.first} against {one.second} on {counts.draws} pairs: only {one.first} held "
        f"{counts.only_first}, only {one.second} {counts.only_second}; Δ {100 * counts.difference:+.1f} points "
        f"({points(one.interval)}; over objects {points(one.clustered)}), McNemar p {p_of(one.p_value)}, after Holm "
        f"{p_of(answer.mcnemar[found.hand])}{more}; "
        f"not inferior by {100 * study.analysis.margin:.0f} points: p {p_of(one.inferior)}, after Holm "
        f"{p_of(answer.inferior[found.hand])}; cycle {seconds(one)}, of it {-by_definition(found, study):+.2f} s by "
        f"definition: "
        f"{'beats' if answer.beats[found.hand] else 'not shown to beat'} reach-then-grasp."
    )


def by_definition(found: Finding, study: Study) -> float:
    """What the chosen overlap saves however the trials come out, s: its part of the closing time."""
    return study.policy(found.chosen).overlap * study.motion.close


def choices_of(found: Finding) -> str:
    """How settled the choice of the overlap is."""
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in found.choices.items() if share > 0.0)
    return f"Of {found.trained} pairs of train drawn again: {shares}."


def half_of(found: Finding) -> str:
    """φ₅₀ and the curve's slope."""
    half = found.dose.half
    said = "success does not fall" if math.isinf(half) else "φ₅₀ beyond 1" if half > 1.0 else f"φ₅₀ {half:.2f}"
    return f"{said} (b = {found.dose.b:+.2f})"


def controls(rows: Sequence[Row], study: Study, hand: str) -> list[tuple[str, str]]:
    """Each control with what came of it."""
    told = []
    for name in study.controls:
        pairs = control_of(rows, study, hand, name)
        if not pairs:
            continue
        held, n = sum(bool(row["held"]) for row, _ in pairs), len(pairs)
        beside = [(bool(row["held"]), bool(other["held"])) for row, other in pairs if other is not None]
        alike = sum(a == b for a, b in beside)
        without = sum(b for _, b in beside)
        told.append((name, f"held {held} of {n}; without it {without}; the same verdict in {alike} of {len(beside)}"))
    return told
