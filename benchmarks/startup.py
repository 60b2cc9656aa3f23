"""How long a person waits for the package and for the command's help."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Iterator


def figures() -> Iterator[tuple[str, float, float, str]]:
    bare = _seconds("pass")
    yield "import allegro_twin", _seconds("import allegro_twin") - bare, 0.25, "s"
    yield (
        "allegro-twin --help",
        _seconds("import sys; sys.argv[1:] = ['--help']; import allegro_twin.__main__"),
        0.6,
        "s",
    )


def _seconds(code: str) -> float:
    times = []
    for _ in range(7):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL, check=True)
        times.append(time.perf_counter() - start)
    return statistics.median(times)
