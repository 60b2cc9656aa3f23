"""Evaluates a policy on a virtual hand on a CAN bus: every frame is encoded, sent and decoded, and behind the hand's
processor runs the environment's episode."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.drivers.can.virtual.lockstep import LockstepLink
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.calibration import Version, load_wiring
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.environments.episode import EpisodeBackend
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.policy.card import check_card
from allegro_twin.learning.policy.controller import PolicyController
from allegro_twin.learning.policy.loading import load_policy
from allegro_twin.learning.training.evaluation import Evaluation
from allegro_twin.loop import run


def evaluate_on_can(
    policy: Path, task: str, settings: EnvSettings, episodes: int, *, seed: int = 0, version: Version = "v4"
) -> Evaluation:
    """Run the episodes of `evaluate` with the same seeds, on a bus in simulated time. What no hand reports does not go
    over the bus: a camera beside the hand gives it. Raises ConfigError for a policy of another task."""
    check_can(settings)
    loaded, episode = load_policy(policy), EpisodeBackend(task, settings)
    check_card(loaded.card, episode.engine.task.card())
    success: list[bool] = []
    returned: list[float] = []
    objects: list[str] = []
    counted: list[float] = []
    shares: dict[str, list[float]] = {}
    name = episode.engine.task.count_term
    for each in range(episodes):
        episode.seed = seed + each
        episode.reset()
        interface = episode.engine.task.interface  # With the scripts of these objects.
        controller = PolicyController(
            loaded.policy, interface, episode.goal, episode.script, episode.target, episode.complete_observation
        )
        with closing(_on_bus(episode, version)) as hand:  # Switched on anew: its motors are cold.
            returned.append(sum(_rewards(hand, controller, episode)))
        success.append(episode.success)
        counted += [episode.count] if name in episode.terms else []
        for share, value in episode.shares.items():
            shares.setdefault(share, []).append(value)
        objects.append(*episode.report.get("object", [""]))
    named = tuple(objects) if any(objects) else ()
    parts = {name: np.array(values) for name, values in shares.items()}
    return Evaluation(np.array(success), np.array(returned), named, np.array(counted) if counted else None, parts)


def check_can(settings: EnvSettings) -> None:
    """Raise ConfigError for environments whose hand is on no CAN bus."""
    spec = load_spec(settings.hand, settings.side)
    if "torque" not in spec.commands:
        raise ConfigError(f"{spec.name} is on no CAN bus: leave out --can")
    load_wiring(spec.model, spec.serial)


def _rewards(hand: CanBackend, controller: PolicyController, episode: EpisodeBackend) -> Iterator[float]:
    for _ in run(hand, controller):
        yield episode.reward
        if episode.over:
            return


def _on_bus(episode: EpisodeBackend, version: Version) -> CanBackend:
    """A virtual hand whose episode begins with every session."""
    spec = episode.spec
    codec = make_codec(version, load_wiring(spec.model, spec.serial).calibration)
    firmware = Firmware(episode, codec, restart=True)
    bus = LockstepLink(VirtualHands([firmware]), spec.name)
    return CanBackend(spec, codec, bus.port, CanHostSettings(period=episode.period))
