"""Snapshots of environments on processors: everything that decides how their simulations continue."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.engine import EpisodeEngine

_OURS = ("allegro_twin.learning.environments.", "allegro_twin.learning.tasks.", "allegro_twin.sim.batch.")
_PHYSICS = "physics"
_FIELD = "worlds/_rows/"
"""In the paths of model fields that simulations have to themselves."""
_CACHES = ("_palettes",)
"""What follows from the models."""


class _Slot(NamedTuple):
    """A value, and where it can be replaced."""

    owner: Any
    key: Any
    value: Any


class EpisodeState(NamedTuple):
    """A saved state of an environment."""

    parts: dict[str, Any]
    """Arrays and numbers by their paths."""
    generators: list[Any]
    """States of the random number generators."""


def take_snapshot(env: Any) -> dict[str, Any]:
    """Copies of all arrays and numbers of an environment with an `engine` on processors, by their paths. Raises
    ConfigError on a device."""
    engine: EpisodeEngine = env.engine
    if engine.settings.device != "cpu":
        raise ConfigError(f"device {engine.settings.device}: its runs are not equal to the bit, and states are not "
                          "saved there; device cpu saves them")  # fmt: skip
    found: dict[str, Any] = {_PHYSICS: np.stack([engine.worlds.state(row) for row in range(engine.n)])}
    for path, slot in _slots(env, engine):
        value = slot.value
        found[path] = np.array(value) if isinstance(value, np.ndarray) else value
    return dict(sorted(found.items()))  # In no order that the course of an episode decides.


def restore_snapshot(env: Any, content: dict[str, Any]) -> None:
    """Restore a snapshot in an environment of the same settings and size. Raises ConfigError where a part does not
    fit."""
    engine: EpisodeEngine = env.engine
    _expand_fields(engine, content)
    _let_go(engine)
    slots, owners = dict(_slots(env, engine)), dict(_owners(env, engine))
    for path in sorted(content.keys() ^ slots.keys() - {_PHYSICS}):
        _match(path, content, slots, owners, engine)
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
            f"the state's {different[0]} does not fit these environments: it is of other settings or another version"
        )


def spread_snapshot(env: Any, content: dict[str, Any]) -> None:
    """Let all simulations of an environment go on from the one episode of a snapshot of another, with the same
    settings."""
    engine: EpisodeEngine = env.engine
    _expand_fields(engine, content)
    for row in range(engine.n):
        engine.worlds.restore(row, content[_PHYSICS][0])
    _let_go(engine)
    slots = dict(_slots(env, engine))
    for path, slot in slots.items():
        if path not in content or not path.startswith("engine/") or path.endswith("/n"):
            continue
        value = content[path]
        if isinstance(slot.value, np.ndarray) and isinstance(value, np.ndarray):
            slot.value[...] = value  # One row for all.
        elif not isinstance(slot.value, np.ndarray) and not isinstance(value, np.ndarray):
            _set(path, slot, value)


def _expand_fields(engine: EpisodeEngine, content: dict[str, Any]) -> None:
    """Give each simulation a row of its own of every model field of which the snapshot has some."""
    for path in content:
        if _FIELD in path:
            engine.worlds.expand(path.partition(_FIELD)[2])


def _let_go(engine: EpisodeEngine) -> None:
    """Have arrays of one's own in place of those that the last step has given out: they stay as they were given."""
    for owner in (engine, engine.task):
        for name, value in vars(owner).items():
            if isinstance(value, np.ndarray) and value.base is None:
                setattr(owner, name, value.copy())


def _match(
    path: str, content: dict[str, Any], slots: dict[str, _Slot], owners: dict[str, Any], engine: EpisodeEngine
) -> None:
    """Make or unmake a part that only the state has, or only the environments: what a task made on the way, and a model
    field that has been the same for all since. Raises ConfigError for any other."""
    above, _, name = path.rpartition("/")
    if path == _PHYSICS:
        return
    if _FIELD in path:
        engine.worlds.reset_field(name)
    elif above not in owners or isinstance(owners[above], dict | list | tuple):
        raise ConfigError(f"the state and these environments differ in {path}: it is of other settings, or of another "
                          "version")  # fmt: skip
    elif path in content:
        setattr(owners[above], name, content[path])
    else:
        delattr(owners[above], name)
        del slots[path]


def _set(path: str, slot: _Slot, value: Any) -> None:
    if not isinstance(slot.value, np.ndarray) or value is None:
        value = np.array(value) if isinstance(value, np.ndarray) else value
        if isinstance(slot.owner, dict | list):
            slot.owner[slot.key] = value
        elif not isinstance(slot.owner, tuple):
            setattr(slot.owner, slot.key, value)
    elif np.shape(value) != slot.value.shape:
        raise ConfigError(f"the state's {path} has the shape {np.shape(value)}, and here it is {slot.value.shape}")
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
    return ((path, slot) for path, slot in _nested_slots(env, "", engine.n, modules, set()) if isinstance(slot, _Slot))


def _owners(env: Any, engine: EpisodeEngine) -> Iterator[tuple[str, Any]]:
    """What has such, by its path."""
    modules = (*_OURS, type(engine.task).__module__)
    for path, slot in _nested_slots(env, "", engine.n, modules, set()):
        if not isinstance(slot, _Slot):
            yield path, slot


def _nested_slots(owner: Any, path: str, n: int, modules: tuple[str, ...], seen: set[int]) -> Iterator[tuple[str, Any]]:
    """Slots, and every owner of some."""
    if id(owner) in seen:
        return
    seen.add(id(owner))
    yield path, owner
    for key, value in _parts(owner):
        if key in _CACHES:
            continue
        here = f"{path}/{key}" if path else str(key)
        if isinstance(value, np.ndarray):
            # Read-only arrays are results of the last step, or never change.
            if value.flags.writeable and value.dtype.kind in "biuf" and n in value.shape[:2]:
                yield here, _Slot(owner, key, value)
        elif value is None or isinstance(value, bool | int | float):
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
