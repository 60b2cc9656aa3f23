"""Terminal output: tables, progress, warnings and hints."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from allegro_twin.files.standard_streams import OutputLost

if TYPE_CHECKING:
    from allegro_twin.grasping.plan.search import GraspSearch
    from allegro_twin.grasping.plan.validate import PlannedGrasp
    from allegro_twin.grasping.verdict import TrialReport
    from allegro_twin.learning.mpc.episodes import MpcEpisode
    from allegro_twin.learning.mpc.settings import MpcSettings
    from allegro_twin.learning.tasks.base import Task
    from allegro_twin.learning.training.evaluation import Evaluation
    from allegro_twin.learning.training.report import Comparison
    from allegro_twin.learning.training.settings import Recipe
    from allegro_twin.spec import HandSpec
    from allegro_twin.spec.thermal import ThermalData
    from allegro_twin.surfaces.hand.grasps import GraspOutcome
    from allegro_twin.twin.identify.motions.limits import FoundLimits
    from allegro_twin.types import HandState


class _Console(Console):
    """Whoever stops to listen, as `head` does, does not stop what is told, nor does a full disk."""

    def __exit__(self, *raised: object) -> None:
        with suppress(OutputLost):  # The program says so when it ends.
            super().__exit__(*raised)

    def on_broken_pipe(self) -> None:
        self.quiet = True
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())


console: Console = _Console(width=None if sys.stdout.isatty() else 120)
errors: Console = _Console(stderr=True, width=None if sys.stderr.isatty() else 120)


def warn(line: str) -> None:
    """Print a warning on standard error, in one line; an empty one is not printed."""
    if line:
        errors.print(line, style="yellow", markup=False, soft_wrap=True, highlight=False)


def say(line: str) -> None:
    """Print a line as it is: what looks like markup in a path or a reason is no markup."""
    console.print(line, markup=False, soft_wrap=True, highlight=False)


def hint(line: str) -> None:
    """Print what to do next, in one line."""
    console.print(line, style="dim", markup=False, soft_wrap=True, highlight=False)


@contextmanager
def progress() -> Iterator[Progress]:
    """A progress bar that disappears at the end. Nothing without a terminal, FORCE_COLOR or not: a notebook would keep
    every step of the bar."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True, disable=not sys.stderr.isatty()) as bar:
        yield bar


@contextmanager
def growing(table: Table) -> Iterator[Callable[[], None]]:
    """A table that is shown again whenever the function is called; without a terminal, FORCE_COLOR or not, once, at the
    end: a notebook would keep every state of it."""
    if sys.stdout.isatty():
        with Live(table, console=console, auto_refresh=False) as live:
            yield live.refresh
        return
    try:
        yield lambda: None
    finally:
        console.print(table)


GONE_DISTANCE = 1000.0
"""mm in the palm: beyond them an object is gone, and the number means nothing."""


def millimetres(distance: float) -> str:
    """A distance of an object in the palm, m, in mm; `gone` beyond GONE_DISTANCE."""
    return "gone" if 1000.0 * distance > GONE_DISTANCE else f"{1000.0 * distance:.1f}"


def summary(reports: Mapping[tuple[str, str], TrialReport], grasps: Mapping[str, str], engine: str) -> Table:
    """One row for each trial: verdict and margins."""
    held = sum(report.held for report in reports.values())
    table = Table(title=f"{held} of {len(reports)} held ({engine})", title_style="bold")
    parts = next((list(report.phases[0].contact_force) for report in reports.values() if report.phases), [])
    for name in ("object", "hand", "grasp", "held"):
        table.add_column(name)
    for name in ("drift\nmm", "turn\n°", "inside\nmm", *(f"{part[:6]}\nN" for part in parts), "at\nlimit"):
        table.add_column(name, justify="right")
    for (scenario, side), report in reports.items():
        checks = [phase for phase in report.phases if phase.check]
        forces = checks[0].contact_force.values() if checks else ()
        table.add_row(
            scenario,
            side,
            grasps[scenario],
            "[green]yes[/]" if report.held else "[red]no[/]",
            millimetres(max(phase.drift for phase in checks)) if checks else "",
            f"{max(phase.rotation for phase in checks):.1f}" if checks else "",
            f"{report.penetration * 1000:.1f}" if report.phases else "",
            *((f"{force:.1f}" for force in forces) if checks else [""] * len(parts)),
            _stalls(report),
        )
    failed = [f"{scenario}, {side}: {r.reason}" for (scenario, side), r in reports.items() if not r.held]
    table.caption = "\n".join([_counted(reports), *failed])
    table.caption_justify = "left"
    return table


