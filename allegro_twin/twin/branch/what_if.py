"""What-if branches of a recording: a simulation is run again, a hand on a wire is replaced by its model."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.errors import ConfigError
from allegro_twin.recording.reader import Recording, load
from allegro_twin.twin.branch.overrides import Changes
from allegro_twin.twin.branch.result import BranchOptions, BranchResult, SampleStages


def branch_recording(
    path: Path,
    at: float,
    changes: Changes,
    stages: SampleStages = lambda samples, reference: samples,
    options: BranchOptions = BranchOptions(),  # noqa: B008  # Frozen.
) -> BranchResult:
    """Continue a recording differently from `at`, s. `stages`: stages for the branch's samples. Raises ConfigError for
    a recording that cannot be continued, or a wrong change."""
    recording = load(path)
    last = float(recording.columns["t"][-1])
    if not 0.0 <= at <= last:
        raise ConfigError(f"--at {at:g} s: {path} goes from 0 to {last:g} s")
    if needs_model(recording, options):
        from allegro_twin.twin.branch.from_estimate import branch_from_estimate

        return branch_from_estimate(recording, at, changes, stages, options)
    asked = {
        "--disturbance": options.disturbance != "forget",
        "--open-loop": options.open_loop,
        "--gravity": options.gravity is not None,
    }
    if any(asked.values()):
        names = " and ".join(name for name, given in asked.items() if given)
        also = "" if _simulated(recording) else ", or give --hand to go on from what a mirror knows"
        raise ConfigError(
            f"{path} is of a simulation, which is repeated with what pushed it, its gravity and its controller: leave "
            f"out {names}{also}"
        )
    from allegro_twin.twin.branch.resimulate import resimulate

    return resimulate(recording, at, changes, stages)


def needs_model(recording: Recording, options: BranchOptions) -> bool:
    """Whether a model replaces the hand; otherwise a simulation runs again. Raises ConfigError for a simulation with
    `options.hand`."""
    if options.hand and _simulated(recording):
        raise ConfigError(f"{recording.path} is of a simulation, which is repeated as it was: leave out --hand")
    return not (_simulated(recording) or "engine" in recording.meta) or bool(options.hand)


def _simulated(recording: Recording) -> bool:
    """Whether the hand itself is simulated, without a bus."""
    backend = (recording.meta.get("config") or {}).get("backend", {})
    return bool(backend.get("kind") == "sim")
