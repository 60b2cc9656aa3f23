"""One line for what this computer refuses: memory, open files, the import of an installed package."""

from __future__ import annotations

import errno
import traceback

_MEMORY = ("Cannot allocate memory", "failed to map segment")
"""What the loader of shared libraries says."""
_FILES = "Too many open files"
REINSTALL = "`pip install --force-reinstall allegro-twin` may mend it"
"""The way out where the doctor cannot be asked."""
_OURS = "allegro_twin"


def computer_error(error: BaseException, remedy: str = "`allegro-twin doctor` says what mends it") -> str:
    """One line that says what is missing and where to look; empty for an error of another kind. `remedy`: for the
    import of a package."""
    number = getattr(error, "errno", None)
    if isinstance(error, MemoryError) or number == errno.ENOMEM or any(each in str(error) for each in _MEMORY):
        return "not enough memory: end other programs, or raise the limit (`ulimit -v`)"
    if number in (errno.EMFILE, errno.ENFILE) or (isinstance(error, ImportError) and _FILES in str(error)):
        return "too many open files: raise the limit (`ulimit -n`)"
    if isinstance(error, (ImportError, OSError)) and (package := imported_package(error)):
        why = (str(error).strip() or type(error).__name__).splitlines()[0]
        return f"{package} cannot be imported: {why}; {remedy}"
    return ""


def imported_package(error: BaseException) -> str:
    """The package of others, of which the import raised an error; empty where no such import did."""
    package = ""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        name = str(frame.f_globals.get("__name__") or "").partition(".")[0]
        if name == _OURS:
            package = ""
        elif frame.f_code.co_name == "<module>":
            package = name  # The last one: of the package that is broken, not of those that import it.
    asked = (error.name or "").partition(".")[0] if isinstance(error, ImportError) else ""
    return "" if asked == _OURS else package or asked
