"""The report: one HTML file that fetches nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from allegro_twin.files import atomic_file
from allegro_twin.grasping.evaluation import Interval
from allegro_twin.viewing.report import (
    IntervalRow,
    html_page,
    html_table,
    interval_chart,
    rate_chart,
    svg,
    svg_text,
)
from studies.preemption import report_text
from studies.preemption.analysis import Answer, Arm, Finding, analysed
from studies.preemption.dose_response import Dose
from studies.preemption.measures import Row
from studies.preemption.protocol import Study
from studies.preemption.registration import status_of


def write_report(path: Path, rows: Sequence[Row], study: Study, about: Mapping[str, str]) -> None:
    """Write the report of some trials. `about`: what they depend on. Raises RecordingError where the disk refuses."""
    with atomic_file(path) as temporary:
        temporary.write_text(page(rows, study, about), encoding="utf-8")


def page(rows: Sequence[Row], study: Study, about: Mapping[str, str]) -> str:
    """The same as text."""
    answer = analysed(rows, study)
    facts = " · ".join(f"{key} {value}" for key, value in about.items())
    parts = [
        f"<p><b>{escape(status_of(about))}</b></p>",
        f"<p><b>{escape(report_text.answer_of(answer, study))}</b></p>",
        "<p class='soft'>In simulation, with these hands' models, grasps and objects; docs/results/preemption.md "
        "has the "
        "protocol and the limits.</p>",
        _primary(answer, study),
        *(_hand(each, answer, rows, study) for each in answer.findings),
    ]
    return html_page("Closing while the arm still moves, against reach-then-grasp", facts, parts)


def _primary(answer: Answer, study: Study) -> str:
    if not answer.findings:
        return ""
    success = [
        IntervalRow(f"{each.hand}, {each.chosen}", 100 * each.primary.counts.difference,
                    *_scaled(each.primary.interval), f"p {report_text.p_of(answer.mcnemar[each.hand])} after Holm")
        for each in answer.findings
    ]  # fmt: skip
    time = [
        IntervalRow(f"{each.hand}, {each.chosen}", each.primary.seconds, *each.primary.faster,
                    f"{each.primary.seconds:+.2f} s")
        for each in answer.findings
    ]  # fmt: skip
    margin = -100 * study.analysis.margin
    return (
        "<h2>The overlap that was chosen on train, on test</h2><h3>Success, points more than "
        f"{study.analysis.baseline}</h3><p class='soft'>Newcombe's 95 % interval; dashed: the margin.</p>"
        f"{interval_chart(success, 'Difference of success', 'pp', margin)}"
        "<h3>Cycle time</h3><p class='soft'>Bootstrap over objects, 95 %.</p>"
        f"{interval_chart(time, 'Difference of cycle time', 's')}"
    )


def _hand(found: Finding, answer: Answer, rows: Sequence[Row], study: Study) -> str:
    chart = [(each.policy, each.held, each.trials, *each.rate) for each in found.arms]
    curves = {f"σ {sigma:g} mm": curve for sigma, curve in found.by_sigma.items()}
    both, unsaid, wrong, neither = found.check
    checks = "".join(
        f"<li>{escape(name)}: {escape(said)}</li>" for name, said in report_text.controls(rows, study, found.hand)
    )
    return (
        f"<h2>{escape(found.hand)}</h2><p>{escape(report_text.sentence(found, answer, study))} Chosen on "
        f"{found.trained} pairs of train. {escape(report_text.choices_of(found))}</p>"
        f"{rate_chart(chart, f'Success with {found.hand}')}"
        f"<h3>Success against overlap</h3><p class='soft'>{escape(report_text.half_of(found))}</p>"
        f"{_dose_chart(curves, f'Success of {found.hand} by overlap')}{_arms(found.arms)}{_versus(found)}"
        f"<h3>Controls</h3><ul>{checks}</ul><p class='soft'>The force check: held and said so {both}, held and "
        f"not said {unsaid}, said and not held {wrong}, neither {neither}.</p>"
    )


def _arms(arms: Sequence[Arm]) -> str:
    heads = ("policy", "held", "95 %", "cycle s", "s per success", "touched early s", "moved mm", "peak N")
    return html_table(heads, (
        (each.policy, f"{each.held} of {each.trials}", report_text.between(each.rate),
         f"{each.seconds:.2f}", f"{each.per_success:.2f}", f"{each.premature:.2f}", f"{each.carried:.1f}",
         f"{each.peak:.0f}")
        for each in arms
    ), "What each policy did")  # fmt: skip


def _versus(found: Finding) -> str:
    heads = ("first", "second", "only first", "only second", "Δ points", "95 %", "over objects", "McNemar p", "cycle")
    return html_table(heads, (
        (each.first, each.second, str(each.counts.only_first), str(each.counts.only_second),
         f"{100 * each.counts.difference:+.1f}", report_text.points(each.interval), report_text.points(each.clustered),
         report_text.p_of(each.p_value), report_text.seconds(each))
        for each in found.versus
    ), "In the same trials")  # fmt: skip


def _dose_chart(curves: Mapping[str, tuple[Dose, Sequence[tuple[float, int, int]]]], title: str) -> str:
    """Rates against the overlap from 0 to 1: dots as they were, lines as they were fitted, each with its name."""
    width, height, left, foot, top, right = 460, 240, 46, 40, 12, 90
    across, tall, body = width - left - right, height - foot - top, []

    def place(overlap: float, rate: float) -> tuple[float, float]:
        return round(left + across * overlap, 1), round(top + tall * (1.0 - rate), 1)

    for part in (0.0, 0.25, 0.5, 0.75, 1.0):
        (x0, y), (x1, _) = place(0.0, part), place(1.0, part)
        body.append(f'<line class="grid" x1="{x0}" x2="{x1}" y1="{y}" y2="{y}"/>')
        body.append(svg_text(left - 6, y + 4, f"{100 * part:.0f} %", "end"))
        body.append(svg_text(place(part, 0.0)[0], height - foot + 18, f"{part:g}", "middle"))
    body.append(svg_text(left + across / 2, height - 3, "overlap φ", "middle"))
    for number, (dose, dots) in enumerate(curves.values()):
        strength = f'style="opacity:{1.0 - 0.75 * number / max(len(curves), 1):.2f}"'
        way = " ".join(f"{x},{y}" for x, y in (place(k / 40, dose.rate(k / 40)) for k in range(41)))
        marks = "".join(
            '<circle class="good" cx="{}" cy="{}" r="4"/>'.format(*place(overlap, held / tried))
            for overlap, held, tried in dots
            if tried
        )
        body.append(f'<g {strength}><polyline class="whisker" style="fill:none" points="{way}"/>{marks}</g>')
    ends = {name: place(1.0, dose.rate(1.0))[1] for name, (dose, _) in curves.items()}
    body += [svg_text(left + across + 6, y + 4, name, "start") for name, y in _apart(ends, 14.0).items()]
    return svg(width, height, "".join(body), f"{title}: {', '.join(curves)}")


def _apart(heights: Mapping[str, float], least: float) -> dict[str, float]:
    """Labels at some heights, from the top down, moved so that none is written over another."""
    found, last = dict[str, float](), -math.inf
    for name in sorted(heights, key=lambda each: heights[each]):
        found[name] = last = max(heights[name], last + least)
    return found


def _scaled(interval: Interval) -> Interval:
    return Interval(100 * interval[0], 100 * interval[1])
