"""One opening of a hand, and what its loop tells the page."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig
from allegro_twin.app.controller_settings import PositionSettings
from allegro_twin.errors import RecordingError
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.panel.scene_state import eyes_of
from allegro_twin.surfaces.panel.stream import Frame
from allegro_twin.types import Sample

if TYPE_CHECKING:
    from allegro_twin.recording.recorder import Recorder

RATE = 30.0
"""Frames a second of the hand's clock."""


class OpenHand:
    """A hand that a config describes, limp, with its time passing. `perform`: doing what the config is for; else its
    wrist stays where its scene begins. Raises HandError."""

    def __init__(self, number: int, config: RunConfig, send: Callable[[Frame], None], *, perform: bool = False) -> None:
        self.number, self.config, self.rig = number, config, assemble(config)
        self._send, self._eyes, self.verdict_due = send, eyes_of(self.rig), False
        self._next, self._lost, self._tick = 0.0, 0, -1
        self._recorder: Recorder | None = None
        self._recorded_from, self.teaching, self.trouble = 0.0, False, ""
        trial = self.rig.trial
        self._judged = trial if perform else None
        if trial is not None and not perform:
            trial.backend.drive = trial.backend.drive[:1]
        controller = config.controller
        self.gains = controller.gains if isinstance(controller, PositionSettings) else "default"
        self.hand = Hand(self.rig, load_gains(self.gains, self.rig.spec), background=True)
        if perform:
            self.hand.direct.perform()
        self.hand.listen(self._look)
        self.hand.direct.prepare()

    def record(self, path: Path | None) -> None:
        """Begin to record, or end it. Raises RecordingError."""
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.close()
        if path is not None:
            from allegro_twin.app.session import recording_meta
            from allegro_twin.recording.recorder import Recorder

            meta = recording_meta(self.rig, self.config)
            self._recorded_from = self.hand.state.t
            self._recorder = Recorder(path, self.rig.spec, self.rig.backend.period, meta)

    @property
    def recording(self) -> bool:
        return self._recorder is not None

    def close(self) -> None:
        """Leave the hand limp and let go of it. Raises LinkError when it did not confirm that."""
        try:
            self.hand.close()
        finally:
            with suppress(RecordingError):  # What was written is readable.
                self.record(None)

    def _look(self, sample: Sample) -> None:
        """In the loop's own thread: as little as can be, and nothing that waits."""
        state = sample.state
        self._lost += 0 if self._tick < 0 else state.tick - self._tick - 1
        self._tick = state.tick
        if self._judged is not None:
            self._judged.see(state)
            if state.t >= self._judged.seconds:
                self._judged, self.verdict_due = None, True
        if self._recorder is not None:
            self._keep(sample)
        if state.t >= self._next:
            self._next = state.t + 1.0 / RATE - self.rig.backend.period / 2
            self._send(self._frame(sample))

    def _keep(self, sample: Sample) -> None:
        recorder, look = self._recorder, {k: v for k, v in self._eyes().items() if v.ndim == 1}
        try:
            if recorder is not None:
                recorder.add(sample, look | {"target": self.hand.direct.target})
        except RecordingError as error:
            self._recorder, self.trouble = None, str(error)

    def _frame(self, sample: Sample) -> Frame:
        state, direct = sample.state, self.hand.direct
        return Frame(
            self.number, state.t, state.position, state.torque, state.temperature, direct.target, dict(self._eyes()),
            self.hand.controller, direct.stopped, self._lost, tuple(self.rig.device.warnings()),
            state.t - self._recorded_from if self._recorder is not None else -1.0, self.teaching,
        )  # fmt: skip
