"""What episodes came to is counted over all simulations, each episode once."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: pip install 'allegro-twin[rsl]'")

from allegro_twin.learning.training.rsl.rounds import EpisodeStatistics  # noqa: E402  # Behind the check for the extra.


def tensor(*values: float) -> Any:
    return torch.tensor(values, dtype=torch.float32)


def test_an_episode_counts_when_it_ends_and_the_next_begins_at_nothing() -> None:
    statistics = EpisodeStatistics(SimpleNamespace(num_envs=3, xp=torch))  # type: ignore[arg-type]  # All that is asked of it.
    number, *rest = statistics.take_means()
    assert number == 0
    assert all(math.isnan(each) for each in rest)
    never, yes = tensor(0, 0, 0), tensor(1, 0, 1)
    statistics.add(tensor(1, 2, 3), torch.tensor([False, False, False]), {"is_success": never})
    statistics.add(tensor(1, 2, 3), torch.tensor([True, False, True]), {"is_success": yes})
    assert statistics.take_means() == (2, (2.0 + 6.0) / 2, 2.0, 1.0)
    statistics.add(tensor(10, 2, 30), torch.tensor([True, True, False]), {"is_success": tensor(0, 1, 1)})
    # The first's second episode has one action; the second's only one has three.
    assert statistics.take_means() == (2, (10.0 + 6.0) / 2, (1.0 + 3.0) / 2, 0.5)
    statistics.add(tensor(0, 0, 0.5), torch.tensor([False, False, True]), {"is_success": never})
    assert statistics.take_means() == (1, 30.5, 2.0, 0.0)


def test_statistics_that_were_saved_go_on() -> None:
    first, second = (EpisodeStatistics(SimpleNamespace(num_envs=2, xp=torch)) for _ in range(2))  # type: ignore[arg-type]  # As above.
    first.add(tensor(1, 2), torch.tensor([True, False]), {"is_success": tensor(1, 0)})
    kept = first.state_dict()
    first.add(tensor(5, 5), torch.tensor([False, True]), {"is_success": tensor(0, 1)})
    second.load(kept)
    second.add(tensor(5, 5), torch.tensor([False, True]), {"is_success": tensor(0, 1)})
    assert second.take_means() == first.take_means() == (2, 4.0, 1.5, 1.0)
