"""Verdicts as a file."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.grasping.verdict import Report
from allegro_twin.sim.engine.backend import ENGINE
from allegro_twin.version import __version__


def write_reports(path: Path, reports: dict[str, Report]) -> None:
    """All verdicts with their margins as one JSON file."""
    content = {
        "allegro_twin": __version__,
        "engine": ENGINE,
        "trials": {name: asdict(report) for name, report in reports.items()},
    }
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1, default=dict))
