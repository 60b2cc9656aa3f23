"""Snapshots of environments on processors: everything that decides how their simulations continue.

The package's own objects are saved by their arrays with a row per simulation and their numbers. A user's task is saved
by all that it keeps (`_encode`), or is refused with the name of what it keeps: nothing is left out in silence.
"""

from __future__ import annotations

import logging
import sys
import types
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.engine import EpisodeEngine

_OURS = ("allegro_twin.learning.environments.", "allegro_twin.learning.tasks.", "allegro_twin.sim.batch.")
_PHYSICS = "physics"
_FIELD = "worlds/_rows/"
"""In the paths of model fields that simulations have to themselves."""
_CACHES = ("_palettes", "contact_steps", "_sensor_steps")
"""What follows from the models, and what a task reads between two steps only."""
_LOOKS = ("_ezpickle_args", "_ezpickle_kwargs", "render_mode", "_size", "metadata")
"""Of an environment: how it was made, and how it is shown, which decide no episode."""


_TASK = "engine/task"
_CONSTANT = (type, types.ModuleType, types.FunctionType, types.BuiltinFunctionType, types.MethodType, np.ufunc,
             logging.Logger)  # fmt: skip
"""What has no state of its own."""
_TO_KEEP = "numbers, strings, enums, arrays, lists, tuples, dicts, sets and deques of these, NumPy's generators"


class _Slot(NamedTuple):
    """A value, and where it can be replaced."""

    owner: Any
    key: Any
    value: Any
    user: bool = False
    """Whether a user's task keeps it."""
    memory: bool = False
    """Whether it is saved as a whole, by `_encode`."""


class EpisodeState(NamedTuple):
    """A saved state of an environment."""

    parts: dict[str, Any]
    """Arrays and numbers by their paths; tuples stand for what a user's task keeps besides."""
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
    """Copies of all that decides how an environment with an `engine` goes on, by their paths: arrays, numbers, and
    tuples of such. Raises ConfigError on a device, and for a user's task that keeps what cannot be saved."""
    engine: EpisodeEngine = env.engine
    if engine.settings.device != "cpu":
        raise ConfigError(f"device {engine.settings.device}: its runs are not equal to the bit, and states are not "
                          "saved there; device cpu saves them")  # fmt: skip
    found: dict[str, Any] = {_PHYSICS: np.stack([engine.worlds.state(row) for row in range(engine.n)])}
    slots = sorted(_slots(env, engine))  # In no order that the course of an episode decides.
    known = {id(slot.value): path for path, slot in slots if isinstance(slot.value, np.ndarray) and not slot.memory}
    for path, slot in slots:
        if slot.memory:
            found[path] = _encode(slot.value, path, known, engine)
        else:
            found[path] = np.array(slot.value) if isinstance(slot.value, np.ndarray) else slot.value
    return dict(sorted(found.items()))


def restore_snapshot(env: Any, content: dict[str, Any]) -> None:
    """Restore a snapshot in an environment of the same settings and size. Raises ConfigError where a part does not
    fit."""
    engine: EpisodeEngine = env.engine
    _expand_fields(engine, content)
    _let_go(engine)
    slots, owners = dict(_slots(env, engine)), dict(_owners(env, engine))
    apart = sorted(content.keys() ^ slots.keys() - {_PHYSICS})
    for path in apart:
        _check_owner(path, owners, engine)
    for path, value in content.items():
        _check_shape(path, value, np.stack([engine.worlds.state(0)] * engine.n) if path == _PHYSICS
                     else slots[path].value if path in slots else value)  # fmt: skip
    decoder = _Decoder(slots)
    for path in apart:
        _match(path, content, slots, owners, engine, decoder)
    for path, value in content.items():
        if path == _PHYSICS:
            for row, state in enumerate(np.asarray(value)):
                engine.worlds.restore(row, state)
        elif path in slots:
            _set(slots[path], value if not isinstance(value, tuple) else decoder(value, path, slots[path].value))
    again = take_snapshot(env)
    different = [path for path, value in content.items() if path in slots and not _same(again[path], value)]
    if different:
        raise ConfigError(
            f"the state's {different[0]} does not fit these environments: it is of other settings or another version"
        )


