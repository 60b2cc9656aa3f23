"""Rerun recordings of an evaluation's trials, for its report to link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.surfaces.cli import console

if TYPE_CHECKING:
    from allegro_twin.grasping.evaluation.campaign import EvaluationTarget


class Recorded(StrEnum):
    """Of which grasps."""

    ends = "ends"
    """The best and the worst of every object."""
    all = "all"


def check(out: Path | None) -> None:
    """Raises ConfigError, before anything is tried, where recordings have no place or there is no Rerun."""
    from allegro_twin.app.session import rerun_stage

    if out is None:
        raise ConfigError("--rrd is kept beside the report: say --out FOLDER, too")
    rerun_stage()


def record(targets: Sequence[EvaluationTarget], rows: Sequence[dict[str, Any]], wanted: Recorded, folder: Path) -> None:
    """Keep each trial without a draw as a `.rrd`, and name it in its row; those that are there stay. Raises
    HandError."""
    from allegro_twin.app.portraits import ends_of_objects

    chosen = list(range(len(rows))) if wanted is Recorded.all else ends_of_objects(rows)
    paths = []
    with console.progress() as bar:
        for number in bar.track(chosen, description="recordings"):
            path = folder / f"{number}_{targets[number].name}.rrd"
            if path.is_file() or _made(targets[number], rows[number], path):
                rows[number]["rrd"] = str(path.resolve())
                paths.append(path)
        seconds = bar.tasks[0].elapsed or 0.0
    size = sum(path.stat().st_size for path in paths) / 1e6
    said = f"{len(paths)} recordings, {size:.1f} MB, in {seconds:.0f} s: rerun {folder}/NAME.rrd"
    console.console.print(said, soft_wrap=True, highlight=False)


def _made(target: EvaluationTarget, row: Mapping[str, Any], path: Path) -> bool:
    """Whether there is one: a trial in which the guard stops the hand has none."""
    from allegro_twin.app.config import RunConfig
    from allegro_twin.app.portraits import staged
    from allegro_twin.app.session import Outputs, perform
    from allegro_twin.app.simulated import following
    from allegro_twin.hands.settings import HandSettings

    hand = HandSettings(model=target.spec.model, side=target.side)
    config = RunConfig.model_validate(
        {"hand": hand.model_dump(), "backend": {"kind": "sim"}, "controller": following(hand)}
    )
    try:
        perform(staged(target, row), config, Outputs(rrd=path))
    except HandFault as error:
        console.errors.print(f"[yellow]{target.name}: no recording: {error}[/]")
        return False
    return True
