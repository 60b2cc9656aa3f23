"""Straight lines through recordings: where the fit begins, with and without friction that breaks away."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.sim.open_loop import OpenLoopPlayer
from allegro_twin.twin.identify.fitting.regress import regress, regress_breakaway
from allegro_twin.twin.identify.motions.motion import read_motion
from tests.twin.identify import hidden


@pytest.mark.slow
def test_friction_that_breaks_away_and_grows_with_the_torque_has_a_line_of_its_own() -> None:
    motions = [read_motion(path) for path in hidden.recordings(breaking=True)]
    player = OpenLoopPlayer(motions[0].spec, motions[0].period)
    start = regress(motions, player, np.ones(16))
    found = regress_breakaway(motions, player, start)
    off = [np.abs(each.torque_constant / hidden.CONSTANT - 1.0) for each in (start, found)]
    assert np.median(off[1]) < 0.04
    assert np.median(off[1]) < 0.7 * np.median(off[0])
    assert np.median(np.abs(found.frictionloss - hidden.FRICTION)) < 1.5e-3
    assert np.median(np.abs(found.damping / hidden.DAMPING - 1.0)) < 0.05
    assert 1.2 < np.median(found.stiction) < 1.6  # The filter rounds its peak off.
    assert (found.load_friction > 0.02).mean() > 0.7
