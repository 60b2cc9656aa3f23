"""A whole cell in Rerun: arm, hand and things in 3-D with what the camera sees, its states, forces and torques."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from allegro_twin.files.atomic_write import whole_file
from allegro_twin.hands.description.shapes import Body, Shape
from allegro_twin.recording.events import Happening, Moved
from allegro_twin.recording.reader import Tracks
from allegro_twin.spec import HandSpec
from allegro_twin.viewing.rerun.arm import ArmRows, draw_arm
from allegro_twin.viewing.rerun.cell_events import note
from allegro_twin.viewing.rerun.cell_layout import cell_layout
from allegro_twin.viewing.rerun.columns import Row, Rows
from allegro_twin.viewing.rerun.scene import Scenery
from allegro_twin.viewing.rerun.static import draw_still
from allegro_twin.viewing.rerun.target import TOGETHER, Canvas


class CellViewer(Canvas):
    """Draws happenings into a Rerun recording. One of `spawn`, `serve`, `to_file` says where it goes.

    `look` is what a cell's recording says of its looks: `arm`, `hand`, `adapter`, `base`, `objects`, `fixed`.
    """

    def __init__(
        self, look: Mapping[str, Any], arm: HandSpec, hand: HandSpec, *, rate: float = 30.0, live: bool = False
    ) -> None:
        super().__init__()
        self._arm_spec, self._hand_spec, self._base = arm, hand, np.array(look["base"])
        self._links = tuple(Body.from_json(body) for body in look["arm"])
        self._adapter = [Shape.from_json(shape) for shape in look["adapter"]]
        objects = {name: [Shape.from_json(shape) for shape in each] for name, each in look["objects"].items()}
        self._hand = Scenery(
            tuple(Body.from_json(body) for body in look["hand"]),
            objects,
            [Shape.from_json(shape) for shape in look["fixed"]],
        )
        self._rows = Rows(self._stream, hand, self._hand)
        self._arm_rows = ArmRows(self._stream, arm, self._links, list(objects)[1:])
        self._interval, self._next = 1.0 / rate, {"arm": 0.0, "hand": 0.0}
        self._together = TOGETHER if live else float("inf")
        self._begun: float | None = None

    def see(self, happening: Happening) -> None:
        """Draw it; of samples no more than the frame rate has."""
        if not isinstance(happening, Moved):
            note(self._stream, happening)
            return
        t = happening.sample.state.t
        if happening.device == "arm":
            self._arm_rows.feel(happening.beside["force"])
        if t < self._next[happening.device] - 1e-9:
            return
        self._next[happening.device] = t + self._interval
        if happening.device == "hand":
            self._rows.add(Row.of(happening.sample, happening.beside))
        self._arm_rows.add(happening)
        self._begun = t if self._begun is None else self._begun
        if t - self._begun >= self._together:
            self._send()

    def _layout(self) -> rr.blueprint.Blueprint:
        return cell_layout(self._arm_spec, self._hand_spec, self._base)

    def _begin(self) -> None:
        draw_still(self._stream, self._hand_spec, self._hand)
        draw_arm(self._stream, self._arm_spec, self._links, self._adapter, self._base)

    def _send(self) -> None:
        self._begun = None
        self._rows.send()
        self._arm_rows.send()


def viewer_of(recording: Tracks) -> CellViewer:
    """For a cell's recording. Raises RecordingError where it has no arm or no hand."""
    return CellViewer(recording.meta["look"], recording.device("arm").spec, recording.device("hand").spec)


def write_cell(recording: Tracks, happened: Iterable[Happening], path: Path) -> None:
    """All of it into a `.rrd` file, which is there only when it is whole."""
    with whole_file(path) as temporary:
        viewer = viewer_of(recording).to_file(temporary)
        try:
            for happening in happened:
                viewer.see(happening)
        finally:
            viewer.close()
