"""Policies of `ArmPick`: the card in their files, and how one is loaded."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse_settings
from allegro_twin.learning.policy.card import ARM_PICK, NetworkCard, read_network_card
from allegro_twin.learning.policy.controller import Policy
from allegro_twin.learning.policy.loading import onnx_policy, policy_file
from allegro_twin.pick.settings import PickSettings

VARIED = ("objects", "place", "off", "friction", "camera_shift", "camera_turn", "camera_delay", "seconds")
"""Keywords of environments that a policy may meet with other values than those of its training."""


class PickCard(NetworkCard):
    """Card of a policy that moves an arm with its hand."""

    task: str = ARM_PICK
    environment: dict[str, Any]
    """Keywords of the environments that it was trained in."""

    def settings(self) -> PickSettings:
        """The environments that it was trained in."""
        return parse_settings(PickSettings, self.environment, "a policy of ArmPick: environment")


@dataclass(frozen=True, slots=True, eq=False)
class PickPolicy:
    """A policy and its card."""

    policy: Policy
    card: PickCard


def read_pick_card(path: str | Path) -> PickCard:
    """The card of a policy's file, by its path or by the name of one that ships. Raises ConfigError for another
    task's."""
    return read_network_card(policy_file(path), PickCard, ARM_PICK)


def load_pick_policy(path: str | Path) -> PickPolicy:
    """A policy by its path or by the name of one that ships: `policy(observation)` is the action. Raises ConfigError
    for another task's, and for a file that is none."""
    file = policy_file(path)
    card = read_pick_card(file)
    if file.suffix != ".onnx":
        raise ConfigError(f"{path}: a policy of ArmPick ends in .onnx")
    return PickPolicy(onnx_policy(file, card), card)


def trained_keywords(policy: object, keywords: dict[str, Any]) -> dict[str, Any]:
    """Keywords of the environments in which a policy was trained, and of these the ones that it may meet with other
    values. Raises ConfigError for others that differ."""
    if not isinstance(policy, str | Path) or not str(policy):
        raise ConfigError(f"policy is the path of a policy's file, or the name of one that ships, not {policy!r}")
    card = read_pick_card(policy)
    trained, given = card.settings(), parse_settings(PickSettings, keywords, "environment")
    if found := contradiction(trained, given, given.model_fields_set):
        key, its, value = found
        raise ConfigError(f"policy {policy} was trained with {key} {its}, not {value}: leave out {key}, or leave "
                          "out policy and load it with load_pick_policy")  # fmt: skip
    return trained.keywords() | keywords


def contradiction(trained: PickSettings, given: PickSettings, keys: Iterable[str]) -> tuple[str, object, object] | None:
    """The first of these keys that must be as in the training and is not, with its value there and here."""
    for key in sorted({*keys} - {*VARIED}):
        if (its := getattr(trained, key)) != (value := getattr(given, key)):
            return key, its, value
    return None
