"""Base class of tasks with an object and a scripted grasp: variants, scripts, the object's place and its variation."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import to_numpy
from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.library import load_posture
from allegro_twin.kinematics.orientation import rotate_quaternion
from allegro_twin.learning.environments.objects import ObjectChoice, object_name
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.settings import EnvSettings, Level, ResetOptions
from allegro_twin.learning.policy.card import GraspScript
from allegro_twin.learning.policy.script import SampledScript, closing_moves, closing_time, sample_script, script_table
from allegro_twin.learning.tasks.base import Flags, Task
from allegro_twin.learning.tasks.scenes import OBJECT, TaskScene, add_variant, known_scenarios, make_worlds
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.link_contacts import LinkContacts
from allegro_twin.sim.contact.contacts import penetration_depth
from allegro_twin.types import Array, Vector

_Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ObjectVariation:
    """Variation of an object, drawn at every reset unless `randomise` or an option of the reset gives it."""

    noise: float
    """Largest offset along each axis, m."""
    yaw: float = 0.0
    """Largest turn about the vertical, rad."""
    friction: _Range | None = None
    """Sliding friction of every contact."""
    mass: _Range | None = None
    """Factor on its mass."""
    size: _Range | None = None
    """Factor on its size."""
    push: float = 1.0
    """Factor on the pushes."""

    def draw(self, draws: Draws, values: dict[str, Array]) -> None:
        """Add missing quantities to `values`; the same random numbers are used up in any case."""
        for name in ("friction", "mass", "size"):
            share = draws.uniform(0.0, 1.0)[:, 0]
            found: _Range | None = getattr(self, name)
            if found is not None and name not in values:
                values[name] = found[0] + (found[1] - found[0]) * share


EASY = ObjectVariation(noise=0.010)
HARD = ObjectVariation(noise=0.020, yaw=float(np.radians(20.0)), friction=(0.4, 1.0), mass=(0.5, 2.5), size=(0.9, 1.1))


MARGIN = 0.1  # s, for the last action.
DEEPEST = 0.012
"""m. Largest depth of an object inside the pre-shaped hand at the beginning: a deeper one would be thrown out."""


class ScriptedClosingTask(Task):
    """The library's grasp closes on the object by a script; an action is added to that.

    A variant is an object with a grasp; its script has the same number.
    """

    wait: ClassVar[float] = 0.6
    """s in the pre-shape while object and hand come together."""
    squeeze: ClassVar[float] = 0.4
    """s from closed to squeezed."""
    after: ClassVar[float] = 0.0
    """s of an episode from there to its verdict."""
    levels: ClassVar[dict[Level, ObjectVariation]] = {"easy": EASY, "default": HARD}
    own_settings: ClassVar[tuple[str, ...]] = ("level", "position_noise", "reach")

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        self.variation = self.levels[settings.level]
        first = [(choice, self.make_scene(choice, None)) for choice in self.object_choices()]
        latest = max(self.verdict_time(scene) for _, scene in first)
        if latest > self.seconds:  # A slower hand: its episodes are longer.
            self.seconds = math.ceil(10.0 * (latest + MARGIN)) / 10.0
        self.periods = round(self.seconds / settings.period)
        self.scenes: list[TaskScene] = []
        self._numbers: dict[tuple[ObjectChoice, str | None], int] = {}
        self._scripts: list[SampledScript] = []
        self._named = {object_name(choice): choice for choice in self.object_choices()}
        for index, (choice, scene) in enumerate(first):
            if index == 0:
                self.worlds = make_worlds(self.spec, scene.model, n, threads, settings)
            self._add_object(scene, choice, None)
        self.object_body = self.worlds.free_body(OBJECT)
        self.contacts = LinkContacts(self.worlds, within=False)
        xp = self.worlds.xp
        self.offset = xp.zeros((n, 3))
        """Offset of each object, m, world."""
        self.script: Rows = xp.zeros(n, np.int64)
        self._upward = xp.asarray(np.array([0.0, 0.0, 1.0]))

    def object_names(self) -> tuple[str, ...]:
        return tuple(map(object_name, self.object_choices()))

    @abstractmethod
    def make_scene(self, choice: ObjectChoice, grasp: str | None) -> TaskScene:
        """Make the scene of an object."""

    def overlap(self, scene: TaskScene, size: float) -> float:
        """Penetration depth of an object of `size` times its size and the pre-shaped hand, m."""
        pose = scene.pose.copy()
        pose[:3] += self.grasp_offset(scene, size)
        return penetration_depth(scene.model, self.spec, scene.grasp.preshape, OBJECT, pose, size)

    @abstractmethod
    def grasp_offset(self, scene: TaskScene, size: float) -> Vector:
        """From the object in the scene's model to where the hand at rest in that model would grasp it, m."""

    def verdict_time(self, scene: TaskScene) -> float:
        """When an episode in a scene is decided, s."""
        return closing_time(scene.grasp, self.wait, self.squeeze) + self.after

    @abstractmethod
    def object_choices(self) -> tuple[ObjectChoice, ...]:
        """Objects to draw from."""

    def variant(self, rows: Rows, draws: Draws, options: ResetOptions) -> Rows:
        drawn = draws.integers(len(self.object_choices()))
        if options.object is None and options.grasp is None:
            return drawn
        chosen = None if options.object is None else self._named.get(options.object, options.object)
        choices = [chosen or self.object_choices()[number] for number in drawn.tolist()]
        numbers = np.array([self._variant_number(choice, options.grasp) for choice in choices], np.int64)
        found: Rows = self.worlds.xp.asarray(numbers)
        return found

    def draw_variation(
        self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions
    ) -> None:
        self.variation.draw(draws, values)

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions) -> None:
        self._check_size(variant, options)
        self.contacts.begin(rows)
        width = self.settings.position_noise if options.position_noise is None else options.position_noise
        width = self.variation.noise if width is None else width
        self.offset[rows] = draws.uniform(-width, width, 3)
        yaw = draws.uniform(-self.variation.yaw, self.variation.yaw) * self._upward
        self.script[rows] = variant
        start = self._starts[variant]
        if options.posture is not None:
            start = 0.0 * start + self.worlds.xp.asarray(load_posture(options.posture, self.spec))
        self.worlds.place(rows, start)
        assert self.object_body is not None
        self.object_body.pose[rows, :3] = self._poses[variant, :3]
        self.object_body.pose[rows, 3:] = rotate_quaternion(self._poses[variant, 3:], yaw)

    def held(self) -> Flags:
        """Who touches the object at the last physics step, (n,): without that nothing counts as held. Call once per
        decision."""
        self.contacts.add_period()
        return self.contacts.in_contact_now()

    def scripts(self, rows: Rows) -> Rows:
        return self.script[rows]

    def grasp_scripts(self) -> tuple[GraspScript, ...]:
        return tuple(GraspScript(grasp=s.grasp.name, wait=self.wait, squeeze=self.squeeze) for s in self.scenes)

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        contacts = {f"contacts/{name}": array for name, array in self.contacts.live_arrays().items()}
        return {"offset": self.offset, "script": self.script} | contacts

    def reset_info(self, rows: Rows) -> dict[str, NDArray[np.generic]]:
        scenes = [self.scenes[number] for number in self.script[rows].tolist()]
        return {
            "object": np.array([scene.object_name for scene in scenes], dtype=object),
            "grasp": np.array([scene.grasp.name for scene in scenes], dtype=object),
            "position_noise": to_numpy(self.offset[rows]),
        }

    def closing_period(self, scene: TaskScene) -> int:
        """When the script has squeezed, in control periods."""
        return round(closing_time(scene.grasp, self.wait, self.squeeze) / self.settings.period)

    def _variant_number(self, choice: ObjectChoice, grasp: str | None) -> int:
        """The variant of an object with its own grasp or another; compiled on first use."""
        if (choice, grasp) not in self._numbers:
            self.add_object(choice, grasp)
        return self._numbers[choice, grasp]

    def add_object(self, choice: ObjectChoice, grasp: str | None) -> None:
        self._add_object(self.make_scene(choice, grasp), choice, grasp)
        self.added.append((choice, grasp))

    def _add_object(self, scene: TaskScene, choice: ObjectChoice, grasp: str | None) -> None:
        end = self.verdict_time(scene)
        action = self.settings.period * self.settings.decimation
        if end > self.seconds:
            raise ConfigError(
                f"{self.name}: {scene.grasp.name} closes too slowly: its verdict would come after {end:.2f} s, and an "
                f"episode takes {self.seconds:g} s"
            )
        if end > self.seconds - action:
            raise ConfigError(
                f"{self.name}: actions of {action:g} s (decimation {self.settings.decimation}) are too long: the "
                f"verdict comes after {end:.2f} s, and the last action begins after {self.seconds - action:.2f} s"
            )
        if choice not in known_scenarios(self.spec.model):  # Those of the catalogue fit their own grasps.
            self._check_fit(scene, 1.0)
        if self.scenes:
            add_variant(self.worlds, scene.model, scene.object_name, self.scenes[0].object_name)
        self._numbers[choice, grasp] = len(self.scenes)
        self.scenes.append(scene)
        moves, period = closing_moves(scene.grasp, self.wait, self.squeeze), self.settings.period
        self._scripts.append(sample_script(moves, scene.grasp.preshape, self.periods, period))
        self.interface = self._interface(scripts=script_table(self._scripts), reach=self.settings.reach)
        place = self.worlds.xp.asarray
        self._starts = place(np.array([scene.grasp.preshape for scene in self.scenes]))
        self._poses = place(np.array([scene.pose for scene in self.scenes]))
        self.update_tables()

    def update_tables(self) -> None:
        """Update the tables that have a row per variant."""

    def _check_size(self, variant: Rows, options: ResetOptions) -> None:
        """Raise ConfigError for a chosen object that is too large for its grasp."""
        if options.size is None and options.object is None:
            return
        for number in set(variant.tolist()):
            self._check_fit(self.scenes[number], options.size or 1.0)

    def _check_fit(self, scene: TaskScene, size: float) -> None:
        """Raise ConfigError for an object of `size` times its size that is too large for its grasp."""
        depth = self.overlap(scene, size)
        if depth > DEEPEST:
            raise ConfigError(
                f"{scene.object_name} at {size:g} times its size is too large for {scene.grasp.name}: it would begin "
                f"{depth * 1000:.0f} mm inside the hand; at most {DEEPEST * 1000:.0f} mm can be"
            )
