"""Definition of a sweep: a function by name, and items of plain data with a hash of all that their rows depend on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any, NamedTuple

from allegro_twin.errors import ConfigError
from allegro_twin.files.fingerprints import fingerprint, source_fingerprint
from allegro_twin.version import __version__

_FEW = 4
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
    order. It must be pure: its rows depend on nothing but its arguments, its own code and what `stamps` and `inputs`
    name, and the row of an item not on the other items of its unit. Raises ConfigError for no items, or for what is no
    plain data."""

    function: str
    items: Sequence[Item]
    shared: Mapping[str, Any] = field(default_factory=dict)
    """Plain data that all items need; the seed, for example."""
    unit: int = 200
    """Items in a call, 1 or more: what may have to be computed again after an interruption."""
    stamps: Mapping[str, str] = field(default_factory=dict)
    """Further parts of the question, such as the name of a protocol. Each question has a folder of its own."""
    inputs: Sequence[Mapping[str, str]] = ()
    """For each item what its row is made of, fingerprints by name; none: of nothing but code and data. With another
    input the same question has another row, which is computed anew."""

    def __post_init__(self) -> None:
        if not self.items:
            raise ConfigError(f"a sweep of {self.function} without items: there is nothing to compute")
        if self.unit < 1:
            raise ConfigError(f"a sweep's unit must be 1 item or more, not {self.unit}")
        if self.inputs and len(self.inputs) != len(self.items):
            raise ConfigError(f"a sweep of {len(self.items)} items has inputs of {len(self.inputs)}; give one for each")

    def question(self) -> dict[str, str]:
        """The question: sweeps with the same question are one. Raises ConfigError for shared data that is not plain."""
        shared = _digest(_canonical(self.shared, "shared data"))
        return {"function": self.function, "shared": shared, **self.stamps}

    def fingerprints(self) -> dict[str, str]:
        """Fingerprints of what answers are made of: engine, package, the function's code, and all inputs by name."""
        found: dict[str, set[str]] = {}
        for each in {id(each): each for each in self.inputs}.values():
            for name, digest in each.items():
                found.setdefault(name, set()).add(digest)
        return self._common() | {name: _joined(found[name]) for name in sorted(found)}

    def all_stamps(self) -> dict[str, str]:
        """All that the rows depend on, except the items."""
        return self.question() | self.fingerprints()

    def keys(self) -> list[str]:
        """For each item the SHA-256 of what its row depends on. Raises ConfigError for an item that is not plain."""
        begin = hashlib.sha256(_canonical(self.question() | self._common(), "stamps"))
        keys = []
        for number, item in enumerate(self.items):
            whole = begin.copy()
            whole.update(_canonical(item, f"item {number}"))
            if self.inputs:
                whole.update(_canonical(self.inputs[number], f"inputs of item {number}"))
            keys.append(whole.hexdigest())
        return keys

    def _common(self) -> dict[str, str]:
        """Fingerprints that all rows share."""
        return versions() | {"code": source_fingerprint(self.function.partition(":")[0])}

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
    """Versions of the physics engine and of this package."""
    return {"engine": f"mujoco {version('mujoco')}", "allegro_twin": __version__}


def _joined(digests: set[str]) -> str:
    """Digests that differ between items: each of a few, or one of all of many."""
    few = sorted(digests)
    return " ".join(few) if len(few) <= _FEW else f"{len(few)} of {fingerprint(few)}"


def _canonical(data: object, what: str) -> bytes:
    try:
        return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{what} of a sweep: not plain data: {error}") from error


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
