"""The tables of docs/results/preemption.md, of the trials that a folder has.

`python -m benchmarks.preemption docs/studies/preemption [docs/results/preemption.md]` prints them; with the path of a
page they
are put between that page's marks.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.unlearned import put
from studies.preemption import report_text
from studies.preemption.analysis import Answer, Finding, Versus, analysed, choices, chosen
from studies.preemption.folder import read
from studies.preemption.measures import Row
from studies.preemption.outcomes import outcomes_of
from studies.preemption.protocol import Study

_HEAD = (
    "| policy | held | 95 % | Δ to {base}, points | 95 % | only it / only {base} | McNemar p | cycle, s | "
    "s per success | touched early, s | moved, mm |"
)


def lines(rows: Sequence[Row], study: Study) -> Iterator[str]:
    """Training, then each hand."""
    yield from _train(rows, study)
    answer = analysed(rows, study)
    for found in answer.findings:
        yield from _hand(found, answer, rows, study)


def _train(rows: Sequence[Row], study: Study) -> Iterator[str]:
    names = list(study.trained)
    yield f"On train, {study.pairs.train} pairs a hand, so many were held; the overlap is chosen by them and nothing"
    yield "else is concluded from them:"
    yield ""
    yield f"| hand | {' | '.join(names)} | chosen | by these pairs drawn again |"
    yield "|" + "---|" * (len(names) + 3)
    for hand in study.hands:
        train = outcomes_of(rows, study, hand, "train")
        if train.trials:
            held = " | ".join(str(sum(train.held(name))) for name in names)
            again = choices(train, study.analysis, study.seed)
            shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in again.items() if share > 0.0)
            yield f"| {hand} | {held} | {chosen(train, study.analysis)} | {shares} |"


def _hand(found: Finding, answer: Answer, rows: Sequence[Row], study: Study) -> Iterator[str]:
    base, head = study.analysis.baseline, _HEAD.format(base=study.analysis.baseline)
    against: dict[str, Versus] = {each.first: each for each in found.versus if each.second == base}
    yield f"\n### {found.hand}: {found.primary.counts.draws:,} pairs\n"
    yield head
    yield "|" + "---|" * (head.count("|") - 1)
    for arm in found.arms:
        mark = f"{arm.policy} (φ*)" if arm.policy == found.chosen else arm.policy
        one = against.get(arm.policy)
        cells = "| | | |" if one is None else (
            f"| {100 * one.counts.difference:+.1f} | {report_text.points(one.interval)} | {one.counts.only_first} / "
            f"{one.counts.only_second} | {report_text.p_of(one.p_value)}"
        )  # fmt: skip
        yield (
            f"| {mark} | {arm.held:,} of {arm.trials:,} | {report_text.between(arm.rate)} {cells} "
            f"| {arm.seconds:.2f} | {arm.per_success:.2f} | {arm.premature:.2f} | {arm.carried:.1f} |"
        )
    overlaps = ", ".join(f"{dose:g}" for dose, _, _ in next(iter(found.by_sigma.values()))[1])
    sigmas = "; ".join(
        f"{sigma:g} mm " + ", ".join(f"{held} of {tried}" for _, held, tried in points)
        for sigma, (_, points) in found.by_sigma.items()
    )
    both, unsaid, wrong, neither = found.check
    yield f"\n{report_text.sentence(found, answer, study)}"
    yield f"Over φ from 0 to 0.9 {report_text.half_of(found)}; by σ, at φ = {overlaps}: {sigmas}."
    yield (
        f"\nThe force check, all policies: held and said so {both:,}, held and not said {unsaid:,}, said and not held "
        f"{wrong:,}, neither {neither:,}.\n\nControls:\n"
    )
    yield from (f"- {name}: {said}" for name, said in report_text.controls(rows, study, found.hand))


def main(arguments: list[str]) -> None:
    """Print the tables, or put them into a page."""
    held = read(Path(arguments[0]))
    put(lines(held.table.to_pylist(), held.study), map(Path, arguments[1:]), "tables")


if __name__ == "__main__":
    main(sys.argv[1:])
