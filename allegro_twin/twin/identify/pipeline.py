"""Identification from recordings to values with uncertainties; and the gap between a hand and its twin."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import parse_yaml
from allegro_twin.files.yaml_edit import has_content, read_text
from allegro_twin.hands.description.calibration import load_wiring
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.open_loop import OpenLoopPlayer
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.fitting.fit import DriveFit, Friction, fit_drive
from allegro_twin.twin.identify.fitting.problem import Masses
from allegro_twin.twin.identify.fitting.regress import regress, regress_breakaway
from allegro_twin.twin.identify.motions.limits import FoundLimits, centring_offsets
from allegro_twin.twin.identify.motions.motion import RecordedMotion, check_same_hand, read_motion
from allegro_twin.twin.identify.results.gap import Gap, drive_parameters, make_player, measure_gap
from allegro_twin.twin.identify.results.hand_file import drive_to_write, offset_shift
from allegro_twin.twin.identify.results.uncertainty import (
    IdentifiedValue,
    MotionCoverage,
    identified_values,
    motion_coverage,
)
from allegro_twin.twin.identify.results.written_drive import WrittenDrive
from allegro_twin.types import Vector


@dataclass(frozen=True, slots=True)
class KnownWeight:
    """A known mass at a finger's tip, or at all of them, in one recording."""

    at: str
    """`tip` for all fingers, or a finger's name."""
    mass: float
    """kg"""
    recording: str
    """File name of the recording, with or without suffix."""


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """Result of an identification."""

    motions: tuple[RecordedMotion, ...]
    coverage: MotionCoverage
    fit: DriveFit
    values: Mapping[str, IdentifiedValue]
    written: WrittenDrive
    """What a hand's file gets, and how well that predicts what the fit has not seen."""
    end_stop_offsets: Vector
    """Encoder offsets from the joints' end stops, (n,), rad, where the hand's file has measured limits; else NaN."""


def identify_hand(
    paths: Sequence[Path],
    weights: Sequence[KnownWeight],
    *,
    masses_known: bool,
    hand: str = "",
    friction: Friction = "auto",
    progress: Callable[[str], None] = lambda line: None,
) -> Identification:
    """Identify a hand's drive from recordings of excitations. `weights`: masses at fingertips; `masses_known`: the
    file's link masses are right; `hand`: its file, whose `drive.mass_scale` are these masses; `friction`: model of dry
    friction; `progress`: called with a line on what is being done. Raises ConfigError or RecordingError."""
    motions = _motions(paths, weights)
    spec = motions[0].spec
    # A file that does not exist yet says nothing of masses.
    file = load_spec(spec.model, spec.side, hand) if hand and Path(hand).is_file() else None
    own = file.drive.mass_scale if file is not None and file.drive is not None else np.ones(spec.n_joints)
    masses: Masses = "weighed" if weights else "known" if masses_known else "assumed"
    player = OpenLoopPlayer(spec, motions[0].period)
    coverage = motion_coverage(motions, player)
    progress("one line through everything")
    start = regress(motions, player, own)
    nominal = load_spec(spec.model, spec.side)
    base = drive_parameters(nominal, np.ones(spec.n_joints), np.zeros(spec.n_joints))
    progress("the motion as the model would make it")
    fitted = fit_drive(motions, start, regress_breakaway(motions, player, start), base, masses, friction)
    stops = _stops(file, nominal) if file is not None else np.full(spec.n_joints, np.nan)
    values = identified_values(fitted, coverage)
    progress("what the fit has not seen")
    path = Path(hand)
    content = parse_yaml(read_text(path), hand) if file is not None and has_content(read_text(path)) else {}
    written = drive_to_write(path, content, fitted, values, motions)
    return Identification(tuple(motions), coverage, fitted, values, written, stops)


def _stops(file: HandSpec, model: HandSpec) -> Vector:
    limits = FoundLimits(file.lower, file.upper)
    measured = not (np.array_equal(file.lower, model.lower) and np.array_equal(file.upper, model.upper))
    return centring_offsets(limits, model) if measured else np.full(model.n_joints, np.nan)


def measure_gaps(paths: Sequence[Path], hand: str) -> list[Gap]:
    """Gap of recordings, with the nominal hand and with a hand's file. Raises ConfigError or RecordingError."""
    return [_gap(read_motion(path), hand) for path in paths]


def _gap(motion: RecordedMotion, hand: str) -> Gap:
    spec = motion.spec
    mine = load_spec(spec.model, spec.side, hand or spec.serial, motion.version)
    wiring = load_wiring(spec.model, hand or spec.serial)
    if wiring.version not in (None, motion.version):
        raise ConfigError(f"{motion.name} is of a {motion.version} hand, {hand} of a {wiring.version} one")
    nominal = load_spec(spec.model, spec.side)
    ones, zero = np.ones(spec.n_joints), np.zeros(spec.n_joints)
    constant = np.array(wiring.calibration.torque_constant, dtype=float)
    player = OpenLoopPlayer(nominal, motion.period)
    own = make_player(nominal, motion.period, mine.drive)
    after = drive_parameters(
        mine, constant, offset_shift(motion.version, motion.calibration, wiring.calibration.encoder_offset)
    )
    return measure_gap(motion, (player, drive_parameters(nominal, ones, zero)), (own, after))


def _motions(paths: Sequence[Path], weights: Sequence[KnownWeight]) -> list[RecordedMotion]:
    first = read_motion(paths[0])
    chosen = {weight.recording.removesuffix(".arrow") for weight in weights}
    names = [path.stem for path in paths]
    for name in sorted(chosen - set(names)):
        raise ConfigError(unknown("recording", name, names))
    motions = [read_motion(path, _weight(path.stem, weights, first.spec)) for path in paths]
    check_same_hand(motions)
    return motions


def _weight(name: str, weights: Sequence[KnownWeight], spec: HandSpec) -> Vector:
    found = np.zeros(spec.n_joints)
    for weight in weights:
        if weight.recording.removesuffix(".arrow") == name:
            fingers = spec.fingers if weight.at == "tip" else (spec.finger(weight.at),)
            found[[finger.joints[-1] for finger in fingers]] = weight.mass
    return found
