"""What a hand is not told: how far the object of a trial is from where, and from what, it is taken to be.

Draw number i of a seed is the same for every grasp and every object (common random numbers), so that two grasps are
compared on the same cases.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field

from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import Settings
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_from_vector, quaternion_product
from allegro_twin.sim.model.scene import Stage
from allegro_twin.sim.objects.catalogue import PlacedObject

SampleStream: TypeAlias = Literal["evaluate", "search", "judge"]
"""What draws are for. Those of one stream are never those of another, whatever their seeds: what was chosen on some is
judged on others."""
_STREAMS: dict[SampleStream, tuple[int, ...]] = {"evaluate": (), "search": (0x5EA7C4,), "judge": (0x10D6E,)}
Share = Annotated[float, Field(ge=0, lt=1)]


class Uncertainty(Settings):
    """Half-widths of uniform distributions."""

    position: Annotated[float, Field(ge=0, le=0.1)] = 0.010
    """Of the object along x and y, m."""
    yaw: Annotated[float, Field(ge=0, le=180)] = 10.0
    """About the vertical, degrees."""
    size: Share = 0.05
    """Of all its measures together, as a fraction."""
    mass: Share = 0.2
    """As a fraction."""
    friction: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] | None = (0.5, 1.0)
    """Smallest and largest sliding friction; None: as the scenario has it."""
    torque: Share = 0.3
    """What the motors give of what they are told, as a fraction."""


@dataclass(frozen=True, slots=True)
class Perturbation:
    """One case."""

    x: float = 0.0
    """m."""
    y: float = 0.0
    yaw: float = 0.0
    """rad."""
    size: float = 1.0
    mass: float = 1.0
    """Factors."""
    friction: float | None = None
    """None: the scenario's."""
    torque: float = 1.0
    """Factor."""

    def on(self, stage: Stage, factor: float = 1.0) -> Stage:
        """The stage as it is in this case; the hand stays where it would be. `factor`: on friction. Raises ConfigError
        for an object that brings its own sizes."""
        friction = stage.friction if self.friction is None else self.friction * factor
        things = [self._moved(stage.things[0], on_something=stage.table), *stage.things[1:]]
        return replace(stage, things=things, friction=friction)

    def _moved(self, placed: PlacedObject, *, on_something: bool) -> PlacedObject:
        thing = placed.thing
        x, y, z = placed.position
        if thing.shape == "mjcf" and (self.size != 1.0 or self.mass != 1.0):
            raise ConfigError(f"object {thing.name}: an MJCF brings its own size and mass; say size=0,mass=0")
        if on_something and self.size != 1.0:
            turned = np.abs(matrix_from_quaternion(np.array(placed.quaternion))[2])
            z += float(turned @ thing.half_extents()) * (self.size - 1.0)
        larger = replace(
            thing, size=tuple(s * self.size for s in thing.size), mass=thing.mass * self.mass,
            stretch=thing.stretch * self.size,
        )  # fmt: skip
        w, i, j, k = quaternion_product(
            quaternion_from_vector(np.array([0.0, 0.0, self.yaw])), placed.quaternion
        ).tolist()
        return PlacedObject(larger, (x + self.x, y + self.y, z), (w, i, j, k))


def sample_perturbations(
    uncertainty: Uncertainty, n: int, seed: int = 0, first: int = 0, stream: SampleStream = "evaluate"
) -> list[Perturbation]:
    """Draws `first` to `first + n` of a seed of a stream."""
    return [
        _draw(uncertainty, np.random.default_rng([*_STREAMS[stream], seed, number]))
        for number in range(first, first + n)
    ]


def _draw(of: Uncertainty, random: np.random.Generator) -> Perturbation:
    x, y, yaw, size, mass, friction, torque = random.uniform(-1.0, 1.0, 7).tolist()
    low, high = of.friction if of.friction is not None else (0.0, 0.0)
    return Perturbation(
        of.position * x, of.position * y, float(np.radians(of.yaw)) * yaw, 1.0 + of.size * size, 1.0 + of.mass * mass,
        None if of.friction is None else low + (high - low) * (friction + 1.0) / 2.0, 1.0 + of.torque * torque,
    )  # fmt: skip
