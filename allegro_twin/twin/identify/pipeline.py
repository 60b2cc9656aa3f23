"""Identification from beginning to end: recordings in, values with their doubts out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.hands.description.calibration import load_wiring
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.open_loop.windows import Player
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.fitting.fit import Fit, Friction, fit
from allegro_twin.twin.identify.fitting.problem import Masses
from allegro_twin.twin.identify.fitting.regress import breaking, regress
from allegro_twin.twin.identify.motions.limits import FoundLimits, centring_offsets
from allegro_twin.twin.identify.motions.motion import Motion, read_motion, same_hand
from allegro_twin.twin.identify.results.gap import Gap, drive_of, gap, player_of
from allegro_twin.twin.identify.results.hand_file import shift
from allegro_twin.twin.identify.results.uncertainty import Seen, Value, seen, values
from allegro_twin.types import Vector

Tell = Callable[[str], None]
"""Told what is being done."""


@dataclass(frozen=True, slots=True)
class Weight:
    """A known mass at a finger's tip, or at all of them, in one recording."""

    at: str
    """`tip` for all fingers, or a finger's name."""
    mass: float
    """kg"""
    recording: str
    """Its file's name, with or without suffix."""


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """All there is to report and to store."""

    motions: tuple[Motion, ...]
    seen: Seen
    fit: Fit
    values: Mapping[str, Value]
    stops: Vector
    """Encoder offsets by the joints' end stops, (n,), rad, where the hand's file has measured limits; else NaN."""


def identify(
    paths: Sequence[Path],
    weights: Sequence[Weight],
    *,
    masses_known: bool,
    hand: str = "",
    friction: Friction = "auto",
    tell: Tell = lambda line: None,
) -> Identified:
    """`hand`: its file, whose `drive.mass_scale` are the masses of its links. Raises ConfigError or RecordingError."""
    motions = _motions(paths, weights)
    spec = motions[0].spec
    # A file that is yet to be written says nothing of masses.
    file = load_spec(spec.model, spec.side, hand) if hand and Path(hand).is_file() else None
    own = file.drive.mass_scale if file is not None and file.drive is not None else np.ones(spec.n_joints)
    masses: Masses = "weighed" if weights else "known" if masses_known else "assumed"
    player = Player(spec, motions[0].period)
    looked = seen(motions, player)
    tell("one line through everything")
    start = regress(motions, player, own)
    nominal = load_spec(spec.model, spec.side)
    base = drive_of(nominal, np.ones(spec.n_joints), np.zeros(spec.n_joints))
    tell("the motion as the model would make it")
    found = fit(motions, start, breaking(motions, player, start), base, masses, friction)
    stops = _stops(file, nominal) if file is not None else np.full(spec.n_joints, np.nan)
    return Identified(tuple(motions), looked, found, values(found, looked), stops)


def _stops(file: HandSpec, model: HandSpec) -> Vector:
    limits = FoundLimits(file.lower, file.upper)
    measured = not (np.array_equal(file.lower, model.lower) and np.array_equal(file.upper, model.upper))
    return centring_offsets(limits, model) if measured else np.full(model.n_joints, np.nan)


def gaps(paths: Sequence[Path], hand: str) -> list[Gap]:
    """Of recordings, with the nominal hand and with a hand's file. Raises ConfigError or RecordingError."""
    return [_gap(read_motion(path), hand) for path in paths]


def _gap(motion: Motion, hand: str) -> Gap:
    spec = motion.spec
    mine = load_spec(spec.model, spec.side, hand or spec.serial, motion.version)
    wiring = load_wiring(spec.model, hand or spec.serial)
    if wiring.version not in (None, motion.version):
        raise ConfigError(f"{motion.name} is of a {motion.version} hand, {hand} of a {wiring.version} one")
    nominal = load_spec(spec.model, spec.side)
    ones, zero = np.ones(spec.n_joints), np.zeros(spec.n_joints)
    constant = np.array(wiring.calibration.torque_constant, dtype=float)
    player = Player(nominal, motion.period)
    own = player_of(nominal, motion.period, mine.drive)
    after = drive_of(mine, constant, shift(motion.version, motion.calibration, wiring.calibration.encoder_offset))
    return gap(motion, (player, drive_of(nominal, ones, zero)), (own, after))


def _motions(paths: Sequence[Path], weights: Sequence[Weight]) -> list[Motion]:
    first = read_motion(paths[0])
    chosen = {weight.recording.removesuffix(".arrow") for weight in weights}
    names = [path.stem for path in paths]
    for name in sorted(chosen - set(names)):
        raise ConfigError(unknown("recording", name, names))
    motions = [read_motion(path, _weight(path.stem, weights, first.spec)) for path in paths]
    same_hand(motions)
    return motions


def _weight(name: str, weights: Sequence[Weight], spec: HandSpec) -> Vector:
    found = np.zeros(spec.n_joints)
    for weight in weights:
        if weight.recording.removesuffix(".arrow") == name:
            fingers = spec.fingers if weight.at == "tip" else (spec.finger(weight.at),)
            found[[finger.joints[-1] for finger in fingers]] = weight.mass
    return found