def spread_snapshot(env: Any, content: dict[str, Any]) -> None:
    """Let all simulations of an environment go on from the one episode of a snapshot of another, with the same
    settings. What a user's task keeps not by simulation is common to all."""
    engine: EpisodeEngine = env.engine
    _expand_fields(engine, content)
    for row in range(engine.n):
        engine.worlds.restore(row, content[_PHYSICS][0])
    _let_go(engine)
    slots, owners = dict(_slots(env, engine)), dict(_owners(env, engine))
    decoder = _Decoder(slots, engine.n)
    for path in sorted(content.keys() ^ slots.keys()):
        above = path.rpartition("/")[0]
        if above in owners and _is_of_user(owners[above], above, False):
            _match(path, content, slots, owners, engine, decoder)
    for path, slot in slots.items():
        if path not in content or not path.startswith("engine/"):
            continue
        if path.endswith("/n") and (slot.owner is engine.task or not slot.user):
            continue
        value, here = content[path], slot.value
        if isinstance(value, tuple) or slot.memory:
            _set(slot, decoder(value, path, here))
        elif isinstance(here, np.ndarray) and isinstance(value, np.ndarray):
            here[...] = value  # One row for all.
        elif not isinstance(here, np.ndarray) and not isinstance(value, np.ndarray):
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
            if isinstance(value, np.ndarray) and value.base is None and value.flags.writeable:
                setattr(owner, name, value.copy())


def _check_owner(path: str, owners: dict[str, Any], engine: EpisodeEngine) -> None:
    """Raise ConfigError for a part that only the state has, or only the environments, unless a task made it on the way
    or it is a model field that has been the same for all since."""
    above = path.rpartition("/")[0]
    if path == _PHYSICS or _FIELD in path:
        return
    owner = owners.get(above)
    if owner is None or isinstance(owner, dict | list | tuple) or owner is engine.worlds:
        raise ConfigError(f"the state and these environments differ in {path}: it is of other settings, or of another "
                          "version")  # fmt: skip


def _check_shape(path: str, value: Any, here: Any) -> None:
    """Raise ConfigError for an array that does not fit."""
    if isinstance(here, np.ndarray) and isinstance(value, np.ndarray) and np.shape(value) != here.shape:
        raise ConfigError(f"the state's {path} has the shape {np.shape(value)}, and here it is {here.shape}")


def _match(
    path: str,
    content: dict[str, Any],
    slots: dict[str, _Slot],
    owners: dict[str, Any],
    engine: EpisodeEngine,
    decoder: _Decoder,
) -> None:
    """Make or unmake a part that only the state has, or only the environments."""
    above, _, name = path.rpartition("/")
    if path == _PHYSICS:
        return
    if _FIELD in path:
        engine.worlds.reset_field(name)
    elif path in content:
        setattr(owners[above], name, decoder(content[path], path, None))
    else:
        delattr(owners[above], name)
        del slots[path]


def _set(slot: _Slot, value: Any) -> None:
    if value is slot.value:
        return
    if not isinstance(slot.value, np.ndarray) or value is None or slot.memory or not isinstance(value, np.ndarray):
        value = np.array(value) if isinstance(value, np.ndarray) and not slot.memory else value
        if isinstance(slot.owner, dict | list):
            slot.owner[slot.key] = value
        elif not isinstance(slot.owner, tuple):
            setattr(slot.owner, slot.key, value)
    else:
        # In place, so that views of it stay views. PyTorch has no unsigned integers.
        slot.value[...] = value.view(np.uint64) if slot.value.dtype == np.uint64 else value


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, np.ndarray) and one.dtype == np.uint64:
        one, other = one.view(np.int64), np.asarray(other).view(np.int64)
    if isinstance(one, float) and isinstance(other, float) and one != one:
        return other != other
    return np.array_equal(one, other, equal_nan=isinstance(one, np.ndarray) and one.dtype.kind == "f")


