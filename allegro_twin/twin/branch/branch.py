"""Which way a recording goes on: a simulation is repeated, of a hand on a wire its model goes on."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.errors import ConfigError
from allegro_twin.recording.reader import Recording, load
from allegro_twin.twin.branch.overrides import Changes
from allegro_twin.twin.branch.result import Branched, Through, Wanted


def branch(
    path: Path,
    at: float,
    changes: Changes,
    through: Through = lambda samples, beside: samples,
    wanted: Wanted = Wanted(),  # noqa: B008  # Frozen.
) -> Branched:
    """Go on otherwise from `at`, s; `through`: stages for its samples. Raises ConfigError for a recording that cannot
    be gone on from, or an odd change."""
    recording = load(path)
    last = float(recording.columns["t"][-1])
    if not 0.0 <= at <= last:
        raise ConfigError(f"--at {at:g} s: {path} goes from 0 to {last:g} s")
    if by_model(recording, wanted):
        from allegro_twin.twin.branch.from_estimate import estimated

        return estimated(recording, at, changes, through, wanted)
    if wanted != Wanted():
        raise ConfigError(
            f"{path} is of a simulation, which is repeated with what pushed it, its gravity and its controller: leave "
            "out --disturbance, --open-loop and --gravity, or give --hand to go on from what a mirror knows"
        )
    from allegro_twin.twin.branch.resimulate import repeated

    return repeated(recording, at, changes, through)


def by_model(recording: Recording, wanted: Wanted) -> bool:
    """Whether a model goes on in the place of a hand; otherwise a simulation is repeated. Raises ConfigError where only
    the latter can be."""
    backend = (recording.meta.get("config") or {}).get("backend", {})
    if wanted.hand and backend.get("kind") == "sim":
        raise ConfigError(f"{recording.path} is of a simulation, which is repeated as it was: leave out --hand")
    return "engine" not in recording.meta or bool(wanted.hand)
