"""What is to be computed: a function by name, and items of plain data, each known by a hash of all it depends on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any, NamedTuple

from allegro_twin.errors import ConfigError
from allegro_twin.version import __version__

Item = Mapping[str, Any]
"""Plain data, as JSON has it."""
Result = Mapping[str, Any] | str
"""The flat row of an item, or the text of the error that it raised."""


class Unit(NamedTuple):
    """Items that are computed in one call."""

    keys: tuple[str, ...]
    items: tuple[Item, ...]
    places: tuple[int, int]
    """Where the first and the last of them stand in the sweep, from 0."""

    def __str__(self) -> str:
        first, last = self.places
        return f"item {first}" if first == last else f"items {first} to {last}"


@dataclass(frozen=True, slots=True)
class Sweep:
    """`function`, named `package.module:name`, takes `shared` and a list of items and gives a flat row for each, in
    order. It must be pure: its rows depend on nothing but its arguments and `stamps`, and the row of an item not on
    the other items of its unit. Raises ConfigError for no items, or what is no plain data."""

    function: str
    items: Sequence[Item]
    shared: Mapping[str, Any] = field(default_factory=dict)
    """Plain data that all items need; the seed, for example."""
    unit: int = 200
    """Items in a call, 1 or more: what may have to be computed again after an interruption."""
    stamps: Mapping[str, str] = field(default_factory=dict)
    """What else the rows depend on: the version of a protocol, of somebody's package."""

    def __post_init__(self) -> None:
        if not self.items:
            raise ConfigError(f"a sweep of {self.function} without items: there is nothing to compute")
        if self.unit < 1:
            raise ConfigError(f"a sweep's unit must be 1 item or more, not {self.unit}")

    def stamped(self) -> dict[str, str]:
        """All that the rows depend on but the items. Raises ConfigError for shared data that is not plain."""
        shared = _digest(_canonical(self.shared, "shared data"))
        return {"function": self.function, "shared": shared, **versions(), **self.stamps}

    def keys(self) -> list[str]:
        """For each item the SHA-256 of what its row depends on. Raises ConfigError for an item that is not plain."""
        begin = hashlib.sha256(_canonical(self.stamped(), "stamps"))
        keys = []
        for number, item in enumerate(self.items):
            whole = begin.copy()
            whole.update(_canonical(item, f"item {number}"))
            keys.append(whole.hexdigest())
        return keys

    def units(self, keys: Sequence[str], there: Collection[str]) -> list[Unit]:
        """The items whose keys are not there yet, each once, in units."""
        places = {key: place for place, key in reversed(list(enumerate(keys))) if key not in there}
        left = sorted(places.values())
        chunks = [left[k : k + self.unit] for k in range(0, len(left), self.unit)]
        return [
            Unit(tuple(keys[k] for k in chunk), tuple(self.items[k] for k in chunk), (chunk[0], chunk[-1]))
            for chunk in chunks
        ]


def versions() -> dict[str, str]:
    """Of what every figure depends on."""
    return {"engine": f"mujoco {version('mujoco')}", "allegro_twin": __version__}


def _canonical(data: object, what: str) -> bytes:
    try:
        return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{what} of a sweep: not plain data: {error}") from error


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
