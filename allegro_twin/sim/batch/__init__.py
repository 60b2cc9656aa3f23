"""Many simulations at once: on threads, and on a GPU.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.sim.batch.core import Rows
    from allegro_twin.sim.batch.cpu import CpuBatch
    from allegro_twin.sim.batch.separate_models import SeparateModelBatch
    from allegro_twin.sim.batch.shared_model import SharedModelBatch

__all__ = [
    "CpuBatch",
    "Rows",
    "SeparateModelBatch",
    "SharedModelBatch",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "core": ("Rows",),
        "cpu": ("CpuBatch",),
        "separate_models": ("SeparateModelBatch",),
        "shared_model": ("SharedModelBatch",),
    },
)
