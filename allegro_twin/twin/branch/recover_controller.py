"""Who drove a recorded hand: its config's controller, where that computes every recorded command again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.app.controllers import make_controller
from allegro_twin.app.simulated import trial_of
from allegro_twin.backend import limp_of
from allegro_twin.controller import Controller
from allegro_twin.errors import ConfigError
from allegro_twin.recording.reader import Recording
from allegro_twin.recording.recorder import columns_of
from allegro_twin.spec import HandSpec
from allegro_twin.twin.branch.overrides import Changes, changed, config_of, of_controller
from allegro_twin.twin.mirror.for_hand import played
from allegro_twin.types import Array, Command, HandState, TorqueCommand, Vector

_SAME = 1e-6
"""N·m or rad. Ours: a thousandth of a v4 hand's count, and more than two processors' roundings differ by."""


class Driver(NamedTuple):
    """What commands the hand from the instant on."""

    controller: Controller[Any]
    memory: Any
    """With which it meets the state at the instant."""
    config: RunConfig | None
    """With whose controller and limits; None: the recorded commands go on."""
    why: str
    """Why the recorded commands go on; empty where the loop is closed."""


def driver_of(recording: Recording, spec: HandSpec, row: int, *, open_loop: bool) -> Driver:
    """Who commands from a row on: the controller of the recording's config, or the recorded commands themselves."""
    if open_loop:
        return Driver(Again(recording), None, None, "as --open-loop says")
    try:
        config = config_of(recording)
        controller = _made(config, spec)
        return Driver(controller, _memory(recording, row, controller, config.controller.kind), config, "")
    except ConfigError as error:
        return Driver(Again(recording), None, None, str(error))


def changed_by(driver: Driver, recording: Recording, spec: HandSpec, row: int, changes: Changes) -> Driver:
    """The driver with its controller changed. Raises ConfigError where no controller drives."""
    asked = of_controller(changes)
    if not asked:
        return driver
    if driver.config is None:
        raise ConfigError(
            f"--set controller.{next(iter(asked))}: only commands of {recording.path} go on: {driver.why}"
        )
    after = changed(driver.config, changes)
    state = next(islice(played(recording), row, None)).state
    other = _made(after, spec)
    return Driver(*successor(driver.controller, driver.memory, other, state), after, "")


def successor(
    controller: Controller[Any], memory: Any, other: Controller[Any], state: HandState
) -> tuple[Controller[Any], Any]:
    """Another controller and its memory: one of the same kind goes on with what the first remembers, another begins
    anew at a state."""
    if type(other) is type(controller) and hasattr(other, "gains"):
        return replace(controller, gains=other.gains), memory  # type: ignore[type-var]
    return other, other.start(state)


class Again:
    """What a hand was told in a recording, period by period, whatever its state is.

    Of a hand that takes torques that which acted, so what its limits left; in periods that nobody heard of the one
    before goes on, as it did in the hand.
    """

    def __init__(self, recording: Recording) -> None:
        columns = recording.columns
        self._tick, self._limp = columns["tick"], limp_of(recording.spec)
        self._torque: Array | None = columns["torque"] if "torque" in recording.spec.commands else None
        self._told = [sample.command for sample in played(recording)] if self._torque is None else []

    def start(self, state: HandState) -> None:
        return None

    def __call__(self, state: HandState, memory: None) -> tuple[Command, None]:
        if self._torque is None:
            return self._told[int(np.searchsorted(self._tick, state.tick, side="right")) - 1], None
        after = int(np.searchsorted(self._tick, state.tick, side="right"))
        return TorqueCommand(self._torque[after]) if after < len(self._tick) else self._limp, None


def _made(config: RunConfig, spec: HandSpec) -> Controller[Any]:
    return make_controller(config, spec, trial_of(config.task, spec, config.period))[0]


def _memory(recording: Recording, row: int, controller: Controller[Any], kind: str) -> Any:
    """With which it meets a row. Raises ConfigError where it was not the one that drove the hand."""
    memory: Any = None
    found: Any = None
    for number, (state, command) in enumerate(played(recording)):
        if number == 0:
            memory = controller.start(state)
        if number == row:
            found = memory
        mine, memory = controller(state, memory)
        if not _same(columns_of(mine), columns_of(command)):
            raise ConfigError(f"its config's {kind} would have commanded something else at {state.t:.3f} s")
    return found


def _same(mine: Mapping[str, Vector], theirs: Mapping[str, Vector]) -> bool:
    return mine.keys() == theirs.keys() and all(
        np.allclose(mine[name], theirs[name], rtol=0.0, atol=_SAME, equal_nan=True) for name in mine
    )
