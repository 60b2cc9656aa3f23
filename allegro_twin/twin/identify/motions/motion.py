"""Recordings as motions: joint positions, and the share of full PWM that made them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from hashlib import sha256
from pathlib import Path
from typing import Any, get_args

import numpy as np

from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.hands.description.calibration import FULL_SCALE, HandCalibration, Version
from allegro_twin.recording.missed import hold_missed
from allegro_twin.recording.reader import load
from allegro_twin.sim.open_loop import BEFORE
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

FEWEST = 3.0
"""s of motion that a recording needs."""
EDGE = 0.02
"""rad. Closer to a joint limit its stop may push."""
LEAST_NOISE = 1e-5
"""rad, of a reported position."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMotion:
    """One recording, rows a period apart; missing periods are filled and marked."""

    name: str
    hash: str
    spec: HandSpec
    version: Version
    period: float
    position: Array
    """(k, n), rad."""
    duty: Array
    """Fraction of full PWM over the period that ends at the row, (k, n)."""
    good: Array
    """1 where a row and its joint can be trusted, (k, n): no gap, and no limit reached by driver or joint."""
    gravity: Vector
    """In the palm frame, (3,), m/s²."""
    weight: Vector
    """At the fingertips, (n,), kg."""
    calibration: HandCalibration
    """With which counts became rad and N·m."""
    unfollowed: tuple[tuple[int, str], ...] = ()
    """Joints that did not follow what an excitation told them, and by how much."""

    @property
    def torque_constant(self) -> Vector:
        """(n,), N·m at full PWM."""
        return np.array(self.calibration.torque_constant, dtype=float)

    @property
    def noise(self) -> Vector:
        """Standard deviation of the reported positions, (n,), rad; at least what rounding to counts leaves."""
        return noise_floor(self.position, make_codec(self.version).rad_per_count)

    @property
    def seconds(self) -> float:
        return len(self.position) * self.period

    @property
    def saturated(self) -> float:
        """Share of rows and joints that cannot be trusted."""
        return 1.0 - float(self.good.mean())


def read_motion(path: Path, weight: Vector | None = None) -> RecordedMotion:
    """Read a recording. Raises ConfigError or RecordingError, with the remedy, for one that says nothing about a
    drive."""
    recording = hold_missed(load(path), "gravity")
    spec, columns = recording.spec, recording.columns
    table = recording.meta.get("calibration")
    if table is None:
        raise ConfigError(
            f"{path} does not say with which torque constant its counts became N·m: record it again through the hand's "
            "bus (`allegro-twin excite`), or give its backend a `calibration` (docs/contract.md#calibration)"
        )
    # A log of a bus begins before its host has sent a torque: such rows are as if they had not come.
    driven = np.asarray(np.isfinite(columns["torque"]).all(axis=1))
    columns = {name: column[driven] for name, column in columns.items()}
    torque = columns["torque"]
    if 2 * driven.sum() < len(driven) or not torque.any():
        raise ConfigError(f"{path} holds positions without torques: nothing about motors follows from it")
    if len(columns["t"]) * recording.period < FEWEST:
        raise ConfigError(f"{path} is {len(columns['t']) * recording.period:.1f} s long: record at least {FEWEST:g} s")
    gravity = np.median(columns["gravity"], axis=0)
    if not np.isfinite(gravity).all() or np.ptp(columns["gravity"], axis=0).max() > 2.0:
        what = "moves" if np.isfinite(gravity).all() else "does not say where down is"
        raise ConfigError(f"{path}: the palm {what}; record with the palm still and `backend.gravity` or its IMU")
    calibration = recorded_calibration(table)
    present, missing = _fill_gaps(columns["tick"])
    duty = present(torque) / np.array(calibration.torque_constant)
    version: Version = table["version"]
    limits = np.array(calibration.pwm_limits(version)) / FULL_SCALE[version]
    position = present(columns["position"])
    lower, upper = spec.lower + EDGE, spec.upper - EDGE
    good = (np.abs(duty) < limits - 1e-6) & (position > lower) & (position < upper) & ~missing[:, None]
    return RecordedMotion(
        path.name, sha256(path.read_bytes()).hexdigest()[:16], spec, version, recording.period, position, duty,
        good.astype(float), gravity, np.zeros(spec.n_joints) if weight is None else weight, calibration,
    )  # fmt: skip


