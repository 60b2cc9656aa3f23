"""Memory of a user's task as plain data: what it keeps between steps, for saved states and checkpoints.

A task of the package names the arrays that an episode changes (`Task.live_arrays`). A user's task need not: all that it
keeps is saved, or is refused by name; nothing is left out in silence. Saved are tuples of arrays, numbers and strings,
which PyTorch reads without pickle.
"""

from __future__ import annotations

import logging
import sys
import types
from collections import deque
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.tasks.base import Task

_CODE = (type, types.ModuleType, types.FunctionType, types.BuiltinFunctionType, types.MethodType, np.ufunc,
         logging.Logger)  # fmt: skip
"""What has no state of its own."""
_TO_KEEP = "numbers, strings, enums, arrays, lists, tuples, dicts, sets and deques of these, NumPy's generators"
_ABSENT = object()


@runtime_checkable
class HasLiveArrays(Protocol):
    """Object that names the arrays which an episode changes."""

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays that decide how the episodes go on, by name, live: a write changes the episodes."""
        ...


class MemoryWriter:
    """Codes of values. `task`: its name, for errors; `package`: of the user, whose objects are saved by their
    attributes; `known`: what is saved elsewhere, by its name: what is kept in two places is one thing afterwards, too.
    Raises ConfigError for what cannot be saved."""

    def __init__(self, task: str, package: str, known: Mapping[str, Any]) -> None:
        self._task, self._package = task, package
        self._known = {id(value): name for name, value in known.items()}
        self._alive: list[Any] = [known]
        """While it is written nothing else may have the identity of what was."""

    def __call__(self, value: Any, path: str) -> Any:
        if value is None or type(value) in (bool, int, float, str):
            return ("plain", value)
        if isinstance(value, Enum):
            return ("enum", *_reference(value), value.name)
        if _is_constant(value):
            return ("constant",)
        if isinstance(value, np.generic):
            return ("scalar", self._array(np.array(value), path))
        if isinstance(value, complex):
            return ("complex", value.real, value.imag)
        if isinstance(value, bytes):
            return ("bytes", list(value))
        if id(value) in self._known:
            return ("same", self._known[id(value)])
        if not isinstance(value, tuple | frozenset) or value:  # Python has one empty one of each.
            self._known[id(value)] = path
            self._alive.append(value)
        return self._contents(value, path)

    def _contents(self, value: Any, path: str) -> Any:
        if isinstance(value, np.ndarray):
            return self._array(value, path)
        if isinstance(value, np.random.Generator) and type(value.bit_generator).__module__.startswith("numpy.random."):
            name, state = type(value.bit_generator).__name__, value.bit_generator.state
            return ("generator", name, MemoryWriter(self._task, self._package, {})(state, f"{path}/state"))
        if isinstance(value, dict):
            return ("dict", *_reference(value), *self._items(value, path))
        if type(value) is deque:
            return ("deque", value.maxlen, self._parts(value, path))
        if type(value) in (set, frozenset):
            return (type(value).__name__, self._parts(sorted(value, key=repr), path))
        if type(value) is list:
            return ("list", self._parts(value, path))
        if type(value) is tuple or (isinstance(value, tuple) and hasattr(value, "_fields")):
            return ("tuple", *(("", "") if type(value) is tuple else _reference(value)), self._parts(value, path))
        if isinstance(value, HasLiveArrays) and _is_ours(value):
            return ("arrays", *self._items(value.live_arrays(), path))
        if self._is_of_user(value):
            return ("object", *_reference(value), *self._items(vars(value), path))
        kind = type(value)
        raise ConfigError(f"{self._task} keeps a {kind.__module__}.{kind.__qualname__} in {path}, which no state can "
                          f"have: keep {_TO_KEEP}, and objects of your own package with such; what never changes "
                          "belongs to the class; or say what is to be saved in save_memory")  # fmt: skip

    def _parts(self, parts: Any, path: str) -> list[Any]:
        return [self(part, f"{path}/{k}") for k, part in enumerate(parts)]

    def _items(self, value: Mapping[Any, Any], path: str) -> tuple[list[Any], list[Any]]:
        own = {key: part for key, part in value.items() if not _is_constant_key(key)}
        keys = [self(key, f"{path}/keys/{k}") for k, key in enumerate(own)]
        return keys, [self(part, _below(path, key, k)) for k, (key, part) in enumerate(own.items())]

    def _array(self, value: NDArray[Any], path: str) -> Any:
        if value.dtype.kind not in "biufcSUmM":
            raise ConfigError(f"{self._task} keeps an array of {value.dtype} in {path}, which no state can have: keep "
                              f"{_TO_KEEP}")  # fmt: skip
        own = np.array(value, order="C")
        # PyTorch has no strings and no times.
        data = own if own.dtype.kind in "biuf" else np.frombuffer(own.tobytes(), np.uint8).copy()
        return ("array", own.dtype.str, own.shape, value.flags.writeable, data)

    def _is_of_user(self, value: Any) -> bool:
        """Whether something is saved by its attributes, as objects of the user's package are, but for settings."""
        inside = isinstance(value, Draws) or f"{type(value).__module__}.".startswith(f"{self._package}.")
        return inside and hasattr(value, "__dict__") and not hasattr(type(value), "model_fields")


