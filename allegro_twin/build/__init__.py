"""The one place that joins the parts: from a config to a guarded hand, its controller, and what surrounds them."""

from allegro_twin.build.assemble import assemble, make_backend
from allegro_twin.build.rig import Rig
from allegro_twin.build.simulated import make_trial, scenario_config

__all__ = ["Rig", "assemble", "make_backend", "make_trial", "scenario_config"]
