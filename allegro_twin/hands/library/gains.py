"""Named controller gains: of a hand of ours in conf/gains, of any other in its card."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from allegro_twin.control.controllers import Gains
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.hands.description.card import card_gains
from allegro_twin.hands.description.specs import card_path
from allegro_twin.spec import HandSpec

_KEYS = ("kp", "kd", "ki", "clamp")


def gains_names(spec: HandSpec) -> tuple[str, ...]:
    """All names of gains of a hand."""
    if "torque" not in spec.commands:
        return ("default",)
    return tuple(_table(spec)[1])


def _table(spec: HandSpec) -> tuple[str, Mapping[str, Any]]:
    """Where the gains of a hand that takes torques are, and all of them by name."""
    card = card_path(spec.card or spec.model)
    if card is None:
        path = data_root() / "conf" / "gains" / f"{spec.model}.yaml"
        return str(path), read_yaml(path)
    return f"{card}: gains", card_gains(card)


def protocol_gains(requested: str | None, spec: HandSpec) -> str:
    """The name of the gains of a protocol; a hand that closes its own loop keeps its own."""
    return requested if requested is not None and "torque" in spec.commands else "default"


def load_gains(name: str, spec: HandSpec) -> Gains:
    """Gains by name, from the hand's card, or for a hand of ours from conf/gains/<model>.yaml; those of its own loop,
    `default`, for a hand that takes positions. Raises ConfigError for an unknown name or a wrong count."""
    if "torque" not in spec.commands:
        if name != "default":
            raise ConfigError(f"{spec.name} closes its own loop: leave out the gains {name!r}")
        stiffness, nothing = spec.actuation.stiffness, np.zeros(spec.n_joints)
        return Gains(nothing if stiffness is None else stiffness, nothing, nothing, nothing)
    path, table = _table(spec)
    if not table:
        raise ConfigError(
            f"{path}: none, and {spec.name} takes torques: write `gains: {{{name}: {{kp: [...], kd: [...], ki: [...], "
            "clamp: [...]}}` into the card; `hand new` chooses some"
        )
    if name not in table:
        raise ConfigError(f"{path}: {unknown('gains', name, table)}")
    row = table[name]
    wrong = sorted(set(row) ^ set(_KEYS))
    if wrong:
        raise ConfigError(f"{path}: {name} needs exactly {', '.join(_KEYS)}; see {', '.join(wrong)}")
    gains = Gains(*(spec.vector(row[key], f"{path}: {name}.{key}") for key in _KEYS))
    if any((values < 0).any() for values in (gains.kp, gains.kd, gains.ki, gains.clamp)):
        raise ConfigError(f"{path}: {name}: gains must not be negative")
    return gains
