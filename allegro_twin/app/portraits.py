"""Trials of an evaluation once more, to be looked at: which of many are worth it, and a picture of one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from allegro_twin.app.rig import Rig
from allegro_twin.grasping.batch.trials import AXES, PERIOD, TrialRunner
from allegro_twin.grasping.evaluation.campaign import EvaluationTarget
from allegro_twin.hands.library.gains import protocol_gains
from allegro_twin.hands.limits import hand_limits
from allegro_twin.hands.settings import LimitSettings
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard

Row = Mapping[str, Any]
MOST = 12
"""Pictures in all: half of them of the best."""
SIZE = (360, 360)


def worth_showing(rows: Sequence[Row], most: int = MOST) -> list[int]:
    """Numbers of the best and of the worst rows, best first: by their rate, whether they held, and their margin."""
    order = _best_first(rows, range(len(rows)))
    return order if len(order) <= most else order[: most // 2] + order[len(order) - most // 2 :]


def ends_of_objects(rows: Sequence[Row]) -> list[int]:
    """Numbers of the best and the worst row of every object, in their order."""
    groups: dict[str, list[int]] = {}
    for number, row in enumerate(rows):
        groups.setdefault(str(row["object"]), []).append(number)
    ordered = [_best_first(rows, members) for members in groups.values()]
    return sorted({order[end] for order in ordered for end in (0, -1)})


def staged(target: EvaluationTarget, row: Row | None = None) -> Rig:
    """The trial without a draw, ready to be performed: where it has six directions the one with the least margin in
    the target's row of results, without one the first. Raises ConfigError."""
    case = target.case.directions()[0 if row is None else _hardest(row)]
    spec, rules = target.spec, case.ruled
    bench = TrialRunner(spec, protocol_gains(rules.gains, spec), rules.period or PERIOD)
    trial = bench.trial(case)
    hand = Guard(trial.backend, hand_limits(LimitSettings(), spec))
    return Rig(spec, hand, bench.controller(trial), trial.seconds, trial, trial.backend)


def portrait(target: EvaluationTarget, path: Path) -> None:
    """Perform the trial without a draw up to the end of its first check, along the first direction, and keep a PNG.
    Raises ConfigError where pictures cannot be rendered, ImportError without the extra for them, HandFault where the
    guard stops the hand."""
    from allegro_twin.viewing.stills import photographed
    from allegro_twin.viewing.views import AUTO

    rig = staged(target)
    assert rig.trial is not None
    assert rig.sim is not None
    moment = next((window.end for window in rig.trial.windows if window.check), rig.trial.seconds)
    with ExitStack() as stack:
        samples = until(moment, run(rig.backend, rig.controller))
        name = rig.trial.objects[0].grasp_object.name
        for _ in photographed(samples, rig.sim, None, path, [moment], SIZE, AUTO, stack, [name]):
            pass


def _best_first(rows: Sequence[Row], members: Sequence[int]) -> list[int]:
    def good(number: int) -> tuple[float, bool, float]:
        row = rows[number]
        return row.get("success", 0.0), row["held"], _left(row.get("margin"))

    return sorted(members, key=good, reverse=True)


def _hardest(row: Row) -> int:
    margins = [_left(row.get(f"margin_{axis}")) for axis in AXES]
    return margins.index(min(margins))


def _left(margin: float | None) -> float:
    """Nothing at all where the trial could not go on."""
    return -math.inf if margin is None or margin != margin else margin