def recorded_calibration(table: Mapping[str, Any]) -> HandCalibration:
    """The calibration in a recording's metadata, or of a device. Raises ConfigError for one of another format."""
    known, versions = [each.name for each in fields(HandCalibration)], get_args(Version)
    for key in table:
        if key not in ("version", *known):
            raise ConfigError(f"calibration: {unknown('key', str(key), ('version', *known))}")
    if table.get("version") not in versions:
        raise ConfigError(f"calibration: version must be one of {', '.join(versions)}, not {table.get('version')!r}")
    if "torque_constant" not in table:
        raise ConfigError("calibration: torque_constant is missing: N·m at full PWM, one a joint")
    try:
        return HandCalibration(**{key: _tuple(value) for key, value in table.items() if key != "version"})
    except ConfigError as error:
        raise ConfigError(f"calibration: {error}") from error


def check_same_hand(motions: list[RecordedMotion]) -> None:
    """Raise ConfigError for recordings of different hands, versions or periods."""
    for other in motions[1:]:
        for what in ("name", "serial"):
            mine, theirs = getattr(motions[0].spec, what), getattr(other.spec, what)
            if mine != theirs:
                raise ConfigError(
                    f"{other.name} is of the hand {theirs!r}, {motions[0].name} of {mine!r}: one at a time"
                )
        if other.version != motions[0].version or other.period != motions[0].period:
            raise ConfigError(
                f"{other.name} is of a {other.version} hand at {other.period} s, {motions[0].name} of a "
                f"{motions[0].version} one at {motions[0].period} s"
            )


def noise_floor(position: Array, grain: float) -> Vector:
    """Standard deviation of what a joint reports when nothing changes, (n,), rad, with its encoder's rounding.
    `position`: reported, (k, n), rad, a period apart; `grain`: rad a count, 0 where nothing is rounded. From third
    differences, to which a motion below 15 Hz adds nothing: Δ³ of white noise has the variance 20 σ². In a slow motion
    a coarse encoder reports the same count again and again, and they show less than the rounding: that is known."""
    third = np.abs(np.diff(position, n=3, axis=0))
    moving = np.ptp(position, axis=0) > 1e-3
    spread: Vector = np.sqrt(np.square(third).mean(axis=0) / 20.0)
    robust = grouped_median(third, grain) / 0.6745 / np.sqrt(20.0)
    least = max(LEAST_NOISE, grain / np.sqrt(12.0))
    return np.asarray(np.where(moving, np.maximum(np.minimum(spread, robust), least), least))


def grouped_median(sizes: Array, grain: float) -> Vector:
    """Median of each column of sizes that were rounded, (k, n), as of those before: a size of c counts was anywhere
    within half a count of c. Half of them may be 0. `grain`: a count; 0 where nothing was rounded. (n,)."""
    if grain <= 0.0:
        return np.asarray(np.median(sizes, axis=0))
    found = []
    for column in np.rint(sizes / grain).T:
        count, many = np.unique(column, return_counts=True)
        at = int(np.searchsorted(many.cumsum(), len(column) / 2.0))
        share = (len(column) / 2.0 - many[:at].sum()) / many[at]  # Of this count's sizes below the middle.
        low = max(count[at] - 0.5, 0.0)
        found.append(low + share * (count[at] + 0.5 - low))
    return np.asarray(grain * np.array(found), np.float64)


SHORT_GAP = 2
"""Periods without a report, between which commands and positions hardly bend: a bus that loses a frame in a hundred
loses a report in 25, and 0.3 s without any would be rare."""


def _fill_gaps(tick: Array) -> tuple[Callable[[Array], Array], Any]:
    """What fills the periods that have no row: a straight line in a short gap, in a longer one the row before. And
    which periods have no row, or a command before them that is unknown: those after a longer gap."""
    first, last = int(tick[0]), int(tick[-1])
    ticks = np.arange(first, last + 1)
    below = np.searchsorted(tick, ticks, side="right") - 1
    above = np.minimum(below + 1, len(tick) - 1)
    length = np.maximum(tick[above] - tick[below], 1)
    absent = ticks != tick[below]
    short = absent & (length - 1 <= SHORT_GAP)
    part = np.where(short, (ticks - tick[below]) / length, 0.0)[:, None]
    after = np.convolve(absent & ~short, np.ones(BEFORE + 1), mode="full")[: len(absent)] > 0
    return lambda column: column[below] + part * (column[above] - column[below]), absent | after


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
