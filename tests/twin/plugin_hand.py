"""A hand of somebody else's package, as an entry point names it: our physics behind a backend of its own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

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


class TheirHand:
    live = False

    def __init__(self, settings: TheirSettings, context: plugins.BackendContext) -> None:
        self._sim: HandBackend = context.simulate(None, context.spec(version="v4"), context.period)
        self._imu, self._ends = settings.imu, settings.ends
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
        if self._ends and state.t > 1.5:
            raise KeyboardInterrupt if self._ends == "ctrl-c" else LinkError("the bus is down")
        return state

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
