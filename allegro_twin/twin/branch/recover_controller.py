"""Recovers the controller of a recorded hand: its config's controller, if that computes every recorded command
again."""

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
from allegro_twin.recording.recorder import command_columns
from allegro_twin.spec import HandSpec
from allegro_twin.twin.branch.overrides import Changes, apply_changes, controller_changes, recorded_config
from allegro_twin.twin.mirror.on_recording import recorded_samples
from allegro_twin.types import Array, Command, HandState, TorqueCommand, Vector

_SAME = 1e-6
"""N·m or rad. Ours: a thousandth of a v4 hand's count, and more than the rounding of two processors differs by."""


class BranchController(NamedTuple):
    """The controller of a branch from the instant on."""

    controller: Controller[Any]
    memory: Any
    """The controller's memory at the instant."""
    config: RunConfig | None
    """Config with the controller and its limits; None: the recorded commands continue."""
    reason: str
    """Why the recorded commands continue; empty where the loop is closed."""


def find_controller(recording: Recording, spec: HandSpec, row: int, *, open_loop: bool) -> BranchController:
    """The controller of the recording's config, or the recorded commands, from a row on."""
    if open_loop:
        return BranchController(RecordedCommands(recording), None, None, "as --open-loop says")
    try:
        config = recorded_config(recording)
        controller = _make(config, spec)
        return BranchController(
            controller, _recover_memory(recording, row, controller, config.controller.kind), config, ""
        )
    except ConfigError as error:
        return BranchController(RecordedCommands(recording), None, None, str(error))


def change_controller(
    driver: BranchController, recording: Recording, spec: HandSpec, row: int, changes: Changes
) -> BranchController:
    """Change the controller. Raises ConfigError where only recorded commands continue."""
    keys = controller_changes(changes)
    if not keys:
        return driver
    if driver.config is None:
        raise ConfigError(
            f"--set controller.{next(iter(keys))}: only commands of {recording.path} go on: {driver.reason}"
        )
    config = apply_changes(driver.config, changes)
    state = next(islice(recorded_samples(recording), row, None)).state
    other = _make(config, spec)
    return BranchController(*hand_over(driver.controller, driver.memory, other, state), config, "")


def hand_over(
    controller: Controller[Any], memory: Any, other: Controller[Any], state: HandState
) -> tuple[Controller[Any], Any]:
    """Another controller and its memory. One of the same kind takes over the memory; another starts anew at a state."""
    if type(other) is type(controller) and hasattr(other, "gains"):
        return replace(controller, gains=other.gains), memory  # type: ignore[type-var]
    return other, other.start(state)


class RecordedCommands:
    """A controller that repeats the commands of a recording, period by period, whatever the state is.

    For a hand that takes torques these are the torques that acted, so what its limits left. In periods without a report
    the torque before continues, as it did in the hand.
    """

    def __init__(self, recording: Recording) -> None:
        columns = recording.columns
        self._tick, self._limp = columns["tick"], limp_of(recording.spec)
        self._torque: Array | None = columns["torque"] if "torque" in recording.spec.commands else None
        self._told = [sample.command for sample in recorded_samples(recording)] if self._torque is None else []

    def start(self, state: HandState) -> None:
        return None

    def __call__(self, state: HandState, memory: None) -> tuple[Command, None]:
        if self._torque is None:
            return self._told[int(np.searchsorted(self._tick, state.tick, side="right")) - 1], None
        after = int(np.searchsorted(self._tick, state.tick, side="right"))
        return TorqueCommand(self._torque[after]) if after < len(self._tick) else self._limp, None


def _make(config: RunConfig, spec: HandSpec) -> Controller[Any]:
    return make_controller(config, spec, trial_of(config.task, spec, config.period))[0]


def _recover_memory(recording: Recording, row: int, controller: Controller[Any], kind: str) -> Any:
    """The controller's memory at a row. Raises ConfigError where it is not the controller that drove the hand."""
    memory: Any = None
    found: Any = None
    for number, (state, command) in enumerate(recorded_samples(recording)):
        if number == 0:
            memory = controller.start(state)
        if number == row:
            found = memory
        mine, memory = controller(state, memory)
        if not _same(command_columns(mine), command_columns(command)):
            raise ConfigError(f"its config's {kind} would have commanded something else at {state.t:.3f} s")
    return found


def _same(mine: Mapping[str, Vector], theirs: Mapping[str, Vector]) -> bool:
    return mine.keys() == theirs.keys() and all(
        np.allclose(mine[name], theirs[name], rtol=0.0, atol=_SAME, equal_nan=True) for name in mine
    )
