"""Errors of other packages' backends and controllers as faults in one line."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from traceback import walk_tb
from typing import Any

from allegro_twin.errors import HandError, HandFault


def is_own(source: Any) -> bool:
    """Whether a class or a function is of this package."""
    return str(getattr(source, "__module__", "")).startswith("allegro_twin.")


@contextmanager
def as_plugin_fault(source: Any, call: str, part: str) -> Iterator[None]:
    """Raise what another package's class or function raises as a HandFault that names the call and the deepest line of
    its own modules. `part`: backend or controller."""
    try:
        yield
    except HandError:
        raise
    except Exception as error:  # A package of somebody else's may raise anything.
        if is_own(source):
            raise
        modules = {getattr(each, "__module__", "") for each in getattr(source, "__mro__", (source,))}
        own = {getattr(sys.modules.get(name), "__file__", None) for name in modules}
        lines = [(frame.f_code.co_filename, line) for frame, line in walk_tb(error.__traceback__)][1:]
        places = [place for place in lines if place[0] in own] or lines or [("", 0)]
        said = " ".join(str(error).split())
        raise HandFault(
            f"{call} raises {type(error).__name__}{said and f': {said}'} ({places[-1][0]}:{places[-1][1]}); a {part} "
            "tells what goes wrong by a HandError: see to its package"
        ) from error
