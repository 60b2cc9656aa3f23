"""Writes the identified values into a hand's own file: all or nothing, with recordings, engine and intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import parse_yaml, refuse_shipped
from allegro_twin.files.yaml_edit import has_content, lock_file, read_text, replace_document, set_note, write_text
from allegro_twin.hands.description.calibration import HandCalibration, Version, load_wiring
from allegro_twin.sim.engine.backend import ENGINE
from allegro_twin.sim.open_loop import PARASITIC, WARMTH
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.fitting.fit import DriveFit
from allegro_twin.twin.identify.fitting.parameterisation import PLAY, PULLED, SHAPE, TEETH
from allegro_twin.twin.identify.motions.motion import RecordedMotion
from allegro_twin.twin.identify.results.uncertainty import PER_PWM, IdentifiedValue, value_correlations
from allegro_twin.twin.identify.results.written_drive import (
    NONE,
    WrittenDrive,
    choose_drive,
    replacements,
    unwritten,
)
from allegro_twin.types import Vector
from allegro_twin.version import __version__

SCALE = {
    "known": "the link masses in this file, declared to be right",
    "assumed": "the link masses of the model, assumed: all N·m here are as far off as these are",
    "weighed": "a known weight at a fingertip",
}
NOTHING_WRITTEN = "nothing is written: the nominal hand predicts what the fit has not seen best"
BY_WEIGHT, FROM_FILE = "by weight", "as the file had them"
"""Where a hand's encoder offsets are from, in its `identified` block."""
_NOTE = "Found by `allegro-twin identify`"
_DIGITS = 6


def write_hand_file(
    path: Path, found: DriveFit, values: Mapping[str, IdentifiedValue], motions: Sequence[RecordedMotion], day: str
) -> str:
    """Write the determined values into a hand's file, and leave everything else in it as it is. Returns a note on that,
    or nothing. Raises ConfigError for a file that ships, for a file of another hand, or one with another calibration
    than the recordings; RecordingError."""
    with lock_file(path):
        text = read_text(path)
        content = parse_yaml(text, str(path)) if has_content(text) else {}
        check_hand_file(path, content, motions)
        blocks = _blocks(path, content, found, values, motions, day)
        if not blocks:
            return NOTHING_WRITTEN
        made = replace_document(text, content | blocks, str(path))
        kept = _kept_offsets(path, content, motions[0])
        write_text(path, set_note(made, ("identified",), _NOTE, f", {day}; docs/explanation/identification.md"))
    return " ".join(filter(None, (_strength_note(path, content), _offset_note(path, kept, values, motions))))


def _strength_note(path: Path, content: Mapping[str, Any]) -> str:
    if "strength" not in (content.get("drive") or {}):
        return ""
    return f"drive.strength is out of {path}: wire.torque_constant, which was found, holds it."


def _offset_note(
    path: Path, kept: tuple[int, ...] | None, values: Mapping[str, IdentifiedValue], motions: Sequence[RecordedMotion]
) -> str:
    """Difference of kept encoder offsets from those by weight, rad, as a sentence; empty where none are kept."""
    if kept is None:
        return ""
    apart = np.abs(values["offset"].value - offset_shift(motions[0].version, motions[0].calibration, kept))
    apart = np.where(values["offset"].identifiable, apart, 0.0)
    most = int(apart.argmax())
    other = f": {motions[0].name} was recorded with others" if kept != motions[0].calibration.encoder_offset else ""
    return (
        f"The encoder offsets in {path} stay as they were{other}. By weight "
        f"they are up to {1000 * apart[most]:.1f} mrad from that ({_joint(motions[0].spec, most)}); take "
        "`wire.encoder_offset` out of the file to have that instead."
    )


def _kept_offsets(path: Path, content: Mapping[str, Any], first: RecordedMotion) -> tuple[int, ...] | None:
    """Encoder offsets, counts, that the file has from elsewhere, as from `calibrate`: the ends of the joints tell them
    to a fraction of a milliradian, weight to some. None where it has none, or those of an identification."""
    if "encoder_offset" not in (content.get("wire") or {}):
        return None
    written = load_wiring(serial=str(path)).calibration.encoder_offset
    identified = content.get("identified")
    own = identified is not None and identified.get("encoder_offset") != FROM_FILE
    return None if own and written == first.calibration.encoder_offset else written