def _counted(reports: Mapping[tuple[str, str], TrialReport]) -> str:
    """Rate with its interval. Mirrored trials of the left hand do not count as trials of their own."""
    from allegro_twin.grasping.statistics import wilson

    own = {key: report for key, report in reports.items() if key[1] == "right" or (key[0], "right") not in reports}
    held = sum(report.held for report in own.values())
    low, high = wilson(held, len(own))
    text = f"{held} of {len(own)} is {100 * low:.0f}–{100 * high:.0f} % (95 % Wilson interval)"
    return (
        text if len(own) == len(reports) else f"right hand: {text}; the left hand's trials mirror them: n = {len(own)}"
    )


def plan_table(name: str, found: Sequence[PlannedGrasp], requested: int) -> Table:
    """One row for each grasp, in the order of the search: rates on the search's draws, and on fresh ones."""
    from allegro_twin.grasping.evaluation.outcomes import make_rate

    count = f"{len(found)} grasp{'' if len(found) == 1 else 's'}"
    fewer = f" of {requested} asked for" if len(found) < requested else ""
    table = Table(title=f"{count}{fewer}: {name}" if fewer else f"{count} for {name}", title_style="bold")
    words = ("from", "like", "type")
    for title in ("", *words, "chosen on\ndraws", "held in\nfresh draws", "drift\nlimits left", "motor\nsustains"):
        table.add_column(title, justify="left" if title in words else "right")
    for number, each in enumerate(found, 1):
        table.add_row(
            str(number), each.candidate.direction, each.candidate.template, str(each.grasp.kind),
            f"{each.held} of {each.tried}" if each.tried else "",
            str(make_rate("", each.judged_held, each.judged)) if each.judged else "",
            f"{each.margin:.0%}", f"{each.sustained:.0%}",
        )  # fmt: skip
    return table


def search_summary(search: GraspSearch, seeds: int, found: Sequence[PlannedGrasp]) -> str:
    """Size of a search, how to repeat it, and how what it found was judged."""
    from allegro_twin.grasping.plan.validate import JUDGED

    closed, times = search.closed, f"{search.cpu:.0f} CPU-s"
    again = f"--seed {search.seed} --candidates {closed} finds the same" if closed else "there is nothing to repeat"
    if seeds > 1:
        again = "; ".join(f"seed {seed}: --candidates {count}" for seed, count in search.counts.items())
    if search.cut:
        again = "--time cut the first round short, so no number of candidates repeats it"
    if search.interrupted:
        again = "it was interrupted, so no number of candidates repeats it"
    judged = f" Judged afterwards on {JUDGED} draws of their own, in the whole trial."
    said = f"Searched: {closed} candidates, {times}; {again}."
    return said + (judged if any(each.judged for each in found) else "")


def _stalls(report: TrialReport) -> str:
    """Share of time that the most loaded joint spends at its torque limit; – where no limit is known."""
    if math.isnan(report.stall):
        return "–" if report.at_limit else ""
    return f"{report.stall:.0%}" if report.stall >= 0.005 else ""


