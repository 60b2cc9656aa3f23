"""Base class of tasks: scene, script, goal, reward and success, written for a whole batch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.learning.environments.objects import ObjectChoice, object_name
from allegro_twin.learning.environments.posterior import load_posterior
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.randomise import check_randomise
from allegro_twin.learning.environments.settings import TASK_SETTINGS, EnvSettings, ResetOptions
from allegro_twin.learning.policy.card import GraspScript, PolicyCard
from allegro_twin.learning.policy.interface import Interface, Observation
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.shared_model import FreeBody, SharedModelBatch
from allegro_twin.types import Array
from allegro_twin.viewing.overlays import Mark

Flags = NDArray[np.bool_]
Ticks = NDArray[np.int64]
_OF_EVERY_TASK = ("settings", "n", "added", "posterior", "spec", "gains", "interface", "worlds")
"""What follows from the settings and the options of resets."""


class StepOutcome(NamedTuple):
    """Outcome of a step, one value per simulation, shape (n,)."""

    reward: Array
    failed: Flags
    """The episode cannot succeed any more, and ends."""
    success: Flags
    terms: dict[str, Array]
    """Terms of the reward, and further values to report."""


@runtime_checkable
class GoalTask(Protocol):
    """A task with goals."""

    def reward(self, achieved: ArrayLike, desired: ArrayLike, dropped: Array, held: ArrayLike = 1.0) -> Array:
        """Reward for goals (..., k) from any source; `dropped` (...): cost of the loss of an object; `held` (...): 1
        where the object, if there is one, is held, or 0. A step uses the true goal state. A policy sees it only with
        noise and delay."""
        ...


class Task(ABC):
    """`n` episodes of one task."""

    name: ClassVar[str]
    purpose: ClassVar[str]
    """One line for lists."""
    seconds: float
    """Duration of an episode."""
    options: ClassVar[tuple[str, ...]]
    """Names of the `ResetOptions` that a reset takes."""
    own_settings: ClassVar[tuple[str, ...]] = ()
    """Names of the TASK_SETTINGS that this task has."""
    n_privileged: int = 0
    """Numbers in an observation that no real hand has. A task with any is privileged."""
    settings: EnvSettings
    interface: Interface
    worlds: SharedModelBatch
    count_term: ClassVar[str] = ""
    """Term of the outcome that an evaluation reports besides success, where outcomes have it; its unit is
    `count_unit`."""
    count_unit: ClassVar[str] = ""
    count_digits: ClassVar[int] = 2
    """After the point, where that term is printed; 0 for whole numbers."""
    reward_terms: ClassVar[dict[str, float]] = {}
    """Terms of the outcome and their factors in the reward, which settings may change (`EnvSettings.reward`). None for
    a task with goals, whose reward anybody can compute from a state and a goal."""
    share_terms: ClassVar[tuple[str, ...]] = ()
    """Terms of the outcome that are shares of the episode's time so far, from 0 to 1. An evaluation reports those that
    outcomes have."""
    goal_is_orientation: ClassVar[bool] = False
    """Goals are orientations, quaternions w, x, y, z."""
    farthest: float = 0.0
    """Largest distance of new goals, rad, where a task has such."""
    object_body: FreeBody | None = None
    """The object, where there is one."""

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        self.settings, self.n = settings, n
        self.added: list[tuple[ObjectChoice, str | None]] = []
        """Objects, each with a grasp or None, that the options of resets have added."""
        for name in TASK_SETTINGS:
            if name in settings.model_fields_set and name not in self.own_settings:
                raise ConfigError(f"{self.name} has no {name} to choose")
        names = [object_name(choice) for choice in settings.objects or ()]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ConfigError(f"objects has {twice[0]} twice: leave one out, or give each a name of its own")
        if settings.reward and not self.reward_terms:
            raise ConfigError(f"{self.name} has no terms of the reward to weigh: leave reward out")
        for term in settings.reward:
            if term not in self.reward_terms:
                raise ConfigError(unknown(f"term of {self.name}'s reward", term, self.reward_terms))
        if isinstance(self.seconds, bool) or not isinstance(self.seconds, int | float):
            raise ConfigError(f"{self.name}.seconds must be a number, not {self.seconds!r}")
        action = settings.period * settings.decimation
        if action > self.seconds / 2:
            raise ConfigError(
                f"an action of {settings.decimation} periods of {settings.period:g} s takes {action:g} s, and an "
                f"episode of {self.name} {self.seconds:g} s: choose a smaller decimation or period"
            )
        twin = settings.randomise.twin
        self.posterior = None if twin is None else load_posterior(twin, settings.hand, settings.side)
        """What is known of one hand's drive, where episodes draw from it."""
        self.spec = load_spec(settings.hand, settings.side) if self.posterior is None else self.posterior.spec
        self.spec.check_step(settings.timestep, "timestep")
        check_randomise(settings.randomise, self.spec)
        self.gains = load_gains(settings.gains, self.spec)

    @abstractmethod
    def variant(self, rows: Rows, draws: Draws, options: ResetOptions) -> Rows:
        """Variant of the batch's models for each new episode, (m,)."""

    @abstractmethod
    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions) -> None:
        """Set up new episodes of simulations that have their variant and their randomised `values`, (m,) each."""

    def add_object(self, choice: ObjectChoice, grasp: str | None) -> None:
        """Add an object that an option of a reset names. Raises ConfigError."""
        raise ConfigError(f"{self.name} has no objects to choose")

    def object_names(self) -> tuple[str, ...]:
        """Names of the objects that episodes draw from; a task that has some by default overrides this."""
        return tuple(map(object_name, self.settings.objects or ()))

    def draw_variation(
        self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions
    ) -> None:
        """Add to `values` the randomised quantities that the task itself draws, where they are missing."""
        return

    def initial_targets(self, rows: Rows) -> Array | None:
        """Initial set-points of the fingers, (m, joints), rad; None: where they are."""
        return None

    def plan_surroundings(self, tick: Ticks) -> None:
        """Prepare the surroundings of the hands for the step that begins `tick` (n,) periods after the beginning."""
        return

    def move_surroundings(self, k: int) -> None:
        """Move the surroundings of the hands for the k-th control period of that step."""
        return

    @abstractmethod
    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> StepOutcome:
        """Outcome of the step that ended at `tick`. `action`: as it was taken, shape (n, joints).

        It follows from the simulation's own state (`worlds`, `object_body`). `observation` is what the policy sees,
        with noise and delays of `randomise`: reward, success and failure must not depend on it (test).
        """

    def scripts(self, rows: Rows) -> Rows:
        """Number of each simulation's script, (m,)."""
        found: Rows = self.worlds.xp.zeros(len(rows), np.int64)
        return found

    def goal(self) -> NDArray[np.floating[Any]] | None:
        """Goals, shape (n, k), for tasks with goals."""
        return None

    def set_goal(self, row: int, goal: Array | None) -> None:
        """Give a simulation another goal, (k,), between two periods; None: the task's own next one. It is judged and
        counted as any other. Raises ConfigError for a task that takes none."""
        raise ConfigError(f"{self.name} takes no goal from outside; Reorient and Reach do")

    def describe_outcome(self, terms: Mapping[str, float], success: bool) -> str:
        """What an episode has come to, from the `terms` of its last step, as text; empty where a task counts
        nothing."""
        counted = terms.get(self.count_term)
        return "" if counted is None else f"{counted:.{self.count_digits}f} {self.count_unit}"

    def achieved(self, tick: Ticks) -> Array | None:
        """State to compare with the goal at that decision, shape (n, k), where the interface cannot compute it from the
        joints."""
        return None

    def look(self, tick: Ticks) -> None:
        """Observe the surroundings at the decision `tick` (n,) periods after the beginning, once, for `achieved` and
        `privileged_observation`."""
        return

    def privileged_observation(self, tick: Ticks) -> Array | None:
        """What no real hand has, shape (n, n_privileged), at the decision `tick` (n,) periods after the beginning."""
        return None

    def marks(self, row: int) -> Sequence[Mark]:
        """Marks that show a simulation's goal in pictures."""
        return ()

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays of a task of this package that decide how the episodes go on, by name, with a row for each simulation,
        live: states copy them and write into them. What the simulation itself holds is not among them."""
        return {}

    def save_memory(self) -> dict[str, Any]:
        """What a task of your own keeps between steps, by name: all of its attributes. Whoever keeps what no state can
        have, such as an object of another library, returns instead numbers, strings, arrays and containers of these,
        from which `restore_memory` makes it anew."""
        if type(self).__module__.startswith("allegro_twin."):
            return {}  # Its arrays are live, and the rest never changes.
        return {name: value for name, value in vars(self).items() if name not in _OF_EVERY_TASK}

    def restore_memory(self, memory: dict[str, Any]) -> None:
        """Go on with what `save_memory` has returned, in a task of the same settings; where all simulations of a plan
        go on from one episode, arrays with a row for it have a row for each."""
        for name in self.save_memory().keys() - memory.keys():
            delattr(self, name)
        vars(self).update(memory)

    def reset_info(self, rows: Rows) -> dict[str, NDArray[np.generic]]:
        """What a reset reports besides randomised values, (m, …) each."""
        return {}

    def _interface(self, **given: object) -> Interface:
        settings = self.settings
        chosen = {} if settings.step is None else {"step": settings.step}
        common = {"mode": settings.control, "period": settings.period, "decimation": settings.decimation,
                  "history": settings.history, "xp": self.worlds.xp}  # fmt: skip
        return Interface(self.spec, self.gains, **(common | given | chosen))

    @property
    def n_unmeasured(self) -> int:
        """Numbers at the end of an observation that no hand reports by itself."""
        return self.n_privileged + (self.spec.n_joints if self.settings.touch else 0)

    @property
    def id(self) -> str:
        """Id of the environment, for cards."""
        return task_id(type(self))

    def card(self) -> PolicyCard:
        """The card of a policy that was trained in this task."""
        interface, settings = self.interface, self.settings
        return PolicyCard(
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
            scripts=self.grasp_scripts(),
            periods=0 if interface.scripts is None else interface.scripts.periods,
            observation=interface.n_observation + self.n_unmeasured,
            action=self.spec.n_joints,
            history=interface.history,
            privileged=self.n_unmeasured,
            environment=settings.model_dump(mode="json", exclude_unset=True),
        )

    def grasp_scripts(self) -> tuple[GraspScript, ...]:
        """Descriptions of the scripts, one each."""
        return ()


def task_id(kind: type[Task]) -> str:
    """Id of a task's environment, for cards."""
    own = kind.__module__.startswith("allegro_twin.")
    return f"AllegroTwin/{kind.name}-v0" if own else f"{kind.__module__}:{kind.__qualname__}"


def task_named(id: str) -> str:
    """Name of a task, as recipes have it, of the environment's id in a card."""
    own = id.removeprefix("AllegroTwin/")
    return id if own == id else own.removesuffix("-v0")
