"""Uncertainty of a trial: random deviations of the object, unknown to the hand.

Draw number i of a seed is the same for every grasp and every object (common random numbers), so that two grasps are
compared on the same cases.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import Settings
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_from_vector, quaternion_product
from allegro_twin.sim.model.scene import Stage
from allegro_twin.sim.objects.catalogue import PlacedObject
from allegro_twin.types import Array

SampleStream: TypeAlias = Literal["evaluate", "search", "judge"]
"""What draws are for. Those of one stream are never those of another, whatever their seeds: what was chosen on some is
judged on others."""
_STREAMS: dict[SampleStream, tuple[int, ...]] = {"evaluate": (), "search": (0x5EA7C4,), "judge": (0x10D6E,)}
MEASURES = 7
"""That a draw varies."""
_BITS = 20
_SOBOL = ((0, ()), (0, (1,)), (1, (1, 3)), (1, (1, 3, 1)), (2, (1, 1, 1)), (1, (1, 1, 3, 3)), (4, (1, 3, 5, 13)))
"""Primitive polynomials, without their first and last digits, and the first direction numbers of each measure: S. Joe,
F. Y. Kuo, Constructing Sobol sequences with better two-dimensional projections, SIAM J. Sci. Comput. 30 (2008)."""
Share = Annotated[float, Field(ge=0, lt=1)]


class Uncertainty(Settings):
    """Half-widths of uniform distributions."""

    position: Annotated[float, Field(ge=0, le=0.1)] = 0.010
    """Deviation of the object along x and y, m."""
    yaw: Annotated[float, Field(ge=0, le=180)] = 10.0
    """Deviation of the object's yaw about the vertical, degrees."""
    size: Share = 0.05
    """Deviation of all its measures together, as a fraction."""
    mass: Share = 0.2
    """Deviation of the object's mass, as a fraction."""
    friction: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] | None = (0.5, 1.0)
    """Smallest and largest sliding friction; None: as the scenario has it."""
    torque: Share = 0.3
    """Deviation of the motors' torque from the command, as a fraction."""


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
        objects = [self._moved(stage.objects[0], on_something=stage.table), *stage.objects[1:]]
        return replace(stage, objects=objects, friction=friction)

    def _moved(self, placed: PlacedObject, *, on_something: bool) -> PlacedObject:
        grasp_object = placed.grasp_object
        x, y, z = placed.position
        if grasp_object.shape == "mjcf" and (self.size != 1.0 or self.mass != 1.0):
            raise ConfigError(f"object {grasp_object.name}: an MJCF brings its own size and mass; say size=0,mass=0")
        if on_something and self.size != 1.0:
            turned = np.abs(matrix_from_quaternion(np.array(placed.quaternion))[2])
            z += float(turned @ grasp_object.half_extents()) * (self.size - 1.0)
        larger = replace(
            grasp_object, size=tuple(s * self.size for s in grasp_object.size), mass=grasp_object.mass * self.mass,
            stretch=grasp_object.stretch * self.size,
        )  # fmt: skip
        w, i, j, k = quaternion_product(
            quaternion_from_vector(np.array([0.0, 0.0, self.yaw])), placed.quaternion
        ).tolist()
        return PlacedObject(larger, (x + self.x, y + self.y, z), (w, i, j, k))


def sample_perturbations(
    uncertainty: Uncertainty, n: int, seed: int = 0, first: int = 0, stream: SampleStream = "evaluate"
) -> list[Perturbation]:
    """Draws `first` to `first + n` of a seed of a stream. Those of `evaluate` and `judge` are independent; those of
    `search` are a shifted Sobol sequence, whose first 2, 4, 8 … have every measure in as many equal parts of its range
    once: a search that looks at a few is not misled by a run of easy ones."""
    rows = _spread(seed, first, n) if stream == "search" else _independent(stream, seed, first, n)
    return [_draw(uncertainty, row) for row in rows.tolist()]


def _independent(stream: SampleStream, seed: int, first: int, n: int) -> Array:
    """Between -1 and 1, (n, 7)."""
    return np.array([
        np.random.default_rng([*_STREAMS[stream], seed, number]).uniform(-1.0, 1.0, MEASURES)
        for number in range(first, first + n)
    ]).reshape(n, MEASURES)  # fmt: skip


def _spread(seed: int, first: int, n: int) -> Array:
    """Points of a Sobol sequence, shifted in its binary digits by the seed, between -1 and 1, (n, 7). (SciPy has it,
    and takes a second to load.)"""
    shift = np.random.default_rng([*_STREAMS["search"], seed]).integers(0, 1 << _BITS, MEASURES)
    digits = (np.arange(first, first + n)[:, None] >> np.arange(_BITS)) & 1
    points = np.bitwise_xor.reduce(digits[:, :, None] * _directions().T, axis=1) ^ shift
    spread: Array = (2 * points + 1) / (1 << _BITS) - 1.0
    return spread


@cache
def _directions() -> NDArray[np.int64]:
    """What each binary digit of a point's number adds to it, modulo 2, (7, bits)."""
    found = np.zeros((MEASURES, _BITS), dtype=np.int64)
    for row, (polynomial, begin) in enumerate(_SOBOL):
        degree, terms = len(begin), list(begin)
        for k in range(degree, _BITS):
            new = terms[k - degree] ^ (terms[k - degree] << degree) if degree else 1
            for i in range(1, degree):
                if (polynomial >> (degree - 1 - i)) & 1:
                    new ^= terms[k - i] << i
            terms.append(new)
        found[row] = [term << (_BITS - 1 - k) for k, term in enumerate(terms)]
    return found


def _draw(of: Uncertainty, row: list[float]) -> Perturbation:
    x, y, yaw, size, mass, friction, torque = row
    low, high = of.friction if of.friction is not None else (0.0, 0.0)
    return Perturbation(
        of.position * x, of.position * y, float(np.radians(of.yaw)) * yaw, 1.0 + of.size * size, 1.0 + of.mass * mass,
        None if of.friction is None else low + (high - low) * (friction + 1.0) / 2.0, 1.0 + of.torque * torque,
    )  # fmt: skip
