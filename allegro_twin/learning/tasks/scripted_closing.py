"""What tasks with an object and a scripted closing share: variants, scripts, the object's place and its noise."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import to_numpy
from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.library import load_posture
from allegro_twin.kinematics.orientation import rotate_quaternion
from allegro_twin.learning.environments.objects import Given, name_of
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.settings import EnvSettings, Level, Options
from allegro_twin.learning.policy.card import Closed
from allegro_twin.learning.policy.script import Script, closed_after, closing, sampled, table
from allegro_twin.learning.tasks.base import Task
from allegro_twin.learning.tasks.scenes import THING, Scene, worlds
from allegro_twin.sim.batch.worlds import Rows
from allegro_twin.sim.contact.overlap import overlap
from allegro_twin.types import Array, Vector

_Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Variation:
    """What is drawn of an object at every reset, unless `randomise` or an option of the reset says it."""

    noise: float
    """It is off by up to so much along each axis, m."""
    yaw: float = 0.0
    """It is turned about the vertical by up to so much, rad."""
    friction: _Range | None = None
    """Sliding friction of every contact."""
    mass: _Range | None = None
    """Factor on its mass."""
    size: _Range | None = None
    """Factor on its size."""
    push: float = 1.0
    """Factor on the pushes."""

    def draw(self, draws: Draws, values: dict[str, Array]) -> None:
        """Put what nobody has drawn into `values`; the same numbers are used up whatever is missing."""
        for name in ("friction", "mass", "size"):
            share = draws.within(0.0, 1.0)[:, 0]
            found: _Range | None = getattr(self, name)
            if found is not None and name not in values:
                values[name] = found[0] + (found[1] - found[0]) * share


EASY = Variation(noise=0.010)
HARD = Variation(noise=0.020, yaw=float(np.radians(20.0)), friction=(0.4, 1.0), mass=(0.5, 2.5), size=(0.9, 1.1))


MARGIN = 0.1  # s, for the last action.
DEEPEST = 0.012  # m. How far an object may begin inside the pre-shaped hand: more would be thrown out, not grasped.


class Closing(Task):
    """The library's grasp closes on the object as the scripted player does it; an action is added to that.

    A variant is an object with a grasp; its script has the same number.
    """

    wait: ClassVar[float] = 0.6
    """s in the pre-shape while object and hand come together."""
    squeeze: ClassVar[float] = 0.4
    """s from closed to squeezed."""
    after: ClassVar[float] = 0.0
    """s that an episode needs from there to its verdict."""
    levels: ClassVar[dict[Level, Variation]] = {"easy": EASY, "default": HARD}
    own: ClassVar[tuple[str, ...]] = ("level",)

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        self.variation = self.levels[settings.level]
        first = [(given, self.scene(given, None)) for given in self.things()]
        latest = max(self.verdict(scene) for _, scene in first)
        if latest > self.seconds:  # A slower hand: its episodes are longer.
            self.seconds = math.ceil(10.0 * (latest + MARGIN)) / 10.0
        self.periods = round(self.seconds / settings.period)
        self.scenes: list[Scene] = []
        self._numbers: dict[tuple[Given, str | None], int] = {}
        self._scripts: list[Script] = []
        self._named = {name_of(given): given for given in self.things()}
        for index, (given, scene) in enumerate(first):
            if index == 0:
                self.worlds = worlds(self.spec, scene.model, n, threads, settings)
            self._learn(scene, given, None)
        self.thing = self.worlds.free(THING)
        xp = self.worlds.xp
        self.offset = xp.zeros((n, 3))
        """By how much each object is off, m, world."""
        self.script: Rows = xp.zeros(n, np.int64)
        self._upward = xp.asarray(np.array([0.0, 0.0, 1.0]))

    @abstractmethod
    def scene(self, given: Given, grasp: str | None) -> Scene:
        """The scene of an object."""

    def overlap(self, scene: Scene, size: float) -> float:
        """How deep an object of `size` times its size is in the hand that is about to close on it, m."""
        met = scene.pose.copy()
        met[:3] += self.apart(scene, size)
        return overlap(scene.model, self.spec, scene.grasp.preshape, THING, met, size)

    @abstractmethod
    def apart(self, scene: Scene, size: float) -> Vector:
        """From where the scene's model has the object to where the hand at rest in that model would grasp it, m."""

    def verdict(self, scene: Scene) -> float:
        """When an episode in a scene is decided, s."""
        return closed_after(scene.grasp, self.wait, self.squeeze) + self.after

    @abstractmethod
    def things(self) -> tuple[Given, ...]:
        """The objects that are drawn from."""

    def variant(self, rows: Rows, draws: Draws, options: Options) -> Rows:
        drawn = draws.number(len(self.things()))
        if options.object is None and options.grasp is None:
            return drawn
        chosen = None if options.object is None else self._named.get(options.object, options.object)
        things = [chosen or self.things()[number] for number in drawn.tolist()]
        numbers = np.array([self._number(given, options.grasp) for given in things], np.int64)
        found: Rows = self.worlds.xp.asarray(numbers)
        return found

    def vary(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: Options) -> None:
        self.variation.draw(draws, values)

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: Options) -> None:
        self._fitting(variant, options)
        width = self.settings.position_noise if options.position_noise is None else options.position_noise
        width = self.variation.noise if width is None else width
        self.offset[rows] = draws.within(-width, width, 3)
        yaw = draws.within(-self.variation.yaw, self.variation.yaw) * self._upward
        self.script[rows] = variant
        start = self._starts[variant]
        if options.posture is not None:
            start = 0.0 * start + self.worlds.xp.asarray(load_posture(options.posture, self.spec))
        self.worlds.place(rows, start)
        assert self.thing is not None
        self.thing.pose[rows, :3] = self._poses[variant, :3]
        self.thing.pose[rows, 3:] = rotate_quaternion(self._poses[variant, 3:], yaw)

    def scripts(self, rows: Rows) -> Rows:
        return self.script[rows]

    def closed_scripts(self) -> tuple[Closed, ...]:
        return tuple(Closed(grasp=s.grasp.name, wait=self.wait, squeeze=self.squeeze) for s in self.scenes)

    def facts(self, rows: Rows) -> dict[str, NDArray[np.generic]]:
        scenes = [self.scenes[number] for number in self.script[rows].tolist()]
        return {
            "object": np.array([scene.thing for scene in scenes], dtype=object),
            "grasp": np.array([scene.grasp.name for scene in scenes], dtype=object),
            "position_noise": to_numpy(self.offset[rows]),
        }

    def closed(self, scene: Scene) -> int:
        """When the scripted player has squeezed, in control periods."""
        return round(closed_after(scene.grasp, self.wait, self.squeeze) / self.settings.period)

    def _number(self, given: Given, grasp: str | None) -> int:
        """The variant of an object with its own grasp or another; compiled when it is asked for the first time."""
        if (given, grasp) not in self._numbers:
            self._learn(self.scene(given, grasp), given, grasp)
        return self._numbers[given, grasp]

    def _learn(self, scene: Scene, given: Given, grasp: str | None) -> None:
        end = self.verdict(scene)
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
        if self.scenes:
            self.worlds.add(scene.model)
        self._numbers[given, grasp] = len(self.scenes)
        self.scenes.append(scene)
        moves, period = closing(scene.grasp, self.wait, self.squeeze), self.settings.period
        self._scripts.append(sampled(moves, scene.grasp.preshape, self.periods, period))
        self.interface = self._interface(scripts=table(self._scripts), reach=self.settings.reach)
        place = self.worlds.xp.asarray
        self._starts = place(np.array([scene.grasp.preshape for scene in self.scenes]))
        self._poses = place(np.array([scene.pose for scene in self.scenes]))
        self.learned()

    def learned(self) -> None:
        """Keep what follows from the scenes in tables with a row a variant."""

    def _fitting(self, variant: Rows, options: Options) -> None:
        """Raise ConfigError for an object that somebody has chosen and that is too large for its grasp."""
        if options.size is None and options.object is None:
            return
        for number in set(variant.tolist()):
            scene = self.scenes[number]
            depth = self.overlap(scene, options.size or 1.0)
            if depth > DEEPEST:
                raise ConfigError(
                    f"{scene.thing} at {options.size or 1.0:g} times its size is too large for {scene.grasp.name}: it "
                    f"would begin {depth * 1000:.0f} mm inside the hand; at most {DEEPEST * 1000:.0f} mm can be"
                )
