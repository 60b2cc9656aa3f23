"""Calibration of an Allegro on CAN: encoder counts to joint positions, torques to PWM, and the PWM limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeAlias, cast, get_args

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, find_file, read_yaml
from allegro_twin.spec import Side

Version: TypeAlias = Literal["v1", "v2", "v3", "v4", "v5", "v5plus"]
N_JOINTS = 16
_ONES = (1,) * N_JOINTS
NOMINAL: Version = "v4"
"""The version whose driver the nominal hand is limited by."""
FULL_SCALE: dict[Version, float] = {
    "v1": 800.0, "v2": 800.0, "v3": 1200.0, "v4": 1200.0, "v5": 1430.0, "v5plus": 1430.0,
}  # fmt: skip
"""Counts at full PWM. v1, v2: R :44-47, L main:48, C :92-95; v3, v4: R4 AllegroHandDrv.cpp:282, L4 main:169; v5 counts
mA: V5R :205, V5R2 :184, V5W :161. docs/reference/can_protocol.md names the sources."""
_TABLE = 3 * (375, 675, 450, 285) + (525, 405, 270, 270)
"""C :55-66, 98-132 (v1 to v3) and R4 AllegroHandDrv.cpp:278-311 (v4)."""
PWM_LIMIT: dict[Version, tuple[int, ...]] = {
    "v1": _TABLE, "v2": _TABLE, "v3": _TABLE, "v4": _TABLE, "v5": (240,) * N_JOINTS, "v5plus": (240,) * N_JOINTS,
}  # fmt: skip
"""The most counts that the manufacturer's driver sends. v5: V5R :272-278, V5R2 :230-235."""


@dataclass(frozen=True, slots=True)
class HandCalibration:
    """The values that turn counts into joint positions and torques on one hand: 16 each, index to thumb, palm outward.

    Raises ConfigError for a wrong number of values, a direction that is not ±1, a constant or limit that is not
    positive.
    """

    encoder_offset: tuple[int, ...] = (0,) * N_JOINTS
    """Counts that an encoder reads at zero (v1–v3: beyond the middle of its range)."""
    encoder_direction: tuple[int, ...] = _ONES
    """±1; v1–v3 only."""
    motor_direction: tuple[int, ...] = _ONES
    """±1; v1–v3 only."""
    torque_constant: tuple[float, ...] = (1.0,) * N_JOINTS
    """N·m at full PWM (v5: at 1430 mA). Nominal: nobody has published it for v1–v4."""
    pwm_limit: tuple[int, ...] | None = None
    """The most counts that may be sent (v5: mA); None: what the manufacturer's driver of the version sends."""
    torque_order: Literal["reversed", "straight"] = "straight"
    """v1 only: whether a finger's four torques go from tip to palm, as on v2 and v3. Sources disagree; the default is
    that of the manufacturer's ROS drivers, which alone ship calibrations of v1 hands."""
    convention: Literal["ros", "c"] = "ros"
    """v1–v3 only: whose formulas the offsets and directions are for, the manufacturer's ROS drivers' or its C driver's.
    They differ where a direction is -1: C :376 turns an encoder about the middle of its range, and C :340 applies the
    motors' directions after the order was reversed, so to the joint at the other end of the finger."""

    def __post_init__(self) -> None:
        for name in ("encoder_offset", "encoder_direction", "motor_direction", "torque_constant", "pwm_limit"):
            values = getattr(self, name)
            if values is not None and len(values) != N_JOINTS:
                raise ConfigError(f"{name} needs 16 values, one a joint; it has {len(values)}")
            if name.endswith("direction") and any(value not in (1, -1) for value in values):
                raise ConfigError(f"{name} must be 1 or -1 for every joint: {list(values)}")
        if not all(0.0 < value < math.inf for value in self.torque_constant):
            raise ConfigError(f"torque_constant must be positive: {list(self.torque_constant)}")
        if self.pwm_limit is not None and not all(value > 0 for value in self.pwm_limit):
            raise ConfigError(f"pwm_limit must be positive: {list(self.pwm_limit)}")

    def pwm_limits(self, version: Version) -> tuple[int, ...]:
        """The most counts that may be sent to each motor of a hand of this version, never more than full PWM."""
        limits = PWM_LIMIT[version] if self.pwm_limit is None else self.pwm_limit
        return tuple(min(limit, int(FULL_SCALE[version])) for limit in limits)

    def torque_limit(self, version: Version) -> tuple[float, ...]:
        """The torque at these counts, N·m: count limit / full scale · torque constant, for each joint."""
        full, doubled = FULL_SCALE[version], double_geared_joints(version)
        return tuple(
            limit / full * constant * (2.0 if joint in doubled else 1.0)
            for joint, (limit, constant) in enumerate(zip(self.pwm_limits(version), self.torque_constant, strict=True))
        )

    def full_torque(self, version: Version) -> tuple[float, ...]:
        """The torque at full PWM, N·m, for each joint: what a motor gives to a driver that does not limit itself."""
        return HandCalibration(torque_constant=self.torque_constant, pwm_limit=(1 << 15,) * N_JOINTS).torque_limit(
            version
        )


