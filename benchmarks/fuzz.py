"""Ten million fuzzed frames through codec, assembler, backend and firmware: `python -m benchmarks.fuzz [frames]`.

A hand whose joints count its periods, but for a finger that rests, reports on a bus on which every real report is
followed by invented frames, to a host that is late now and then. What comes out must be an error of the tree or a state
whose fingers are all of one period; nothing else may be raised.
"""

from __future__ import annotations

import logging
import sys
import time
from collections import Counter, deque
from collections.abc import Iterator
from typing import get_args

import can
import numpy as np

from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import Frame, single
from allegro_twin.drivers.can.codec.messages import (
    FingerPosition,
    Information,
    MotorError,
    ServoOff,
    ServoOn,
    SetTorque,
    Status,
)
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.link.adapter import AdapterLink
from allegro_twin.drivers.can.virtual.firmware import Firmware, Identity
from allegro_twin.errors import HandError, ProtocolError
from allegro_twin.hands.description.calibration import Version
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, TorqueCommand, frozen

PERIOD, GAP = 0.003, 0.00013
PER_PERIOD = 12
"""Invented frames between two bursts of real ones."""
LIES, ENDINGS = 0.01, 0.0005
"""Shares of frames that say where a finger is, and that end a session: few, or nothing else would be tried."""
ENDING = SetTorque | ServoOn | ServoOff | Status | Information | MotorError
_HARDWARE = {"v1": 0x100, "v2": 0x200, "v3": 0x300, "v4": 0x400, "v5": 0x500, "v5plus": 0x500}
_SERIALS = {"v5": "5TAR0001", "v5plus": "5TBR0001"}
COUNT = 0.01
"""rad a period: more than a count of every version."""
CYCLE = 90
REST, SHIFT = -0.1, 500
"""rad at which a finger rests; periods after which the next one does, or none."""
PAUSE, STALL, FRAME = 0.002, 0.05, (0.00005, 0.0005)
"""Share of periods in which the host falls asleep; for how long at most, and what a frame costs it then, s."""


class CountingHand:
    """A hand without physics: all joints stand at the number of the period, but for those of a finger that rests."""

    def __init__(self, spec: HandSpec) -> None:
        self.spec, self.period, self._tick = spec, PERIOD, 0

    def reset(self) -> HandState:
        return self._state()

    def write(self, command: Command) -> None:
        pass

    def read(self) -> HandState:
        self._tick += 1
        return self._state()

    def close(self) -> None:
        pass

    def _state(self) -> HandState:
        zero = frozen(np.zeros(16))
        position = np.full(16, COUNT * (self._tick % CYCLE))
        resting = self._tick // SHIFT % 5
        position[4 * resting : 4 * resting + 4] = REST  # The fifth does not exist.
        return HandState(self._tick * PERIOD, self._tick, frozen(position), zero, zero, zero, frozen([0.0, 0.0, -9.81]))


class NoisyBus(can.BusABC):
    """Real frames first, each moment's own stamps; then invented ones, spread over the rest of the period."""

    lockstep = True

    def __init__(self, hand: Firmware, noise: Iterator[Frame], lies: set[int]) -> None:
        self._hand, self._noise, self._lies, self.now, self.heard = hand, noise, lies, 0.0, 0
        self._queue: deque[can.Message] = deque()
        self._periods, self._rng, self._host = 0, np.random.default_rng(1), 0.0
        self.channel_info = "noise"
        super().__init__("noise")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        for frame in self._hand.receive(Frame(msg.arbitration_id, bytes(msg.data), msg.is_remote_frame)):
            self._put(frame, self.now)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if not self._queue and timeout != 0.0:
            begin = self.now
            frames = enumerate(single(self._hand.step()))
            real = self._harmed([(begin + PERIOD + k * GAP, frame) for k, frame in frames])
            times = begin + PERIOD * (1.0 + self._rng.random(PER_PERIOD))
            unreal = [(float(t), next(self._noise)) for t in times]
            if not 2 < self._periods % 10 < 7:  # Faults are single: no lies near those of real frames.
                unreal = [(t, frame) for t, frame in unreal if frame.id not in self._lies]
            if self._rng.random() < PAUSE:
                self._host = begin + PERIOD + STALL * self._rng.random()
            for t, frame in sorted(real + unreal, key=lambda one: one[0]):
                self._put(frame, self._read_at(t))
            self.now = begin + PERIOD
            self.heard += len(unreal)
        return self._queue.popleft() if self._queue else None

    def _read_at(self, t: float) -> float:
        """When a late host comes to a frame that came at `t`: that is its stamp."""
        if self._host > t:
            self._host += float(self._rng.uniform(*FRAME))
            return self._host
        return t

    def _harmed(self, real: list[tuple[float, Frame]]) -> list[tuple[float, Frame]]:
        """Real frames after the fault of every tenth period: one is lost, late by up to a period, doubled or early."""
        self._periods += 1
        if not real or self._periods % 10:
            return real
        which = int(self._rng.integers(len(real)))
        t, frame = real.pop(which)
        match self._rng.integers(4):
            case 0:
                return real
            case 1:
                return [*real, (t + PERIOD * float(self._rng.random()), frame)]
            case 2:
                return [*real, (t, frame), (t + GAP, frame)]
            case _:
                return [(t - which * GAP - 1e-6, frame), *real]

    def _put(self, frame: Frame, t: float) -> None:
        self._queue.append(
            can.Message(
                timestamp=t, arbitration_id=frame.id, is_extended_id=False, is_remote_frame=frame.remote,
                data=frame.data, dlc=len(frame.data),
            )
        )  # fmt: skip


