"""Sweeps: many small pure computations on plain data, on this computer's cores or on a cluster.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.sweep.cluster import RayCluster
    from allegro_twin.sweep.jobs import Sweep
    from allegro_twin.sweep.local import Local
    from allegro_twin.sweep.runner import run
    from allegro_twin.sweep.store import Store
    from allegro_twin.sweep.table import latest_rows, read_results, write_results

__all__ = [
    "Local",
    "RayCluster",
    "Store",
    "Sweep",
    "latest_rows",
    "read_results",
    "run",
    "write_results",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "cluster": ("RayCluster",),
        "jobs": ("Sweep",),
        "local": ("Local",),
        "runner": ("run",),
        "store": ("Store",),
        "table": (
            "latest_rows",
            "read_results",
            "write_results",
        ),
    },
)
