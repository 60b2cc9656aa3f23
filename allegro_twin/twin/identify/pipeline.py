"""Identification from recordings to values with uncertainties; and the gap between a hand and its twin."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import parse_yaml
from allegro_twin.files.yaml_edit import has_content, read_text
from allegro_twin.hands.description.calibration import load_wiring
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.recording.reader import load
from allegro_twin.sim.open_loop import OpenLoopPlayer
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.fitting.fit import DriveFit, Friction, fit_drive
from allegro_twin.twin.identify.fitting.problem import Masses
from allegro_twin.twin.identify.fitting.regress import regress, regress_breakaway
from allegro_twin.twin.identify.fitting.shooting import cut_segments
from allegro_twin.twin.identify.motions.following import unfollowed_joints
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
from allegro_twin.types import Vector, frozen

LEAST_USABLE = 0.5
"""Share of a recording's pieces that a fit needs."""


@dataclass(frozen=True, slots=True)
class KnownWeight:
    """A known mass at a finger's tip, or at all of them, in one recording."""

    at: str
    """`tip` for all fingers, or a finger's name."""
    mass: float
    """Mass of the weight, kg."""
    recording: str
    """The recording by its path, or by its file name where no other has that; with or without suffix."""


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
    check_trusted(motions)
    spec = motions[0].spec
    # A file that does not exist yet, or has nothing in it, says nothing of masses.
    filled = bool(hand) and has_content(read_text(Path(hand)))
    file = load_spec(spec.model, spec.side, hand) if filled else None
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
    content = parse_yaml(read_text(path), hand) if filled else {}
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
    check_trusted([motion])
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


def check_trusted(motions: Sequence[RecordedMotion]) -> None:
    """Raise ConfigError for a recording of which the fit could use less than half."""
    cuts = cut_segments(motions, motions[0].spec)
    for number, motion in enumerate(motions):
        own = cuts.trust[cuts.recording == number]
        if len(own) and (share := own.any(axis=1).mean()) < LEAST_USABLE:
            raise ConfigError(
                f"{motion.name}: {100.0 * share:.0f} % of its rows can be used: too few reports arrived; record it "
                "again on a quieter computer"
            )
    if len(cuts.trust) and (share := cuts.trust.mean()) < LEAST_USABLE:
        raise ConfigError(
            f"{', '.join(motion.name for motion in motions)}: {100.0 * share:.0f} % of the fingers' rows can be used: "
            f"the others are at a limit of driver or joint{_strays(motions)}; record again with `allegro-twin excite`"
        )


def _strays(motions: Sequence[RecordedMotion]) -> str:
    """Joints that did not follow, in words; empty without any."""
    names = {motion.spec.joint_labels[joint]: None for motion in motions for joint, _ in motion.unfollowed}
    return f", or have a joint that did not follow what it was told ({', '.join(names)})" if names else ""


def _motions(paths: Sequence[Path], weights: Sequence[KnownWeight]) -> list[RecordedMotion]:
    names = distinct_names(paths)
    first = read_motion(paths[0])
    hung = [_chosen(weight.recording, paths) for weight in weights]
    motions = []
    for number, (path, name) in enumerate(zip(paths, names, strict=True)):
        own = [weight for weight, chosen in zip(weights, hung, strict=True) if chosen == number]
        motion = replace(read_motion(path, _weight(own, first.spec)), name=name)
        motions.append(_without_unfollowed(motion, load(path).meta.get("excitation")))
    check_same_hand(motions)
    return motions


def _without_unfollowed(motion: RecordedMotion, excitation: Mapping[str, Any] | None) -> RecordedMotion:
    """The motion, in which joints that did not follow the excitation are not trusted: their motors, their encoders or
    their wires are not what a model takes them for."""
    if excitation is None:
        return motion
    good, t = motion.good.copy(), frozen(motion.period * np.arange(len(motion.position)))
    found = unfollowed_joints(motion.spec, excitation, t, motion.position)
    good[:, [each.joint for each in found]] = 0.0
    return (
        replace(motion, good=good, unfollowed=tuple((each.joint, each.reason) for each in found)) if found else motion
    )


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """A name for every recording: its file's, with as many of its folders as make it the only one. Raises ConfigError
    for one that is given twice."""
    parts = [path.resolve().parts for path in paths]
    for number, path in enumerate(paths):
        if parts[number] in parts[:number]:
            raise ConfigError(f"{path} is given twice: name every recording once")
    found = []
    for own in parts:
        others = [each for each in parts if each != own]
        length = next(k for k in range(1, len(own) + 1) if own[-k:] not in [each[-k:] for each in others])
        found.append(Path(*own[-length:]).as_posix())
    return found


def _chosen(text: str, paths: Sequence[Path]) -> int:
    """Which of the recordings a text names: by path, or by a file name that only one has. Raises ConfigError."""
    asked = {Path(text).resolve(), Path(f"{text}.arrow").resolve()}
    by_path = [number for number, path in enumerate(paths) if path.resolve() in asked]
    by_name = [number for number, path in enumerate(paths) if text in (path.name, path.stem)]
    found = by_path or by_name
    if not found:
        raise ConfigError(unknown("recording", text, [str(path) for path in paths]))
    if len(found) > 1:
        several = " and ".join(str(paths[number]) for number in found)
        raise ConfigError(f"the recording {text} of a known mass may be {several}: give its path")
    return found[0]


def _weight(weights: Sequence[KnownWeight], spec: HandSpec) -> Vector:
    found = np.zeros(spec.n_joints)
    for weight in weights:
        fingers = spec.fingers if weight.at == "tip" else (spec.finger(weight.at),)
        found[[finger.joints[-1] for finger in fingers]] = weight.mass
    return found
