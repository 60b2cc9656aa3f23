"""The Rerun viewer: a hand, or a cell with its arm and its camera, in 3-D with the series that explain it.

One of `spawn`, `serve` and `to_file` says where it goes. It draws what any session reports, live or from a recording.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import rerun as rr

from allegro_twin.errors import ConfigError, HandError, RecordingError
from allegro_twin.files.atomic_write import atomic_file, write_error
from allegro_twin.recording.events import DeviceSample, SessionEvent
from allegro_twin.recording.reader import CellRecording
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample
from allegro_twin.viewing.rerun import server
from allegro_twin.viewing.rerun.columns import RowBuffer
from allegro_twin.viewing.rerun.journals import draw_entry
from allegro_twin.viewing.rerun.layout import cell_layout, hand_layout
from allegro_twin.viewing.rerun.static import draw_arm, draw_still, draw_verdict
from allegro_twin.viewing.scenery import Scenery, scenery
from allegro_twin.viewing.views import DEFAULT

Look = Callable[[], Mapping[str, Array]]
"""What is known beside the hand's state: `target` (n,), `palm`, `object`, `target_object` (7,), `contact_force` (p,),
`contact_point`, `contact_vector` (3 p,)."""
_HEAD = 2**19
"""Bytes that the disk must take before Rerun begins a file: its layout and the shapes of a hand take 0.3 MB."""
_TOGETHER = 0.1  # s of the device's clock that are sent together to somebody who watches.


class Viewer:
    """Draws the events of a session into a Rerun recording.

    `arm`: the spec of the arm that carries the hand, whose shapes `scene` has; `rate`: pictures a second of each
    device's clock; `live`: send them as they come; `view`: the first view of a hand, as `views.NAMES` has it.
    """

    def __init__(
        self,
        spec: HandSpec,
        scene: Scenery | None = None,
        *,
        arm: HandSpec | None = None,
        rate: float = 30.0,
        live: bool = False,
        view: str = DEFAULT,
    ) -> None:
        self._stream = rr.RecordingStream("allegro_twin")
        self._server: server.RerunServer | None = None
        self._name: Path | None = None
        self._spec, self._arm, self._interval, self._next = spec, arm, 1.0 / rate, {"hand": 0.0, "arm": 0.0}
        self._scene, self._view = scene or scenery(spec, {}), view
        self._rows = RowBuffer(self._stream, spec, self._scene, arm)
        self._together = _TOGETHER if live else float("inf")

    def on_event(self, event: SessionEvent) -> None:
        """Draw an event; of a device's samples no more than the frame rate has. Whoever watches gets them over the next
        calls, a few messages in each, so that no period is late. Raises ConfigError for a pose that is not one."""
        if not isinstance(event, DeviceSample):
            draw_entry(self._stream, event)
            return
        t = event.sample.state.t
        self._rows.smooth(event)
        if t < self._next[event.device] - 1e-9:
            self._rows.advance()
            return
        self._next[event.device] = t + self._interval
        self._rows.add(event)
        if t - self._rows.begin >= self._together:
            self._rows.start()

    def draw(self, sample: Sample, look: Mapping[str, Array]) -> None:
        """Draw a sample of the hand, with what is known beside it."""
        self.on_event(DeviceSample("hand", sample, look))

    def happens(self, t: float, what: str) -> None:
        """Mark that from a moment, s, on something is so; an empty text ends it."""
        self._stream.set_time("time", duration=t)
        self._stream.log("mirror/event", rr.StateChange(state=what))
        self._stream.reset_time()

    def conclude(self, held: Mapping[str, bool], text: str) -> None:
        """Show how the trial ended: in each phase that was checked, and as text (Markdown)."""
        self._rows.send()
        draw_verdict(self._stream, self._scene, held, text)

    def spawn(self) -> Self:
        """Open the native viewer. Raises ConfigError where there is no screen for it."""
        self._server = server.window()
        return self._connected()

    def serve(self, *, open_browser: bool = True, web_port: int = 9090) -> str:
        """Serve a page to this machine's browser; its address. Raises ConfigError when the port is taken."""
        self._server, address = server.page(web_port)
        self._connected()
        if open_browser:
            server.browse(address)
        return address

    def to_file(self, path: Path, name: Path | None = None) -> Self:
        """Write a file that `rerun` and https://app.rerun.io open; `name`: what errors call it. Raises ConfigError
        where it cannot be made, RecordingError on a full disk."""
        self._name = name or path
        try:
            str(path).encode()
        except UnicodeEncodeError as error:
            raise ConfigError(f"cannot write {self._name}: Rerun takes only a path that is UTF-8") from error
        try:
            path.write_bytes(bytes(_HEAD))  # Where the disk takes not even this, Rerun may wait for ever.
        except OSError as error:
            raise write_error(self._name, error) from error
        try:
            self._stream.save(str(path), default_blueprint=self._layout())
        except (OSError, RuntimeError) as error:
            raise ConfigError(f"cannot write {self._name}: {error}") from error
        self._draw_static()
        return self

    @contextmanager
    def recorded(self, path: Path) -> Iterator[Self]:
        """Write such a file, which is there when the block ends, and also where a fault, the link or Ctrl-C ends it and
        something was drawn. Raises ConfigError where it cannot be made, RecordingError when the disk is full."""
        ended: BaseException | None = None
        with atomic_file(path) as temporary:
            try:
                self.to_file(temporary, path)
                yield self
            except (HandError, KeyboardInterrupt) as error:
                if isinstance(error, (ConfigError, RecordingError)) or not any(self._next.values()):
                    raise
                ended = error
            finally:
                self.close()
        if ended is not None:
            raise ended

    def flush(self) -> None:
        """Wait until everything drawn has left this process."""
        self._rows.send()
        self._stream.flush()

    def close(self) -> None:
        """Let go of the viewer or the file. Raises RecordingError when the disk did not take all that was drawn."""
        try:
            self.flush()
        except RuntimeError as error:
            what = "send to the viewer" if self._name is None else f"write {self._name}"
            raise RecordingError(f"cannot {what}: {error}; is the disk full?") from error
        finally:
            self._stream.disconnect()
            if self._server is not None:
                self._server.close()

    def _connected(self) -> Self:
        assert self._server is not None
        self._stream.connect_grpc(self._server.url, default_blueprint=self._layout())
        self._draw_static()
        return self

    def _layout(self) -> rr.blueprint.Blueprint:
        if self._arm is not None and self._scene.arm is not None:
            return cell_layout(self._spec, self._arm, self._scene.arm.base)
        return hand_layout(self._spec, self._scene, self._view)

    def _draw_static(self) -> None:
        draw_still(self._stream, self._spec, self._scene)
        if self._arm is not None and self._scene.arm is not None:
            draw_arm(self._stream, self._arm, self._scene.arm)


def viewer_of(recording: CellRecording, *, live: bool = False) -> Viewer:
    """A viewer for a recording of a cell. Raises RecordingError where it has no arm or no hand."""
    hand = recording.device("hand").spec
    return Viewer(hand, scenery(hand, recording.meta), arm=recording.device("arm").spec, live=live)


def shown(samples: Iterable[Sample], viewer: Viewer, look: Look | None = None) -> Iterator[Sample]:
    """A stage that draws what passes."""
    for sample in samples:
        viewer.draw(sample, look() if look is not None else {})
        yield sample


def write_events(events: Iterable[SessionEvent], viewer: Viewer, path: Path) -> None:
    """Consume all events of a session into a `.rrd` file, which is there only when it is whole."""
    with atomic_file(path) as temporary:
        viewer.to_file(temporary, path)
        try:
            for event in events:
                viewer.on_event(event)
        finally:
            viewer.close()
