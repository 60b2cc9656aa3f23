"""Which entries pass a filter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import get_args

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.library.entries import GraspFile, Kind, Taxonomy, joint_values
from allegro_twin.library.sources import Listed
from allegro_twin.spec import HandSpec

_TYPES = get_args(Taxonomy.model_fields["type"].annotation)


def matching(
    entries: Sequence[Listed],
    kind: Kind | None,
    hand: HandSpec | None,
    taxonomy: int | str | None,
    fingers: int | None,
    object_size: float | tuple[float, float] | None,
) -> Iterator[Listed]:
    """Those that pass every filter that is not None; see `Library.list`. Raises ConfigError."""
    _known(entries, taxonomy)
    for listed in entries:
        entry = listed.entry
        if kind is not None and listed.kind != kind:
            continue
        if taxonomy is not None and not (isinstance(entry, GraspFile) and _is(entry.taxonomy, taxonomy)):
            continue
        if fingers is not None and not (isinstance(entry, GraspFile) and len(entry.fingers) == fingers):
            continue
        if object_size is not None and not (isinstance(entry, GraspFile) and _fits(entry, object_size)):
            continue
        if hand is None or _can(listed, hand):
            yield listed


def _known(entries: Sequence[Listed], taxonomy: int | str | None) -> None:
    if isinstance(taxonomy, int) and not 1 <= taxonomy <= 33:
        raise ConfigError(f"the GRASP taxonomy has the numbers 1 to 33, not {taxonomy}")
    if isinstance(taxonomy, str):
        names = {e.entry.taxonomy.name for e in entries if isinstance(e.entry, GraspFile)} | set(_TYPES)
        if taxonomy.lower() not in {name.lower() for name in names}:
            raise ConfigError(unknown("taxonomy", taxonomy, names))


def _is(taxonomy: Taxonomy, wanted: int | str) -> bool:
    if isinstance(wanted, int):
        return wanted == taxonomy.number
    return wanted.lower() in (taxonomy.name.lower(), taxonomy.type)


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
