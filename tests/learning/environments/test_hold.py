"""What HoldDisturbed begins with is a grasp that can be kept."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.spec import Side


@pytest.mark.long
@pytest.mark.parametrize("side", ["right", "left"])
def test_a_mug_is_kept_through_the_pushes_by_the_grasp_that_it_is_given(side: Side) -> None:
    env = HandVectorEnv("HoldDisturbed", 12, objects=("mug",), side=side, level="easy", autoreset_mode="disabled")
    _, info = env.reset(seed=0)
    assert set(info["grasp"]) == {"power_sphere"}
    kept = np.ones(12, bool)
    for _ in range(env.limit):
        _, _, lost, _, info = env.step(np.zeros((12, 16), np.float32))
        kept &= ~lost
    assert (kept & info["is_success"]).mean() >= 0.9  # 32 of 32 were kept on each side; of large_diameter 1 in 20.


def test_the_pushes_of_an_episode_do_not_depend_on_the_episode_before() -> None:
    first, second = (HandVectorEnv("HoldDisturbed", 2, objects=("lemon",), level="easy") for _ in range(2))
    zero = np.zeros((2, 16), np.float32)
    first.reset(seed=3)
    first.step(zero)
    for env in (first, second):
        env.reset(seed=7)
    for _ in range(20):
        for one, other in zip(first.step(zero)[:2], second.step(zero)[:2], strict=True):
            np.testing.assert_array_equal(one, other)
