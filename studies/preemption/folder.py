"""A folder of the study: its trials, and what is written of them; several folders as one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from allegro_twin import ConfigError, RecordingError
from allegro_twin.sweep import Store, latest_rows, read_results, write_results
from studies.preemption.page import write_report
from studies.preemption.protocol import Study, study_of

TRIALS = "trials"
FILE = "trials.parquet"
_ORDER = ("hand", "set", "trial", "policy", "control")
_FACTS = ("protocol", "registration", "engine", "allegro_twin", "code")


class Held(NamedTuple):
    """What a folder holds."""

    study: Study
    stamps: dict[str, str]
    table: Any
    """A pyarrow.Table, a row a trial, in the order of hand, set, trial, policy and control."""

    @property
    def hands(self) -> dict[str, int]:
        """Trials of each."""
        counts = self.table["hand"].value_counts().to_pylist()
        return {str(each["values"]): int(each["counts"]) for each in counts}


def read(folder: Path) -> Held:
    """The trials that are there, swept or as a file that was written of them, and the protocol under which they were
    made. Raises RecordingError."""
    path = folder / FILE if not (folder / TRIALS).exists() and (folder / FILE).exists() else folder / TRIALS
    shared, stamps, table = _written(path) if path.suffix else Store(path).content()
    if "study" not in shared:
        raise RecordingError(f"{path} is of another sweep than a study")
    study = study_of(shared["study"], str(path if path.suffix else path / "manifest.json"))
    if study.digest != stamps.get("protocol"):
        raise RecordingError(
            f"{path}: made under the protocol {stamps.get('protocol')}, and its "
            f"{'metadata have' if path.suffix else 'manifest has'} {study.digest}: it was changed afterwards; sweep "
            "into another folder"
        )
    made = table.select([name for name in table.column_names if name != "key"])
    return Held(study, stamps, made.sort_by([(name, "ascending") for name in _ORDER]))


def gathered(folders: Sequence[Path]) -> Held:
    """Several as one: of each hand the trials of the last folder that has it, so that a hand made anew takes the place
    of the old one. Raises RecordingError, and ConfigError for folders of unlike trials."""
    parts = [read(folder) for folder in folders]
    for folder, part in zip(folders, parts, strict=True):
        for fact in _FACTS:
            if part.stamps.get(fact) != parts[0].stamps.get(fact):
                raise ConfigError(
                    f"{folder}: {fact} {part.stamps.get(fact)}, and {folders[0]} has {parts[0].stamps.get(fact)}: "
                    "trials of both are no one study; make one of them anew"
                )
    table = latest_rows([part.table for part in parts], "hand")
    return Held(parts[0].study, parts[0].stamps, table.sort_by([(name, "ascending") for name in _ORDER]))


def write(held: Held, folder: Path, where: str = "") -> None:
    """Write trials.parquet and report.html. `where`: on which machine, and when, the trials were made. Raises
    RecordingError where the disk refuses."""
    facts = {key: held.stamps[key] for key in _FACTS if key in held.stamps}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report.html").unlink(missing_ok=True)  # Until the new one is there, none says what other trials were.
    plain = json.dumps(held.study.model_dump(mode="json"))
    write_results(folder / FILE, held.table, facts | {"study": plain}, {})
    write_report(folder / "report.html", held.table.to_pylist(), held.study, facts | ({"made": where} if where else {}))


def _written(path: Path) -> tuple[dict[str, Any], dict[str, str], Any]:
    """Of a file: what all its trials have in common, its stamps, its rows."""
    table, stamps = read_results(path)
    try:
        return ({"study": json.loads(stamps.pop("study"))} if "study" in stamps else {}), stamps, table
    except ValueError as error:
        raise RecordingError(
            f"{path}: the protocol in it is no JSON; write it anew from its folder of trials"
        ) from error
