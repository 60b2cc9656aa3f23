"""What is written in conf/hands of one hand's electronics: version, side, encoders and motors."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, cast, get_args

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, find, read_yaml
from allegro_twin.hands.description.calibration import N_JOINTS, Calibration, Version
from allegro_twin.spec import Side

_WORDS = {"version": get_args(Version), "side": get_args(Side), "torque_order": ("reversed", "straight"),
          "convention": ("ros", "c")}  # fmt: skip
_WHOLE = ("encoder_offset", "encoder_direction", "motor_direction", "pwm_limit")
_NUMBERS = (*_WHOLE, "torque_constant")
_OLD = ("v1", "v2", "v3")
_ONLY = {**dict.fromkeys(("encoder_direction", "motor_direction", "convention"), _OLD), "torque_order": ("v1",)}
"""Keys that only some versions have a use for."""
NOTHING: Mapping[str, Any] = MappingProxyType({})
HIDDEN = "truth"
"""What overrides a hand's file, in errors."""


class Wiring(NamedTuple):
    """One hand's electronics; None where no file says."""

    version: Version | None
    side: Side | None
    calibration: Calibration


def load_wiring(model: str = "allegro", serial: str = "", over: Mapping[str, Any] = NOTHING) -> Wiring:
    """The nominal hand's `wire` block, overridden key by key by that of conf/hands/<serial>.yaml, and that by `over`.

    Raises ConfigError that names the file and the key.
    """
    files = [data_root() / "conf" / "hands" / f"{model}.yaml"]
    if serial:
        files.append(find(serial, "hand", "conf/hands"))
    tables = [(str(path), read_yaml(path)) for path in files]
    values: dict[str, Any] = {}
    for where, table in [*tables, (HIDDEN, over)]:
        values |= _block(where, table)
        _refuse_useless(where, values)
    return Wiring(values.pop("version", None), values.pop("side", None), Calibration(**values))


def _block(path: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """What one file says, each value checked by itself."""
    block = table.get("wire", {})
    if not isinstance(block, dict):
        raise ConfigError(f"{path}: wire must hold keys and values, not {type(block).__name__}")
    values: dict[str, Any] = {}
    for key, given in block.items():
        if key in _WORDS:
            values[key] = _word(path, key, given)
        elif key in _NUMBERS:
            values[key] = _row(path, key, given)
        else:
            raise ConfigError(f"{path}: wire: {unknown('key', str(key), (*_WORDS, *_NUMBERS))}")
    return values


def _word(path: str, key: str, given: object) -> str:
    if given not in _WORDS[key]:
        raise ConfigError(f"{path}: wire.{key} must be one of {', '.join(_WORDS[key])}, not {given!r}")
    return str(given)


def _row(path: str, key: str, given: object) -> tuple[float, ...]:
    """One value for every joint, or sixteen."""
    row = given if isinstance(given, list) else [given] * N_JOINTS
    kind, name = (int, "whole number") if key in _WHOLE else (int | float, "number")
    for value in row:
        if isinstance(value, bool) or not isinstance(value, kind):
            raise ConfigError(f"{path}: wire.{key} needs a {name} for every joint, not {value!r}")
    try:
        Calibration(**cast(dict[str, Any], {key: tuple(row)}))
    except ConfigError as error:
        raise ConfigError(f"{path}: wire.{error}") from error
    return tuple(row)


def _refuse_useless(path: str, values: dict[str, Any]) -> None:
    """A key that the version does not read would be a calibration that is silently not applied."""
    version = values.get("version")
    for key, versions in _ONLY.items():
        if key in values and version is not None and version not in versions:
            raise ConfigError(f"{path}: wire.{key} means nothing to a {version} hand, only to {', '.join(versions)}")
