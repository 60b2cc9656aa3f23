"""A recorded hand on a wire goes on otherwise from some instant: its model does, from what a mirror knows of it.

Of a hand nobody knows what it holds, and a model is not the hand. So what is known, estimated and assumed is said, and
the same model goes on without any change, too: what it is off by from the recording is its own error.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np

from allegro_twin.app.rig import guarded
from allegro_twin.backend import HandBackend
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.recording.reader import Recording
from allegro_twin.sim.model.friction_changes import Change
from allegro_twin.twin.branch.assumptions import knowledge, meetings
from allegro_twin.twin.branch.model_backend import model_at
from allegro_twin.twin.branch.overrides import Changes, change_of
from allegro_twin.twin.branch.recover_controller import Driver, changed_by, driver_of
from allegro_twin.twin.branch.result import Branched, Through, Wanted, rows_before
from allegro_twin.twin.mirror.contact_detection import SETTLED
from allegro_twin.twin.mirror.for_hand import mirrored, played, spec_in
from allegro_twin.types import Array, Sample


def estimated(recording: Recording, at: float, changes: Changes, through: Through, wanted: Wanted) -> Branched:
    """Raises ConfigError for a recording that tells too little to go on from."""
    _check(recording, at, changes)
    spec, columns = spec_in(recording, wanted.hand), recording.columns
    row = int(np.searchsorted(columns["t"], at - 1e-9))
    change = change_of(changes, spec)
    driver = driver_of(recording, spec, row, open_loop=wanted.open_loop)
    other = changed_by(driver, recording, spec, row, changes)
    seen = mirrored(recording.path, wanted.hand, None, wanted.gravity)
    before = columns["position"][:row]
    alone = _Future(recording, row, driver, Change(), wanted)
    unchanged = np.concatenate([before, [sample.state.position for sample in alone.samples()]])
    future, beside = _Future(recording, row, other, change, wanted), _Beside(columns["position"], unchanged)
    samples = chain(rows_before(played(recording), row), future.samples())
    branched = np.array([sample.state.position for sample in through(beside.counted(samples), beside)])
    said = [*knowledge(recording, at, seen, driver, wanted), *alone.stopped("without a change "), *future.stopped()]
    rest = slice(row, len(branched))
    said += meetings(spec, columns["t"][rest], columns["position"][rest], branched[rest])
    return Branched(columns["t"], columns["position"], branched, spec, None, unchanged, tuple(said))


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
    if "torque" in recording.spec.commands and not np.isfinite(columns["torque"]).all():
        raise ConfigError(f"{path} holds positions without torques: nobody can say how its hand would have gone on")


class _Future:
    """The rows of a recording from one on, as a model has them."""

    def __init__(self, recording: Recording, row: int, driver: Driver, change: Change, wanted: Wanted) -> None:
        self._recording, self._row, self._driver, self._change, self._wanted = recording, row, driver, change, wanted
        self._fault = ""

    def samples(self) -> Iterator[Sample]:
        """Until the recording ends, or the guard would have stopped the hand."""
        driver = self._driver
        closed = driver.config is not None
        hand: HandBackend = model_at(self._recording, self._row, self._change, self._wanted, closed=closed)
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
        """Why it ended before the recording did."""
        if self._fault:
            yield f"The guard would {how}have left it limp {self._fault}"


class _Beside:
    """Where the recording's joints were, and where those of the unchanged branch are."""

    def __init__(self, recorded: Array, unchanged: Array) -> None:
        self._recorded, self._unchanged, self._row = recorded, unchanged, -1

    def counted(self, samples: Iterator[Sample]) -> Iterator[Sample]:
        for sample in samples:
            self._row += 1
            yield sample

    def __call__(self) -> dict[str, Array]:
        last = min(self._row, len(self._unchanged) - 1)
        return {"target": self._recorded[self._row], "unchanged": self._unchanged[last]}
