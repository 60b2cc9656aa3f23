"""What tasks with an object lying in the upturned hand share. They are privileged: they see the object's motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.gym.noise import Draws
from allegro_twin.gym.settings import EnvSettings, Options
from allegro_twin.gym.tasks.base import Task
from allegro_twin.gym.tasks.scenes import THING, compiled, worlds
from allegro_twin.gym.tasks.starts import played
from allegro_twin.gym.tasks.vectors import length
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.library.named import load_posture
from allegro_twin.policy.script import Script
from allegro_twin.sim import objects
from allegro_twin.sim.batch import Rows, Worlds
from allegro_twin.sim.scene import Stage
from allegro_twin.types import Array, frozen

POSTURE = "ready"  # Fingers half bent: a cube comes to rest on the palm's edge and the fingers' bases.
PALM, AIR, ALONG = 0.0111, 0.002, 0.010  # m: the palm's surface, a gap, and how far towards the fingers.
LARGEST = 0.09  # m. Longer ones do not lie between the fingers and the thumb.
SETTLE = 1.5  # s until the object lies still.
LOST = 0.08  # m from where it lay: it is no longer in the hand.
FAST, SPINS = 0.5, 5.0  # m/s and rad/s by which what is seen is divided, to be of order 1.


class InHand(Task):
    """The palm looks up and an object lies on it."""

    extra = 13
    options = ("object", "friction")

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        self.interface = self._interface(step=0.1)
        self._numbers: dict[str, int] = {}
        self._names: list[str] = []
        for name in settings.objects or ("rubiks_cube",):
            self._number(name, n, threads)
        self.thing = self.worlds.free(THING)
        self.place = np.zeros((n, 3))
        """Where the object lay at the beginning, m, world."""
        self.kind = np.zeros(n, np.int64)

    def variant(self, rows: Rows, draws: Draws, options: Options) -> Rows:
        drawn = draws.number(len(self.settings.objects or (1,)))
        return drawn if options.object is None else np.full(len(rows), self._number(options.object, self.n, 1))

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: Options) -> None:
        assert self.thing is not None
        self.kind[rows] = variant
        self.place[rows] = self.thing.pose[rows, :3]

    def seen(self) -> Array:
        """The object's place from where it lay, in 5 cm, its quaternion, its velocity and its spin; world axes."""
        assert self.thing is not None
        thing = self.thing
        shift = (thing.pose[:, :3] - self.place) / 0.05
        return np.concatenate([shift, thing.pose[:, 3:], thing.velocity / FAST, thing.spin / SPINS], axis=-1)

    def facts(self, rows: Rows) -> dict[str, NDArray[np.generic]]:
        return {"object": np.array([self._names[number] for number in self.kind[rows]], dtype=object)}

    def lost(self) -> NDArray[np.bool_]:
        assert self.thing is not None
        return length(self.thing.pose[:, :3] - self.place) > LOST

    def _number(self, name: str, n: int, threads: int) -> int:
        if name not in self._numbers:
            thing = objects.named(name)
            extents = 2 * thing.half_extents()
            if extents.max() > LARGEST:
                raise ConfigError(
                    f"{name} is too large for {self.name}: {extents.max() * 1000:.0f} mm long; "
                    f"at most {LARGEST * 1000:.0f} mm can be"
                )
            # The fingers point along the world's x, so the palm's x is up and its y to the world's y.
            place = (ALONG, 0.0, PALM + extents[2] / 2 + AIR)
            placed = objects.Placement(replace(thing, name=THING), place, (1.0, 0.0, 0.0, 0.0))
            stage = Stage(np.zeros(3), quaternion_facing((0, 0, 1), (1, 0, 0)), [placed])
            model = compiled(self.spec, stage, self.settings)
            if not self._names:
                self.worlds = worlds(self.spec, model, n, threads, self.settings)
            else:
                self.worlds.add(model)
            self._numbers[name] = len(self._names)
            self._names.append(name)
            rest = np.tile(load_posture(POSTURE, self.spec), (round(SETTLE / self.settings.period), 1))
            lying = played(
                self.spec, model, self.gains, Script(rest, frozen(np.zeros_like(rest))), self.settings, _nothing
            )
            self.worlds.keep_start(self._numbers[name], lying)
        return self._numbers[name]


def _nothing(worlds: Worlds, k: int) -> None:
    """Nothing acts but the hand."""