def _modules(engine: EpisodeEngine) -> tuple[str, ...]:
    """Beginnings of the names of modules whose objects have a state: ours, and the package of a user's task."""
    package = type(engine.task).__module__.partition(".")[0]
    return _OURS if package == "allegro_twin" else (*_OURS, f"{package}.")


def _slots(env: Any, engine: EpisodeEngine) -> Iterator[tuple[str, _Slot]]:
    """Arrays with a row per simulation, plain numbers, and what a user's task keeps, by their paths."""
    found = _nested_slots(env, "", engine.n, _modules(engine), set())
    return ((path, slot) for path, slot in found if isinstance(slot, _Slot))


def _owners(env: Any, engine: EpisodeEngine) -> Iterator[tuple[str, Any]]:
    """What has such, by its path."""
    for path, slot in _nested_slots(env, "", engine.n, _modules(engine), set()):
        if not isinstance(slot, _Slot):
            yield path, slot


def _nested_slots(
    owner: Any, path: str, n: int, modules: tuple[str, ...], seen: set[int], user: bool = False
) -> Iterator[tuple[str, Any]]:
    """Slots, and every owner of some. `user`: whether a container is of a user's task."""
    if id(owner) in seen:
        return
    seen.add(id(owner))
    yield path, owner
    user = _is_of_user(owner, path, user)
    for key, value in _parts(owner):
        if key in _CACHES or (not path and key in _LOOKS):
            continue
        here = f"{path}/{key}" if path else str(key)
        if isinstance(value, np.ndarray):
            # Read-only arrays of ours are results of the last step, or never change.
            if value.flags.writeable and value.dtype.kind in "biuf" and n in value.shape[:2]:
                yield here, _Slot(owner, key, value, user)
            elif user:
                yield here, _Slot(owner, key, value, user, memory=True)
        elif value is None or type(value) in (bool, int, float):
            yield here, _Slot(owner, key, value, user)
        elif user and _is_plain(value):
            yield here, _Slot(owner, key, value, user, memory=True)
        elif isinstance(value, dict | list | tuple) or _is_environment_part(value, modules):
            yield from _nested_slots(value, here, n, modules, seen, user)
        elif user and not _is_constant(value):
            yield here, _Slot(owner, key, value, user, memory=True)  # To be refused by name.


def _parts(owner: Any) -> list[tuple[Any, Any]]:
    if isinstance(owner, dict):
        return [(key, value) for key, value in owner.items() if isinstance(key, str | int)]
    if isinstance(owner, tuple) and hasattr(owner, "_fields"):
        return list(zip(owner._fields, owner, strict=True))
    if isinstance(owner, list | tuple):
        return list(enumerate(owner))
    return list(vars(owner).items())


def _is_environment_part(value: Any, modules: tuple[str, ...]) -> bool:
    """Objects of the environments and of the package of a user's own task: not their settings and models."""
    return (
        hasattr(value, "__dict__")
        and (type(value).__module__ + ".").startswith(modules)
        and not isinstance(value, (Enum, *_CONSTANT))
        and not hasattr(type(value), "model_fields")
    )


def _is_of_user(owner: Any, path: str, container: bool) -> bool:
    """Whether something is of a user's task, all of which is saved; `container`: what holds of one of Python's."""
    module = type(owner).__module__
    if module in ("builtins", "collections"):
        return container
    return (path + "/").startswith(_TASK + "/") and not module.startswith("allegro_twin.")


def _is_constant(value: Any) -> bool:
    """What a state needs not have: settings, models, descriptions, and code."""
    return isinstance(value, _CONSTANT) or type(value).__module__.startswith(("allegro_twin.", "mujoco."))


