"""Snapshots of environments on processors: everything that decides how their simulations continue.

Who owns such state names it: `live_arrays` of the engine and all its parts. A user's task is saved by all that it keeps
(`learning/tasks/task_memory.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import first_difference
from allegro_twin.learning.environments.engine import EpisodeEngine
from allegro_twin.learning.tasks.task_memory import release, restore_task, save_task

_BEGUN, _MEMORY = "begun", "task memory"
"""Parts of a snapshot besides arrays: whether there was a reset, and what a user's task keeps besides its arrays."""
_WORLDS = "engine/worlds/"
"""Before the paths of the simulations' own arrays."""


class Environment(Protocol):
    """Environment with an engine, and perhaps with arrays of its own that decide how episodes go on."""

    engine: EpisodeEngine

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """Its own arrays, by name, live."""
        ...


class EpisodeState(NamedTuple):
    """A saved state of an environment."""

    parts: dict[str, Any]
    """Arrays by their paths; tuples stand for what a user's task keeps besides."""
    generators: list[Any]
    """States of the random number generators."""
    keywords: dict[str, Any]
    """Keywords of the environments: task, number, settings."""
    added: list[tuple[Any, str | None]]
    """Objects, each with a grasp or None, that the options of resets have added."""
    seed: int = -1
    """As Gymnasium reports it of a single environment; -1: unknown."""


def save_episode(env: Environment, generators: Sequence[np.random.Generator], **keywords: Any) -> EpisodeState:
    """State of an environment. `keywords`: those that decide episodes beside its settings. Raises ConfigError on a
    device."""
    states = [generator.bit_generator.state for generator in generators]
    return EpisodeState(take_snapshot(env), states, _keywords(env.engine, keywords), list(env.engine.task.added))


def restore_episode(env: Environment, state: EpisodeState, begin: Callable[[], object], **keywords: Any) -> list[Any]:
    """Restore a state in an environment with the same keywords, but for its random numbers: returns the states of the
    generators. `begin`: its first reset, for one that has had none. Raises ConfigError for a state of other keywords,
    before anything changes."""
    if not isinstance(state, EpisodeState):
        raise ConfigError(f"restore_state takes what save_state has returned, not {type(state).__name__}")
    engine: EpisodeEngine = env.engine
    difference = first_difference(state.keywords, _keywords(engine, keywords))
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


def take_snapshot(env: Environment) -> dict[str, Any]:
    """Copies of all that decides how an environment goes on, by their paths: arrays, numbers, and tuples of such.
    Raises ConfigError on a device, and for a user's task that keeps what cannot be saved."""
    engine = env.engine
    if engine.settings.device != "cpu":
        raise ConfigError(f"device {engine.settings.device}: its runs are not equal to the bit, and states are not "
                          "saved there; device cpu saves them")  # fmt: skip
    live = _live_arrays(env)
    found: dict[str, Any] = {path: np.array(array) for path, array in live.items()}
    found[_BEGUN] = engine.begun
    if (memory := save_task(engine.task, live)) is not None:
        found[_MEMORY] = memory
    return dict(sorted(found.items()))  # In no order that the course of an episode decides.


def restore_snapshot(env: Environment, content: Mapping[str, Any]) -> None:
    """Restore a snapshot in an environment of the same settings and size. Raises ConfigError where a part does not
    fit."""
    engine, arrays = env.engine, _arrays(content)
    unused = _expand_fields(engine, arrays)
    live = _live_arrays(env)
    for path in sorted(arrays.keys() ^ (live.keys() - {f"{_WORLDS}{name}" for name in unused})):
        raise ConfigError(f"the state and these environments differ in {path}: it is of other settings, or of another "
                          "version")  # fmt: skip
    for path, value in arrays.items():
        if value.shape != (here := live[path].shape):
            raise ConfigError(f"the state's {path} has the shape {value.shape}, and here it is {here}")
    _write(engine, lambda: _live_arrays(env), content)
    engine.worlds.reset_fields(unused)
    engine.begun = content[_BEGUN]


def spread_snapshot(env: Environment, content: Mapping[str, Any]) -> None:
    """Let all simulations of an environment go on from the one episode of a snapshot of another, with the same
    settings. What a user's task keeps not by simulation is common to all."""
    engine = env.engine
    unused = _expand_fields(engine, _arrays(content))
    _write(engine, lambda: _engine_arrays(engine), content, engine.n)
    engine.worlds.reset_fields(unused)


def _live_arrays(env: Environment) -> dict[str, NDArray[Any]]:
    """Live arrays of the engine, and of the environment itself."""
    own = {f"environment/{name}": array for name, array in env.live_arrays().items()}
    return _engine_arrays(env.engine) | own


def _engine_arrays(engine: EpisodeEngine) -> dict[str, NDArray[Any]]:
    return {f"engine/{path}": array for path, array in engine.live_arrays().items()}


def _arrays(content: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    return {path: part for path, part in content.items() if path not in (_BEGUN, _MEMORY)}


def _expand_fields(engine: EpisodeEngine, arrays: Mapping[str, Any]) -> set[str]:
    """Give each simulation a row of its own of every model field of which the snapshot has some. Returns the fields of
    which only these environments have some."""
    return engine.worlds.expand_as(path.removeprefix(_WORLDS) for path in arrays if path.startswith(_WORLDS))


def _write(
    engine: EpisodeEngine, live_arrays: Callable[[], dict[str, NDArray[Any]]], content: Mapping[str, Any], n: int = 0
) -> None:
    """Write a snapshot into live arrays, and into a user's task. `n`: simulations that all go on from its one."""
    engine.release()
    release(engine.task)
    live = live_arrays()
    restore_task(engine.task, content.get(_MEMORY), live, n)
    for path, own in live.items():
        if path in content:
            value = content[path]
            # In place, so that views of it stay views. PyTorch has no unsigned integers.
            own[...] = value.view(np.uint64) if own.dtype == np.uint64 else value
