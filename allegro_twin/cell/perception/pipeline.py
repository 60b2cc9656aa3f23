"""Perception pipeline: the objects on the table in one picture, their poses, and how certain these are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from allegro_twin.cell.perception.cloud import OrganizedCloud, Points
from allegro_twin.cell.perception.clusters import image_functions
from allegro_twin.cell.perception.errors import PerceptionRefusal, position_text
from allegro_twin.cell.perception.fits.model import Solid, sample_points
from allegro_twin.cell.perception.fits.solids import fit_solids
from allegro_twin.cell.perception.segmentation import Cluster, TablePlane, find_objects, find_table
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.cell.perception.touching import (
    Separated,
    background_share,
    forms_one_body,
    make_compound,
    see_through_share,
    separate_solids,
    surface_distance,
)
from allegro_twin.types import Array, Vector

_LEVEL = 10
"""Degrees below which a camera does not see a thing's top, and so not how deep it is."""
_STEEP = 30
"""Degrees from which a camera sees enough of a thing's top, docs/reference/perception.md."""
_DEEP, _SCATTER, _THROUGH = 0.006, 5.0, 0.02
"""m, and times the camera's scatter: what is seen so deep in a solid is seen through it, and what is seen so far out of
it is none of it. And the share of points that may be seen through it."""


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """A thing on the table, in the world."""

    solid: Solid
    table: TablePlane
    points: Array
    """Its own, (n, 3), m."""
    sigma: float
    """The camera's scatter there, m: what `solid.error` is to be compared with."""
    others: int
    """Things beside it."""
    instead: tuple[Detection, ...] = ()
    """What it may be besides, for no picture tells what touches from what is one: of a compound its parts as things of
    their own, of each of these the compound."""

    @property
    def protruding(self) -> Array:
        """Its points that stand out of the solid: of a handle, or of a bottle's neck, (k, 3), m."""
        parts = self.solid.parts or (self.solid,)
        out = np.min([surface_distance(part, self.points) for part in parts], axis=0)
        return np.asarray(self.points[out > max(_DEEP, _SCATTER * self.sigma)])


