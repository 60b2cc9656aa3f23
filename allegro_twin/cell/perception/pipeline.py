"""From one picture to one thing: what it is, where it stands and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from allegro_twin.cell.perception.cloud import OrganizedCloud, Points
from allegro_twin.cell.perception.clusters import image_functions
from allegro_twin.cell.perception.errors import PerceptionRefusal, position_text
from allegro_twin.cell.perception.fits.model import Solid, sample_points
from allegro_twin.cell.perception.fits.solids import fit_solids
from allegro_twin.cell.perception.segmentation import Cluster, TablePlane, depth_scatter, largest_object
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.types import Array, Vector

_LEVEL = 10
"""Degrees below which a camera does not see a thing's top, and so not how deep it is."""
_STEEP = 30
"""Degrees from which a camera sees enough of a thing's top, docs/reference/perception.md."""


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """The largest thing on the table, in the world."""

    solid: Solid
    table: TablePlane
    points: Array
    """Its own, (n, 3), m."""
    sigma: float
    """The camera's scatter there, m: what `solid.error` is to be compared with."""
    others: int
    """Things beside it."""


class PerceptionPipeline:
    """Looks at pictures, each for itself: the same picture has the same answer. Raises ConfigError without SciPy."""

    def __init__(self, settings: PerceptionSettings, seed: int = 0) -> None:
        image_functions()  # SciPy is there, or this raises.
        self.settings, self._seed = settings, seed

    def detect(
        self, cloud: Points, position: Vector, rotation: Array, robot: Array | None = None
    ) -> Detection | PerceptionRefusal:
        """The largest thing of an organised cloud (rows, columns, 3), m in the camera's frame, NaN unknown.

        `position` (3,), m, and `rotation` (3, 3), columns: the camera in the world when the picture was taken. `robot`:
        balls around what is the robot's own and is no thing, (k, 4), middle in the world and radius, m. Raises
        ConfigError for other shapes and a pose that is not finite.
        """
        draws = np.random.default_rng(self._seed)
        view = OrganizedCloud(cloud, position, rotation, robot)
        cluster = largest_object(view, self.settings, draws)
        if isinstance(cluster, PerceptionRefusal):
            return cluster
        sigma = depth_scatter(view, self.settings) * cluster.depth**2
        middle = cluster.points.mean(axis=0) * [1.0, 1.0, 0.0]
        solids = fit_solids(sample_points(cluster.points - middle, cluster.pixel, sigma, cluster.elevation), draws)
        level = np.array([0.0, 0.0, cluster.plane.offset])
        placed = [_placed(solid, middle + level, cluster) for solid in solids]
        points = (cluster.points + level) @ cluster.axes
        refused = self._doubt(placed, points, sigma, cluster.elevation)
        return refused or Detection(placed[0], cluster.plane, points, sigma, cluster.others)

    def _doubt(self, solids: list[Solid], points: Array, sigma: float, elevation: float) -> PerceptionRefusal | None:
        limits, where = self.settings.object, position_text(points.mean(axis=0))
        most = max(limits.best, limits.error * sigma)
        if elevation < np.radians(_LEVEL):
            said = f"of the thing at {where} the top is not seen, from {np.degrees(elevation):.0f}° above it"
            return PerceptionRefusal(
                "unclear", f"{said}; raise the camera: from {_STEEP}° it tells how deep a thing is"
            )
        if not solids or solids[0].error > most:
            off = f"{solids[0].error * 1e3:.1f} mm off a {solids[0].shape}, the best" if solids else "nothing fits"
            said = f"the thing at {where} is no ball, egg, cylinder or box: {off}, and {most * 1e3:.1f} mm are allowed"
            low = f"; it is seen from {np.degrees(elevation):.0f}° above, look from {_STEEP}° or more"
            way = low if elevation < np.radians(_STEEP) else "; where two things touch, move them 2 cm apart"
            return PerceptionRefusal("unclear", said + way)
        at, space = solids[0].position, self.settings.workspace
        if not (np.all(at >= space.lower) and np.all(at <= space.upper)):
            said = (
                f"the {solids[0].shape} at {position_text(at)} is outside the workspace {space.lower} to {space.upper}"
            )
            return PerceptionRefusal("outside", f"{said}; move it there, or set `workspace` to what the arm reaches")
        return None


def _placed(solid: Solid, origin: Array, cluster: Cluster) -> Solid:
    """From the axes of the table in the world."""
    position = (solid.position + origin) @ cluster.axes
    return replace(solid, position=position, axes=cluster.axes.T @ solid.axes)
