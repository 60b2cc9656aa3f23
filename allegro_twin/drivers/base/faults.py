"""Faults of virtual hands, as a config has them: events at given moments, and bytes that chance loses or garbles."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Annotated, Generic, TypeVar

import numpy as np
from pydantic import Field

from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import Probability, Seed, Settings


class FaultEvent(Settings):
    """Something that goes wrong once; each kind of hand knows its own."""

    at: Annotated[float, Field(ge=0)]
    """s since the hand was switched on."""
    what: str
    which: Annotated[int, Field(ge=0)] = 0
    """The actuator."""


def check_amount(what: str, amount: float | None, least: float, most: float) -> None:
    """Raises ValueError for an amount of a fault that there is not; None leaves it to the hand."""
    if amount is not None and not least <= amount <= most:
        bounds = f"{least:g} … {most:g}" if most < math.inf else f"from {least:g}"
        raise ValueError(f"amount: of {what} it is {bounds}, not {amount:g}")


E = TypeVar("E", bound=FaultEvent)


class FaultScript(Generic[E]):
    """The events that are still to come. Raises ConfigError for one of a part that the hand does not have."""

    def __init__(self, events: Sequence[E], n: int, parts: str) -> None:
        for event in events:
            if event.which >= n:
                raise ConfigError(f"faults.script: which is {event.which}; this hand has {n} {parts}")
        self._events = deque(sorted(events, key=lambda event: event.at))

    def take(self, now: float) -> Iterator[E]:
        """The events up to `now`, s, each of them once."""
        while self._events and self._events[0].at <= now:
            yield self._events.popleft()


class LineNoise(Settings):
    """Bytes that get lost or garbled on their way, by chance with a seed."""

    lose: Probability = 0.0
    """Per byte."""
    garble: Probability = 0.0
    """Per byte."""
    seed: Seed = 0


class NoisyLine:
    """Loses and garbles bytes as a LineNoise says; a garbled byte has one bit turned over."""

    def __init__(self, noise: LineNoise) -> None:
        self._noise, self._rng = noise, np.random.default_rng(noise.seed)

    def __call__(self, data: bytes) -> bytes:
        """What arrives of these bytes."""
        noise, rng = self._noise, self._rng
        if not data or not (noise.lose or noise.garble):
            return data
        arrived = np.frombuffer(data, np.uint8)
        hit = rng.random(len(arrived)) < noise.garble
        arrived = arrived ^ (hit << rng.integers(8, size=len(arrived))).astype(np.uint8)
        return arrived[rng.random(len(arrived)) >= noise.lose].tobytes()
