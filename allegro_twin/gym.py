"""Gymnasium environments of the hand: `import allegro_twin.gym`, then `gymnasium.make("AllegroTwin/Lift-v0")`."""

from __future__ import annotations

import gymnasium

from allegro_twin.learning.tasks import TASKS

NAMESPACE, VERSION = "AllegroTwin", 0
SIDES = {"": "right", "Right": "right", "Left": "left"}
"""What follows the task in an id. An id without a side is of the right hand, or of the keyword `side`."""


PICK = f"{NAMESPACE}/ArmPick-v{VERSION}"
"""An arm, a hand and an object, one environment at a time (docs/rl.md#armpick); its class is in `allegro_twin.cell`."""


def ids() -> dict[str, tuple[str, str]]:
    """All ids, with task and side."""
    return {f"{NAMESPACE}/{task}{suffix}-v{VERSION}": (task, side) for task in TASKS for suffix, side in SIDES.items()}


for _id, (_task, _side) in ids().items():
    _named = _side.capitalize() in _id  # The id says the side, not a keyword.
    gymnasium.register(
        _id,
        entry_point="allegro_twin.learning.environments.env:HandEnv",
        vector_entry_point="allegro_twin.learning.environments.vector:HandVectorEnv",
        kwargs={"task": _task} | ({"of_side": _side} if _named else {}),
    )
gymnasium.register(PICK, entry_point="allegro_twin.cell.pick.env:ArmPick")