def phases(title: str, report: TrialReport, thermal: ThermalData | None) -> Table:
    """One row for each phase of a trial. `thermal`: of the hand."""
    table = Table(title=f"{title}: {'[green]held[/]' if report.held else '[red]not held:[/] ' + report.reason}")
    parts = list(report.phases[0].contact_force) if report.phases else []
    for name in ("phase", "drift mm", "largest mm", "turn °", *(f"{part} N" for part in parts), "held"):
        table.add_column(name, justify="left" if name in ("phase", "held") else "right")
    for phase in report.phases:
        forces = [f"{value:.1f}" for value in phase.contact_force.values()]
        verdict = ("[green]yes[/]" if phase.held else "[red]no[/]") if phase.check else ""
        numbers = (millimetres(phase.drift), millimetres(phase.largest_drift), f"{phase.rotation:.1f}")
        table.add_row(phase.name, *numbers, *forces, verdict)
    from allegro_twin.grasping.evaluation.rejudge import limits_left, motor_load

    kind = report.observed
    acts = "" if kind is None else f"\n{kind}: {kind.virtual_fingers or kind.why}; {kind.carries}"
    rose = "it left the table and fell" if report.fell else f"lifted {report.lift * 1000:.0f} mm"
    table.caption = (
        f"{rose}, at most {report.penetration * 1000:.1f} mm in each other"
        f"{limits_left(report.margin)}; {'; '.join(motor_load(report, thermal))}{acts}"
    )
    return table


def final_state(spec: HandSpec, state: HandState) -> Table:
    """Joint positions at the end of a run, by finger."""
    what = "positions of the motors, in their own units" if spec.followers else "joint positions, rad"
    table = Table(title=f"{spec.name} at {state.t:.3f} s: {what}")
    table.add_column("finger")
    for place in range(max(len(finger.joints) for finger in spec.fingers)):
        table.add_column(str(place), justify="right")
    for finger in spec.fingers:
        table.add_row(finger.name, *(f"{state.position[joint]:.4f}" for joint in finger.joints))
    return table


def grasp_forces(grasped: GraspOutcome) -> Table:
    """Forces of the fingers at the end of a grasp, from joint torques."""
    table = Table(title=f"{grasped.name}: what the joints felt")
    for name, justify in (("finger", "left"), ("pad presses N", "right")):
        table.add_column(name, justify=justify)  # type: ignore[arg-type]  # Rich narrows it to a literal.
    for finger, force in grasped.force.items():
        table.add_row(finger, f"{force:.1f}")
    table.caption = grasped.describe()
    return table


def limits(spec: HandSpec, found: FoundLimits) -> Table:
    """Measured joint limits, those of the model, and the offsets that centre them."""
    from allegro_twin.twin.identify.motions.limits import centring_offsets

    table = Table(title=f"{spec.name}: limits found, rad")
    for name in ("joint", "lowest", "model", "highest", "model", "centring offset"):
        table.add_column(name, justify="left" if name == "joint" else "right")
    offsets = centring_offsets(found, spec)
    for k, name in enumerate(spec.joint_labels):
        row = (found.lower[k], spec.lower[k], found.upper[k], spec.upper[k], offsets[k])
        table.add_row(name, *(f"{value:+.3f}" for value in row))
    return table


def identity(model: HandSpec, mine: HandSpec, margin: float) -> Table:
    """Joints of a hand: limits of the model and of this hand with the margin, and the motors."""
    title = f"{mine.name} {mine.serial}".strip()
    table = Table(title=f"{title}: limits rad, torque N·m, margin {margin:g} rad")
    heads = (
        "joint",
        "name",
        "model lowest",
        "highest",
        "this hand lowest",
        "highest",
        "torque limit",
        "damping",
        "friction",
    )
    for name in heads:
        table.add_column(name, justify="left" if name in ("joint", "name") else "right")
    motors = mine.actuation
    for k, name in enumerate(mine.joints):
        limit = (model.lower[k], model.upper[k], mine.lower[k] + margin, mine.upper[k] - margin)
        motor = (motors.torque_limit[k], motors.damping[k], motors.frictionloss[k])
        numbers = ("unknown" if math.isinf(v) else f"{v:.4f}" for v in motor)
        table.add_row(name, mine.joint_labels[k], *(f"{v:+.3f}" for v in limit), *numbers)
    return table


