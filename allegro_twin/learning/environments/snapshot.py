"""Snapshots of environments on processors: everything that decides how their simulations continue."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.engine import EpisodeEngine

_OURS = ("allegro_twin.learning.environments.", "allegro_twin.learning.tasks.", "allegro_twin.sim.batch.")
_PHYSICS = "physics"
_FIELD = "engine/worlds/_rows/"


class _Slot(NamedTuple):
    """A value, and where it can be replaced."""

    owner: Any
    key: Any
    value: Any


def take_snapshot(env: Any) -> dict[str, Any]:
    """Copies of all arrays and numbers of an environment with an `engine` on processors, by their paths."""
    engine: EpisodeEngine = env.engine
    found: dict[str, Any] = {_PHYSICS: np.stack([engine.worlds.state(row) for row in range(engine.n)])}
    for path, slot in _slots(env, engine):
        value = slot.value
        found[path] = np.array(value) if isinstance(value, np.ndarray) else value
    return found


def restore_snapshot(env: Any, content: dict[str, Any]) -> None:
    """Restore a snapshot in an environment of the same settings and size. Raises ConfigError where a part does not
    fit."""
    engine: EpisodeEngine = env.engine
    for path in content:
        if path.startswith(_FIELD):
            engine.worlds.expand(path.removeprefix(_FIELD))
    slots = dict(_slots(env, engine))
    for path, value in content.items():
        if path == _PHYSICS:
            for row, state in enumerate(np.asarray(value)):
                engine.worlds.restore(row, state)
        elif path in slots:
            _set(path, slots[path], value)
    again = take_snapshot(env)
    different = [path for path, value in content.items() if path in slots and not _same(again[path], value)]
    if different:
        raise ConfigError(
            f"the checkpoint's {different[0]} does not fit these environments: train anew in another folder"
        )


def _set(path: str, slot: _Slot, value: Any) -> None:
    if not isinstance(slot.value, np.ndarray):
        if isinstance(slot.owner, dict | list):
            slot.owner[slot.key] = value
        elif not isinstance(slot.owner, tuple):
            setattr(slot.owner, slot.key, value)
    elif np.shape(value) != slot.value.shape:
        raise ConfigError(f"the checkpoint's {path} has the shape {np.shape(value)}, and here it is {slot.value.shape}")
    else:
        given = np.asarray(value)
        # In place, so that views of it stay views. PyTorch has no unsigned integers.
        slot.value[...] = given.view(np.uint64) if slot.value.dtype == np.uint64 else given


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) and one.dtype == np.uint64:
        one, other = one.view(np.int64), np.asarray(other).view(np.int64)
    return np.array_equal(one, other, equal_nan=isinstance(one, np.ndarray) and one.dtype.kind == "f")


def _slots(env: Any, engine: EpisodeEngine) -> Iterator[tuple[str, _Slot]]:
    """Arrays with a row per simulation, and plain numbers, by their paths."""
    modules = (*_OURS, type(engine.task).__module__)
    yield from _nested_slots(env, "", engine.n, modules, set())


def _nested_slots(
    owner: Any, path: str, n: int, modules: tuple[str, ...], seen: set[int]
) -> Iterator[tuple[str, _Slot]]:
    if id(owner) in seen:
        return
    seen.add(id(owner))
    for key, value in _parts(owner):
        here = f"{path}/{key}" if path else str(key)
        if isinstance(value, np.ndarray):
            # Read-only arrays are results of the last step, or never change.
            if value.flags.writeable and value.dtype.kind in "biuf" and n in value.shape[:2]:
                yield here, _Slot(owner, key, value)
        elif isinstance(value, bool | int | float):
            yield here, _Slot(owner, key, value)
        elif isinstance(value, dict | list | tuple) or _is_environment_part(value, modules):
            yield from _nested_slots(value, here, n, modules, seen)


def _parts(owner: Any) -> list[tuple[Any, Any]]:
    if isinstance(owner, dict):
        return [(key, value) for key, value in owner.items() if isinstance(key, str | int)]
    if isinstance(owner, tuple) and hasattr(owner, "_fields"):
        return list(zip(owner._fields, owner, strict=True))
    if isinstance(owner, list | tuple):
        return list(enumerate(owner))
    return list(vars(owner).items())


def _is_environment_part(value: Any, modules: tuple[str, ...]) -> bool:
    """Objects of the environments and of a user's own task: not their settings and models."""
    return (
        hasattr(value, "__dict__")
        and type(value).__module__.startswith(modules)
        and not hasattr(type(value), "model_fields")
    )
