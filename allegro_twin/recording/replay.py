"""Replay backend: a recording in place of a hand. It gives the same states again, whatever is commanded."""

from __future__ import annotations

from collections.abc import Iterator

from allegro_twin.backend import position_of, torque_of
from allegro_twin.errors import EndOfRecording
from allegro_twin.recording.reader import Recording
from allegro_twin.recording.recorder import recorded_command
from allegro_twin.spec import HandSpec
from allegro_twin.types import NO_WRENCH, Array, Command, HandState, Sample


class ReplayBackend:
    """Plays a recording back, row by row. Commands are kept for comparison and change nothing."""

    live = False
    """Time passes only while this backend reads."""

    def __init__(self, recording: Recording) -> None:
        self.recording, self._row, self._spec = recording, 0, recording.spec
        self.written: list[Command] = []
        """All commands since reset."""

    @property
    def spec(self) -> HandSpec:
        return self._spec

    @property
    def period(self) -> float:
        return self.recording.period

    def reset(self) -> HandState:
        self._row = 0
        self.written.clear()
        return self._state()

    def write(self, command: Command) -> None:
        (torque_of if "torque" in self._spec.commands else position_of)(command, self._spec)
        self.written.append(command)

    def read(self) -> HandState:
        if self._row + 1 >= len(self.recording):
            end = self.recording.columns["t"][-1]
            raise EndOfRecording(f"{self.recording.path} ends at {end:.3f} s, after {len(self.recording)} rows")
        self._row += 1
        return self._state()

    def close(self) -> None:
        pass  # The recording is in memory: nothing to close.

    def warnings(self) -> tuple[str, ...]:
        """What of its source is left out."""
        return self.recording.notes

    def extras(self) -> dict[str, Array]:
        """The further columns of the current row."""
        return {k: v[self._row] for k, v in self.recording.columns.items() if k not in HAND_COLUMNS}

    def _state(self) -> HandState:
        columns, row = self.recording.columns, self._row
        return HandState(
            float(columns["t"][row]),
            int(columns["tick"][row]),
            columns["position"][row],
            columns["velocity"][row],
            columns["torque"][row],
            columns["temperature"][row],
            columns["gravity"][row],
            columns["wrench"][row] if "wrench" in columns else NO_WRENCH,
        )


def replay_samples(backend: ReplayBackend) -> Iterator[Sample]:
    """The recorded samples: each state with the command that was computed from it at the time."""
    columns = backend.recording.columns
    state = backend.reset()
    for row in range(len(backend.recording)):
        if row:
            state = backend.read()
        yield Sample(state, recorded_command(columns, row))


HAND_COLUMNS = frozenset(
    (
        *("t", "tick", "position", "velocity", "torque", "temperature", "gravity", "wrench"),
        *("command_torque", "command_position", "command_effort", "command_duration"),
    )
)