class MemoryReader:
    """Values of codes, as they were. Arrays, containers and objects that are there are filled, so that what refers to
    them goes on doing so. `known`: as for the writer; `n`: simulations that all go on from the one of the state; 0:
    each from its own."""

    def __init__(self, known: Mapping[str, Any], package: str, n: int = 0) -> None:
        self._made, self._package, self._n = dict(known), package, n
        self._used = {id(value) for value in self._made.values()}

    def __call__(self, code: Any, path: str, here: Any) -> Any:
        """The value of a code; `here`: what is in its place now. Raises ConfigError for what is not there."""
        kind, *parts = code
        match kind:
            case "constant":
                return here
            case "plain":
                return parts[0]
            case "same":
                return self._made[parts[0]]
            case "enum":
                return self._type(parts[0], parts[1], path)[parts[2]]
            case "complex":
                return complex(*parts)
            case "bytes":
                return bytes(parts[0])
            case "scalar":
                return MemoryReader({}, self._package)(parts[0], path, None)[()]
        found = getattr(self, f"_{kind}")(path, None if id(here) in self._used else here, *parts)
        return self._keep(path, found)

    def _keep(self, path: str, value: Any) -> Any:
        self._made[path] = value
        self._used.add(id(value))
        return value

    def _inner(self, codes: Sequence[Any], path: str, here: Sequence[Any]) -> list[Any]:
        found = [self(code, f"{path}/{k}", here[k] if k < len(here) else _ABSENT) for k, code in enumerate(codes)]
        if any(each is _ABSENT for each in found):
            raise _another(path)
        return found

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
            if not writeable and not here.flags.writeable and _equal(here, found):
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
        here.bit_generator.state = MemoryReader({}, self._package)(state, path, None)
        return here

    def _items(self, path: str, here: Mapping[Any, Any], keys: Sequence[Any], values: Sequence[Any]) -> dict[Any, Any]:
        names = MemoryReader({}, self._package)._inner(keys, path, ())
        found = {
            name: self(code, _below(path, name, k), here.get(name, _ABSENT))
            for k, (name, code) in enumerate(zip(names, values, strict=True))
        }
        return {name: value for name, value in found.items() if value is not _ABSENT}

    def _dict(self, path: str, here: Any, module: str, name: str, keys: Sequence[Any], values: Sequence[Any]) -> Any:
        if _reference(here) != (module, name):
            if (module, name) != _reference({}):
                raise _another(path)
            here = {}
        own = self._keep(path, here)
        found = self._items(path, own, keys, values)
        kept = {key: value for key, value in own.items() if _is_constant_key(key) or (not path and _is_constant(value))}
        own.clear()
        own.update(kept | found)
        return own

    def _deque(self, path: str, here: Any, longest: int | None, codes: Sequence[Any]) -> Any:
        own = self._keep(path, here if type(here) is deque and here.maxlen == longest else deque(maxlen=longest))
        parts = self._inner(codes, path, list(own))
        own.clear()
        own.extend(parts)
        return own

    def _list(self, path: str, here: Any, codes: Sequence[Any]) -> Any:
        own = self._keep(path, here if type(here) is list else [])
        own[:] = self._inner(codes, path, list(own))
        return own

    def _set(self, path: str, here: Any, codes: Sequence[Any]) -> Any:
        own = self._keep(path, here if type(here) is set else set())
        parts = self._inner(codes, path, ())
        own.clear()
        own.update(parts)
        return own

    def _frozenset(self, path: str, here: Any, codes: Sequence[Any]) -> Any:
        return frozenset(self._inner(codes, path, ()))

    def _tuple(self, path: str, here: Any, module: str, name: str, codes: Sequence[Any]) -> Any:
        parts = self._inner(codes, path, here if isinstance(here, tuple) else ())
        return self._type(module, name, path)(*parts) if name else tuple(parts)

    def _object(self, path: str, here: Any, module: str, name: str, keys: Sequence[Any], values: Sequence[Any]) -> Any:
        kind = self._type(module, name, path)
        own = self._keep(path, here if type(here) is kind else object.__new__(kind))
        found = self._items(path, vars(own), keys, values)
        kept = {name: value for name, value in vars(own).items() if _is_constant(value)}
        vars(own).clear()
        vars(own).update(kept | found)
        return own

    def _arrays(self, path: str, here: Any, keys: Sequence[Any], values: Sequence[Any]) -> Any:
        if not isinstance(here, HasLiveArrays):
            raise _another(path)
        own = here.live_arrays()
        for name, value in self._items(path, own, keys, values).items():
            own[name][...] = value
        return here

    def _type(self, module: str, name: str, path: str) -> Any:
        """An enum, a tuple, or a class of the user's package by its name. Raises ConfigError where it is not there."""
        found: Any = sys.modules.get(module)
        for part in name.split("."):
            found = getattr(found, part, None)
        known = isinstance(found, type) and (
            issubclass(found, Enum | tuple | Draws) or f"{module}.".startswith(f"{self._package}.")
        )
        if not known:
            raise ConfigError(f"the state's {path} is a {module}.{name}, which is not here: it is of another version")
        return found


