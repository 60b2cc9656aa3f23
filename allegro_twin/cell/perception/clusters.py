"""Clusters of points: neighbouring cells of a grid, seen from above."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.perception.cloud import Points
from allegro_twin.errors import ConfigError
from allegro_twin.types import Array

_TOUCHING = np.ones((3, 3), np.int_)
Labels = NDArray[np.int_]


@dataclass(frozen=True, slots=True, eq=False)
class ClusterGrid:
    """Square cells over a plane and the cluster of each: 0 is none."""

    corner: Array
    """Corner of the first cell, (2,), m."""
    cell: float
    """Edge, m."""
    labels: Labels

    def of(self, places: Points) -> Labels:
        """The clusters of places (n, 2), m; 0 for one outside."""
        cells = np.floor((places - self.corner) / self.cell).astype(np.int_)
        inside = ((cells >= 0) & (cells < self.labels.shape)).all(axis=1)
        found = np.zeros(len(places), np.int_)
        found[inside] = self.labels[cells[inside, 0], cells[inside, 1]]
        return found

    def spread(self) -> ClusterGrid:
        """Each cluster with the free cells around it, for the points that were not looked at before."""
        inner = np.pad(self.labels, 1)
        wider = image_functions().maximum_filter(inner, 3)
        return ClusterGrid(self.corner - self.cell, self.cell, np.where(inner > 0, inner, wider))


def image_functions() -> ModuleType:
    """SciPy's. Raises ConfigError where the extra is not installed."""
    try:
        from scipy import ndimage  # type: ignore[import-untyped]  # Its types are a package of their own.
    except ImportError as error:
        raise ConfigError("perception needs SciPy: pip install 'allegro-twin[lab]'") from error
    found: ModuleType = ndimage
    return found


def find_clusters(places: Points, cell: float) -> tuple[ClusterGrid, Labels]:
    """The grid over places (n, 2), m, and how many of them each cluster has, from cluster 1 on, (k,)."""
    corner = places.min(axis=0)
    cells = np.floor((places - corner) / cell).astype(np.int_)
    filled = np.zeros(cells.max(axis=0) + 1, np.bool_)
    filled[cells[:, 0], cells[:, 1]] = True
    labels, count = image_functions().label(filled, _TOUCHING)
    sizes = np.bincount(labels[cells[:, 0], cells[:, 1]], minlength=count + 1)[1:]
    return ClusterGrid(corner, cell, labels.astype(np.int_)), sizes
