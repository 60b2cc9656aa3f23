"""The one place that joins the parts: from a config to a guarded hand, its controller, and what surrounds them."""

from allegro_twin.app.assembly import assemble, make_backend
from allegro_twin.app.backends.simulated import scenario_config
from allegro_twin.app.rig import Rig

__all__ = ["Rig", "assemble", "make_backend", "scenario_config"]
