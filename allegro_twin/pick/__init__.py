"""A task of an arm with a hand, take an object off a table: environment, script, and a training that imitates it.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.pick.card import load_pick_policy
    from allegro_twin.pick.env import ArmPick
    from allegro_twin.pick.recipe import PickRecipe, load_pick_recipe
    from allegro_twin.pick.scripted_policy import ScriptedPick
    from allegro_twin.pick.training import train_pick

__all__ = [
    "ArmPick",
    "PickRecipe",
    "ScriptedPick",
    "load_pick_policy",
    "load_pick_recipe",
    "train_pick",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "card": ("load_pick_policy",),
        "env": ("ArmPick",),
        "training": ("train_pick",),
        "recipe": ("PickRecipe", "load_pick_recipe"),
        "scripted_policy": ("ScriptedPick",),
    },
)
