"""Checks of a recording that is read: its metadata, its columns and the order of its rows."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, NamedTuple, get_args

import numpy as np
import pyarrow as pa

from allegro_twin.errors import RecordingError
from allegro_twin.recording.arrow_writer import FORMAT, SHARED, TRACKS
from allegro_twin.recording.spec_json import spec_from_json
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Array

_ROWS = ("position", "velocity", "torque", "temperature")
STRONGEST = 500.0
"""m/s², gravity: some 50 g, more than the IMU of any hand measures."""
NOT_RADIANS = 3.0
"""Times a joint's furthest end, in most joints, from which on positions are not in rad; degrees are 57 times them."""
FEW = 10
"""Rows of which nothing is said about their clock."""
OFF = 2.0 / 3.0
"""Share of the period, and its inverse, from which on times contradict it."""
_COMMANDS = (("command_torque",), ("command_position", "command_effort", "command_duration"))


def stream_metadata(name: str, schema: pa.Schema) -> dict[str, Any]:
    """The metadata of a stream; `name` stands for it in error messages. Raises RecordingError for a stream of something
    else, of a version that this program does not know, and for metadata that are damaged."""
    text = (schema.metadata or {}).get(b"allegro_twin")
    try:
        meta = json.loads(text) if text else {}
    except ValueError as error:  # Also of bytes that are no text.
        raise RecordingError(f"{name}: its metadata are no JSON: {error}") from error
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise RecordingError(f"{name} is an Arrow stream of something else: its schema has no {FORMAT!r} metadata")
    version = meta.get("version")
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise RecordingError(f"{name}: metadata: version is {version!r}, not a whole number from 1")
    if version > SHARED:
        raise RecordingError(f"{name} has format version {version}; this program reads up to {SHARED}: upgrade it")
    if version == SHARED and schema.remove_metadata() != TRACKS:
        raise RecordingError(f"{name} is of a cell and has not the columns {', '.join(TRACKS.names)}")
    return meta


def check_recording(
    name: str, meta: Mapping[str, Any], columns: Mapping[str, Array], *, partial: bool | None = False
) -> Mapping[str, Array]:
    """The columns; if `partial`, of the rows before the first that is wrong; None: what is read has no such choice.

    Raise RecordingError, which names the metadata, or the column and the row, unless a recording of a device can be
    replayed: all columns of a state and of a command, as wide as its hand, numbers; no row is a `bad_row`; `t` and
    `tick` increase together as the period says; positions are rad (`check_radians`). Rows count from 0. Columns that a
    hand need not report may have NaN (`missed.hold_missed`), and ticks may jump.
    """
    spec = _check_metadata(name, meta)
    n = spec.n_joints
    widths: dict[str, int | None] = {"t": None, "tick": None, **dict.fromkeys(_ROWS, n), "gravity": 3}
    command = next((each for each in _COMMANDS if each[0] in columns), _COMMANDS["torque" not in spec.commands])
    for each in command:
        widths[each] = 1 if each == "command_duration" else spec.n_actuators
    for each, width in widths.items():
        _check_column(name, columns, each, width)
    found = bad_row(columns)
    if found is not None and partial and found.row:
        columns = {each: values[: found.row] for each, values in columns.items()}
    elif found is not None:
        rest = f"; with --partial the {found.row} rows before it are read" if found.row and partial is not None else ""
        raise RecordingError(f"{name}: row {found.row}: {found.why}{found.cause}{rest}")
    _check_clock(name, float(meta["period"]), columns["t"], columns["tick"])
    check_radians(name, columns["position"], spec)
    return columns


class BadRow(NamedTuple):
    """The first row that no reader takes."""

    row: int
    why: str
    cause: str = ""
    """What the rows of a file have been through that was written whole."""


def bad_row(columns: Mapping[str, Array], before: tuple[float, float] = (-math.inf, -math.inf)) -> BadRow | None:
    """The first of some rows (k,) or (k, width) that cannot be replayed, by the columns of a state and a command:
    positions and commands are finite; no value is infinite, and gravity is what an IMU can measure; t and tick, which
    were `before` the first row, increase."""
    found: list[BadRow] = []
    command = next(each[0] for each in _COMMANDS if each[0] in columns)
    for each in ("t", "tick", "position", command):
        bad = ~np.isfinite(columns[each])
        if bad.any():
            row, *place = (int(k) for k in np.argwhere(bad)[0])
            what = f"{each}[{place[0]}]" if place else each
            found.append(BadRow(row, f"{what} is {columns[each][row, *place]}, not a finite number"))
    for each, most in (("velocity", np.inf), ("torque", np.inf), ("gravity", STRONGEST)):
        beyond = np.abs(columns[each]) >= most
        if beyond.any():
            row, joint = (int(k) for k in np.argwhere(beyond)[0])
            value, at = columns[each][row, joint], columns["t"][row]
            why = f"{each}[{joint}] is {value:g} at {at:.3f} s, which no hand reports"
            found.append(BadRow(row, why, ": the file is damaged; make it NaN, which is unknown, or record again"))
    for each, last in (("tick", before[1]), ("t", before[0])):
        bad = np.diff(columns[each], prepend=last) <= 0
        if bad.any():
            row = int(np.argmax(bad))
            earlier = columns[each][row - 1] if row else last
            why = f"{each} is {columns[each][row]:g} after {earlier:g}; it must increase"
            found.append(BadRow(row, why, ": rows were repeated or moved"))
    return min(found, key=lambda each: each.row, default=None)


