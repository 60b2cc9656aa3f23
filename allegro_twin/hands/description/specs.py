"""HandSpec of a hand from its files: the table of facts, and what was measured on it in conf/hands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin._lazy import entry_points_of
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, find_file, read_yaml
from allegro_twin.files.schema import parse_settings
from allegro_twin.hands.description import arms, facts
from allegro_twin.hands.description.calibration import HIDDEN, NOMINAL, NOTHING, Version, load_wiring
from allegro_twin.hands.description.card import ThermalCard, spec_from_card
from allegro_twin.spec import SIDES, Actuation, CommandKind, Finger, ForeignModel, HandSpec, Side
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.spec.hand import aliases, check_side
from allegro_twin.spec.thermal import ThermalData
from allegro_twin.types import Vector, frozen

GROUP = "allegro_twin.hands"
_MOTOR = ("damping", "armature", "frictionloss")
_ACTUATION = (*_MOTOR, "torque_limit", "stiffness")


def load_spec(
    model: str = "allegro",
    side: Side | None = None,
    serial: str = "",
    version: Version | None = None,
    over: Mapping[str, Any] = NOTHING,
) -> HandSpec:
    """The spec of a hand, or of an arm: nominal, or with what conf/hands/<serial>.yaml says of that very hand.

    `side`: None is that of the hand's card, and of a hand without one the right.

    `version` is the hand's, where its file does not say; it decides how much torque its driver lets through. `over`
    overrides the file key by key. Raises ConfigError that names the file and the key, and for another side.
    """
    if side is not None:
        check_side(side)
    side = side or card_side(model) or "right"
    if model in arms.arm_names():
        return _arm(model, side, serial)
    its = hand_side(serial) if serial else None
    if its is not None and its != side:
        raise ConfigError(f"{serial} is a {its} hand; hand.side is {side}")
    if not facts.has_facts(model):
        return _by_card(model, side, serial)
    _check_own(model, serial)
    hand = facts.load_facts(model, side)
    lower, upper = _limits(hand.joints, serial)
    fingers = tuple(Finger(name, joints, f"{hand.last_link(name).name}_tip") for name, joints in hand.fingers.items())
    joints = hand.joints
    return HandSpec(
        model=model,
        side=side,
        joints=tuple(joint.name for joint in joints),
        fingers=fingers,
        lower=lower,
        upper=upper,
        actuation=load_actuation(model, len(joints), serial, version, over),
        mirror_flips=hand.mirror_flips,
        serial=serial,
        aliases=aliases(fingers, len(joints)),
        foreign=_foreign(serial, [finger.name for finger in fingers], len(joints)) if serial else None,
        commands=_commands(model),
        drive=_drive(len(joints), serial, over),
        thermal=_thermal(model, serial, over),
    )


def _arm(model: str, side: Side, serial: str) -> HandSpec:
    if side != "right" or serial:
        raise ConfigError(
            f"{model} is an arm, and an arm has no side and no file of its own: leave out side and serial"
        )
    return arms.load_arm_spec(model)


def _check_own(model: str, serial: str) -> None:
    """Raises ConfigError for a file that is not of one hand of this model: that of another model, or one that speaks of
    electronics that this model does not have."""
    if not serial:
        return
    path = find_file(serial, "hand", "conf/hands")
    if serial != model and is_hand_model(serial):
        raise ConfigError(f"{path} is not of one {model}: it says what every {path.stem} is; name that hand's own file")
    if "wire" not in read_yaml(_nominal(model)) and "wire" in read_yaml(path):
        raise ConfigError(f"{path} is not of a {model}: it has a `wire` block, and no hand of that model is on CAN")


def is_hand_model(name: str) -> bool:
    """Whether it names a model of hand, not one hand of a model: by its facts, or a card."""
    if facts.has_facts(name):
        return True
    if name in installed_hands():
        return True
    path = Path(name) if Path(name).suffix == ".yaml" else data_root() / "conf" / "hands" / f"{name}.yaml"
    return path.is_file() and "driven" in read_yaml(path)


def names_shipped_hand(name: str) -> bool:
    """Whether a model of hand of this name ships, so that no other may have it."""
    return is_hand_model(name) and name not in installed_hands() and not Path(name).suffix


def installed_hands() -> tuple[str, ...]:
    """Hands that installed packages add by the entry point `allegro_twin.hands`, whose value is the path of a card, or
    a function without arguments that returns it. Hands of this package have their names first."""
    own = data_root() / "conf" / "hands"
    return tuple(name for name in sorted(entry_points_of(GROUP)) if not (own / f"{name}.yaml").is_file())


def card_path(model: str) -> Path | None:
    """The card of a model of hand, by its name or path; None: its name is one of our own, described by facts."""
    return None if facts.has_facts(model) else _card_path(model)


def card_side(model: str) -> Side | None:
    """The side of a hand as its card says it; None for a hand without one, and where the card cannot be read:
    `load_spec` says why."""
    try:
        path = None if model in arms.arm_names() else card_path(model)
        side = None if path is None else read_yaml(path).get("side", "right")
    except ConfigError:
        return None
    return next((each for each in SIDES if each == side), None)


def _card_path(model: str) -> Path:
    """Raises ConfigError with the nearest names, or with what is wrong with a package."""
    if model not in installed_hands():
        stems = [file.stem for file in (data_root() / "conf" / "hands").glob("*.yaml")]
        bare = Path(model).name == model and not Path(model).suffix and not Path(model).is_file()
        if bare and not get_close_matches(model, stems, cutoff=0.5):  # Of which nobody wants every serial number.
            raise ConfigError(unknown("hand", model, filter(is_hand_model, stems)) + "; or the path of a card")
        return find_file(model, "hand", "conf/hands")
    point = entry_points_of(GROUP)[model]
    try:
        value = point.load()
        path = Path(value() if callable(value) else value)
    except Exception as error:  # A package of somebody else's may raise anything.
        raise ConfigError(f"hand {model}: {point.value} of an installed package: {error}") from error
    if not path.is_file():
        raise ConfigError(f"hand {model}: {point.value} says {path}, which is no file")
    return path


_OWN_BLOCKS = {"wire", "actuation", "drive", "limits", "identified"}
"""Blocks of one hand's own file, which distinguish it from a card."""