def policy_table(found: Sequence[Comparison], recipe: Recipe, seed: int) -> Table:
    """Success of a policy, and without action, in each set of episodes with seeds from `seed` on; 95 % intervals."""
    from allegro_twin.learning.tasks import task_type
    from allegro_twin.learning.training.report import quartiles

    title = f"success in the same episodes, seeds from {seed} (95 % interval)"
    table = Table(title=title, title_justify="left", title_style="bold")
    kind = task_type(recipe.task)
    counts = any(each.policy.counts is not None for each in found)
    known = [name for name in kind.share_terms if all(name in each.policy.shares for each in found)]
    more = [f"{kind.count_term}, {kind.count_unit}: mean (quartiles)"] if counts else []
    more += [f"{_share_name(name)}: policy, no action" for name in known]
    for column in ("objects", "episodes", "policy", "no action", *more):
        table.add_column(column, justify="left" if column == "objects" else "right")
    for each in found:
        shares = [success_rate(each.policy), success_rate(each.no_action)]
        if (counted := each.policy.counts) is not None:
            low, median, high = quartiles(counted)
            shares.append(f"{counted.mean():.1f} ({low:.1f}, {median:.1f}, {high:.1f})")
        for name in known:
            shares.append(", ".join(f"{found.shares[name].mean():.0%}" for found in (each.policy, each.no_action)))
        table.add_row(each.name, str(len(each.policy.success)), *shares)
    return table


def pick_table(found: Sequence[Comparison], seed: int) -> Table:
    """Success of a policy of `ArmPick`, and of the script, in each set of episodes with seeds from `seed` on."""
    title = f"success in the same episodes, seeds from {seed} (95 % interval)"
    table = Table(title=title, title_justify="left", title_style="bold")
    for column in ("objects", "episodes", "policy", "script"):
        table.add_column(column, justify="left" if column == "objects" else "right")
    for each in found:
        table.add_row(each.name, str(len(each.policy.success)), success_rate(each.policy), success_rate(each.no_action))
    return table


def _share_name(term: str) -> str:
    """What a share is of."""
    return {"by_tips": "by fingertips, share of force"}.get(term, f"{term.replace('_', ' ')}, share of time")


def mpc_table(found: Sequence[MpcEpisode], kind: type[Task], settings: MpcSettings, seed: int) -> Table:
    """Episodes under model predictive control, a row each."""
    title = f"{settings.method}, {settings.samples} samples over {settings.horizon:g} s; seeds from {seed}, in lockstep"
    table = Table(title=title, title_justify="left", title_style="bold")
    count = [f"{kind.count_term}, {kind.count_unit}"] if kind.count_term else []
    for column in ("object", "kept, s", "success", *count, "by fingertips", "thinking a decision, s"):
        table.add_column(column, justify="left" if column == "object" else "right")
    for each in found:
        kept = f"{each.seconds:.1f}" + ("" if each.kept else ", then lost")
        counted = ["–" if math.isnan(each.count) else f"{each.count:.{kind.count_digits}f}"] if count else []
        tips = "–" if math.isnan(each.by_tips) else f"{each.by_tips:.0%}"
        table.add_row(each.object or "–", kept, "yes" if each.success else "no", *counted, tips, f"{each.thinking:.2f}")
    return table


def success_rate(found: Evaluation) -> str:
    """Success rate with its 95 % Wilson interval."""
    from allegro_twin.grasping.statistics import wilson

    low, high = wilson(int(found.success.sum()), len(found.success))
    return f"{found.rate:.0%} ({low:.0%} to {high:.0%})"
