"""The first error of a session, with what goes wrong after it as its notes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

from allegro_twin.errors import HandError


class _Closable(Protocol):
    def close(self) -> None: ...


_C = TypeVar("_C", bound=_Closable)


@contextmanager
def closing_noted(resource: _C) -> Iterator[_C]:
    """Close something at the end of a block, as `contextlib.closing` does. Where the block has raised, that error goes
    on, with what closing raises as its note; else closing raises."""
    try:
        yield resource
    except (GeneratorExit, KeyboardInterrupt):  # No errors: a consumer has stopped, a person has.
        resource.close()
        raise
    except BaseException as error:
        try:
            resource.close()
        except HandError as later:
            if str(later) not in str(error):  # The hand's own errors say already that it may not be limp.
                error.add_note(str(later))
        raise
    resource.close()


def message_of(error: BaseException) -> str:
    """What an error says in one line, its notes included."""
    return "; ".join([str(error), *getattr(error, "__notes__", ())])
