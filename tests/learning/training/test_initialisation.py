"""A policy that begins a training does there, from the first action on, what it did before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.tasks import make_task

torch = pytest.importorskip("torch", reason="torch is not installed: pip install 'allegro-twin[rsl]'")
pytest.importorskip("onnx", reason="onnx is not installed: pip install 'allegro-twin[rsl]'")

HAND, PLACES = 5, 3
"""Numbers of an observation, and of a goal, in these tests."""


def columns(theirs: dict[str, int], mine: dict[str, int], *, turns: bool = False) -> list[int]:
    from allegro_twin.learning.training.rsl.ppo import _columns

    return _columns(Path("start.onnx"), theirs, turns, mine)


def goals(hand: int, width: int) -> dict[str, int]:
    return {"observation": hand, "achieved_goal": width, "desired_goal": width}


def test_every_input_is_found_by_its_name_and_its_first_numbers() -> None:
    assert columns({"observation": 3}, {"observation": 5}) == [0, 1, 2]
    assert columns({"observation": 3}, goals(5, 2)) == [0, 1, 2]
    assert columns(goals(3, 2), goals(5, 2)) == [0, 1, 2, 5, 6, 7, 8, 9, 10]
    # Orientations: four numbers each, and three that are left.
    assert columns(goals(3, 4), goals(4, 4), turns=True) == [0, 1, 2, *range(4, 8), *range(8, 12), 12, 13, 14]
    same = goals(4, 3)
    assert columns(same, same) == list(range(4 + 3 + 3 + 3))
    # In another order than here.
    assert columns({"state": 1, "observation": 2}, {"observation": 3, "state": 2}) == [3, 0, 1]


@pytest.mark.parametrize(
    ("theirs", "mine", "message"),
    [
        ({"observation": 6}, {"observation": 5}, "it sees 6 numbers of observation, here are 5"),
        ({"observation": 5, "touch": 2}, {"observation": 5}, "it sees 2 numbers of touch, here are 0"),
        (goals(5, 4), goals(5, 3), "it sees 4 numbers of achieved_goal, here are 3"),
    ],
)
def test_what_the_recipe_does_not_see_is_refused(theirs: dict[str, int], mine: dict[str, int], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        columns(theirs, mine)


def test_a_policy_that_acts_much_acts_the_same_from_its_new_place(tmp_path: Path) -> None:
    """All inputs differ, and so does every weight: a number that went to a neighbour's column would show."""
    pytest.importorskip("rsl_rl", reason="rsl_rl is not installed: pip install 'allegro-twin[rsl]'")
    from rsl_rl.models import MLPModel
    from tensordict import TensorDict

    from allegro_twin.learning.training.goal_features import goal_difference
    from allegro_twin.learning.training.onnx_policy import NetworkActor, PolicyNetwork, read_onnx_network, to_onnx
    from allegro_twin.learning.training.rsl.ppo import start_from_policy

    torch.manual_seed(0)
    theirs, mine = goals(HAND - 2, PLACES), goals(HAND, PLACES)
    rng = np.random.default_rng(0)
    seen_by_it = sum(theirs.values()) + PLACES
    layers = [torch.nn.Linear(seen_by_it, 8), torch.nn.ELU(), torch.nn.Linear(8, 16)]
    mean, scale = (rng.uniform(low, 1.5, seen_by_it).astype(np.float32) for low in (-1.5, 0.5))
    card = make_task("Reach", EnvSettings(), 1, 1).card()
    to_onnx(PolicyNetwork(theirs, mean, scale, None, layers), tmp_path / "start.onnx", card)

    parts = {name: torch.from_numpy(rng.normal(size=(7, width)).astype(np.float32)) for name, width in mine.items()}
    parts["left"] = goal_difference(parts["desired_goal"], parts["achieved_goal"], False)
    flat = torch.cat(list(parts.values()), dim=-1)
    groups = {"actor": ["policy"]}
    seen = TensorDict({"policy": flat}, batch_size=[7])
    actor: Any = MLPModel(seen, groups, "actor", 16, hidden_dims=[8], activation="elu", obs_normalization=True)
    start_from_policy(actor, tmp_path / "start.onnx", mine)
    given = torch.cat([parts["observation"][:, : HAND - 2], *list(parts.values())[1:]], dim=-1)
    with torch.no_grad():
        wanted = NetworkActor(read_onnx_network(tmp_path / "start.onnx"))(given)
        found = actor(seen).clamp(-1.0, 1.0)
    assert wanted.abs().mean() > 0.2, "it hardly acts: nothing is tested"
    torch.testing.assert_close(found, wanted, atol=1e-5, rtol=1e-5)
