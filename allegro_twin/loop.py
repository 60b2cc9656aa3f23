"""The loop that joins a backend and a controller, and the stages that need nothing but samples."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from allegro_twin.backend import HandBackend
from allegro_twin.controller import Controller
from allegro_twin.errors import EndOfRecording
from allegro_twin.types import HandState, Sample

M = TypeVar("M")


def run(backend: HandBackend, controller: Controller[M]) -> Iterator[Sample]:
    """Reset the hand and drive it for as long as somebody consumes the samples."""
    yield from resume(backend, controller, backend.reset())


def resume(backend: HandBackend, controller: Controller[M], state: HandState) -> Iterator[Sample]:
    """Drive the hand from a state on, without a reset, for as long as the samples are consumed."""
    memory = controller.start(state)
    while True:
        command, memory = controller(state, memory)
        backend.write(command)
        yield Sample(state, command)  # The consumer works while the hand is already moving.
        state = backend.read()


def until(t: float, samples: Iterable[Sample]) -> Iterator[Sample]:
    """Stop after the first sample at or past `t` seconds on the hand's clock."""
    for sample in samples:
        yield sample
        if sample.state.t >= t - 1e-9:
            return


def interleave(*runs: tuple[Iterable[Sample], float]) -> Iterator[tuple[int, Sample]]:
    """The samples of devices that share a world, each with the place of its run among the arguments.

    A run is its samples, with whatever stages around them, and its period, s. They take turns in the order of time, at
    the same moment in the order of the arguments, so that none misses a period. It ends with the first run that ends.
    """
    each = [iter(samples) for samples, _ in runs]
    due = [0.0] * len(each)
    while True:
        # At equal times the sums of periods differ by roundings.
        turn = min(range(len(each)), key=lambda k: (round(due[k], 9), k))
        try:
            sample = next(each[turn])
        except StopIteration:
            return
        due[turn] = sample.state.t + runs[turn][1]
        yield turn, sample


def to_the_end(samples: Iterable[Sample]) -> Iterator[Sample]:
    """Take the end of a recording for the end of the run."""
    try:
        yield from samples
    except EndOfRecording:
        return


def paced(samples: Iterable[Sample], speed: float = 1.0) -> Iterator[Sample]:
    """Hold the samples back to `speed` times real time: the package's only sleep."""
    start = None
    for sample in samples:
        now = time.monotonic()
        if start is None:
            start = now - sample.state.t / speed
        delay = start + sample.state.t / speed - now
        if delay > 0.0:
            time.sleep(delay)
        yield sample
