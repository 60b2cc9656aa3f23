"""How far a network comes at `ArmPick` from its observations alone, which imitates the script.

`python -m benchmarks.pick_imitation [--control grasp] [--rounds 5] [--episodes 60] [--judged 300]`

DAgger (Ross, Gordon and Bagnell 2011). In the first round the script leads, with noise on its actions; in later ones
the network leads three episodes in seven from their beginning and as many from some instant on. In every state the
script says what it would do, and the network learns that from all states so far. It sees no grasp, no approach and
nothing of the script's. The last line has its success in episodes that it was not trained in, with Wilson's interval,
95 %. Needs PyTorch.
"""

from __future__ import annotations

import argparse
from collections import Counter
from typing import Any

import numpy as np
import torch

from allegro_twin.cell.pick.env import ArmPick, Floats
from allegro_twin.cell.pick.scripted_policy import ScriptedPick
from allegro_twin.grasping.statistics import wilson

HIDDEN, BATCH, STEPS, LAST = 256, 512, 2500, 12000
"""Units of both layers, states of a step, steps after a round and after the last one."""
RATE, NOISE, SCRIPT = 1e-3, 0.1, 0.15
"""Learning rate; spread of what is added to a leading script's actions; share of episodes that it leads later on."""
TRAINED = 100_000
"""First seed of the training. Seeds from 0 on judge."""


class Imitator:
    """A network that learns a script's actions from observations. Their scale is that of the first round."""

    def __init__(self, seen: int, acts: int) -> None:
        self.network = torch.nn.Sequential(
            torch.nn.Linear(seen, HIDDEN), torch.nn.ELU(), torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.ELU(),
            torch.nn.Linear(HIDDEN, acts),
        )  # fmt: skip
        self._adam = torch.optim.Adam(self.network.parameters(), lr=RATE)
        self._scale: tuple[torch.Tensor, torch.Tensor] | None = None

    def __call__(self, seen: Floats) -> Floats:
        with torch.no_grad():
            found: Floats = self.network(self._scaled(torch.from_numpy(seen))).clamp(-1.0, 1.0).numpy()
        return found

    def learn(self, seen: torch.Tensor, acts: torch.Tensor, steps: int, *, last: bool) -> float:
        """Learn from states, (rows, …). `last`: the rate falls to a hundredth. Returns the last error."""
        if self._scale is None:
            self._scale = seen.mean(dim=0), seen.std(dim=0) + 1e-2
        seen, error = self._scaled(seen), torch.zeros(())
        for step in range(steps):
            for group in self._adam.param_groups:
                group["lr"] = RATE * max(1.0 - last * step / steps, 0.01)
            rows = torch.randint(len(seen), (BATCH,))
            error = ((self.network(seen[rows]) - acts[rows]) ** 2).sum(dim=-1).mean()
            self._adam.zero_grad()
            error.backward()
            self._adam.step()
        return float(error.detach())

    def _scaled(self, seen: torch.Tensor) -> torch.Tensor:
        assert self._scale is not None
        mean, spread = self._scale
        return (seen - mean) / spread


def episode(env: ArmPick, seed: int, leads: Any) -> tuple[list[Floats], list[Floats], bool]:
    """What was seen, what the script would have done, and success. `leads`: the action, of the script's action, what is
    seen, and the number of the decision."""
    observation, _ = env.reset(seed=seed)
    script, seen, acts, over = ScriptedPick(env), list[Floats](), list[Floats](), False
    info: dict[str, Any] = {}
    while not over:
        seen.append(observation)
        acts.append(script())
        observation, _, lost, late, info = env.step(leads(acts[-1], observation, len(acts) - 1))
        over = lost or late
    return seen, acts, bool(info["is_success"])


def train(env: ArmPick, rounds: int, episodes: int) -> Imitator:
    """The rounds, with a line for each."""
    random = np.random.default_rng(0)
    torch.manual_seed(0)
    torch.set_num_threads(1)
    found = Imitator(*(int(np.prod(space.shape or ())) for space in (env.observation_space, env.action_space)))
    seen, acts = list[Floats](), list[Floats]()
    for number in range(rounds):
        succeeded = 0
        for each in range(episodes):
            led = not number or random.random() < SCRIPT
            since = env.episodes.limit if led else int(random.integers(env.episodes.limit)) * int(random.integers(2))

            def leads(act: Floats, observation: Floats, k: int, led: bool = led, since: int = since) -> Floats:
                if k >= since:
                    return found(observation)
                noise = random.normal(0.0, NOISE, act.shape) if led else 0.0
                return np.asarray(np.clip(act + noise, -1.0, 1.0), np.float32)

            more, its, success = episode(env, TRAINED + number * episodes + each, leads)
            seen, acts, succeeded = seen + more, acts + its, succeeded + success
        last = number == rounds - 1
        data = torch.from_numpy(np.array(seen)), torch.from_numpy(np.array(acts))
        error = found.learn(*data, LAST if last else STEPS, last=last)
        print(f"round {number}: {len(seen)} states, error {error:.4f}, {succeeded} of {episodes} succeeded", flush=True)
    return found


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--control", default="grasp", choices=("grasp", "joints"))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=60, help="Episodes of a round.")
    parser.add_argument("--judged", type=int, default=300, help="Episodes of the judgement.")
    asked = parser.parse_args()
    env = ArmPick(control=asked.control)
    found = train(env, asked.rounds, asked.episodes)
    tried, taken = Counter[str](), Counter[str]()
    for seed in range(asked.judged):
        _, _, success = episode(env, seed, lambda act, seen, k: found(seen))
        tried[env.episodes.scene.name] += 1
        taken[env.episodes.scene.name] += success
    low, high = wilson(taken.total(), asked.judged)
    print(", ".join(f"{name} {taken[name]} of {tried[name]}" for name in sorted(tried)))
    print(f"{taken.total() / asked.judged:.0%} ({low:.0%}–{high:.0%}) of {asked.judged}")
    env.close()


if __name__ == "__main__":
    main()
