"""Which type each grasp of the library shows in the trial that is its evidence: `python -m benchmarks.grasp_types`.

With `--write` the grasp files say so: `observed`, and a claim (`taxonomy`) that differs gives way to it.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from allegro_twin.files.assets import data_root
from allegro_twin.grasping.batch.trials import PERIOD, TrialCase, TrialRunner, load_case
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import GraspFile
from allegro_twin.hands.library.entry_files import LibraryEntry
from allegro_twin.hands.library.gains import protocol_gains
from allegro_twin.hands.library.library import Library
from allegro_twin.hands.library.taxonomy import ClaimedType, ObservedType, claim_observed

_PLAIN = re.compile(r"[A-Za-z][\w %.;-]*")


def shown(listed: list[LibraryEntry]) -> Iterator[tuple[LibraryEntry, bool, ObservedType | None]]:
    """Each grasp that has evidence, whether it holds there, and as what."""
    groups: dict[tuple[str, str, float], list[tuple[LibraryEntry, TrialCase]]] = {}
    for each in listed:
        entry = each.entry
        assert isinstance(entry, GraspFile)
        if entry.evidence and not entry.evidence.startswith("posture: "):
            spec = load_spec(entry.hand)
            case = load_case({"scenario": entry.evidence, "grasp": each.name}, spec)
            key = entry.hand, protocol_gains(case.ruled.gains, spec), case.ruled.period or PERIOD
            groups.setdefault(key, []).append((each, case))
    for (hand, gains, period), rows in groups.items():
        verdicts = TrialRunner(load_spec(hand), gains, period, 1).verdicts([case for _, case in rows])
        for (each, _), verdict in zip(rows, verdicts, strict=True):
            yield each, verdict.held, None if verdict.report is None else verdict.report.observed


def mended(text: str, claimed: ClaimedType, observed: ObservedType) -> str:
    """A grasp file's text with both."""
    lines = [line for line in text.splitlines() if not line.startswith("observed:")]
    place = next(k for k, line in enumerate(lines) if line.startswith("taxonomy:"))
    if claimed.number != observed.number or claimed.number is None:
        lines[place] = f"taxonomy: {_flow(claim_observed(observed))}"
    lines.insert(place + 1, f"observed: {_flow(observed)}")
    return "\n".join(lines) + "\n"


def _flow(model: ClaimedType | ObservedType) -> str:
    fields = model.model_dump()
    kept = {key: value for key, value in fields.items() if value not in (None, "") or key == "number"}
    return "{" + ", ".join(f"{key}: {_scalar(value)}" for key, value in kept.items()) + "}"


def _scalar(value: object) -> str:
    if value is None:
        return "null"
    text = str(value)
    return text if isinstance(value, int) or _PLAIN.fullmatch(text) else f'"{text}"'


def main(names: list[str], *, write: bool) -> None:
    listed = [each for each in Library().list("grasp") if not names or each.name in names]
    for each, held, observed in shown(listed):
        assert isinstance(each.entry, GraspFile)
        said = "lost" if observed is None or not held else f"{observed}: {observed.virtual_fingers}, {observed.carries}"
        print(f"{each.name:32s} claimed {each.entry.taxonomy}; {said}", flush=True)
        path = data_root() / "conf" / "grasps" / f"{each.name}.yaml"
        if write and held and observed is not None and path.is_file():
            Path(path).write_text(mended(path.read_text(), each.entry.taxonomy, observed))


if __name__ == "__main__":
    main([each for each in sys.argv[1:] if each != "--write"], write="--write" in sys.argv)
