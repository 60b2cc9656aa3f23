"""Snapshots: pages, charts and tables are compared with files that somebody has looked at.

Whether a chart is right only the eye can tell. So somebody looks at it once, and it is kept in the folder `snapshots`
next to its test. After a change that is meant, `SNAPSHOTS=write pytest …` writes the new ones, to be looked at.
"""

from __future__ import annotations

import os
import re
from pathlib import Path


def assert_snapshot(text: str, file: Path) -> None:
    """Raises AssertionError where text differs from the kept file; tags are kept one a line."""
    lines = re.sub(r">(?=<)", ">\n", text).rstrip("\n") + "\n"
    if os.environ.get("SNAPSHOTS") == "write":
        file.parent.mkdir(exist_ok=True)
        file.write_text(lines, encoding="utf-8")
    assert lines.splitlines() == file.read_text(encoding="utf-8").splitlines(), f"is no longer {file.name}"
