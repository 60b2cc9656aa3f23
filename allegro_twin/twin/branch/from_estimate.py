"""Branch of a recorded hand on a wire: its model continues from the state that a mirror estimates.

Nobody knows what the hand holds, and a model is not the hand. So the result says what is known, estimated and assumed.
The same model also continues without any change: its distance from the recording is the model's own error.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np

from allegro_twin.app.rig import guarded
from allegro_twin.backend import HandBackend
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.recording.missed import hold_missed, read_by_twin
from allegro_twin.recording.reader import Recording
from allegro_twin.sim.model.joints import JointChange
from allegro_twin.twin.branch.assumptions import first_touch, list_assumptions, list_collisions
from allegro_twin.twin.branch.model_backend import model_backend_at
from allegro_twin.twin.branch.overrides import Changes, hand_change
from allegro_twin.twin.branch.recover_controller import BranchController, change_controller, find_controller
from allegro_twin.twin.branch.result import BranchOptions, BranchResult, SampleStages, first_samples
from allegro_twin.twin.mirror.contact_detection import SETTLED
from allegro_twin.twin.mirror.factory import recorded_spec
from allegro_twin.twin.mirror.on_recording import mirror_recording, recorded_samples
from allegro_twin.types import Array, Sample


def branch_from_estimate(
    recording: Recording, at: float, changes: Changes, stages: SampleStages, options: BranchOptions
) -> BranchResult:
    """Continue a hand's recording with its model. Raises ConfigError for a recording that says too little."""
    recording = hold_missed(recording, *read_by_twin(recording.spec, options.gravity))
    _check(recording, at, changes)
    spec, columns = recorded_spec(recording, options.hand), recording.columns
    row = int(np.searchsorted(columns["t"], at - 1e-9))
    change = hand_change(changes, spec)
    driver = find_controller(recording, spec, row, open_loop=options.open_loop)
    other = change_controller(driver, recording, spec, row, changes)
    mirrored = mirror_recording(recording.path, options.hand, None, options.gravity)
    before = columns["position"][:row]
    alone = _Future(recording, row, driver, JointChange(), options)
    unchanged = np.concatenate([before, [sample.state.position for sample in alone.samples()]])
    future, reference = _Future(recording, row, other, change, options), _References(columns["position"], unchanged)
    samples = chain(first_samples(recorded_samples(recording), row), future.samples())
    branched = np.array([sample.state.position for sample in stages(reference.counted(samples), reference)])
    notes = [
        *list_assumptions(recording, at, mirrored, driver, options),
        *alone.stopped("without a change "),
        *future.stopped(),
    ]
    rest = slice(row, len(branched))
    meetings = list(list_collisions(spec, columns["t"][rest], columns["position"][rest], branched[rest]))
    notes += [sentence for _, sentence in meetings]
    until = min([first_touch(at, mirrored), *(begin for begin, _ in meetings)])
    return BranchResult(columns["t"], columns["position"], branched, spec, None, unchanged, tuple(notes), until)


def _check(recording: Recording, at: float, changes: Changes) -> None:
    path, columns = recording.path, recording.columns
    first, last = float(columns["t"][0]), float(columns["t"][-1])
    if "friction" in changes:
        raise ConfigError(
            f"--set friction is that of contacts, and nobody knows what the hand of {path} touches: that of its joints "
            "is frictionloss"
        )
    if at < first + SETTLED or at >= last:
        raise ConfigError(
            f"--at {at:g} s: {path} goes from {first:g} to {last:g} s, and a mirror needs the first {SETTLED:g} s to "
            "know the hand: say something between"
        )
    after = columns["t"] >= at
    if "torque" in recording.spec.commands and not np.isfinite(columns["torque"][after]).all():
        raise ConfigError(f"{path} holds positions without torques: nobody can say how its hand would have gone on")


class _Future:
    """The rows of a recording from one on, as a model has them."""

    def __init__(
        self, recording: Recording, row: int, driver: BranchController, change: JointChange, options: BranchOptions
    ) -> None:
        self._recording, self._row, self._driver, self._change, self._wanted = recording, row, driver, change, options
        self._fault = ""

    def samples(self) -> Iterator[Sample]:
        """Yield samples until the recording ends, or the guard would stop the hand."""
        driver = self._driver
        closed = driver.config is not None
        hand: HandBackend = model_backend_at(self._recording, self._row, self._change, self._wanted, closed=closed)
        if driver.config is not None:
            hand = guarded(driver.config, hand.spec, hand)
        ticks = self._recording.columns["tick"].astype(int).tolist()
        heard, last, memory = set(ticks), ticks[-1], driver.memory
        try:
            state = hand.reset()
            while True:
                command, memory = driver.controller(state, memory)
                hand.write(command)
                if state.tick in heard:
                    yield Sample(state, command)
                if state.tick == last:
                    return
                state = hand.read()
        except HandFault as fault:
            self._fault = f"after {state.t:.3f} s: {fault}"

    def stopped(self, how: str = "") -> Iterator[str]:
        """Why the samples ended before the recording did."""
        if self._fault:
            yield f"The guard would {how}have left it limp {self._fault}"


class _References:
    """Joint positions of the recording, and of the unchanged branch, beside each sample."""

    def __init__(self, recorded: Array, unchanged: Array) -> None:
        self._recorded, self._unchanged, self._row = recorded, unchanged, -1

    def counted(self, samples: Iterator[Sample]) -> Iterator[Sample]:
        for sample in samples:
            self._row += 1
            yield sample

    def __call__(self) -> dict[str, Array]:
        last = min(self._row, len(self._unchanged) - 1)
        return {"target": self._recorded[self._row], "unchanged": self._unchanged[last]}
