"""What a virtual hand really is, where that is not what its host believes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from allegro_twin.config import CanSettings
from allegro_twin.description.wiring import NOTHING
from allegro_twin.files.assets import find, read_yaml

_BLOCKS = ("actuation", "drive", "wire")


def truth_of(settings: CanSettings) -> Mapping[str, Any]:
    """The blocks that override a hand's file in a virtual hand's own program. Raises ConfigError."""
    truth = settings.scene.truth if settings.scene is not None else None
    if truth is None:
        return NOTHING
    if isinstance(truth, str):
        table = read_yaml(find(truth, "hand", "conf/hands"))
        return {name: table[name] for name in _BLOCKS if name in table}
    return truth
