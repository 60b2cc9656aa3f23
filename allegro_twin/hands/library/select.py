"""Which entries pass a filter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import get_args

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.hands.library.entries import GraspFile, Kind, joint_values
from allegro_twin.hands.library.sources import Listed
from allegro_twin.hands.library.taxonomy import KINDS, Control, Observed, Taxonomy
from allegro_twin.spec import HandSpec

_TYPES = get_args(Control)


def matching(
    entries: Sequence[Listed],
    kind: Kind | None,
    hand: HandSpec | None,
    taxonomy: int | str | None,
    fingers: int | None,
    object_size: float | tuple[float, float] | None,
) -> Iterator[Listed]:
    """Those that pass every filter that is not None; see `Library.list`. Raises ConfigError."""
    if taxonomy is not None:
        check_type(taxonomy)
    for listed in entries:
        entry = listed.entry
        if kind is not None and listed.kind != kind:
            continue
        if taxonomy is not None and not (isinstance(entry, GraspFile) and is_of_type(entry.kind_of_grasp, taxonomy)):
            continue
        if fingers is not None and not (isinstance(entry, GraspFile) and len(entry.fingers) == fingers):
            continue
        if object_size is not None and not (isinstance(entry, GraspFile) and _fits(entry, object_size)):
            continue
        if hand is None or _can(listed, hand):
            yield listed


def check_type(wanted: int | str) -> None:
    """Raises ConfigError for what is no type of the taxonomy: not its number, its name, or how it controls."""
    if isinstance(wanted, int) or wanted.isdigit():
        if int(wanted) not in KINDS:
            raise ConfigError(f"the GRASP taxonomy has the numbers 1 to 33, not {wanted}")
    elif wanted.lower() not in (names := {kind.name.lower(): kind.name for kind in KINDS.values()}) | dict.fromkeys(
        _TYPES
    ):
        raise ConfigError(unknown("taxonomy", wanted, {*names.values(), *_TYPES}))


def is_of_type(kind: Taxonomy | Observed, wanted: int | str) -> bool:
    """Whether a type has this number or name, or is of this control (`power`, `intermediate`, `precision`), which what
    is none of the 33 may be, too."""
    if isinstance(wanted, int) or wanted.isdigit():
        return int(wanted) == kind.number
    return wanted.lower() == (kind.type if wanted.lower() in _TYPES else kind.name.lower())


def _fits(grasp: GraspFile, wanted: float | tuple[float, float]) -> bool:
    smallest, largest = wanted if isinstance(wanted, tuple) else (wanted, wanted)
    size = grasp.object_size
    return size is not None and size[0] - 1e-9 <= largest and smallest <= size[1] + 1e-9


def _can(listed: Listed, hand: HandSpec) -> bool:
    try:
        joint_values(listed.entry, hand, listed.where)
    except ConfigError:
        return False  # The answer, not an error: it is outside that hand's limits, or for another hand.
    return True
