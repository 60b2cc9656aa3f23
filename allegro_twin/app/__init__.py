"""Assembly of a run from its config: the guarded hand, its controller, and what surrounds them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.app.config import RunConfig, load_config
    from allegro_twin.app.rig import Rig, assemble, make_backend, open_backend
    from allegro_twin.app.session import Outputs, RunOutcome, perform
    from allegro_twin.app.simulated import scenario_config

__all__ = [
    "Outputs",
    "Rig",
    "RunConfig",
    "RunOutcome",
    "assemble",
    "load_config",
    "make_backend",
    "open_backend",
    "perform",
    "scenario_config",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "config": ("RunConfig", "load_config"),
        "rig": ("Rig", "assemble", "make_backend", "open_backend"),
        "session": ("RunOutcome", "Outputs", "perform"),
        "simulated": ("scenario_config",),
    },
)