def _by_card(model: str, side: Side, serial: str) -> HandSpec:
    path = _card_path(model)
    if serial:
        raise ConfigError(f"{path} is the hand's only file: leave out hand.serial ({serial})")
    content = read_yaml(path)
    if "driven" not in content and _OWN_BLOCKS & content.keys():
        raise ConfigError(f"{path} is one hand's own file, and a model of hand is wanted: a config has it as `hand: "
                          f"{{serial: {path}}}`, `run` and `evaluate` as --hand, `plan` as --twin")  # fmt: skip
    name = Path(model).stem
    if names_shipped_hand(name) and path.resolve() != (data_root() / "conf" / "hands" / f"{name}.yaml").resolve():
        raise ConfigError(f"{path}: {name} is a hand that ships, whose postures and grasps are not this one's: rename "
                          f"the card, to my_{name}.yaml")  # fmt: skip
    found = spec_from_card(path, name, side)
    return replace(found, card=str(path)) if Path(model).suffix == ".yaml" else found


def hand_side(serial: str) -> Side | None:
    """The side of the hand in a file in conf/hands, where the file says it. Raises ConfigError."""
    return load_wiring(serial=serial).side


def _limits(joints: tuple[facts.JointFacts, ...], serial: str) -> tuple[Vector, Vector]:
    """The model's joint limits, or those that were measured on this very hand."""
    lower, upper = frozen([joint.lower for joint in joints]), frozen([joint.upper for joint in joints])
    if not serial:
        return lower, upper
    path = find_file(serial, "hand", "conf/hands")
    measured = read_yaml(path).get("limits")
    if measured is None:
        return lower, upper
    if not isinstance(measured, dict) or set(measured) != {"lower", "upper"}:
        raise ConfigError(f"{path}: limits needs exactly lower and upper, {len(joints)} numbers each, rad")
    for name, row in measured.items():
        if not isinstance(row, list) or len(row) != len(joints) or not all(isinstance(v, int | float) for v in row):
            raise ConfigError(f"{path}: limits.{name} needs {len(joints)} numbers, rad")
    lower, upper = frozen(measured["lower"]), frozen(measured["upper"])
    if not (lower < upper).all():
        bad = int(np.argmin(upper - lower))
        raise ConfigError(f"{path}: limits of {joints[bad].name}: {lower[bad]} is not below {upper[bad]}")
    return lower, upper


