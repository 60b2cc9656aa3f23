"""Learning: tasks, Gymnasium environments, policies and their training.

`allegro_twin.gym` has the environments, and what tasks of your own are made of.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.learning.environments.env import HandEnv
    from allegro_twin.learning.environments.vector import HandVectorEnv
    from allegro_twin.learning.policy.loading import load_policy, policy_controller
    from allegro_twin.learning.tasks.base import Task
    from allegro_twin.learning.training import train
    from allegro_twin.learning.training.evaluation import evaluate
    from allegro_twin.learning.training.report import compare_policy, film_policy, write_report
    from allegro_twin.learning.training.settings import Recipe, load_recipe

__all__ = [
    "HandEnv",
    "HandVectorEnv",
    "Recipe",
    "Task",
    "compare_policy",
    "evaluate",
    "film_policy",
    "load_policy",
    "load_recipe",
    "policy_controller",
    "train",
    "write_report",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "environments.env": ("HandEnv",),
        "environments.vector": ("HandVectorEnv",),
        "tasks.base": ("Task",),
        "policy.loading": ("load_policy", "policy_controller"),
        "training": ("train",),
        "training.settings": ("Recipe", "load_recipe"),
        "training.evaluation": ("evaluate",),
        "training.report": ("compare_policy", "film_policy", "write_report"),
    },
)
