"""What a task is: a scene, a script, a goal, and the sense in which an episode went well; written for a whole batch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.randomise import applicable
from allegro_twin.learning.environments.settings import OWN, EnvSettings, Options
from allegro_twin.learning.policy.card import Card, Closed
from allegro_twin.learning.policy.interface import Interface, Observation
from allegro_twin.sim.batch.worlds import Body, Rows, Worlds
from allegro_twin.types import Array
from allegro_twin.viewing.overlays import Mark

Flags = NDArray[np.bool_]
Ticks = NDArray[np.int64]


class Outcome(NamedTuple):
    """What a step came to, one value a simulation, shape (n,)."""

    reward: Array
    failed: Flags
    """The episode cannot go well any more, and ends."""
    success: Flags
    terms: dict[str, Array]
    """What the reward is made of."""


@runtime_checkable
class Goals(Protocol):
    """What a task with goals can besides."""

    def reward(self, achieved: ArrayLike, desired: ArrayLike, dropped: Array) -> Array:
        """Of goals (..., k), whatever they come from; `dropped` (...) is what the loss of an object costs. A step pays
        for the goal that is truly achieved, which what a policy sees is with neither noise nor delay."""
        ...


class Task(ABC):
    """`n` episodes of one task."""

    name: ClassVar[str]
    purpose: ClassVar[str]
    """One line for lists."""
    seconds: float
    """How long an episode takes."""
    options: ClassVar[tuple[str, ...]]
    """Which `Options` a reset takes."""
    own: ClassVar[tuple[str, ...]] = ()
    """Which of the settings that only some tasks have (`OWN`) it has."""
    extra: int = 0
    """Numbers in an observation that no real hand has: the task is privileged when there are any."""
    settings: EnvSettings
    interface: Interface
    worlds: Worlds
    counted: ClassVar[str] = ""
    """Of what an outcome tells, what an episode has come to besides success; with its unit in `unit`."""
    unit: ClassVar[str] = ""
    shares: ClassVar[tuple[str, ...]] = ()
    """Of what an outcome tells, shares of the episode's time so far, from 0 to 1, that an evaluation reports."""
    turns: ClassVar[bool] = False
    """Its goals are orientations, quaternions w, x, y, z."""
    farthest: float = 0.0
    """How far new goals are at most, rad, where a task has such."""
    thing: Body | None = None
    """The object, where there is one."""

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        self.settings, self.n = settings, n
        for name in OWN:
            if name in settings.model_fields_set and name not in self.own:
                raise ConfigError(f"{self.name} has no {name} to choose")
        action = settings.period * settings.decimation
        if action > self.seconds / 2:
            raise ConfigError(
                f"an action of {settings.decimation} periods of {settings.period:g} s takes {action:g} s, and an "
                f"episode of {self.name} {self.seconds:g} s: choose a smaller decimation or period"
            )
        self.spec = load_spec(settings.hand, settings.side)
        applicable(settings.randomise, self.spec)
        self.gains = load_gains(settings.gains, self.spec)

    @abstractmethod
    def variant(self, rows: Rows, draws: Draws, options: Options) -> Rows:
        """Which of the batch's variants each new episode takes, (m,)."""

    @abstractmethod
    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: Options) -> None:
        """Set up new episodes of simulations that have their variant and what was randomised (`values`, (m,) each)."""

    def vary(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: Options) -> None:
        """Add to `values` what the task itself draws of `Randomise`'s quantities, where nobody else has."""
        return

    def targets(self, rows: Rows) -> Array | None:
        """Where the fingers are drawn to at the beginning, (m, joints), rad; None: where they are."""
        return None

    def plan(self, tick: Ticks) -> None:
        """Prepare what surrounds the hands for the step that begins `tick` (n,) periods after the beginning."""
        return

    def drive(self, k: int) -> None:
        """Move what surrounds the hands for the k-th control period of that step."""
        return

    @abstractmethod
    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> Outcome:
        """What the step that ended at `tick` came to. `action` as it was taken, shape (n, joints).

        Judged by the simulation's own state (`worlds`, `thing`). `observation` is what the policy sees, with the noise
        and the delays of `randomise`: no reward, success or failure may follow from it (test)."""

    def scripts(self, rows: Rows) -> Rows:
        """Which script each simulation follows, (m,)."""
        found: Rows = self.worlds.xp.zeros(len(rows), np.int64)
        return found

    def goal(self) -> NDArray[np.floating[Any]] | None:
        """What to reach, shape (n, k), for tasks with goals."""
        return None

    def achieved(self, tick: Ticks) -> Array | None:
        """What of the goal is so at that decision, shape (n, k), where the interface cannot tell it from the joints."""
        return None

    def look(self, tick: Ticks) -> None:
        """Look around at the decision `tick` (n,) periods after the beginning, once, for `achieved` and `seen`."""
        return

    def seen(self, tick: Ticks) -> Array | None:
        """What no real hand has, shape (n, extra), at the decision `tick` (n,) periods after the beginning."""
        return None

    def marks(self, row: int) -> Sequence[Mark]:
        """What should be drawn of a simulation's goal."""
        return ()

    def facts(self, rows: Rows) -> dict[str, NDArray[np.generic]]:
        """What a reset should report besides what was randomised, (m, …) each."""
        return {}

    def _interface(self, **given: object) -> Interface:
        settings = self.settings
        chosen = {} if settings.step is None else {"step": settings.step}
        common = {"mode": settings.control, "period": settings.period, "decimation": settings.decimation,
                  "history": settings.history, "xp": self.worlds.xp}  # fmt: skip
        return Interface(self.spec, self.gains, **(common | given | chosen))

    @property
    def unmeasured(self) -> int:
        """Numbers at the end of an observation that no hand reports by itself."""
        return self.extra + (self.spec.n_joints if self.settings.touch else 0)

    @property
    def id(self) -> str:
        """Of the environment, for cards."""
        kind = type(self)
        own = kind.__module__.startswith("allegro_twin.")
        return f"AllegroTwin/{self.name}-v0" if own else f"{kind.__module__}:{kind.__qualname__}"

    def card(self) -> Card:
        """What a policy that was trained here should say of itself."""
        interface, settings = self.interface, self.settings
        return Card(
            task=self.id,
            hand=self.spec.model,
            side=self.spec.side,
            mode=interface.mode,
            period=interface.period,
            decimation=interface.decimation,
            step=interface.step,
            reach=interface.reach,
            gains=settings.gains,
            goal=interface.goal,
            scripts=self.closed_scripts(),
            periods=0 if interface.scripts is None else interface.scripts.periods,
            observation=interface.n_observation + self.unmeasured,
            action=self.spec.n_joints,
            history=interface.history,
            privileged=self.unmeasured,
        )

    def closed_scripts(self) -> tuple[Closed, ...]:
        """What the scripts are made of, one each."""
        return ()
