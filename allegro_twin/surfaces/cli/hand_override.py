"""The option --hand: another hand of the same model, or another model with its own scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from allegro_twin.app.config import RunConfig
from allegro_twin.app.simulated import following
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, find_file, read_yaml
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.hands.description.specs import card_side, hand_side, is_hand_model
from allegro_twin.surfaces.cli import console


def on_hand(config: RunConfig, hand: str | None, side: str | None = None) -> RunConfig:
    """A config with another hand: a model, a file of conf/hands, or a side. Raises ConfigError, also for the file of a
    hand of another side than that which the config names of a hand on a bus or port; a simulated hand becomes it."""
    if hand is None and side is None:
        return config
    blocks: dict[str, Any] = {}
    if hand is not None and is_hand_model(hand):
        blocks |= {"model": hand, "serial": ""}
        side = side or card_side(hand)
    elif hand is not None:
        blocks["serial"] = hand
        side = side or _side_of(hand, config)
    if side is not None:
        blocks["side"] = side
    changed = config.changed(hand=blocks)
    if hand is None or changed.hand.model == config.hand.model:
        return changed
    return changed.changed(controller=following(changed.hand))


def _side_of(hand: str, config: RunConfig) -> str | None:
    """The side that a hand's file says. Raises ConfigError where the config names the other for a hand that is
    there."""
    side, own = hand_side(hand), config.hand
    is_there = not getattr(config.backend, "virtual", True)
    if is_there and side is not None and "side" in own.model_fields_set and side != own.side:
        raise ConfigError(f"{hand} is a {side} hand; hand.side is {own.side}: name a config of the {side} hand")
    return side


def model_or_file(hand: str | None) -> tuple[str | None, str]:
    """What --hand names: a model of hand, or one hand's own file; None and "" for what it does not name. Raises
    ConfigError."""
    if hand is None or is_hand_model(hand):
        return hand, ""
    path = find_file(hand, "hand", "conf/hands")
    if "driven" in read_yaml(path):
        return hand, ""
    return None, str(path)


def block_with_file(path: Path, side: str) -> str:
    """The block of a config with one hand's own file, and with its side where it is left and the file does not say it.
    Raises ConfigError."""
    unsaid = side == "left" and hand_side(str(path)) is None
    return f"hand: {{side: left, serial: {path}}}" if unsaid else f"hand: {{serial: {path}}}"


def own_scenarios(paths: list[Path], hand: str | None) -> list[Path]:
    """Replace scenarios by those of another model of hand for the same objects (scenarios/MODEL).

    Prints which it lacks. Raises ConfigError if none has a replacement."""
    if hand is None or not is_hand_model(hand) or not paths:
        return paths
    found, missing = [], []
    for path in paths:
        scenario, _ = load_scenario(path)
        own = data_root() / "scenarios" / hand / f"{hand}_{path.stem}.yaml"
        if scenario.hand == hand:
            found.append(path)
        elif own.is_file():
            found.append(own)
        else:
            missing.append(path.stem)
    if not found:
        raise ConfigError(f"the hand {hand} has no scenario of its own for {', '.join(missing)}: give one, or a grasp")
    if missing:
        console.say(f"{hand} has no grasp of its own for {', '.join(missing)}")
    return found
