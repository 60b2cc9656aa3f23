"""A hand of somebody else's package, as an entry point names it: our physics behind a backend of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import can
import numpy as np
import pytest

from allegro_twin import plugins
from allegro_twin.backend import HandBackend
from allegro_twin.errors import LinkError
from allegro_twin.types import Command, HandState, frozen

CALIBRATION = {"version": "v4", "torque_constant": [1.0] * 16}


class TheirSettings(plugins.BackendSettings):
    kind: Literal["theirs"]
    counts: bool = True
    """Whether it offers a calibration."""
    imu: bool = True
    ends: Literal["", "ctrl-c", "silent"] = ""
    """What happens after 1.5 s."""
    frames: bool = False
    """Whether it is on a bus of its own, with a frame each period."""


class TheirHand:
    live = False

    def __init__(self, settings: TheirSettings, context: plugins.BackendContext) -> None:
        self._sim: HandBackend = context.simulate(None, context.spec(version="v4"), context.period)
        self._imu, self._ends = settings.imu, settings.ends
        self._frames, self._logs = settings.frames, list[Callable[[can.Message], None]]()
        self.calibration: dict[str, Any] = CALIBRATION if settings.counts else {}

    @property
    def spec(self) -> Any:
        return self._sim.spec

    @property
    def period(self) -> float:
        return self._sim.period

    def reset(self) -> HandState:
        return self._told(self._sim.reset())

    def write(self, command: Command) -> None:
        self._sim.write(command)

    def read(self) -> HandState:
        state = self._told(self._sim.read())
        for log in self._logs:
            log(can.Message(timestamp=state.t, arbitration_id=0x123, data=[state.tick % 256], is_extended_id=False))
        if self._ends and state.t > 1.5:
            raise KeyboardInterrupt if self._ends == "ctrl-c" else LinkError("the bus is down")
        return state

    def listen(self, log: Callable[[can.Message], None]) -> bool:
        self._logs += [log] if self._frames else []
        return self._frames

    def close(self) -> None:
        self._sim.close()

    def _told(self, state: HandState) -> HandState:
        return state if self._imu else replace(state, gravity=frozen(np.full(3, np.nan)))


KIND = plugins.BackendKind(TheirSettings, TheirHand)


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the kind `theirs` known as an installed package does."""

    class Point:
        value = "tests.twin.plugin_hand:KIND"

        def load(self) -> Any:
            return KIND

    monkeypatch.setattr(
        plugins, "entry_points_of", lambda group: {"theirs": Point()} if group.endswith("backends") else {}
    )
