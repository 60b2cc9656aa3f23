"""What ten minutes of recording add to the process."""

from __future__ import annotations

import resource
import tempfile
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from allegro_twin.app import assemble
from allegro_twin.app.config import load_config
from allegro_twin.loop import run
from allegro_twin.recording.recorder import record


def figures() -> Iterator[tuple[str, float, float, str]]:
    rig = assemble(load_config("sim_right"))
    with tempfile.TemporaryDirectory() as folder:
        samples = record(run(rig.backend, rig.controller), Path(folder) / "long.arrow", rig.spec, rig.backend.period)
        for _ in islice(samples, 2_000):
            pass
        before = _resident()
        for _ in islice(samples, 200_000):
            pass
        grown = _resident() - before
        samples.close()  # type: ignore[attr-defined]  # A generator, though typed as an iterator.
    yield "memory over a recording of 10 minutes (200,000 periods)", grown / 1024, 20.0, "MB"


def _resident() -> float:
    """Memory that the process holds now, kB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1024