def _is_plain(value: Any) -> bool:
    """Whether `_encode` can save a value."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "biufcSUmM"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic | Enum):
        return not type(value).__module__.startswith("allegro_twin.")
    if isinstance(value, np.random.Generator):
        return type(value.bit_generator).__module__.startswith("numpy.random.")
    if type(value) is dict:
        return all(_is_plain(key) and _is_plain(part) for key, part in value.items())
    named = isinstance(value, tuple) and hasattr(value, "_fields")
    if type(value) in (list, tuple, set, frozenset, deque) or named:
        return not type(value).__module__.startswith("allegro_twin.") and all(map(_is_plain, value))
    return False


def _encode(value: Any, path: str, known: dict[int, str], engine: EpisodeEngine) -> Any:
    """What a user's task keeps, as tuples of arrays, numbers and strings. `known`: paths of what was saved, by its
    identity: what is kept in two places is one thing afterwards, too. Raises ConfigError for what cannot be saved."""
    if not _is_plain(value):
        raise ConfigError(f"{engine.task.name} keeps {_type_name(value)} in {path.removeprefix(_TASK + '/')}, which no "
                          f"state can have: keep {_TO_KEEP}, and objects of your own package with such; what never "
                          "changes belongs to the class")  # fmt: skip
    if value is None or type(value) in (bool, int, float, str):
        return ("plain", value)
    if isinstance(value, Enum):
        return ("enum", *_reference(value), value.name)
    if isinstance(value, np.generic):
        return ("scalar", _encode(np.array(value), path, {}, engine))
    if isinstance(value, complex):
        return ("complex", value.real, value.imag)
    if isinstance(value, bytes):
        return ("bytes", list(value))
    if id(value) in known and not (isinstance(value, tuple | frozenset) and not value):
        return ("same", known[id(value)])
    known[id(value)] = path

    def inner(parts: Any) -> list[Any]:
        return [_encode(part, f"{path}/{k}", known, engine) for k, part in enumerate(parts)]

    if isinstance(value, np.ndarray):
        own = np.array(value, order="C")
        # PyTorch has no strings and no times.
        data = own if own.dtype.kind in "biuf" else np.frombuffer(own.tobytes(), np.uint8).copy()
        return ("array", own.dtype.str, own.shape, value.flags.writeable, data)
    if isinstance(value, np.random.Generator):
        state = value.bit_generator.state
        return ("generator", type(value.bit_generator).__name__, _encode(state, f"{path}/state", {}, engine))
    if isinstance(value, dict):
        return ("dict", inner(value.keys()), inner(value.values()))
    if isinstance(value, deque):
        return ("deque", value.maxlen, inner(value))
    if isinstance(value, set | frozenset):
        return (type(value).__name__, inner(sorted(value, key=repr)))
    if isinstance(value, list):
        return ("list", inner(value))
    return ("tuple", *(_reference(value) if type(value) is not tuple else ("", "")), inner(value))


def _type_name(value: Any) -> str:
    kind = type(value)
    if isinstance(value, dict | list | tuple | set | frozenset | deque) and kind.__module__ in (
        "builtins",
        "collections",
    ):
        parts = [*value.keys(), *value.values()] if isinstance(value, dict) else list(value)
        inner = next((part for part in parts if not _is_plain(part)), None)
        return f"a {kind.__name__}" + ("" if inner is None else f" with {_type_name(inner)}")
    return f"a {kind.__module__}.{kind.__qualname__}"


def _reference(value: Any) -> tuple[str, str]:
    return type(value).__module__, type(value).__qualname__


def _type_of(module: str, name: str, path: str) -> Any:
    """A class of a user's task. Raises ConfigError where it is not there."""
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    if not isinstance(found, type) or not issubclass(found, Enum | tuple):
        raise ConfigError(f"the state's {path} is a {module}.{name}, which is not here: it is of another version")
    return found