def check_hand_file(path: Path, content: Mapping[str, Any], motions: Sequence[RecordedMotion]) -> None:
    """Raise ConfigError where the recordings are not of the file's hand as the file has it, and for a file that
    ships."""
    refuse_shipped(path)
    wire, first = content.get("wire") or {}, motions[0]
    for key, value in (("version", first.version), ("side", first.spec.side)):
        if wire.get(key, value) != value:
            raise ConfigError(f"{path} is of a {wire[key]} hand, {first.name} of a {value} one: choose another file")
    if not content:
        return  # It is to be made, or filled.
    written = load_wiring(serial=str(path)).calibration.encoder_offset
    used = first.calibration.encoder_offset
    if written != used and "identified" in content:
        raise ConfigError(
            f"{path} has encoder offsets that {first.name} was not recorded with: record again with "
            f"`hand: {{serial: {path}}}`, or identify into a new file"
        )


def drive_to_write(
    path: Path, content: Mapping[str, Any], found: DriveFit, values: Mapping[str, IdentifiedValue],
    motions: Sequence[RecordedMotion],
) -> WrittenDrive:  # fmt: skip
    """The drive that a hand's file, whose content this is, gets."""
    first, drive = motions[0], content.get("drive") or {}
    before, kept = replacements(first, float(drive.get("delay", 0.0)), found), _kept_offsets(path, content, first)
    stays = {}
    if kept is not None:
        stays["offset"] = np.ones(first.spec.n_joints, dtype=bool)
        before = replace(before, offset=offset_shift(first.version, first.calibration, kept))
    # Already part of the identified values.
    before = replace(before, torque_constant=before.torque_constant * np.array(drive.get("strength", 1.0)))
    return choose_drive(found, values, motions, before, stays)


def _blocks(
    path: Path,
    content: Mapping[str, Any],
    found: DriveFit,
    values: Mapping[str, IdentifiedValue],
    motions: Sequence[RecordedMotion],
    day: str,
) -> dict[str, Any]:
    first, kept = motions[0], _kept_offsets(path, content, motions[0])
    spec, drive, doubted = first.spec, dict(content.get("drive") or {}), unwritten(values)
    chosen = drive_to_write(path, content, found, values, motions)
    if chosen.is_nominal:
        return {}
    own, source = chosen.drive, np.array(chosen.source)
    drive.pop("strength", None)
    actuation = dict(content.get("actuation") or {}) | {name: _plain(getattr(own, name)) for name in PER_PWM}
    wire = dict(content.get("wire") or {}) | {"version": first.version, "side": spec.side}
    wire["torque_constant"] = _plain(own.torque_constant)
    wire["encoder_offset"] = _offsets(first, own.offset) if kept is None else list(kept)
    drive = {
        name: value for name, value in drive.items() if name not in (*SHAPE, *PLAY, *TEETH, *PARASITIC, *WARMTH, "tilt")
    }
    drive["delay"] = float(f"{own.delay[0]:.3g}")
    for name, none in NONE.items():
        if name in doubted:
            without = (source == "nominal") | ((source == "determined") & doubted[name])
            drive[name] = _plain(np.where(without, none, getattr(own, name)))
    if found.extras.parasitic:
        drive |= {name: _plain(getattr(own, name)) for name in ("cogging_periods", "ripple_periods")}
    if found.extras.warming:
        drive["warm_up"] = _plain(own.warm_up)
    if len(own.tilt):
        drive["tilt"] = _plain(own.tilt[0])
    if found.masses == "weighed":
        drive["mass_scale"] = _plain(own.mass_scale)
    blocks = {"wire": wire, "actuation": actuation, "drive": drive}
    origin = {"encoder_offset": BY_WEIGHT if kept is None else FROM_FILE}
    return blocks | {"identified": _basis(found, values, motions, spec, day) | origin | _proof(chosen, spec)}


