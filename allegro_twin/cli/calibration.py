"""What `allegro-twin calibrate` does, apart from the command line."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from allegro_twin.build import assemble
from allegro_twin.config import RunConfig
from allegro_twin.control.controllers import PD, Gravity, GravityCompensation
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import parse_yaml
from allegro_twin.files.edit import holds_anything, locked, read_text, with_document, write_text
from allegro_twin.identify.limits import BEYOND, TORQUE, FoundLimits, observed, sweep
from allegro_twin.library.gains import load_gains
from allegro_twin.library.named import load_posture
from allegro_twin.loop import Controller, run, to_the_end, until
from allegro_twin.sim.statics import hand_model
from allegro_twin.spec import HandSpec


def find_limits(
    config: RunConfig, by_hand: float | None, advance: Callable[[float, float], None]
) -> tuple[HandSpec, FoundLimits]:
    """Sweep every joint, or watch while a person does for `by_hand` seconds. The guard allows little torque, and
    positions beyond the model's limits. Raises HandError."""
    if by_hand is not None and not by_hand > 0:
        raise ConfigError(f"--by-hand needs a positive time, s; not {by_hand}")
    rig = assemble(_searching(config))
    gravity = Gravity(hand_model(rig.spec).gravity_torque)
    rest = load_posture("calibrate", rig.spec)
    moves = sweep(rig.spec, rest)
    controller: Controller[object]
    if by_hand is None:
        # From rest it takes as long as from anywhere, but for the way there.
        seconds = moves.begin(rest).seconds + 5.0
        controller = PD(moves, load_gains("default", rig.spec), gravity)  # type: ignore[assignment]  # Its memory.
    else:
        seconds = by_hand
        controller = GravityCompensation(gravity)  # type: ignore[assignment]  # Its memory.
    with closing(rig.backend) as backend:
        samples = until(seconds, to_the_end(run(backend, controller)))

        def watched() -> object:
            for sample in samples:
                advance(sample.state.t, seconds)
                yield sample

        return rig.spec, observed(watched())  # type: ignore[arg-type]  # A generator.


def store_limits(path: Path, found: FoundLimits) -> None:
    """Write the limits into the hand's own file and leave everything else in it as it is. Raises RecordingError."""
    limits = {
        "lower": [round(v, 4) for v in found.lower.tolist()],
        "upper": [round(v, 4) for v in found.upper.tolist()],
    }
    with locked(path):
        text = read_text(path)
        content = parse_yaml(text, str(path)) if holds_anything(text) else {}
        write_text(path, with_document(text, content | {"limits": limits}, str(path)))


def _searching(config: RunConfig) -> RunConfig:
    limits = config.limits.model_copy(update={"margin": -BEYOND, "torque": TORQUE})
    return config.model_copy(update={"limits": limits})
