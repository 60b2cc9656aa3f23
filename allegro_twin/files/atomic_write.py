"""Files and folders that are complete or absent: written under a temporary name and moved into place."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from allegro_twin.errors import RecordingError


def check_place(path: Path) -> None:
    """Make the folder of a file that is to be written. Raises RecordingError when that cannot be, or when something
    stands there that is no file: a folder, a device."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not path.is_file():
            raise RecordingError(f"cannot write {path}: it is {'a folder' if path.is_dir() else 'no plain file'}")
    except OSError as error:
        if isinstance(error, RecordingError):
            raise
        raise write_error(path, error) from error
    place = path if path.exists() else path.parent
    if not os.access(place, os.W_OK):
        unchanging = os.statvfs(place).f_flag & os.ST_RDONLY
        raise RecordingError(
            f"cannot write {path}: {'its file system is read-only' if unchanging else 'no permission'}"
        )


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """A temporary path next to `path` (same suffix) that replaces it when the block ends well, and vanishes otherwise.

    Raises RecordingError when the disk does not let it.
    """
    check_place(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    except RecordingError:
        raise
    except OSError as error:
        raise write_error(path, error) from error
    finally:
        with suppress(OSError):  # What went wrong with it was said above.
            temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """A temporary folder next to `path`, which may be an empty one, that takes its place when the block ends well, and
    vanishes otherwise. Raises RecordingError when the disk does not let it."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.mkdir(parents=True)
        yield temporary
        temporary.replace(path)
    except RecordingError:
        raise
    except OSError as error:
        raise write_error(path, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def write_error(path: Path, error: OSError) -> RecordingError:
    """The error of a file or folder that the disk refuses."""
    return RecordingError(f"cannot write {path}: {error.strerror or error}")