def _proof(chosen: WrittenDrive, spec: HandSpec) -> dict[str, Any]:
    """What was written, joint by joint, and how well it predicts what the fit has not seen."""
    if not chosen.errors:
        return {"written": "determined values; the recordings are too short to keep a part back"}
    table = {name: _plain(row) for name, row in chosen.errors.items()}
    labels = {joint: chosen.source[k] for k, joint in enumerate(spec.joint_labels)}
    return {"written": labels, "kept_back": {"seconds": float(f"{chosen.seconds:.3g}"), "rms_rad": table}}


def _basis(
    found: DriveFit, values: Mapping[str, IdentifiedValue], motions: Sequence[RecordedMotion], spec: HandSpec, day: str
) -> dict[str, Any]:
    """Date, recordings, engine, units, intervals."""
    missing = {
        name: {_joint(spec, k): why for k, why in enumerate(value.reason) if why} for name, value in values.items()
    }
    return {
        "date": day,
        "program": f"allegro-twin {__version__}",
        "engine": ENGINE,
        "recordings": {motion.name: motion.hash for motion in motions},
        "scale": SCALE[found.masses],
        "friction": "LuGre" if found.bristly else "Coulomb",
        "backlash": "seen" if found.loose else "none seen",
        "units": "per_pwm: armature, damping, frictionloss and parasitic torque over the torque constant; "
        "torque_constant N·m at full PWM; "
        "offset and backlash rad; delay s; interval: half of 95 %; "
        "correlation: of a joint's values, below the diagonal",
        "per_pwm": {name: _plain(values[name].value) for name in values if name in PULLED},
        "value": {name: _plain(values[name].value) for name in values if name not in PULLED},
        "interval": {name: _plain(value.half) for name, value in values.items()},
        "correlation": _correlations(found, values, spec),
        "not_determined": {name: table for name, table in missing.items() if table},
        "residual": _plain(found.spread.residual),
        "noise": _plain(found.floor),
    }


def _correlations(found: DriveFit, values: Mapping[str, IdentifiedValue], spec: HandSpec) -> dict[str, Any]:
    """Correlations of each joint's values with each other: the lower triangle, row by row."""
    names = [name for name, value in values.items() if len(value.value) == spec.n_joints]
    below = np.tril_indices(len(names), -1)
    matrices = value_correlations(found, names)
    rows = {_joint(spec, k): [round(each, 3) for each in matrices[k][below].tolist()] for k in range(spec.n_joints)}
    return {"of": names} | rows


def mismatch_warning(path: Path) -> str:
    """Why the values in a hand's file may not fit this program; empty where they do."""
    table = parse_yaml(read_text(path), str(path)) if path.exists() else {}
    engine = (table.get("identified") or {}).get("engine", ENGINE)
    if engine == ENGINE:
        return ""
    return f"{path} was identified under {engine}, and this is {ENGINE}, whose friction may differ: identify it again"


def offset_shift(version: Version, used: HandCalibration, encoder_offset: tuple[int, ...]) -> Vector:
    """Shift of positions, (n,), rad, that were read with one calibration when other encoder offsets, counts, are
    right."""
    right = replace(used, encoder_offset=encoder_offset)
    one, other = (make_codec(version, each).positions.values(bytes(32)) for each in (used, right))
    return one - other


def _offsets(motion: RecordedMotion, offset: Vector) -> list[int]:
    """Encoder offsets, counts, that correct positions which are too high by `offset`, rad."""
    old = motion.calibration
    # Change of a position by one count of offset, rad; each version has its own.
    step = -offset_shift(motion.version, old, tuple(count + 1 for count in old.encoder_offset))
    counts = np.rint(-offset / step)
    return [count + int(added) for count, added in zip(old.encoder_offset, counts, strict=True)]


def _joint(spec: HandSpec, number: int) -> str:
    return spec.joint_labels[number]


def _plain(row: Vector) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in row.tolist()]
