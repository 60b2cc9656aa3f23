"""From a hand's files to its HandSpec: the table of facts, and the calibration in conf/hands."""

from __future__ import annotations

from typing import Any

from allegro_twin.assets import data_root, find, read_yaml
from allegro_twin.description import facts
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.spec import Actuation, Finger, HandSpec, Side, aliases
from allegro_twin.types import frozen

_ACTUATION = ("torque_limit", "damping", "armature", "frictionloss")


def load_spec(model: str = "allegro", side: Side = "right", serial: str = "") -> HandSpec:
    """The spec of a hand: nominal, or with what conf/hands/<serial>.yaml says of that very hand.

    Raises ConfigError that names the file and the key.
    """
    hand = facts.load(model, side)
    fingers = tuple(
        Finger(name, joints, f"link_{joints[-1]}.0_tip") for name, joints in hand.fingers.items()
    )
    joints = hand.joints
    spec = HandSpec(
        model=model,
        side=side,
        joints=tuple(joint.name for joint in joints),
        fingers=fingers,
        lower=frozen([joint.lower for joint in joints]),
        upper=frozen([joint.upper for joint in joints]),
        actuation=load_actuation(model, len(joints), serial),
        mirror_flips=hand.mirror_flips,
        serial=serial,
        aliases=aliases(fingers, len(joints)),
    )
    return spec


def load_actuation(model: str, n_joints: int, serial: str = "") -> Actuation:
    """Motors of the nominal hand, overridden key by key by the hand's own file where it has an `actuation` block."""
    values = _actuation_block(data_root() / "conf" / "hands" / f"{model}.yaml")
    if serial:
        values = values | _actuation_block(find(serial, "hand", "conf/hands"))
    arrays = {}
    for key in _ACTUATION:
        given = values[key]
        row = [given] * n_joints if isinstance(given, int | float) else given
        if not isinstance(row, list) or len(row) != n_joints or not all(isinstance(v, int | float) for v in row):
            raise ConfigError(f"hand {serial or model}: actuation.{key} needs one number or {n_joints}, not {given!r}")
        arrays[key] = frozen(row)
        if (arrays[key] < 0).any():
            raise ConfigError(f"hand {serial or model}: actuation.{key} must not be negative: {given!r}")
    return Actuation(**arrays)


def _actuation_block(path: Any) -> dict[str, Any]:
    block = read_yaml(path).get("actuation", {})
    for key in block:
        if key not in _ACTUATION:
            raise ConfigError(f"{path}: actuation: {unknown('key', key, _ACTUATION)}")
    return dict(block)