class PerceptionPipeline:
    """Looks at pictures, each for itself: the same picture has the same answer. Raises ConfigError without SciPy."""

    def __init__(self, settings: PerceptionSettings, seed: int = 0) -> None:
        image_functions()  # SciPy is there, or this raises.
        self.settings, self._seed = settings, seed

    def detect(
        self, cloud: Points, position: Vector, rotation: Array, robot: Array | None = None
    ) -> Detection | PerceptionRefusal:
        """The thing with most points of an organised cloud (rows, columns, 3), m in the camera's frame, NaN unknown.
        What touches is taken apart where two or three solids explain it; where these look like one body, it is a
        compound.

        `position` (3,), m, and `rotation` (3, 3), columns: the camera in the world when the picture was taken. `robot`:
        balls around what is the robot's own and is no thing, (k, 4), middle in the world and radius, m. Raises
        ConfigError for other shapes and a pose that is not finite.
        """
        draws = np.random.default_rng(self._seed)
        cluster = find_objects(OrganizedCloud(cloud, position, rotation, robot), self.settings, draws)[0]
        return self._explained(cluster, draws)[0]

    def find_table(self, cloud: Points, position: Vector, rotation: Array) -> TablePlane | PerceptionRefusal:
        """The table's top, in the world, or why it cannot be known. Arguments as of `detect`."""
        draws = np.random.default_rng(self._seed)
        return find_table(OrganizedCloud(cloud, position, rotation), self.settings, draws)

    def detect_all(
        self, cloud: Points, position: Vector, rotation: Array, robot: Array | None = None
    ) -> list[Detection | PerceptionRefusal]:
        """All things, or why each cannot be known, first what has most points; where there is none, why there is none.
        As `detect` otherwise."""
        draws = np.random.default_rng(self._seed)
        found = list[Detection | PerceptionRefusal]()
        for cluster in find_objects(OrganizedCloud(cloud, position, rotation, robot), self.settings, draws):
            found += self._explained(cluster, draws)
        return found

    def _explained(
        self, cluster: Cluster | PerceptionRefusal, draws: np.random.Generator
    ) -> list[Detection | PerceptionRefusal]:
        """One solid that nothing is seen through; else the two or three that explain it together, as things of their
        own or as one body; else one with a hollow, or, where the settings allow it, about one. Never one behind which
        something is seen."""
        if isinstance(cluster, PerceptionRefusal):
            return [cluster]
        one, solids, refuted = self._detected(cluster, draws)
        unclear = isinstance(one, PerceptionRefusal) and one.reason == "unclear"
        doubtful = unclear or refuted or (isinstance(one, Detection) and self._seen_through(one.solid, cluster))
        if not doubtful or cluster.elevation < np.radians(_STEEP):
            return [one]
        parts, loose = self._parts(cluster, draws), self.settings.object.loose
        if parts or not unclear or loose is None or not solids or solids[0].error > loose:
            return parts or [one]
        points = cluster.world(cluster.points)
        doubt = self._workspace(solids[0])
        return [doubt or Detection(solids[0], cluster.plane, points, cluster.sigma, cluster.others)]

    def _detected(
        self, cluster: Cluster, draws: np.random.Generator
    ) -> tuple[Detection | PerceptionRefusal, list[Solid], bool]:
        """The solid, or why none is it; all that may be; and whether what fits best is not there."""
        points = cluster.world(cluster.points)
        fitted = self._fitted(cluster, cluster.points, draws)
        solids = [solid for solid in fitted if not self._seen_behind(solid, cluster)]
        if fitted and not solids:
            return _refuted(fitted[0], points), solids, True
        refused = self._doubt(solids, points, cluster.sigma, cluster.elevation)
        one = refused or Detection(solids[0], cluster.plane, points, cluster.sigma, cluster.others)
        return one, solids, bool(fitted) and fitted[0] is not solids[0]

    def _parts(self, cluster: Cluster, draws: np.random.Generator) -> list[Detection | PerceptionRefusal]:
        """What the cluster may consist of, or why one of these cannot be grasped: the likelier reading, with the other
        in `instead`; empty where no solids explain it."""
        points = cluster.world(cluster.points)

        def doubt(one: Separated) -> PerceptionRefusal | None:
            return self._doubt([one.solid], points[one.members], cluster.sigma, cluster.elevation)

        def good(one: Separated) -> bool:
            refused = doubt(one)
            explained = refused is None or refused.reason != "unclear"
            return explained and not self._seen_through(one.solid, cluster)

        def fit(some: Array) -> Solid | None:
            own = some @ cluster.axes.T - [0.0, 0.0, cluster.plane.offset]
            return next(iter(self._fitted(cluster, own, draws)), None)

        found = separate_solids(points, fit, good, self.settings.object.least, draws)
        if not found:
            return []
        others, solids = cluster.others + len(found) - 1, [one.solid for one in found]
        apart = [
            doubt(one) or Detection(one.solid, cluster.plane, points[one.members], cluster.sigma, others)
            for one in found
        ]
        body = make_compound(solids)
        whole = self._workspace(body) or Detection(body, cluster.plane, points, cluster.sigma, cluster.others)
        known = tuple(one for one in apart if isinstance(one, Detection))
        if isinstance(whole, PerceptionRefusal):
            return [whole] if forms_one_body(solids) else apart
        if forms_one_body(solids):
            return [replace(whole, instead=known)]
        return [replace(one, instead=(whole,)) if isinstance(one, Detection) else one for one in apart]

    @staticmethod
    def _seen_through(solid: Solid, cluster: Cluster) -> bool:
        """Whether the camera sees something where the inside of a solid would be, or behind it: there is a notch."""
        deep = max(_DEEP, _SCATTER * cluster.sigma)
        return see_through_share(solid, cluster.around, cluster.eye, deep) > _THROUGH

    @staticmethod
    def _seen_behind(solid: Solid, cluster: Cluster) -> bool:
        """Whether the camera sees something behind a solid, through it: it is not there, whatever fits."""
        deep = max(_DEEP, _SCATTER * cluster.sigma)
        return background_share(solid, cluster.around, cluster.eye, deep) > _THROUGH

    def _fitted(self, cluster: Cluster, points: Array, draws: np.random.Generator) -> list[Solid]:
        """Solids in the world that may explain some of a cluster's points, (n, 3), m, in its axes."""
        middle = points.mean(axis=0) * [1.0, 1.0, 0.0]
        solids = fit_solids(sample_points(points - middle, cluster.pixel, cluster.sigma, cluster.elevation), draws)
        origin = middle + np.array([0.0, 0.0, cluster.plane.offset])
        return [_placed(solid, origin, cluster) for solid in solids]

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
        return self._workspace(solids[0])

    def _workspace(self, solid: Solid) -> PerceptionRefusal | None:
        """Whether it is where the arm goes."""
        at, space = solid.position, self.settings.workspace
        if not (np.all(at >= space.lower) and np.all(at <= space.upper)):
            said = f"the {solid.shape} at {position_text(at)} is outside the workspace {space.lower} to {space.upper}"
            return PerceptionRefusal("outside", f"{said}; move it there, or set `workspace` to what the arm reaches")
        return None


def _refuted(solid: Solid, points: Array) -> PerceptionRefusal:
    size = " x ".join(f"{edge * 1e3:.0f}" for edge in solid.size)
    said = f"the thing at {position_text(points.mean(axis=0))} is no ball, egg, cylinder or box"
    seen = f"the camera sees the table through the best, of {size} mm"
    return PerceptionRefusal("unclear", f"{said}: {seen}; where two things touch, move them 2 cm apart")


def _placed(solid: Solid, origin: Array, cluster: Cluster) -> Solid:
    """From the axes of the table in the world."""
    position = (solid.position + origin) @ cluster.axes
    return replace(solid, position=position, axes=cluster.axes.T @ solid.axes)
