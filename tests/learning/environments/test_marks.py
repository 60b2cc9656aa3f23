"""Goals are seen in the pictures."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.tasks.base import Task


@pytest.mark.parametrize(("task", "count"), [("Reach", 4), ("Reorient", 1)])
def test_a_goal_is_drawn_where_it_is_and_moves_with_the_next_episode(
    task: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    env = HandEnv(task, render_mode="rgb_array", width=160, height=160)
    env.reset(seed=0)
    marks = env.engine.task.marks(0)
    assert len(marks) == count
    goal = env.engine.task.goal()
    assert goal is not None
    if task == "Reach":
        np.testing.assert_allclose(np.concatenate([mark.pose[:3] for mark in marks]), goal[0], atol=1e-7)
    else:
        np.testing.assert_array_equal(marks[0].pose[3:], goal[0])
    shown = env.render()
    with monkeypatch.context() as patch:
        patch.setattr(type(env.engine.task), "marks", Task.marks)
        without = env.render()
    assert shown is not None
    assert without is not None
    assert np.any(shown != without, axis=-1).sum() > 25 * count
    assert env.engine.task.marks(0)[0].pose is not marks[0].pose
    env.reset(seed=1)
    assert not np.array_equal(env.engine.task.marks(0)[0].pose, marks[0].pose)
    env.close()
