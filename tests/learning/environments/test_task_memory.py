"""A state has all that a user's task keeps, or names what it cannot have."""

from __future__ import annotations

import itertools
import pickle
from collections import defaultdict, deque
from enum import Enum
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.snapshot import EpisodeState, spread_snapshot
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.tasks.base import StepOutcome
from allegro_twin.learning.tasks.lift import LiftTask
from allegro_twin.learning.tasks.reach import ReachTask
from allegro_twin.learning.tasks.rotate import RotateTask
from allegro_twin.sim.batch.link_contacts import LinkContacts


class Phase(Enum):
    NEAR = "near"
    FAR = "far"


class Last(NamedTuple):
    step: int
    position: Any


class Filter:
    """An object of a task's own."""

    def __init__(self, n: int) -> None:
        self.n, self.total = 0, np.zeros(n)


class Remembering(ReachTask):
    """Keeps everything that a task may keep, and shows it in its terms."""

    name = "Remembering"
    constant: ClassVar[Any] = itertools.count()  # Of the class: no state has it.

    def begin(self, rows: Any, *given: Any) -> None:
        super().begin(rows, *given)
        if len(rows) < self.n:
            return
        self.steps, self.word, self.phase = np.int64(0), "one", Phase.NEAR
        self.window: deque[Any] = deque(maxlen=3)
        self.seen, self.counts, self.numbers = set[int](), {"even": 0}, list[int]()
        self.table, self.fixed, self.z = np.zeros(7), np.array(["none"]), 1j
        self.last, self.filter = Last(0, np.zeros((self.n, 16))), Filter(self.n)
        self.rng = np.random.default_rng(0)
        self.same = self.numbers

    def outcome(self, *given: Any) -> StepOutcome:
        found = super().outcome(*given)
        position = self.worlds.position
        self.steps += np.int64(1)
        step = int(self.steps)
        self.word += "a"
        self.phase = Phase.FAR if step > 4 else Phase.NEAR
        self.window.append(position[:, 0].copy())
        self.seen.add(step % 5)
        self.counts["even"] += step % 2
        self.counts[f"step {step % 3}"] = step
        self.numbers.append(step)
        self.table[step % 7] += 1.0
        self.fixed = np.array([f"{step}"])
        self.fixed.flags.writeable = False
        self.z *= 1j
        self.last = Last(step, position.copy())
        self.filter.n += 1
        self.filter.total += position[:, 1]
        self.later = (step, "since the first step")
        one = np.ones(self.n)
        own = {
            "phase": one * (self.phase is Phase.FAR), "word": one * len(self.word), "window": sum(self.window),
            "seen": one * sum(self.seen), "counts": one * sum(self.counts.values()), "numbers": one * sum(self.numbers),
            "table": one * (self.table * np.arange(7)).sum(), "fixed": one * float(self.fixed[0]),
            "z": one * self.z.real,
            "last": one * self.last.step + self.last.position[:, 2], "filter": self.filter.total / self.filter.n,
            "rng": one * self.rng.random(), "same": one * len(self.same), "later": one * self.later[0],
        }  # fmt: skip
        return found._replace(terms=found.terms | own)


TASK = f"{__name__}:Remembering"


def terms(env: Any, steps: int) -> list[dict[str, Any]]:
    action = np.full(env.action_space.shape, 0.3, np.float32)
    return [env.step(action)[4] for _ in range(steps)]


def repeated(env: HandEnv) -> tuple[EpisodeState, list[dict[str, Any]]]:
    """A state of an episode, and the terms of the five steps after it, which come again once it is restored."""
    env.reset(seed=1)
    terms(env, 3)
    state = env.save_state()
    first = terms(env, 5)
    env.restore_state(state)
    assert terms(env, 5) == first
    return state, first


def test_a_single_environment_goes_on_with_the_memory_of_its_task() -> None:
    env = HandEnv(TASK, timestep=0.003)
    state, first = repeated(env)
    new = HandEnv(TASK, timestep=0.003)
    new.restore_state(pickle.loads(pickle.dumps(state)))
    assert terms(new, 5) == first
    assert new.engine.task.same is new.engine.task.numbers  # type: ignore[attr-defined]


def test_a_vector_environment_goes_on_with_the_memory_of_its_task() -> None:
    envs = HandVectorEnv(TASK, 3, timestep=0.003)
    envs.reset(seed=1)
    terms(envs, 3)
    state = envs.save_state()
    first = terms(envs, 5)
    new = HandVectorEnv(TASK, 3, timestep=0.003)
    new.restore_state(pickle.loads(pickle.dumps(state)))
    for one, other in zip(first, terms(new, 5), strict=True):
        for name, value in one.items():
            np.testing.assert_array_equal(value, other[name], err_msg=name)


def test_all_simulations_of_a_plan_go_on_with_the_memory_of_the_task() -> None:
    env, batch = HandEnv(TASK, timestep=0.003), HandVectorEnv(TASK, 4, timestep=0.003, autoreset_mode="disabled")
    env.reset(seed=1)
    batch.reset(seed=9)
    terms(env, 3)
    state = env.save_state()
    first = terms(env, 3)
    for _ in range(2):  # A plan follows a plan.
        spread_snapshot(batch, state.parts)
        for one, many in zip(first, terms(batch, 3), strict=True):
            for name, value in one.items():
                np.testing.assert_array_equal(many[name], [value] * 4, err_msg=name)


