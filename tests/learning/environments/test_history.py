"""What an observation with a history shows."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.learning.environments.vector import HandVectorEnv


@pytest.mark.parametrize("randomise", ["off", "default"])
def test_a_history_shows_what_was_seen_at_the_decisions_before(randomise: str) -> None:
    env = HandVectorEnv("Rotate", 3, history=3, randomise=randomise, timestep=0.003, autoreset_mode="disabled")
    frame = env.engine.task.interface.frame
    rng = np.random.default_rng(0)
    rows = [env.reset(seed=1)[0]]
    assert env.single_observation_space.contains(rows[0][0])  # type: ignore[index]  # An array.
    rows += [env.step(rng.uniform(-1, 1, (3, 16)).astype(np.float32))[0] for _ in range(4)]
    first, *later = [np.asarray(row) for row in rows]
    assert not first[:, frame : 3 * frame].any()
    assert first.shape == (3, 3 * frame + 13)
    for before, now in zip([first, *later], later, strict=False):
        np.testing.assert_array_equal(now[:, frame : 3 * frame], before[:, : 2 * frame])
    mask = np.array([False, True, False])
    env.reset(seed=9, options={"reset_mask": mask})
    anew = np.asarray(env.step(np.zeros((3, 16), np.float32))[0])
    assert not anew[1, 2 * frame : 3 * frame].any()
    np.testing.assert_array_equal(anew[0, 2 * frame : 3 * frame], later[-1][0, frame : 2 * frame])