def invented(codec: Codec, seed: int) -> Iterator[Frame]:
    """Frames without end: any identifier, or one that means something; any length, any bytes, now and then remote."""
    rng = np.random.default_rng(seed)
    kinds = _sorted_identifiers(codec)
    while True:
        size = 10_000
        draws, lengths, remote = rng.random(size), rng.integers(0, 9, size), rng.random(size) < 0.1
        strange, pick = rng.integers(0, 2048, size), rng.random(size)
        data = rng.bytes(8 * size)
        for k in range(size):
            draw = draws[k]
            kind = "lie" if draw < LIES else "ending" if draw < LIES + ENDINGS else "known" if draw < 0.7 else None
            ids = kinds[kind] if kind else None
            identifier = int(strange[k]) if ids is None else ids[int(pick[k] * len(ids))]
            if ids is None and identifier in kinds["spoken"]:
                continue
            yield Frame(identifier, data[8 * k : 8 * k + int(lengths[k])], bool(remote[k]))


def _sorted_identifiers(codec: Codec) -> dict[str, list[int]]:
    """Identifiers of lies, of what ends sessions, of all that is known beside them, and of both kinds that count."""
    kinds: dict[str, list[int]] = {"lie": [], "ending": [], "known": []}
    for identifier in range(2048):
        known = None
        for length in range(9):
            try:
                message = codec.decode(Frame(identifier, bytes(length)))
            except ProtocolError:
                known = known or "known"
                continue
            if isinstance(message, FingerPosition):
                known = "lie"
            elif isinstance(message, ENDING):
                known = "ending"
            elif message is not None:
                known = known or "known"
        if known:
            kinds[known].append(identifier)
    return kinds | {"spoken": kinds["lie"] + kinds["ending"]}


def fuzz(version: Version, frames: int, seed: int) -> Counter[str]:
    """What came of so many invented frames. Raises what nobody may raise, and AssertionError for a torn state."""
    spec, codec = load_spec(), make_codec(version)
    who = Identity(_SERIALS.get(version, "FUZZED01"), _HARDWARE[version])
    hand, other = Firmware(CountingHand(spec), codec, who), Firmware(CountingHand(spec), codec, who)
    noise = invented(codec, seed)

    def overheard() -> Iterator[Frame]:
        for frame in noise:
            other.receive(frame)
            yield frame

    bus = NoisyBus(hand, overheard(), set(_sorted_identifiers(codec)["lie"]))
    backend = CanBackend(
        spec, codec, lambda: AdapterLink(bus).port(), CanHostSettings(gravity=(0.0, 0.0, -9.81), deadman=None)
    )
    outcome: Counter[str] = Counter()
    still = TorqueCommand(np.zeros(16))
    while bus.heard < frames:
        try:
            _check(backend.reset(), outcome)
            while bus.heard < frames:
                backend.write(still)
                _check(backend.read(), outcome)
        except HandError as error:
            outcome[type(error).__name__] += 1
    backend.close()
    return outcome + Counter(frames=bus.heard)


def _check(state: HandState, outcome: Counter[str]) -> None:
    """All fingers that tell a period tell the same; one that tells none rests or was lied about."""
    periods = told(state)
    outcome["fingers at rest or lied about"] += 4 - len(periods)
    outcome["states"] += 1
    assert len(set(periods)) <= 1, f"torn at tick {state.tick}: periods {sorted(periods)}"


def told(state: HandState) -> list[int]:
    """The periods that fingers tell."""
    periods = []
    for finger in state.position.reshape(4, 4):
        count = finger[0] / COUNT
        if np.ptp(finger) < 1e-6 and abs(count - round(count)) < 0.2 and count > -0.5:
            periods.append(round(count))
    return periods


def main() -> None:
    logging.disable(logging.CRITICAL)  # Noise says that the hand goes on reporting, and so on.
    total = int(float(sys.argv[1])) if len(sys.argv) > 1 else 10_000_000
    versions: tuple[Version, ...] = get_args(Version)
    everything: Counter[str] = Counter()
    for seed, version in enumerate(versions):
        begin = time.perf_counter()
        outcome = fuzz(version, total // len(versions) + 1, seed)
        everything += outcome
        print(f"{version:<7}{time.perf_counter() - begin:6.0f} s  {dict(outcome)}", flush=True)
    print(f"all: {dict(everything)}; no exception outside the tree, no torn state")


if __name__ == "__main__":
    main()
