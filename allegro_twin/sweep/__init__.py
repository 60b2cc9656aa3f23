"""Sweeps: many small pure computations on plain data, on this computer's cores or on a cluster.

What is named here is loaded when it is first asked for: a process that computes needs none of it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from allegro_twin.sweep.cluster import RayCluster
    from allegro_twin.sweep.jobs import Sweep
    from allegro_twin.sweep.local import Local
    from allegro_twin.sweep.runner import run
    from allegro_twin.sweep.store import Store

__all__ = ["Local", "RayCluster", "Store", "Sweep", "run"]
_HOMES = {"Local": "local", "RayCluster": "cluster", "Store": "store", "Sweep": "jobs", "run": "runner"}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    return found