def double_geared_joints(version: Version) -> tuple[int, ...]:
    """Joints whose motor is geared down twice as far as the others', so that it needs half the counts for a torque: the
    second of the three fingers on a v5 Plus. V5R2 :189-194, V5W :152-156; V5R halves them on the other type
    (docs/reference/can_protocol.md)."""
    return (1, 5, 9) if version == "v5plus" else ()


_WORDS = {"version": get_args(Version), "side": get_args(Side), "torque_order": ("reversed", "straight"),
          "convention": ("ros", "c")}  # fmt: skip
_WHOLE = ("encoder_offset", "encoder_direction", "motor_direction", "pwm_limit")
_NUMBERS = (*_WHOLE, "torque_constant")
_OLD = ("v1", "v2", "v3")
_ONLY = {**dict.fromkeys(("encoder_direction", "motor_direction", "convention"), _OLD), "torque_order": ("v1",)}
"""Keys that only some versions have a use for."""
NOTHING: Mapping[str, Any] = MappingProxyType({})
HIDDEN = "truth"
"""Name in errors of the values that override a hand's file."""


class Wiring(NamedTuple):
    """Electronics of one hand; None where no file says it."""

    version: Version | None
    side: Side | None
    calibration: HandCalibration


def load_wiring(model: str = "allegro", serial: str = "", over: Mapping[str, Any] = NOTHING) -> Wiring:
    """The nominal hand's `wire` block, overridden key by key by that of conf/hands/<serial>.yaml, and that by `over`.

    Raises ConfigError that names the file and the key.
    """
    files = [data_root() / "conf" / "hands" / f"{model}.yaml"]
    if serial:
        files.append(find_file(serial, "hand", "conf/hands"))
    tables = [(str(path), read_yaml(path)) for path in files]
    values: dict[str, Any] = {}
    for where, table in [*tables, (HIDDEN, over)]:
        values |= _block(where, table)
        _refuse_useless(where, values)
    return Wiring(values.pop("version", None), values.pop("side", None), HandCalibration(**values))


def _block(path: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """The `wire` block of one file, each value checked."""
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
    """One value for all joints, or sixteen."""
    row = given if isinstance(given, list) else [given] * N_JOINTS
    kind, name = (int, "whole number") if key in _WHOLE else (int | float, "number")
    for value in row:
        if isinstance(value, bool) or not isinstance(value, kind):
            raise ConfigError(f"{path}: wire.{key} needs a {name} for every joint, not {value!r}")
    try:
        HandCalibration(**cast(dict[str, Any], {key: tuple(row)}))
    except ConfigError as error:
        raise ConfigError(f"{path}: wire.{error}") from error
    return tuple(row)


def _refuse_useless(path: str, values: dict[str, Any]) -> None:
    """A key that the version does not read would be a calibration that is silently not applied."""
    version = values.get("version")
    for key, versions in _ONLY.items():
        if key in values and version is not None and version not in versions:
            raise ConfigError(f"{path}: wire.{key} means nothing to a {version} hand, only to {', '.join(versions)}")
