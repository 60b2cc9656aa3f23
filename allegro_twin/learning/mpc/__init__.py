"""Model predictive control by sampling: any task with a reward, without learning.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.learning.mpc.episodes import MpcEpisode, run_episodes
    from allegro_twin.learning.mpc.sampling import Plan, SamplingMpc
    from allegro_twin.learning.mpc.settings import CostSettings, MpcSettings, planner_settings

__all__ = ["CostSettings", "MpcEpisode", "MpcSettings", "Plan", "SamplingMpc", "planner_settings", "run_episodes"]
__getattr__, __dir__ = exports(
    __name__,
    {
        "episodes": ("MpcEpisode", "run_episodes"),
        "sampling": ("Plan", "SamplingMpc"),
        "settings": ("CostSettings", "MpcSettings", "planner_settings"),
    },
)