def _foreign(serial: str, fingers: list[str], n_joints: int) -> ForeignModel | None:
    """The name map in a hand's file, where it simulates somebody else's MJCF. A relative path is the file's own."""
    path = find_file(serial, "hand", "conf/hands")
    table = read_yaml(path)
    if "mjcf" not in table:
        return None
    for key in ("root", "joints", "tips"):
        if key not in table:
            raise ConfigError(f"{path}: a hand with `mjcf` also needs `{key}`")
    if len(table["joints"]) != n_joints:
        raise ConfigError(f"{path}: joints has {len(table['joints'])} names; the hand has {n_joints}")
    if set(table["tips"]) != set(fingers):
        raise ConfigError(f"{path}: tips must name {', '.join(fingers)}; it names {', '.join(table['tips'])}")
    tips = {finger: (str(body), facts.triple(offset)) for finger, (body, offset) in table["tips"].items()}
    mjcf = Path(table["mjcf"])
    found = mjcf if mjcf.is_absolute() or mjcf.is_file() else path.parent / mjcf
    return ForeignModel(str(found), str(table["root"]), tuple(map(str, table["joints"])), tips)


def load_actuation(
    model: str, n_joints: int, serial: str = "", version: Version | None = None, over: Mapping[str, Any] = NOTHING
) -> Actuation:
    """Motors of the nominal hand, overridden key by key by the hand's own file where it has an `actuation` block.

    The torque limit follows from the counts that the driver may send and from what a count is in N·m; a file that gives
    `torque_limit`, N·m, lowers it.
    """
    nominal = _nominal(model)
    values = _block(str(nominal), read_yaml(nominal), "actuation", _ACTUATION)
    for where, table in _own(serial, over):
        values |= _block(where, table, "actuation", _ACTUATION)
    arrays = {key: _row(values[key], key, n_joints, serial or model) for key in values}
    if "wire" in read_yaml(nominal):
        wiring = load_wiring(model, serial, over)
        clip = frozen(wiring.calibration.torque_limit(wiring.version or version or NOMINAL))
        arrays["torque_limit"] = frozen(np.minimum(clip, arrays.get("torque_limit", clip)))
    return Actuation(**arrays)


def _nominal(model: str) -> Path:
    """The file that holds for every hand of a model."""
    return data_root() / "conf" / "hands" / f"{model}.yaml"


def _commands(model: str) -> tuple[CommandKind, ...]:
    return tuple(read_yaml(_nominal(model)).get("commands", ("torque",)))


def _row(given: object, key: str, n_joints: int, hand: str) -> Vector:
    row = [given] * n_joints if isinstance(given, int | float) else given
    if not isinstance(row, list) or len(row) != n_joints or not all(isinstance(v, int | float) for v in row):
        raise ConfigError(f"hand {hand}: actuation.{key} needs one number or {n_joints}, not {given!r}")
    array = frozen(row)
    if (array < 0).any():
        raise ConfigError(f"hand {hand}: actuation.{key} must not be negative: {given!r}")
    return array


def _drive(n_joints: int, serial: str, over: Mapping[str, Any]) -> Drive | None:
    """The `drive` block of a hand's file, where it has one."""
    values: dict[str, Any] = {}
    for where, table in _own(serial, over):
        values |= _block(where, table, "drive", None)
        try:
            Drive.from_values(values, n_joints)
        except ConfigError as error:
            raise ConfigError(f"{where}: drive{error}") from error
    return Drive.from_values(values, n_joints) if values else None


def _thermal(model: str, serial: str, over: Mapping[str, Any]) -> ThermalData | None:
    """The `thermal` block of the model, or of the hand's own file in its place; None: neither has one."""
    found: ThermalData | None = None
    nominal = _nominal(model)
    for where, table in ((str(nominal), read_yaml(nominal)), *_own(serial, over)):
        if "thermal" in table:
            found = parse_settings(ThermalCard, table["thermal"], f"{where}: thermal").data()
    return found


def _own(serial: str, over: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The blocks for one hand, of its file and of what overrides it, each with its source."""
    if serial:
        path = find_file(serial, "hand", "conf/hands")
        yield str(path), read_yaml(path)
    if over:
        yield HIDDEN, over


def _block(where: str, table: Mapping[str, Any], name: str, known: Sequence[str] | None) -> dict[str, Any]:
    block = table.get(name) or {}
    if not isinstance(block, Mapping):
        raise ConfigError(f"{where}: {name} must hold keys and values, not {type(block).__name__}")
    for key in block:
        if known is not None and key not in known:
            raise ConfigError(f"{where}: {name}: {unknown('key', str(key), known)}")
    return dict(block)
