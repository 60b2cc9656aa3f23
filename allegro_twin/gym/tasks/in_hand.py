"""What tasks with an object in the fingertips of the upturned hand share. They see the object as a camera would."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.gym.camera import Camera, Seen
from allegro_twin.gym.given import thing_of
from allegro_twin.gym.noise import Draws
from allegro_twin.gym.settings import EnvSettings, Options
from allegro_twin.gym.tasks.base import Flags, Task
from allegro_twin.gym.tasks.held import Held, held
from allegro_twin.gym.tasks.scenes import THING, upturned, worlds
from allegro_twin.gym.tasks.vectors import length
from allegro_twin.sim import objects
from allegro_twin.sim.batch import Rows
from allegro_twin.types import Array

if TYPE_CHECKING:
    import mujoco

LARGEST = 0.09  # m. Longer ones do not lie between the fingers and the thumb.
ASIDE = 0.06  # m from where it began: no longer in the hand.
DROPPED = -20.0  # What losing the object costs: more than the steps of a throw can have earned.
FAST, SPINS = 0.5, 5.0  # m/s and rad/s by which what is seen is divided, to be of order 1.
_HAND, _PLACE = 0.02, 0.001  # rad and m, half-widths of the noise on the start.
_FRICTION = (0.5, 1.0)
_NEAR = 16  # States in order of size, among which one of a wanted size is drawn.


class InHand(Task):
    """The palm looks up, and an episode begins in one of the states that `held` has found, with some noise."""

    step: ClassVar[float] = 0.08
    """rad an action, where the settings name no other."""
    options: ClassVar[tuple[str, ...]] = ("object", "size", "friction")
    own: ClassVar[tuple[str, ...]] = ("observation",)

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        self.interface = self._interface(step=self.step)
        self.extra = 13 if settings.observation == "full" else 0
        self._held: list[Held] = []
        self._names: list[str] = []
        for given in settings.objects or ("rubiks_cube",):
            self._learn(thing_of(given), n, threads)
        self.thing = self.worlds.free(THING)
        self.camera = Camera(settings.randomise, self.thing, settings.decimation)
        self.place = np.zeros((n, 3))
        """Where the object was at the beginning, m, world."""
        self.kind, self._state = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self.start = np.zeros((n, self.spec.n_joints))
        """Targets of the fingers at the beginning, rad."""

    def variant(self, rows: Rows, draws: Draws, options: Options) -> Rows:
        drawn = draws.number(len(self.settings.objects or (1,)))
        if options.object is None:
            return drawn
        if options.object not in self._names:
            self._learn(thing_of(options.object), self.n, 1)
        return np.full(len(rows), self._names.index(options.object))

    def vary(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: Options) -> None:
        """The state to begin in, and with it the object's size; the friction."""
        friction, among = draws.within(*_FRICTION)[:, 0], draws.within(0.0, 1.0)[:, 0]
        values.setdefault("friction", friction)
        wanted = values.get("size")
        for row, kind, number in zip(rows, variant, range(len(rows)), strict=True):
            sizes = self._held[kind].size
            self._state[row] = _chosen(sizes, None if wanted is None else float(wanted[number]), float(among[number]))
        values["size"] = np.array(
            [self._held[kind].size[self._state[row]] for row, kind in zip(rows, variant, strict=True)]
        )

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: Options) -> None:
        assert self.thing is not None
        found = [(self._held[kind], state) for kind, state in zip(variant, self._state[rows], strict=True)]
        position, target, pose = (
            np.array([getattr(each, part)[state] for each, state in found]) for part in ("position", "target", "pose")
        )
        noise = draws.within(-_HAND, _HAND, self.spec.n_joints)
        self.worlds.position[rows] = np.clip(position + noise, self.spec.lower, self.spec.upper)
        pose[:, :3] += draws.within(-_PLACE, _PLACE, 3)
        self.thing.pose[rows] = pose
        self.kind[rows], self.start[rows], self.place[rows] = variant, target, pose[:, :3]
        self.camera.begin(rows, values, draws)

    def targets(self, rows: Rows) -> Array:
        return self.start[rows]

    def seen(self, tick: NDArray[np.int64]) -> Array | None:
        return self.told(self.camera.look(tick)) if self.extra else None

    def told(self, seen: Seen) -> Array:
        """The object's shift from where it began, in 5 cm, its quaternion, its velocity and its spin; world axes."""
        shift = (seen.position - self.place) / 0.05
        return np.concatenate([shift, seen.quaternion, seen.velocity / FAST, seen.spin / SPINS], axis=-1)

    def facts(self, rows: Rows) -> dict[str, NDArray[np.generic]]:
        return {"object": np.array([self._names[number] for number in self.kind[rows]], dtype=object)}

    def lost(self) -> Flags:
        assert self.thing is not None
        return length(self.thing.pose[:, :3] - self.place) > ASIDE

    def _learn(self, thing: objects.Thing, n: int, threads: int) -> None:
        """A further object, in the states in which fingertips hold it. Raises ConfigError for one too large."""
        longest = 2 * thing.half_extents().max()
        if longest > LARGEST:
            raise ConfigError(
                f"{thing.name} is too large for {self.name}: {longest * 1000:.0f} mm long; "
                f"at most {LARGEST * 1000:.0f} mm can be"
            )
        self._held.append(held(thing, self.settings.side))
        self._add(upturned(self.spec, thing, (0.0, 0.0, 0.1), self.settings), n, threads)
        self._names.append(thing.name)

    def _add(self, model: mujoco.MjModel, n: int, threads: int) -> None:
        if self._names:
            self.worlds.add(model)
        else:
            self.worlds = worlds(self.spec, model, n, threads, self.settings)


def _chosen(sizes: Array, wanted: float | None, among: float) -> int:
    """One of the states, by a number in [0, 1); of about the wanted size. Raises ConfigError where there is none."""
    if wanted is None:
        return min(int(among * len(sizes)), len(sizes) - 1)
    if not sizes[0] - 0.005 <= wanted <= sizes[-1] + 0.005:
        raise ConfigError(f"fingertips are taught to hold this object at {sizes[0]:.2f} to {sizes[-1]:.2f} times its "
                          f"size, not {wanted:g}")  # fmt: skip
    near = int(np.searchsorted(sizes, wanted)) + int((among - 0.5) * _NEAR)
    return min(max(near, 0), len(sizes) - 1)
