"""What `--vary` says, in the units of people: mm, degrees, per cent."""

from __future__ import annotations

from collections.abc import Callable

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.schema import parse_settings
from allegro_twin.grasping.uncertainty import Uncertainty

_UNITS = {"position": 1e-3, "yaw": 1.0, "size": 1e-2, "mass": 1e-2, "torque": 1e-2}
"""From mm, degrees and per cent."""


def varied(text: str) -> Uncertainty:
    """From `position=5,torque=0,friction=0.5-0.9`: half-widths; friction: its smallest and largest value, or 0 for the
    scenario's own. What is left out is as it always is. Raises ConfigError."""
    content: dict[str, object] = {}
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        key, _, value = (piece.strip() for piece in part.partition("="))
        if key not in (*_UNITS, "friction"):
            raise ConfigError("--vary: " + unknown("variation", key, (*_UNITS, "friction")))
        if key in content:
            raise ConfigError(f"--vary: {key} is given twice")
        try:
            content[key] = _friction(value) if key == "friction" else _UNITS[key] * float(value)
        except ValueError as error:
            way = "a number, or two as 0.5-0.9" if key == "friction" else "a number"
            raise ConfigError(f"--vary: {key}={value}: must be {way}") from error
    return parse_settings(Uncertainty, content, "--vary")


def _friction(text: str) -> tuple[float, float] | None:
    number: Callable[[str], float] = float
    low, _, high = text.partition("-")
    values = number(low), number(high or low)
    return None if values == (0.0, 0.0) else (min(values), max(values))
