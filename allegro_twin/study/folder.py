"""A folder of the study: its trials, and what is written of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from allegro_twin.errors import RecordingError
from allegro_twin.files.schema import parse
from allegro_twin.study.page import write_report
from allegro_twin.study.protocol import Study
from allegro_twin.sweep.results import write_results
from allegro_twin.sweep.store import Store

TRIALS = "trials"
_ORDER = ("hand", "set", "trial", "policy", "control")


class Held(NamedTuple):
    """What a folder holds."""

    study: Study
    stamps: dict[str, str]
    table: Any
    """A pyarrow.Table, a row a trial, in the order of hand, set, trial, policy and control."""


def read(folder: Path) -> Held:
    """The trials that are there, and the protocol under which they were made. Raises RecordingError."""
    shared, stamps, table = Store(folder / TRIALS).content()
    if "study" not in shared:
        raise RecordingError(f"{folder / TRIALS} is of another sweep than a study")
    study = parse(Study, shared["study"], str(folder / TRIALS / "manifest.json"))
    if study.digest != stamps.get("protocol"):
        raise RecordingError(
            f"{folder / TRIALS}: made under the protocol {stamps.get('protocol')}, and its manifest has "
            f"{study.digest}: it was changed afterwards; sweep into another folder"
        )
    made = table.select([name for name in table.column_names if name != "key"])
    return Held(study, stamps, made.sort_by([(name, "ascending") for name in _ORDER]))


def write(folder: Path, where: str = "") -> Held:
    """Write trials.parquet and report.html. `where`: on which machine, and when, the trials were made. Raises
    RecordingError where there are none, or the disk refuses."""
    held = read(folder)
    facts = {key: value for key, value in held.stamps.items() if key in ("protocol", "engine", "allegro_twin")}
    write_results(folder / "trials.parquet", held.table, facts, {})
    write_report(folder / "report.html", held.table.to_pylist(), held.study, facts | ({"made": where} if where else {}))
    return held
