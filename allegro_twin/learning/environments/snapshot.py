"""Snapshots of environments on processors: everything that decides how their simulations continue."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
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
_LOOKS = ("_ezpickle_args", "_ezpickle_kwargs", "render_mode", "_size", "metadata")
"""Of an environment: how it was made, and how it is shown, which decide no episode."""


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
    keywords: dict[str, Any]
    """Of the environments: task, number, settings."""
    added: list[tuple[Any, str | None]]
    """Objects, each with a grasp or None, that the options of resets have added."""


def save_episode(env: Any, generators: Sequence[np.random.Generator], **keywords: Any) -> EpisodeState:
    """State of an environment. `keywords`: those that decide episodes beside its settings. Raises ConfigError on a
    device."""
    states = [generator.bit_generator.state for generator in generators]
    return EpisodeState(take_snapshot(env), states, _keywords(env.engine, keywords), list(env.engine.task.added))


def restore_episode(env: Any, state: EpisodeState, begin: Callable[[], object], **keywords: Any) -> list[Any]:
    """Restore a state in an environment with the same keywords, but for its random numbers: returns the states of the
    generators. `begin`: its first reset, for one that has had none. Raises ConfigError for a state of other keywords,
    before anything changes."""
    if not isinstance(state, EpisodeState):
        raise ConfigError(f"restore_state takes what save_state has returned, not {type(state).__name__}")
    engine: EpisodeEngine = env.engine
    difference = _difference(state.keywords, _keywords(engine, keywords))
    if difference:
        raise ConfigError(f"the state is of environments with {difference}: make them with the same keywords")
    _add_objects(engine, state.added)
    if not engine.begun:
        begin()
    restore_snapshot(env, state.parts)
    return state.generators


def _keywords(engine: EpisodeEngine, more: dict[str, Any]) -> dict[str, Any]:
    """All keywords that decide episodes, with their values."""
    return {"task": engine.task.name, "num_envs": engine.n} | engine.settings.model_dump(mode="json") | more


def _difference(theirs: dict[str, Any], ours: dict[str, Any], above: str = "") -> str:
    """The first value that is another, in words; empty where there is none."""
    for key in [*ours, *(theirs.keys() - ours.keys())]:
        one, other = theirs.get(key), ours.get(key)
        if isinstance(one, dict) and isinstance(other, dict):
            if deeper := _difference(one, other, f"{above}{key}."):
                return deeper
        elif one != other:
            return f"{above}{key} {one}, and these have {other}"
    return ""


def _add_objects(engine: EpisodeEngine, added: list[tuple[Any, str | None]]) -> None:
    """Have the objects that a state's episodes may be with, under the same numbers. Raises ConfigError where others
    have these."""
    own = engine.task.added
    shared = min(len(own), len(added))
    if own[:shared] != added[:shared]:
        wrong = next(k for k in range(shared) if own[k] != added[k])
        raise ConfigError(
            f"the state's resets had the options {_options(added[wrong])} where this environment's had "
            f"{_options(own[wrong])}: restore it in a new environment"
        )
    for choice, grasp in added[shared:]:
        engine.task.add_object(choice, grasp)


def _options(added: tuple[Any, str | None]) -> str:
    choice, grasp = added
    return f"object {choice!r}" + ("" if grasp is None else f", grasp {grasp!r}")


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
    apart = sorted(content.keys() ^ slots.keys() - {_PHYSICS})
    for path in apart:
        _check_owner(path, owners)
    for path, value in content.items():
        _check_shape(path, value, np.stack([engine.worlds.state(0)] * engine.n) if path == _PHYSICS
                     else slots[path].value if path in slots else value)  # fmt: skip
    for path in apart:
        _match(path, content, slots, owners, engine)
    for path, value in content.items():
        if path == _PHYSICS:
            for row, state in enumerate(np.asarray(value)):
                engine.worlds.restore(row, state)
        elif path in slots:
            _set(slots[path], value)
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
            _set(slot, value)


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


def _check_owner(path: str, owners: dict[str, Any]) -> None:
    """Raise ConfigError for a part that only the state has, or only the environments, unless a task made it on the way
    or it is a model field that has been the same for all since."""
    above = path.rpartition("/")[0]
    if path != _PHYSICS and _FIELD not in path and (
        above not in owners or isinstance(owners[above], dict | list | tuple)
    ):  # fmt: skip
        raise ConfigError(f"the state and these environments differ in {path}: it is of other settings, or of another "
                          "version")  # fmt: skip


def _check_shape(path: str, value: Any, here: Any) -> None:
    """Raise ConfigError for an array that does not fit."""
    if isinstance(here, np.ndarray) and value is not None and np.shape(value) != here.shape:
        raise ConfigError(f"the state's {path} has the shape {np.shape(value)}, and here it is {here.shape}")


def _match(
    path: str, content: dict[str, Any], slots: dict[str, _Slot], owners: dict[str, Any], engine: EpisodeEngine
) -> None:
    """Make or unmake a part that only the state has, or only the environments."""
    above, _, name = path.rpartition("/")
    if path == _PHYSICS:
        return
    if _FIELD in path:
        engine.worlds.reset_field(name)
    elif path in content:
        setattr(owners[above], name, content[path])
    else:
        delattr(owners[above], name)
        del slots[path]


def _set(slot: _Slot, value: Any) -> None:
    if not isinstance(slot.value, np.ndarray) or value is None:
        value = np.array(value) if isinstance(value, np.ndarray) else value
        if isinstance(slot.owner, dict | list):
            slot.owner[slot.key] = value
        elif not isinstance(slot.owner, tuple):
            setattr(slot.owner, slot.key, value)
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
        if key in _CACHES or (not path and key in _LOOKS):
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