class Strange(ReachTask):
    name = "Strange"

    def begin(self, *given: Any) -> None:
        super().begin(*given)
        self.parts = {"at": [itertools.count()]}


def test_what_no_state_can_have_is_named() -> None:
    env = HandEnv(f"{__name__}:Strange", timestep=0.003)
    env.reset(seed=1)
    with pytest.raises(
        ConfigError, match=r"Strange keeps a itertools\.count in parts/at/0, which no state can have: k"
    ):
        env.save_state()


class Counting:
    """Keeps what it makes with its first step, and things of the package."""

    def begin(self, rows: Any, variant: Any, draws: Any, *given: Any) -> None:
        super().begin(rows, variant, draws, *given)  # type: ignore[misc]
        self.draws = draws

    def outcome(self, *given: Any) -> StepOutcome:
        found: StepOutcome = super().outcome(*given)  # type: ignore[misc]  # Of the task beside it.
        task: Any = self
        if not hasattr(task, "own"):
            task.own, task.by_number, task.more = Filter(task.n), defaultdict(int), LinkContacts(task.worlds)
        task.own.n += 1
        task.own.total += task.worlds.position[:, 0]
        task.by_number[task.own.n % 2] += task.own.n
        task.more.sums[:, 0] += 1.0
        task.shares = found
        task.owner = task.own
        own = {"mean": task.own.total / task.own.n, "drawn": self.draws.uniform(0.0, 1.0)[:, 0],
               "even": 0.0 * found.reward + task.by_number[0],
               "sums": task.more.sums[:, 0].copy()}  # fmt: skip
        return found._replace(terms=found.terms | own)


class CountingLift(Counting, LiftTask):
    name = "CountingLift"


class CountingRotate(Counting, RotateTask):
    name = "CountingRotate"


@pytest.mark.parametrize("task", ["CountingLift", "CountingRotate"])
def test_a_task_with_an_object_goes_on_with_its_memory(task: str) -> None:
    given: dict[str, Any] = {"task": f"{__name__}:{task}", "timestep": 0.003, "randomise": "default"}
    env, other = HandEnv(**given), HandEnv(**given)
    state, first = repeated(env)
    other.reset(seed=2)
    terms(other, 4)
    other.restore_state(pickle.loads(pickle.dumps(state)))
    assert terms(other, 5) == first
    assert other.engine.task.owner is other.engine.task.own  # type: ignore[attr-defined]
    batch = HandVectorEnv(**given, num_envs=3, autoreset_mode="disabled")
    batch.reset(seed=9)
    terms(batch, 1)
    spread_snapshot(batch, state.parts)
    for one, many in zip(first, terms(batch, 5), strict=True):
        for name, value in one.items():
            np.testing.assert_array_equal(many[name], [value] * 3, err_msg=name)


def test_an_object_that_the_first_step_makes_is_made_where_there_is_none() -> None:
    task = f"{__name__}:Late"
    env, new = HandEnv(task, timestep=0.003), HandEnv(task, timestep=0.003)
    env.reset(seed=1)
    terms(env, 3)
    state = env.save_state()
    first = terms(env, 2)
    new.restore_state(state)
    assert terms(new, 2) == first


class Late(ReachTask):
    name = "Late"

    def outcome(self, *given: Any) -> StepOutcome:
        found = super().outcome(*given)
        self.late = getattr(self, "late", None) or Filter(self.n)
        self.late.n += 1
        return found._replace(terms=found.terms | {"late": 0.0 * found.reward + self.late.n})


class Saving(ReachTask):
    """Keeps what no state can have, and says how it is saved."""

    name = "Saving"

    def begin(self, *given: Any) -> None:
        super().begin(*given)
        self.next, self.told = itertools.count(), 0

    def outcome(self, *given: Any) -> StepOutcome:
        found = super().outcome(*given)
        self.told = next(self.next)
        return found._replace(terms=found.terms | {"told": 0.0 * found.reward + self.told})

    def save_memory(self) -> dict[str, Any]:
        return {"told": self.told}

    def restore_memory(self, memory: dict[str, Any]) -> None:
        self.next = itertools.count(memory["told"] + 1)


def test_a_task_says_itself_how_what_no_state_can_have_is_saved() -> None:
    env, batch = HandEnv(f"{__name__}:Saving", timestep=0.003), HandVectorEnv(f"{__name__}:Saving", 3, timestep=0.003)
    env.reset(seed=1)
    batch.reset(seed=1)
    terms(env, 3)
    state = env.save_state()
    first = terms(env, 2)
    assert [each["told"] for each in first] == [3, 4]
    env.restore_state(state)
    assert terms(env, 2) == first
    spread_snapshot(batch, state.parts)
    assert [each["told"].tolist() for each in terms(batch, 2)] == [[3.0] * 3, [4.0] * 3]


def test_a_state_without_the_memory_of_a_task_is_refused() -> None:
    env = HandEnv(f"{__name__}:Saving", timestep=0.003)
    env.reset(seed=1)
    state = env.save_state()
    with pytest.raises(ConfigError, match="the state and these environments differ in what the task keeps"):
        env.restore_state(state._replace(parts={k: v for k, v in state.parts.items() if k != "task memory"}))
