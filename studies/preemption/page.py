"""The report: one HTML file that fetches nothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.grasping.evaluation.page.charts import Rate, rates
from allegro_twin.grasping.evaluation.page.style import STYLE
from allegro_twin.grasping.statistics import Interval
from studies.preemption import report_text
from studies.preemption.analysis import Answer, Arm, Finding, analysed
from studies.preemption.charts import Difference, differences, doses
from studies.preemption.outcomes import Row
from studies.preemption.protocol import Study
from studies.preemption.registration import status_of


def write_report(path: Path, rows: Sequence[Row], study: Study, about: Mapping[str, str]) -> None:
    """Write the report of some trials. `about`: what they depend on. Raises RecordingError where the disk refuses."""
    with atomic_file(path) as temporary:
        temporary.write_text(page(rows, study, about), encoding="utf-8")


def page(rows: Sequence[Row], study: Study, about: Mapping[str, str]) -> str:
    """The same as text."""
    answer = analysed(rows, study)
    facts = " · ".join(f"{escape(key)} {escape(value)}" for key, value in about.items())
    title = "Closing while the arm still moves, against reach-then-grasp"
    body = [
        f"<header><h1>{title}</h1><p class='soft'>{facts}</p></header>",
        f"<p><b>{escape(status_of(about))}</b></p>",
        f"<p><b>{escape(report_text.answer_of(answer, study))}</b></p>",
        "<p class='soft'>In simulation, with these hands' models, grasps and objects; docs/preemption.md has the "
        "protocol and the limits.</p>",
        _primary(answer, study),
        *(_hand(each, answer, rows, study) for each in answer.findings),
    ]
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{STYLE}</style></head><body><main>{''.join(body)}</main></body></html>\n"
    )


def _primary(answer: Answer, study: Study) -> str:
    if not answer.findings:
        return ""
    success = [
        Difference(f"{each.hand}, {each.chosen}", 100 * each.primary.counts.difference,
                   _scaled(each.primary.interval), f"p {report_text.p_of(answer.mcnemar[each.hand])} after Holm")
        for each in answer.findings
    ]  # fmt: skip
    time = [
        Difference(f"{each.hand}, {each.chosen}", each.primary.seconds, each.primary.faster,
                   f"{each.primary.seconds:+.2f} s")
        for each in answer.findings
    ]  # fmt: skip
    margin = -100 * study.analysis.margin
    return (
        "<h2>The overlap that was chosen on train, on test</h2><h3>Success, points more than "
        f"{study.analysis.baseline}</h3><p class='soft'>Newcombe's 95 % interval; dashed: the margin.</p>"
        f"{differences(success, 'Difference of success', 'pp', margin)}"
        "<h3>Cycle time</h3><p class='soft'>Bootstrap over objects, 95 %.</p>"
        f"{differences(time, 'Difference of cycle time', 's')}"
    )


def _hand(found: Finding, answer: Answer, rows: Sequence[Row], study: Study) -> str:
    chart = [Rate(each.policy, each.held, each.trials, *each.rate) for each in found.arms]
    curves = {f"σ {sigma:g} mm": curve for sigma, curve in found.by_sigma.items()}
    both, unsaid, wrong, neither = found.check
    checks = "".join(
        f"<li>{escape(name)}: {escape(said)}</li>" for name, said in report_text.controls(rows, study, found.hand)
    )
    return (
        f"<h2>{escape(found.hand)}</h2><p>{escape(report_text.sentence(found, answer, study))} Chosen on "
        f"{found.trained} pairs of train. {escape(report_text.choices_of(found))}</p>"
        f"{rates(chart, f'Success with {found.hand}')}"
        f"<h3>Success against overlap</h3><p class='soft'>{escape(report_text.half_of(found))}</p>"
        f"{doses(curves, f'Success of {found.hand} by overlap')}{_arms(found.arms)}{_versus(found)}"
        f"<h3>Controls</h3><ul>{checks}</ul><p class='soft'>The force check: held and said so {both}, held and "
        f"not said {unsaid}, said and not held {wrong}, neither {neither}.</p>"
    )


def _arms(arms: Sequence[Arm]) -> str:
    heads = ("policy", "held", "95 %", "cycle s", "s per success", "touched early s", "moved mm", "peak N")
    return _table("What each policy did", heads, (
        (each.policy, f"{each.held} of {each.trials}", report_text.between(each.rate),
         f"{each.seconds:.2f}", f"{each.per_success:.2f}", f"{each.premature:.2f}", f"{each.carried:.1f}",
         f"{each.peak:.0f}")
        for each in arms
    ))  # fmt: skip


def _versus(found: Finding) -> str:
    heads = ("first", "second", "only first", "only second", "Δ points", "95 %", "over objects", "McNemar p", "cycle")
    return _table("In the same trials", heads, (
        (each.first, each.second, str(each.counts.only_first), str(each.counts.only_second),
         f"{100 * each.counts.difference:+.1f}", report_text.points(each.interval), report_text.points(each.clustered),
         report_text.p_of(each.p_value), report_text.seconds(each))
        for each in found.versus
    ))  # fmt: skip


def _table(caption: str, heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = "".join(f'<th scope="col" style="padding:6px 10px">{escape(each)}</th>' for each in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return (
        f"<div class='wide' tabindex='0' role='region' aria-label='{escape(caption)}'><table><caption class='soft'>"
        f"{escape(caption)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _scaled(interval: Interval) -> Interval:
    return Interval(100 * interval[0], 100 * interval[1])