def save_task(task: Task, live: Mapping[str, Any]) -> Any:
    """What a task keeps besides the arrays `live` of its environments; None for tasks of this package, which keep
    nothing. Raises ConfigError for what cannot be saved."""
    memory = task.save_memory()
    return MemoryWriter(task.name, _package(task), _known(task, live))(memory, "") if memory else None


def restore_task(task: Task, code: Any, live: Mapping[str, Any], n: int = 0) -> None:
    """Have a task go on with what `save_task` has returned; `n`: simulations that all go on from the one of the state.
    Raises ConfigError where the task is another version."""
    here = task.save_memory()
    if (code is None) != (not here):
        raise _another("what the task keeps")
    if code is None:
        return
    task.restore_memory(MemoryReader(_known(task, live), _package(task), n)(code, "", here))


def release(task: Task) -> None:
    """Have arrays of one's own in place of those that a step of a user's task has given out."""
    if _package(task) == "allegro_twin":
        return
    for name, value in vars(task).items():
        if isinstance(value, np.ndarray) and value.base is None and value.flags.writeable:
            setattr(task, name, value.copy())


def _known(task: Task, live: Mapping[str, Any]) -> dict[str, Any]:
    return {"the task": task, "the simulations": task.worlds, **live}


def _package(task: Task) -> str:
    return type(task).__module__.partition(".")[0]


def _is_ours(value: Any) -> bool:
    return type(value).__module__.startswith("allegro_twin.")


def _is_constant(value: Any) -> bool:
    """What a state needs not have: settings, models, descriptions, and code."""
    if isinstance(value, _CODE) or type(value).__module__.startswith("mujoco."):
        return True
    return _is_ours(value) and not isinstance(value, tuple | Draws | HasLiveArrays)


def _is_constant_key(key: Any) -> bool:
    return _is_constant(key) or (type(key) is tuple and any(map(_is_constant_key, key)))


def _below(path: str, key: Any, k: int) -> str:
    """The path of a dict's k-th value."""
    name = key if isinstance(key, str | int) else k
    return f"{path}/{name}" if path else str(name)


def _equal(one: NDArray[Any], other: NDArray[Any]) -> bool:
    return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")


def _reference(value: Any) -> tuple[str, str]:
    return type(value).__module__, type(value).__qualname__


def _another(path: str) -> ConfigError:
    return ConfigError(f"the state and these environments differ in {path}: it is of other settings, or of another "
                       "version")  # fmt: skip
