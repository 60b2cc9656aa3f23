"""Gymnasium environments of the hand: `import allegro_twin.gym`, then `gymnasium.make("AllegroTwin/Lift-v0")`.

Its names are the environments' classes, and what tasks of your own are made of (docs/how-to/add_a_task.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import gymnasium

from allegro_twin._lazy import exports
from allegro_twin.learning.tasks import TASKS

if TYPE_CHECKING:
    from allegro_twin.learning.environments.env import HandEnv
    from allegro_twin.learning.environments.random_streams import jitter
    from allegro_twin.learning.environments.settings import EnvSettings
    from allegro_twin.learning.environments.tensors import TensorVectorEnv
    from allegro_twin.learning.environments.vector import HandVectorEnv
    from allegro_twin.learning.tasks.base import StepOutcome, Task
    from allegro_twin.learning.tasks.grasp import GraspTask
    from allegro_twin.learning.tasks.in_hand import InHandTask
    from allegro_twin.learning.tasks.lift import LiftTask
    from allegro_twin.learning.tasks.vectors import effort_cost, tilt

__all__ = [
    "EnvSettings",
    "GraspTask",
    "HandEnv",
    "HandVectorEnv",
    "InHandTask",
    "LiftTask",
    "StepOutcome",
    "Task",
    "TensorVectorEnv",
    "effort_cost",
    "jitter",
    "tilt",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "environments.env": ("HandEnv",),
        "environments.vector": ("HandVectorEnv",),
        "environments.tensors": ("TensorVectorEnv",),
        "environments.settings": ("EnvSettings",),
        "environments.random_streams": ("jitter",),
        "tasks.base": ("StepOutcome", "Task"),
        "tasks.in_hand": ("InHandTask",),
        "tasks.grasp": ("GraspTask",),
        "tasks.lift": ("LiftTask",),
        "tasks.vectors": ("effort_cost", "tilt"),
    },
    root="allegro_twin.learning",
)

NAMESPACE, VERSION = "AllegroTwin", 0
SIDES = {"": "right", "Right": "right", "Left": "left"}
"""What follows the task in an id. An id without a side is of the right hand, or of the keyword `side`."""


PICK = f"{NAMESPACE}/ArmPick-v{VERSION}"
"""An arm, a hand and an object, one environment at a time (docs/reference/environments.md#armpick); its class is in
`allegro_twin.cell`."""


def ids() -> dict[str, tuple[str, str]]:
    """All ids, with task and side."""
    return {f"{NAMESPACE}/{task}{suffix}-v{VERSION}": (task, side) for task in TASKS for suffix, side in SIDES.items()}


for _id, (_task, _side) in ids().items():
    _named = _side.capitalize() in _id  # The id says the side, not a keyword.
    gymnasium.register(
        _id,
        entry_point="allegro_twin.gym:HandEnv",
        vector_entry_point="allegro_twin.gym:HandVectorEnv",
        order_enforce=False,  # An environment does it itself, and one that is restored needs no reset.
        kwargs={"task": _task} | ({"of_side": _side} if _named else {}),
    )
gymnasium.register(PICK, entry_point="allegro_twin.pick.env:ArmPick")
