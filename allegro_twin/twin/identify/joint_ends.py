"""Calibration by the ends of the joints: limits and encoder offsets of a hand, found and written into its file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import Physics, Rig, assemble
from allegro_twin.control.controllers import PD, GravityCompensation, GravityFeedforward
from allegro_twin.controller import Controller
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import parse_yaml, refuse_shipped
from allegro_twin.files.yaml_edit import has_content, lock_file, read_text, replace_document, set_note, write_text
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_posture
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.loop import run, to_the_end, until
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.motions.limits import (
    BEYOND,
    TORQUE,
    EncoderOffsets,
    FoundLimits,
    check_both_ends,
    encoder_offsets,
    limit_sweep,
    limits_in_samples,
)
from allegro_twin.types import Sample, frozen

if TYPE_CHECKING:
    from allegro_twin.drivers.can.codec.codec import Codec

_NOTE = "Measured by `allegro-twin calibrate limits`"


class JointEnds(NamedTuple):
    """Result of a sweep of the joints."""

    model: HandSpec
    """The hand as the model has it, without a file of its own."""
    limits: FoundLimits
    """As the hand reads them."""
    seconds: float
    """How long it took on the hand's clock, s."""
    codec: Codec | None
    """Codec of a hand on a bus, with which its positions were read."""

    def encoder_offsets(self) -> EncoderOffsets:
        """Encoder offsets that put every range where the model has it. Raises ConfigError for a joint that was not
        brought to both its ends, and for a hand that is not on a bus."""
        if self.codec is None:
            raise ConfigError("encoder offsets are of a hand on a bus; this one has no encoders")
        return encoder_offsets(self.limits, self.model, self.codec)


def find_limits(
    config: RunConfig, by_hand: float | None, advance: Callable[[float, float], None]
) -> tuple[HandSpec, FoundLimits]:
    """Sweep every joint with little torque, or observe for `by_hand` s while a person does. The guard admits positions
    beyond the model's limits. Returns the model's hand and the limits found. Raises HandError."""
    found = find_joint_ends(config, advance, by_hand=by_hand)
    return found.model, found.limits


def find_joint_ends(
    config: RunConfig,
    advance: Callable[[float, float], None] = lambda t, total: None,
    *,
    by_hand: float | None = None,
    physics: Physics | None = None,
    watched: Callable[[Iterator[Sample], Rig], Iterator[Sample]] = lambda samples, rig: samples,
) -> JointEnds:
    """As `find_limits`. `physics`: what stands behind a virtual hand; `watched`: a stage that every sample passes, as
    one that records. Raises HandError."""
    if by_hand is not None and not by_hand > 0:
        raise ConfigError(f"--by-hand needs a positive time, s; not {by_hand}")
    rig = assemble(_searching(config), physics)
    with closing(rig.backend) as backend:
        vector = getattr(config.controller, "gravity", None)  # Of a hand that does not report it.
        gravity = GravityFeedforward(
            hand_kinematics(rig.spec).gravity_torque, None if vector is None else frozen(vector)
        )
        rest = load_posture("calibrate", rig.spec)
        moves = limit_sweep(rig.spec, rest).checked(rig.check_speed)
        controller: Controller[object]
        if by_hand is None:
            # The sweep's duration from rest, plus time to get there.
            seconds = moves.begin(rest).seconds + 5.0
            controller = PD(moves, load_gains("default", rig.spec), gravity)  # type: ignore[assignment]  # Its memory.
        else:
            seconds = by_hand
            controller = GravityCompensation(gravity)  # type: ignore[assignment]  # Its memory.
        samples = watched(until(seconds, to_the_end(run(backend, controller))), rig)

        def observed_samples() -> Iterator[Sample]:
            for sample in samples:
                advance(sample.state.t, seconds)
                yield sample

        most = np.minimum(TORQUE, rig.spec.actuation.torque_limit)
        found = limits_in_samples(observed_samples(), most if by_hand is None else None)
    codec = rig.driver.codec if isinstance(rig.driver, CanBackend) else None
    return JointEnds(load_spec(config.hand.model, config.hand.side), found, seconds, codec)


def codec_with_encoders(settings: RunConfig, config: str) -> Codec:
    """The codec of a config's hand. Raises ConfigError for a hand without encoders."""
    from allegro_twin.drivers.can.opening import codec_of

    if not isinstance(settings.backend, CanSettings):
        raise ConfigError(
            f"--offsets: {config} has backend {settings.backend.kind}, which has no encoders; a hand on a bus has"
        )
    return codec_of(settings.backend, settings.hand)


def refuse_another_hand(path: Path, settings: RunConfig, config: str, codec: Codec | None) -> None:
    """Raise ConfigError for a file that must not get the measurements: it ships with the package; it has encoder
    offsets that the config does not use; or, with `codec`, it is of another version or side."""
    refuse_shipped(path)
    wire = _read(path)[1].get("wire") or {}
    if codec is not None:
        for key, value in (("version", codec.version), ("side", settings.hand.side)):
            if wire.get(key, value) != value:
                raise ConfigError(f"{path} is of a {wire[key]} hand, {config} of a {value} one: choose another file")
    elif "encoder_offset" in wire and isinstance(settings.backend, CanSettings):
        used, written = codec_with_encoders(settings, config).calibration.encoder_offset, wire["encoder_offset"]
        if tuple(written if isinstance(written, list) else [written] * len(used)) != used:
            raise ConfigError(
                f"{path} has encoder offsets that {config} does not use: say `hand: {{serial: {path}}}` there, or "
                "write new ones with --offsets"
            )


def store_limits(path: Path, found: FoundLimits, model: HandSpec, note: str) -> None:
    """Write the limits, with a comment above them, into the hand's own file; the rest of it stays. Raises ConfigError
    for a joint that was not brought to both its ends, RecordingError.

    `model` has the joint limits of the description."""
    check_both_ends(found, model)
    with lock_file(path):
        write_text(path, _with_limits(*_read(path), found, path, note))


def store_offsets(path: Path, right: EncoderOffsets, model: HandSpec, codec: Codec, note: str) -> None:
    """Write encoder offsets, the limits as the hand then reads them, the version and the side. Raises RecordingError.

    `note`: the comment above them."""
    own = {"version": codec.version, "side": model.side, "encoder_offset": list(right.offset)}
    with lock_file(path):
        text, content = _read(path)
        content["wire"] = (content.get("wire") or {}) | own
        text = _with_limits(text, content, right.limits, path, note)
        write_text(path, set_note(text, ("wire", "encoder_offset"), _NOTE, f"{note}; counts"))


def note(config: str, by_hand: float | None, day: str) -> str:
    """Comment text: day, config and method."""
    how = f"pressed with at most {TORQUE:g} N·m" if by_hand is None else "moved by hand"
    return f", {day}, {config}, {how}"


def _read(path: Path) -> tuple[str, dict[str, Any]]:
    text = read_text(path)
    return text, parse_yaml(text, str(path)) if has_content(text) else {}


def _with_limits(text: str, content: dict[str, Any], found: FoundLimits, path: Path, note: str) -> str:
    rows = {"lower": found.lower, "upper": found.upper}
    limits = {name: [round(value, 4) for value in row.tolist()] for name, row in rows.items()}
    written = replace_document(text, content | {"limits": limits}, str(path))
    return set_note(written, ("limits",), _NOTE, f"{note}; rad")


def _searching(config: RunConfig) -> RunConfig:
    limits = config.limits.model_copy(update={"margin": -BEYOND, "torque": TORQUE})
    return config.model_copy(update={"limits": limits})
