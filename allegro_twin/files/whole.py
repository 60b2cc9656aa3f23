"""Files that are whole or not there: written beside their place and moved into it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from allegro_twin.errors import RecordingError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path next to `path` (same suffix) that replaces it when the block ends well, and vanishes otherwise.

    Raises RecordingError when the disk does not let it.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
