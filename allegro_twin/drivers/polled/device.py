"""A hand that does not exist: any backend that takes limited positions, behind electronics that answer."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

import numpy as np

from allegro_twin.backend import HandBackend
from allegro_twin.drivers.base.faults import FaultScript, NoisyLine
from allegro_twin.drivers.base.serial_line import BITS
from allegro_twin.drivers.polled.config import PolledFaultEvent, PolledFaultSettings
from allegro_twin.drivers.polled.scale import Scale
from allegro_twin.errors import ConfigError
from allegro_twin.types import Array, HandState, PositionCommand

_RUNS = 0.5
"""s in which a motor runs through its whole range with nothing on its tendon. Assumed: nobody has published it."""


class Electronics(Protocol):
    """A hand's firmware."""

    @property
    def wants(self) -> list[int] | None:
        """The ticks that its motors go to, (m,); None: they are off."""
        ...

    def receive(self, data: bytes) -> bytes:
        """What it answers. Never raises."""
        ...

    def clear(self) -> None:
        """A pause on the line: what was not a packet yet never becomes one."""
        ...

    def elapse(self, seconds: float) -> None:
        """Time passes: watchdogs strike."""
        ...

    def sense(self, ticks: Array, current: Array) -> None:
        """Where its encoders are, and what its motors draw, mA; (m,) each."""
        ...


class VirtualPolledHand:
    """Virtual polled hand, whose time passes in `step`, and whose bytes pass through `receive`. Raises ConfigError for
    faults of what is not there.

    `backend` takes limited positions, so that one motor alone can give nothing; `boot` makes electronics as they are
    when power comes.
    """

    def __init__(
        self,
        backend: HandBackend,
        boot: Callable[[], Electronics],
        scale: Scale,
        baud: int,
        plan: PolledFaultSettings | None = None,
    ) -> None:
        self.backend, self.scale, self.baud = backend, scale, baud
        self._boot, plan = boot, plan or PolledFaultSettings()
        self.electronics = boot()
        if "limited_position" not in backend.spec.commands:
            kinds = ", ".join(backend.spec.commands)
            raise ConfigError(
                f"a virtual hand needs physics that take a limited_position; {backend.spec.name}: {kinds}"
            )
        n = backend.spec.n_actuators
        self.spoil = NoisyLine(plan)
        self._electronics = threading.Lock()  # They answer while physics are computed.
        self._script = FaultScript(plan.script, n, "actuators")
        self.dead, self.torn = np.zeros((2, n), dtype=bool)
        self.mute = self.off = False
        """Whether its plug is out: it hears nobody; whether it has no power."""
        self.seconds = self.now = self._on = 0.0
        """For how long the line was used; s since `restart`."""
        self.restart()

    @property
    def name(self) -> str:
        return self.backend.spec.name

    @property
    def period(self) -> float:
        """s of a step."""
        return self.backend.period

    @property
    def limp(self) -> bool:
        """Whether no motor does anything."""
        return self._wants is None

    def restart(self) -> None:
        """Begin the scene anew; the electronics stay as they are."""
        self.state = self.backend.reset()
        self._steps, self.now = 0, 0.0
        self._loose = self.state.position.copy()
        self._sense()

    def step(self) -> HandState:
        """Let one period pass."""
        with self._electronics:
            self._command()
        self.state = self.backend.read()
        with self._electronics:
            self._pass()
        return self.state

    def _command(self) -> None:
        """What the motors do in the period that begins."""
        for event in self._script.take(self._on + 1e-9):
            self._do(event)
        spec, wants = self.backend.spec, self._wants
        goal = self.state.position if wants is None else self.scale.position(np.array(wants, dtype=np.float64))
        useless = self.dead | self.torn | (wants is None)
        self.backend.write(PositionCommand(goal, effort=np.where(useless, 0.0, spec.actuation.torque_limit)))

    def _pass(self) -> None:
        """The period is over."""
        spec, wants = self.backend.spec, self._wants
        self._steps += 1
        self.now = self._steps * self.period
        self._on += self.period
        if wants is not None:
            goal = self.scale.position(np.array(wants, dtype=np.float64))
            most = (spec.upper - spec.lower) * self.period / _RUNS
            self._loose += np.where(self.dead, 0.0, np.clip(goal - self._loose, -most, most))
        self.electronics.elapse(self.period)
        self._sense()

    def receive(self, data: bytes, baud: int) -> bytes:
        """What comes back of what a host sends at this speed; at another one it hears noise."""
        with self._electronics:
            heard = self.spoil(data)
            answer = b"" if self.mute or self.off or baud != self.baud else self.spoil(self.electronics.receive(heard))
            self.seconds += (len(data) + len(answer)) * BITS / baud
        return answer

    def clear(self) -> None:
        """A pause on the line."""
        self.electronics.clear()

    @property
    def _wants(self) -> list[int] | None:
        return None if self.off else self.electronics.wants

    def _do(self, event: PolledFaultEvent) -> None:
        match event.what:
            case "dead_motor":
                self.dead[event.which] = True
            case "torn_tendon":
                self.torn[event.which] = True
                self._loose[event.which] = self.state.position[event.which]
            case "silence":
                self.mute = True
            case "power_cut":
                self.off, self.electronics = True, self._boot()
            case "recover":
                self.dead[:] = self.torn[:] = False
                self.mute = self.off = False

    def _sense(self) -> None:
        """An encoder sits at its motor: with the tendon torn it turns, and draws nothing, and the finger stays."""
        position = np.where(self.torn, self._loose, self.state.position)
        ticks = np.rint((position - self.scale.lower) / self.scale.per_tick)
        force = np.where(self.torn | self.dead, 0.0, self.state.torque)
        self.electronics.sense(ticks, np.rint(np.nan_to_num(force / self.scale.per_milliampere)))
