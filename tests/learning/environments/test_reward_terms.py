"""A reward is the sum of its terms, and settings weigh them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.interface import Observation
from allegro_twin.learning.tasks import TASKS, task_type
from allegro_twin.learning.tasks.base import StepOutcome, Ticks
from allegro_twin.learning.tasks.rotate import RotateTask
from allegro_twin.types import Array

N = 4
FEW = {"HoldDisturbed": ("tennis_ball",), "Grasp": ("tennis_ball",), "Lift": ("foam_brick",)}
WEIGHED = sorted(name for name in TASKS if task_type(name).reward_terms)


def steps(task: str, **more: Any) -> list[tuple[np.ndarray[Any, Any], dict[str, Any]]]:
    """Rewards and infos of some steps, in which things move and are dropped."""
    env = HandVectorEnv(task, N, autoreset_mode="disabled", timestep=0.003, objects=FEW.get(task), **more)
    env.reset(seed=3)
    rng, found = np.random.default_rng(0), []
    for step in range(24):
        if step == 20:
            thing = env.engine.task.object_body
            assert thing is not None
            thing.pose[0, 2] += 0.2
        _, reward, _, _, info = env.step(rng.uniform(-1.0, 1.0, (N, 16)).astype(np.float32))
        found.append((reward, info))
    return found


def test_every_task_without_goals_has_terms() -> None:
    assert {*TASKS} - {*WEIGHED} == {"Reach", "Reorient"}


@pytest.mark.parametrize("task", WEIGHED)
def test_a_reward_is_the_sum_of_its_terms_each_times_its_factor(task: str) -> None:
    own = task_type(task).reward_terms
    factors = dict(zip(own, (0.25, 3.0, 0.0, 2.0, 0.5, 7.0, 1.0), strict=False))
    differ = False
    for (plain, info), (weighed, other) in zip(steps(task), steps(task, reward=factors), strict=True):
        for name in own:
            np.testing.assert_array_equal(info[name], other[name])
        for reward, by in ((plain, own), (weighed, factors)):
            np.testing.assert_allclose(reward, sum(by[name] * info[name] for name in own), atol=1e-12)
        differ |= bool((plain != weighed).any())
    assert differ


def test_a_term_that_the_reward_does_not_have_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"Rotate.*droped.*dropped"):
        HandEnv("Rotate", reward={"droped": 0.5})
    with pytest.raises(ConfigError, match="turned"):  # A value that is reported, and no part of the sum.
        HandEnv("Rotate", reward={"turned": 0.5})


@pytest.mark.parametrize("task", ["Reach", "Reorient"])
def test_the_reward_of_a_task_with_goals_stays_what_compute_reward_says(task: str) -> None:
    with pytest.raises(ConfigError, match=f"{task} has no terms of the reward"):
        HandEnv(task, reward={"dropped": 0.5})


class Bare(RotateTask):
    name = "Bare"

    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> StepOutcome:
        return super().outcome(tick, action, observation)._replace(terms={"slide": np.zeros(self.n)})


def test_a_task_that_inherits_names_of_terms_which_it_does_not_report_is_told_so() -> None:
    env = HandEnv(f"{__name__}:Bare", timestep=0.003, reward={"speed": 2.0})
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="Bare reports no speed to weigh: name its own terms in reward_terms"):
        env.step(np.zeros(16, np.float32))


def test_a_factor_is_not_negative() -> None:
    with pytest.raises(ConfigError, match="dropped"):
        HandEnv("Rotate", reward={"dropped": -1.0})
