"""A controller of your own: a frozen class with `start` and `__call__`, and a memory that is handed on."""

from contextlib import closing
from dataclasses import dataclass

import numpy as np

from allegro_twin import HandState, TorqueCommand, load_config, run, until
from allegro_twin.app import make_backend


@dataclass(frozen=True)
class Wave:
    """One finger after the other bends and stretches."""

    stiffness: float = 2.0  # N·m/rad
    damping: float = 0.1  # N·m·s/rad

    def start(self, state: HandState) -> float:
        return state.t

    def __call__(self, state: HandState, began: float) -> tuple[TorqueCommand, float]:
        phase = 2.0 * np.pi * (state.t - began) - np.repeat(np.arange(4), 4) * np.pi / 3
        wanted = np.where(np.arange(16) % 4 == 0, state.position, 0.5 - 0.3 * np.cos(phase))
        return TorqueCommand(self.stiffness * (wanted - state.position) - self.damping * state.velocity), began


with closing(make_backend(load_config("sim_right"))) as hand:
    bent = [s.state.position[1] for s in until(2.0, run(hand, Wave())) if s.state.t > 0.5]  # Once it follows the wave.
print(f"the index bent between {min(bent):.2f} and {max(bent):.2f} rad")
assert np.allclose((min(bent), max(bent)), (0.2, 0.8), atol=0.05)
