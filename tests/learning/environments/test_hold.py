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


@pytest.mark.parametrize(("task", "ends"), [("Grasp", 110), ("Lift", 115), ("HoldDisturbed", 102)])
def test_an_object_that_the_hand_lets_go_of_in_the_last_action_is_no_success(task: str, ends: int) -> None:
    opens, keeps = (HandVectorEnv(task, 2, objects=("tennis_ball",), level="easy", timestep=0.003, control="absolute",
                                  reach=1.0) for _ in range(2))  # fmt: skip
    for env, last in ((opens, -1.0), (keeps, 0.0)):
        env.reset(seed=0)
        for step in range(ends):
            *_, info = env.step(np.full((2, 16), last if step == ends - 1 else 0.0, np.float32))
        assert info["is_success"].tolist() == [last == 0.0] * 2


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
