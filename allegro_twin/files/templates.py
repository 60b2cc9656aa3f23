"""Writing a file of settings for a person to go on with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import refuse_shipped
from allegro_twin.files.atomic_write import whole_file


def written(path: Path, content: dict[str, Any], headline: str) -> None:
    """A YAML file, whole or not at all. Raises ConfigError where it cannot be, or is a file that ships."""
    refuse_shipped(path)
    lines = [f"# {headline}", *(_block(key, value) for key, value in content.items())]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror or error}") from error


def _block(key: str, value: Any) -> str:
    """A row for each part of what is long."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return f"{key}:\n" + "\n".join(f"  - {_line(row)}" for row in value)
    if isinstance(value, dict) and any(isinstance(row, dict) for row in value.values()):
        return f"{key}:\n" + "\n".join(f"  {_line(name)}: {_line(row)}" for name, row in value.items())
    return f"{key}: {_line(value)}"


def _line(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000, sort_keys=False)
    return text.removesuffix("\n").removesuffix("\n...")
