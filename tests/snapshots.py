"""Snapshots: pages, charts and tables are compared with files that somebody has looked at.

Whether a chart is right only the eye can tell. So somebody looks at it once, and it is kept in the folder `snapshots`
next to its test. After a change that is meant, `SNAPSHOTS=write pytest …` writes the new ones, to be looked at.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from allegro_twin.files.schema import Settings


def assert_snapshot(text: str, file: Path) -> None:
    """Raises AssertionError where text differs from the kept file; tags are kept one a line."""
    lines = re.sub(r">(?=<)", ">\n", text).rstrip("\n") + "\n"
    if os.environ.get("SNAPSHOTS") == "write":
        file.parent.mkdir(exist_ok=True)
        file.write_text(lines, encoding="utf-8")
    assert lines.splitlines() == file.read_text(encoding="utf-8").splitlines(), f"is no longer {file.name}"


def settings_text(*models: type[Settings]) -> str:
    """Every key of some settings and of those inside them, a line each, with its default and its bounds."""
    found: dict[str, type[Settings]] = {}
    todo: list[Any] = [*models]
    while todo:
        each = todo.pop()
        if isinstance(each, type) and issubclass(each, Settings):
            if each.__name__ not in found:
                found[each.__name__] = each
                todo += [field.annotation for field in each.model_fields.values()]
        else:
            todo += getattr(each, "__args__", ())
    return "\n".join(line for name in sorted(found) for line in _keys(found[name]))


def _keys(model: type[Settings]) -> list[str]:
    lines = []
    for name, field in model.model_fields.items():
        default = "required" if field.is_required() else field.get_default(call_default_factory=True)
        text = type(default).__name__ if isinstance(default, Settings) else str(default)
        marks = (str(each) for each in field.metadata)
        bounds = [mark for mark in marks if re.fullmatch(r"[A-Z][A-Za-z]+\([a-z_]+=[-\d.e]+\)", mark)]
        lines.append(" ".join([f"{model.__name__}.{name} = {text}", *bounds]))
    return lines
