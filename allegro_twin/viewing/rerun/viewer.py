"""The Rerun stage: the hand and what it holds in 3-D, and the series that explain them, on any backend."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import rerun as rr

from allegro_twin.files.atomic_write import whole_file
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample
from allegro_twin.viewing.rerun.columns import Row, Rows
from allegro_twin.viewing.rerun.layout import layout
from allegro_twin.viewing.rerun.scene import Scenery, scenery
from allegro_twin.viewing.rerun.static import draw_still, draw_verdict
from allegro_twin.viewing.rerun.target import TOGETHER, Canvas
from allegro_twin.viewing.views import DEFAULT

Look = Callable[[], Mapping[str, Array]]
"""What is known beside the hand's state: `target` (n,), `palm`, `object`, `target_object` (7,), `contact_force` (p,),
`contact_point`, `contact_vector` (3 p,)."""


class Viewer(Canvas):
    """Draws samples into a Rerun recording. One of `spawn`, `serve`, `to_file` says where it goes."""

    def __init__(
        self,
        spec: HandSpec,
        scene: Scenery | None = None,
        *,
        rate: float = 30.0,
        live: bool = False,
        view: str = DEFAULT,
    ) -> None:
        super().__init__()
        self._spec, self._interval, self._next = spec, 1.0 / rate, 0.0
        self._scene, self._view = scene or scenery(spec, {}), view
        self._rows = Rows(self._stream, spec, self._scene)
        self._together = TOGETHER if live else float("inf")

    def draw(self, sample: Sample, look: Mapping[str, Array]) -> None:
        """Draw a sample, unless the last one drawn is nearer than the frame rate. Whoever watches gets it over the next
        calls, a little in each, so that no period is late."""
        t = sample.state.t
        if t < self._next - 1e-9:
            self._rows.advance()
            return
        self._next = t + self._interval
        self._rows.add(Row.of(sample, look))
        if t - self._rows.begin >= self._together:
            self._rows.start()

    def happens(self, t: float, what: str) -> None:
        """Mark that from a moment, s, on something is so; an empty word ends it."""
        self._stream.set_time("time", duration=t)
        self._stream.log("mirror/event", rr.StateChange(state=what))
        self._stream.reset_time()

    def conclude(self, held: Mapping[str, bool], words: str) -> None:
        """Say how the trial ended: in each phase that was checked, and in words (Markdown)."""
        self._rows.send()
        draw_verdict(self._stream, self._scene, held, words)

    def _begin(self) -> None:
        draw_still(self._stream, self._spec, self._scene)

    def _send(self) -> None:
        self._rows.send()

    def _layout(self) -> rr.blueprint.Blueprint:
        return layout(self._spec, self._scene, self._view)


def shown(samples: Iterable[Sample], viewer: Viewer, look: Look | None = None) -> Iterator[Sample]:
    """A stage that draws what passes."""
    for sample in samples:
        viewer.draw(sample, look() if look is not None else {})
        yield sample


def write_rrd(samples: Iterable[Sample], viewer: Viewer, path: Path, look: Look | None = None) -> None:
    """Consume all samples into a `.rrd` file, which is there only when it is whole."""
    with whole_file(path) as temporary:
        viewer.to_file(temporary)
        try:
            for _ in shown(samples, viewer, look):
                pass
        finally:
            viewer.close()
