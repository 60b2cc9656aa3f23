"""A network that learns actions by regression does the same when it is asked the same, and goes on as it would have."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError, HandError

torch = pytest.importorskip("torch", reason="extra rl")

DRAWS = np.random.default_rng(0)
SEEN = DRAWS.normal(3.0, [0.1, 1.0, 10.0], (200, 3)).astype(np.float32)
WANTED = np.stack([0.5 * np.tanh(SEEN[:, 1] - 3.0), 0.05 * SEEN[:, 2]], axis=1).astype(np.float32)


def made(seed: int = 0, rate: float = 1e-2, hidden: tuple[int, ...] = (8,)) -> Any:
    from allegro_twin.learning.training.regression import ActionRegression

    return ActionRegression(3, 2, hidden, rate, seed)


def weights(learner: Any) -> bytes:
    network = learner.network()
    parts = [network.mean, network.scale, *(each for layer in network.layers for each in layer.parameters())]
    return b"".join(part.detach().numpy().tobytes() for part in parts)


def learned(learner: Any, calls: int, *, last: bool = False) -> Any:
    for _ in range(calls):
        learner.learn(SEEN, WANTED, 20, 16, last=last)
    return learner


def test_it_goes_on_from_a_dump_to_the_bit() -> None:
    whole = learned(made(), 3)
    other = made(seed=0)
    other.load(learned(made(), 2).dump())
    assert weights(learned(other, 1)) == weights(whole)
    assert weights(learned(made(), 2)) != weights(whole)


def test_a_network_without_adams_moments_goes_another_way() -> None:
    dumped = learned(made(), 2)
    cold = made()
    cold.load(dumped.dump())
    cold._adam = torch.optim.Adam(cold._layers.parameters(), lr=1e-2)
    assert weights(learned(cold, 1)) != weights(learned(dumped, 1)), "else the test above would not see it"


def test_every_seed_begins_and_draws_otherwise_and_every_call_draws_anew() -> None:
    assert weights(learned(made(), 1)) == weights(learned(made(), 1))
    assert weights(made(seed=1)) != weights(made())
    same = made(seed=1)
    same._layers.load_state_dict(made()._layers.state_dict())
    assert weights(learned(same, 1)) != weights(learned(made(), 1)), "the mini-batches are others"
    again = learned(made(), 1)
    again._calls = 0
    assert weights(learned(again, 1)) != weights(learned(made(), 2)), "a second call has mini-batches of its own"


def test_it_learns_numbers_of_any_scale_and_the_last_call_ends_slowly() -> None:
    learner = made()
    first = learner.learn(SEEN, WANTED, 1, 200, last=False)
    assert learned(learner, 40).learn(SEEN, WANTED, 1, 200, last=False) < 0.05 * first
    learned(learner, 1, last=True)
    assert learner._adam.param_groups[0]["lr"] == pytest.approx(1e-2 * (1.0 - 19 / 20))
    learned(learner, 1)
    assert learner._adam.param_groups[0]["lr"] == 1e-2


def test_one_that_diverges_is_an_error_and_so_is_a_dump_of_other_sizes() -> None:
    broken = SEEN.copy()
    broken[:, 0] = np.inf
    with pytest.raises(HandError, match=r"training diverged: choose a learning_rate below 0\.01, and another"):
        made().learn(broken, WANTED, 3, 16, last=False)
    with pytest.raises(ConfigError, match="no state of a network of these sizes"):
        made(hidden=(9,)).load(made().dump())
    with pytest.raises(ConfigError, match="no state of a network of these sizes"):
        made().load(b"")
