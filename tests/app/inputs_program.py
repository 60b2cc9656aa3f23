"""A program for a copy of the package: the keys of some trials after each of some changes to the copy's files."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

READ: set[str] = set()
"""Files of the copy that Python has opened for trials."""


def keys(targets: list[str]) -> list[str]:
    """The first key of each target as the files are now, as a program that begins now would find it."""
    from allegro_twin.files.fingerprints import source_fingerprint
    from allegro_twin.grasping.evaluation.campaign import (
        JUDGE,
        SamplingSettings,
        TargetOptions,
        find_targets,
        make_campaign,
    )
    from allegro_twin.sweep.jobs import Sweep

    source_fingerprint.cache_clear()
    found = []
    for target in targets:
        asked = TargetOptions(protocol="fc", object="mug") if target.endswith(".npy") else TargetOptions()
        items, shared, stamps, inputs = make_campaign(find_targets([Path(target)], asked), SamplingSettings())
        found.append(Sweep(JUDGE, items, shared, 1, stamps, inputs).keys()[0])
    return found


def tried(targets: list[str]) -> None:
    """A trial of each, with what it opens noted."""
    from allegro_twin.grasping.batch.trials import run_cases

    def note(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(arguments[0], str | Path):
            READ.add(str(arguments[0]))

    sys.addaudithook(note)
    for target in targets:
        item = (
            {"file": target, "row": 0, "protocol": "fc", "object": "mug"}
            if target.endswith(".npy")
            else {"scenario": target}
        )
        run_cases({"threads": 1}, [item])


def main() -> None:
    asked = json.load(sys.stdin)
    found: dict[str, Any] = {"before": keys(asked["targets"]), "after": []}
    for name, old, new in asked["changes"]:
        path = Path(name)
        before = path.read_bytes()
        assert old.encode() in before, (name, old)
        path.write_bytes(before.replace(old.encode(), new.encode(), 1))
        found["after"].append(keys(asked["targets"]))
        path.write_bytes(before)
    found["restored"] = keys(asked["targets"])
    if asked["try"]:
        tried(asked["targets"])
    json.dump(found | {"read": sorted(READ)}, sys.stdout)


if __name__ == "__main__":
    main()
