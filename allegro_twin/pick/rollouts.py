"""Whole episodes of `ArmPick`, each in one of several processes, led by its script, a policy, or one after the other.

What an episode comes to depends on its `EpisodeOrder` and nothing else, so neither on the number of processes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import HandError
from allegro_twin.files.fingerprints import fingerprint
from allegro_twin.learning.policy.controller import Policy
from allegro_twin.learning.training.evaluation import Evaluation
from allegro_twin.pick.card import load_pick_policy
from allegro_twin.pick.env import ArmPick, Floats
from allegro_twin.pick.scripted_policy import ScriptedPick
from allegro_twin.pick.settings import PickSettings
from allegro_twin.sweep import Local, Sweep, run

ALWAYS = 1_000_000
"""Decisions: longer than any episode."""


class EpisodeOrder(NamedTuple):
    """One episode."""

    seed: int
    script_until: int
    """Decision from which the policy leads; before it the script does."""
    noise: float = 0.0
    """Spread of what is added to the script's actions."""


class PickRollouts(NamedTuple):
    """Results of episodes, a row each."""

    success: NDArray[np.bool_]
    returns: NDArray[np.float64]
    lengths: NDArray[np.int64]
    objects: tuple[str, ...]
    observed: Floats
    """Observations of every decision, (decisions in all, numbers); none where it was not asked for."""
    taught: Floats
    """Actions of the script there, (decisions in all, numbers)."""


def roll_out(
    settings: PickSettings,
    orders: Sequence[EpisodeOrder],
    policy: Path | None,
    *,
    keep: bool = False,
    processes: int | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> PickRollouts:
    """Run all. `keep`: with what was observed and what the script would have done. `processes`: how many at once; None
    for one for each core. Raises HandError."""
    shared: dict[str, Any] = {
        "environment": settings.keywords(),
        "policy": None if policy is None else [str(policy.resolve()), fingerprint([policy])],
        "keep": keep,
    }
    sweep = Sweep("allegro_twin.pick.rollouts:run_items", [order._asdict() for order in orders], shared, unit=1)
    rows = run(sweep, None, Local(processes), progress).to_pylist()
    for row in rows:
        if row["error"]:
            raise HandError(f"an episode of ArmPick: {row['error']}")
    return PickRollouts(
        np.array([row["success"] for row in rows]),
        np.array([row["return"] for row in rows]),
        np.array([row["length"] for row in rows]),
        tuple(row["object"] for row in rows),
        _floats(rows, "observed"),
        _floats(rows, "taught"),
    )


def evaluate_pick(
    settings: PickSettings, episodes: int, policy: Path | None, *, seed: int = 0, processes: int | None = None
) -> Evaluation:
    """Run the episodes of the seeds from `seed` on, led by a policy or, without one, by the script."""
    until = ALWAYS if policy is None else 0
    found = roll_out(settings, [EpisodeOrder(seed + k, until) for k in range(episodes)], policy, processes=processes)
    return Evaluation(found.success, found.returns, found.objects)


def run_items(shared: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The function of the sweep."""
    env = _environment(_key(shared["environment"]))
    policy = None if shared["policy"] is None else _policy(*shared["policy"])
    return [_run(env, EpisodeOrder(**item), policy, keep=shared["keep"]) for item in items]


def _run(env: ArmPick, order: EpisodeOrder, policy: Policy | None, *, keep: bool) -> dict[str, Any]:
    draws = np.random.default_rng([order.seed, 1])
    observation, info = env.reset(seed=order.seed)
    name, script, observed, taught = info["object"], ScriptedPick(env), list[Floats](), list[Floats]()
    earned, count, over = 0.0, 0, False
    while not over:
        by_script = policy is None or count < order.script_until
        if keep or by_script:
            act = script()
        if keep:
            observed.append(observation)
            taught.append(act)
        if policy is not None and not by_script:
            act = np.asarray(policy(observation))
        elif order.noise:
            act = np.clip(act + draws.normal(0.0, order.noise, act.shape), -1.0, 1.0).astype(np.float32)
        observation, reward, lost, late, info = env.step(act)
        earned, count, over = earned + reward, count + 1, lost or late
    return {
        "success": bool(info["is_success"]), "return": earned, "length": count, "object": name,
        "observed": b"".join(each.tobytes() for each in observed),
        "taught": b"".join(each.tobytes() for each in taught),
    }  # fmt: skip


def _key(environment: Mapping[str, Any]) -> tuple[tuple[str, Any], ...]:
    return tuple((name, tuple(value) if isinstance(value, list) else value) for name, value in environment.items())


@cache
def _environment(keywords: tuple[tuple[str, Any], ...]) -> ArmPick:
    return ArmPick(**dict(keywords))


@cache
def _policy(path: str, content: str) -> Policy:
    """`content`: its fingerprint, for a file that a training writes anew."""
    return load_pick_policy(path).policy


def _floats(rows: Sequence[Mapping[str, Any]], name: str) -> Floats:
    """The arrays of all episodes, (decisions, numbers), one after the other."""
    return np.concatenate([np.frombuffer(row[name], np.float32).reshape(row["length"], -1) for row in rows])