class _Decoder:
    """What `_encode` has made of a task's memory, as it was. Arrays and containers that are there are filled, so that
    what refers to them goes on doing so; `n`: simulations that all go on from the one of the state."""

    def __init__(self, slots: dict[str, _Slot], n: int = 0) -> None:
        self._n = n
        self._made: dict[str, Any] = {path: slot.value for path, slot in slots.items() if not slot.memory}
        self._used = {id(value) for value in self._made.values() if isinstance(value, np.ndarray)}

    def __call__(self, code: Any, path: str, here: Any) -> Any:
        """The value of a code; `here`: what is in its place now."""
        if isinstance(code, np.ndarray):
            code = ("array", code.dtype.str, code.shape, True, code)
        if not isinstance(code, tuple):
            return code
        kind, *parts = code
        if kind == "plain":
            return parts[0]
        if kind == "same":
            return self._made[parts[0]]
        if kind == "enum":
            return _type_of(parts[0], parts[1], path)[parts[2]]
        if kind == "complex":
            return complex(*parts)
        if kind == "bytes":
            return bytes(parts[0])
        if kind == "scalar":
            return _Decoder({})(parts[0], path, None)[()]
        if id(here) in self._used:
            here = None
        found = getattr(self, f"_{kind}")(path, here, *parts)
        self._made[path] = found
        self._used.add(id(found))
        return found

    def _inner(self, codes: Sequence[Any], path: str, here: Sequence[Any]) -> list[Any]:
        return [self(code, f"{path}/{k}", here[k] if k < len(here) else None) for k, code in enumerate(codes)]

    def _array(
        self, path: str, here: Any, dtype: str, shape: Sequence[int], writeable: bool, value: NDArray[Any]
    ) -> Any:
        found = np.array(value, order="C").view(np.dtype(dtype)).reshape(tuple(shape))
        if self._n:
            found = self._spread(found, here)
        if isinstance(here, np.ndarray) and here.dtype == found.dtype and here.shape == found.shape:
            if writeable and here.flags.writeable:
                here[...] = found
                return here
            if not writeable and not here.flags.writeable and _same(here, found):
                return here  # Perhaps a live view.
        found.flags.writeable = writeable
        return found

    def _spread(self, value: Any, here: Any) -> Any:
        """An array of one simulation for all, where it has a row for it: as the one that is here, or else the first."""
        if isinstance(here, np.ndarray) and here.ndim == value.ndim:
            fits = all(a == b or (a == 1 and b == self._n) for a, b in zip(value.shape, here.shape, strict=True))
            return np.array(np.broadcast_to(value, here.shape)) if fits else value
        return np.repeat(value, self._n, axis=0) if value.ndim and len(value) == 1 else value

    def _generator(self, path: str, here: Any, name: str, state: Any) -> Any:
        if not isinstance(here, np.random.Generator) or type(here.bit_generator).__name__ != name:
            here = np.random.Generator(getattr(np.random, name)())
        here.bit_generator.state = _Decoder({})(state, path, None)
        return here

    def _dict(self, path: str, here: Any, keys: Sequence[Any], values: Sequence[Any]) -> Any:
        names = _Decoder({})._inner(keys, path, ())
        own = here if type(here) is dict else {}
        found = {
            name: self(code, f"{path}/{k}", own.get(name))
            for k, (name, code) in enumerate(zip(names, values, strict=True))
        }
        own.clear()
        own.update(found)
        return own

    def _deque(self, path: str, here: Any, longest: int | None, codes: Sequence[Any]) -> Any:
        own = here if type(here) is deque and here.maxlen == longest else deque(maxlen=longest)
        parts = self._inner(codes, path, list(own))
        own.clear()
        own.extend(parts)
        return own

    def _list(self, path: str, here: Any, codes: Sequence[Any]) -> Any:
        own = here if type(here) is list else []
        own[:] = self._inner(codes, path, own)
        return own

    def _set(self, path: str, here: Any, codes: Sequence[Any]) -> Any:
        own = here if type(here) is set else set()
        parts = self._inner(codes, path, ())
        own.clear()
        own.update(parts)
        return own

    def _frozenset(self, path: str, here: Any, codes: Sequence[Any]) -> Any:
        return frozenset(self._inner(codes, path, ()))

    def _tuple(self, path: str, here: Any, module: str, name: str, codes: Sequence[Any]) -> Any:
        parts = self._inner(codes, path, here if isinstance(here, tuple) else ())
        return _type_of(module, name, path)(*parts) if name else tuple(parts)
