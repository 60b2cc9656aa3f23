"""Pinch task: take a small presented object between two or three fingertips, and hold it through a push."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.entries import HAND
from allegro_twin.learning.environments.objects import ObjectChoice, object_name
from allegro_twin.learning.environments.settings import Level
from allegro_twin.learning.tasks.grasp import GraspTask
from allegro_twin.learning.tasks.scenes import GIVE_OBJECTS, TaskScene, presented_scene
from allegro_twin.learning.tasks.scripted_closing import EASY, HARD, ObjectVariation

# Scenario of the taxonomy for each: where the palm goes, and the grasp.
_SCENARIOS = {"ball_30": "inferior_pincer", "golf_ball": "golf_ball"}


class PinchTask(GraspTask):
    """The Grasp task with small balls and the library's pinches."""

    name = "Pinch"
    purpose = "pinch a small presented object with the fingertips and hold it through a push"
    levels: ClassVar[dict[Level, ObjectVariation]] = {
        "easy": replace(EASY, noise=0.005),
        "default": replace(HARD, noise=0.013),
    }

    def object_choices(self) -> tuple[ObjectChoice, ...]:
        if self.settings.objects is None and self.spec.model != HAND:
            raise ConfigError(f"Pinch: the library has no pinches of small balls with {self.spec.model}: "
                              f"{GIVE_OBJECTS}, or take the task Grasp")  # fmt: skip
        return self.settings.objects or tuple(_SCENARIOS)

    def make_scene(self, choice: ObjectChoice, grasp: str | None) -> TaskScene:
        scenario = _SCENARIOS.get(object_name(choice)) if self.spec.model == HAND else None
        return presented_scene(choice, self.spec, self.settings, grasp, scenario)