def check_radians(name: str, position: Array, spec: HandSpec) -> None:
    """Raise RecordingError where positions, (k, n), are several times beyond the joints' ranges in most joints: they
    are not in rad."""
    ends = np.maximum(np.abs(spec.lower), np.abs(spec.upper))
    furthest = np.nan_to_num(np.fmax.reduce(np.abs(position), axis=0))
    beyond = float(np.median(furthest / np.maximum(ends, 1e-3)))
    if not beyond > NOT_RADIANS:
        return
    unit = "they are in degrees: divide them by 57.2958" if beyond < 180.0 / np.pi * 1.1 else "convert them to rad"
    raise RecordingError(
        f"{name}: positions go to {furthest.max():.4g}, and no joint ends beyond {ends.max():.3g} rad; {unit}"
    )


def _check_clock(name: str, period: float, t: Array, tick: Array) -> None:
    """Raise RecordingError where the times contradict the periods: throughout and in most rows, so that no busy host
    that counts some periods late does it."""
    if len(t) <= FEW:
        return
    most, throughout = np.median(np.diff(t) / np.diff(tick)), (t[-1] - t[0]) / (tick[-1] - tick[0])
    if max(most, throughout) >= OFF * period and min(most, throughout) <= period / OFF:
        return
    unit = " (t is in milliseconds: divide it by 1000)" if np.isclose(throughout, 1000.0 * period, rtol=0.1) else ""
    raise RecordingError(
        f"{name}: t goes {throughout:.4g} s on in each tick, and the metadata say a period of {period:g} s{unit}: "
        "correct t, tick or the metadata's period"
    )


def _check_metadata(name: str, meta: Mapping[str, Any]) -> HandSpec:
    period = meta.get("period")
    if not isinstance(period, int | float) or isinstance(period, bool) or not 0.0 < period < math.inf:
        raise RecordingError(f"{name}: metadata: period is {period!r}, not a number of seconds above 0")
    if not isinstance(meta.get("hand"), dict):
        raise RecordingError(f"{name}: metadata: hand is {meta.get('hand')!r}, not the description of a hand")
    try:
        spec = spec_from_json(meta["hand"])
    except KeyError as error:
        raise RecordingError(f"{name}: metadata: hand has no {error.args[0]}") from error
    except (TypeError, ValueError, AttributeError, LookupError) as error:
        raise RecordingError(f"{name}: metadata: hand is damaged: {error}") from error
    n = spec.n_joints
    if not n or not all(isinstance(each, str) for each in (*spec.joints, *spec.aliases, *spec.commands)):
        raise RecordingError(f"{name}: metadata: hand.joints is {list(spec.joints)!r}, not the names of joints")
    for each in ("model", "side", "serial", "card"):
        if not isinstance(getattr(spec, each), str):
            raise RecordingError(f"{name}: metadata: hand.{each} is {getattr(spec, each)!r}, not a text")
    if spec.side not in get_args(Side):
        raise RecordingError(f"{name}: metadata: hand.side is {spec.side!r}, not {' or '.join(get_args(Side))}")
    if not all(isinstance(k, int) and 0 <= k < n for k in spec.mirror_flips):
        raise RecordingError(f"{name}: metadata: hand.mirror_flips is {list(spec.mirror_flips)}, not numbers of joints")
    for each, row in (("lower", spec.lower), ("upper", spec.upper)):
        if row.shape != (n,) or not np.isfinite(row).all():
            raise RecordingError(f"{name}: metadata: hand.{each} is {row.tolist()}, not {n} finite numbers")
    for finger in spec.fingers:
        if not all(isinstance(k, int) and 0 <= k < n for k in finger.joints):
            raise RecordingError(f"{name}: metadata: hand.fingers: {finger.name} has joints {list(finger.joints)}")
    if np.ndim(spec.actuation.torque_limit) != 1 or (spec.aliases and len(spec.aliases) != n):
        what = "actuation.torque_limit" if np.ndim(spec.actuation.torque_limit) != 1 else "aliases"
        raise RecordingError(f"{name}: metadata: hand.{what} is not a row of as many values as joints")
    return spec


def _check_column(name: str, columns: Mapping[str, Array], column: str, width: int | None) -> None:
    if column not in columns:
        raise RecordingError(f"{name} has no column {column}")
    values = columns[column]
    if not np.issubdtype(values.dtype, np.number):
        raise RecordingError(f"{name}: column {column} has {values.dtype}, not numbers")
    if values.shape[1:] != (() if width is None else (width,)):
        wanted = "one number" if width is None else f"{width} numbers"
        raise RecordingError(f"{name}: column {column} has {values.shape[1:] or 'one number'} a row, not {wanted}")
