"""A picture of a trial at the end of its first check, for the best and the worst of many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from allegro_twin.build.campaign import Target, spec_of
from allegro_twin.build.rig import limits_of
from allegro_twin.build.trials import PERIOD, Bench
from allegro_twin.config.run import LimitSettings
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard

MOST = 12
"""Pictures in all: half of them of the best."""
SIZE = (360, 360)


def worth_showing(rows: Sequence[Mapping[str, Any]], most: int = MOST) -> list[int]:
    """Numbers of the best and of the worst rows, best first: by their rate, whether they held, and their margin."""

    def good(number: int) -> tuple[float, bool, float]:
        row = rows[number]
        margin = row.get("margin")
        return row.get("success", 0.0), row["held"], -10.0 if margin is None or margin != margin else margin

    order = sorted(range(len(rows)), key=good, reverse=True)
    return order if len(order) <= most else order[: most // 2] + order[len(order) - most // 2 :]


def portrait(target: Target, path: Path) -> None:
    """Perform the trial without a draw up to the end of its first check, along the first direction, and keep a PNG.
    Raises ConfigError where pictures cannot be rendered, ImportError without the extra for them, HandFault where the
    guard stops the hand."""
    from allegro_twin.look.strips import photographed

    case = target.case.directions()[0]
    spec, rules = spec_of(target), case.ruled
    bench = Bench(spec, rules.gains or "default", rules.period or PERIOD)
    trial = bench.trial(case)
    moment = next((window.end for window in trial.windows if window.check), trial.seconds)
    hand = Guard(trial.backend, limits_of(LimitSettings(), spec))
    with ExitStack() as stack:
        samples = until(moment, run(hand, bench.controller(trial)))
        for _ in photographed(samples, trial.backend, None, path, [moment], SIZE, "side", stack):
            pass
