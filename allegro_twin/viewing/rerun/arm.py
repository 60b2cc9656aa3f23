"""The arm of a cell in Rerun, and what is known beside it: its frames, its torques, and what its flange feels."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
import rerun as rr

from allegro_twin.hands.description.appearance import of_series
from allegro_twin.hands.description.shapes import Body, Shape
from allegro_twin.recording.events import Moved
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array
from allegro_twin.viewing.rerun.static import draw_shapes
from allegro_twin.viewing.skeleton import Skeleton

FRAMES = {"goal": 0.12, "tool": 0.08}
"""Axes that are drawn in the world, and how long, m: where the flange is to go, and the palm."""
SMOOTHED = 33
"""Samples of the force whose mean is drawn, 0.1 s at 3 ms: one alone is lost in the sensor's noise."""
_N, _NM = ("x", "y", "z"), ("about x", "about y", "about z")


def draw_arm(
    stream: rr.RecordingStream, spec: HandSpec, links: Sequence[Body], adapter: Sequence[Shape], base: Array
) -> None:
    """What does not move of itself."""
    stream.log("world/arm", rr.Transform3D(translation=base), static=True)
    for body in links:
        draw_shapes(stream, f"world/arm/{body.name}/look", body.shapes)
    draw_shapes(stream, "world/flange/look", adapter)
    for name, long in FRAMES.items():
        stream.log(f"world/{name}", rr.TransformAxes3D(long), static=True)
    names = {"arm/torque": spec.readable, "cell/force": _N, "cell/moment": _NM}
    for path, each in names.items():
        colors = [[round(255 * part) for part in of_series(k)] for k in range(len(each))]
        stream.log(path, rr.SeriesLines(names=list(each), colors=colors, widths=[1.5]), static=True)


class ArmRows:
    """Collects samples of a cell and sends what `look.rows` does not. `others`: things but the first, by name."""

    def __init__(
        self, stream: rr.RecordingStream, spec: HandSpec, links: Sequence[Body], others: Sequence[str]
    ) -> None:
        self._stream, self._skeleton, self._others = stream, Skeleton(links, spec), others
        self._arm: list[Moved] = []
        self._felt: deque[Array] = deque(maxlen=SMOOTHED)
        self._force: list[Array] = []
        self._hand: list[Moved] = []

    def feel(self, force: Array) -> None:
        """Of every sample of the arm, (6,), N and N·m, drawn or not."""
        self._felt.append(force)

    def add(self, moved: Moved) -> None:
        """A sample of either, to be drawn."""
        if moved.device == "hand":
            self._hand.append(moved)
            return
        self._arm.append(moved)
        self._force.append(np.mean(self._felt, axis=0))

    def send(self) -> None:
        """Send what has been collected."""
        arm, hand, self._arm, self._hand = self._arm, self._hand, [], []
        force, self._force = np.array(self._force), []
        if arm:
            self._arm_moved(arm)
            self._series("cell/force", arm, force[:, :3])
            self._series("cell/moment", arm, force[:, 3:])
        for number, name in enumerate(self._others if hand else ()):
            poses = [moved.beside["others"][7 * number : 7 * number + 7] for moved in hand]
            self._placed(f"world/objects/{name}", hand, np.array(poses))

    def _arm_moved(self, rows: list[Moved]) -> None:
        states = [moved.sample.state for moved in rows]
        places = self._skeleton.places(np.array([state.position for state in states]))
        for body, (place, rotation) in zip(self._skeleton.bodies, places, strict=True):
            if body.parent >= 0:
                moved = rr.Transform3D.columns(translation=place, mat3x3=rotation.reshape(-1, 9))
                self._stream.send_columns(f"world/arm/{body.name}", indexes=times(rows), columns=moved)
        for name in ("flange", *FRAMES):
            self._placed(f"world/{name}", rows, np.array([moved.beside[name] for moved in rows]))
        self._series("arm/torque", rows, np.array([state.torque for state in states]))

    def _placed(self, path: str, rows: list[Moved], poses: Array) -> None:
        moved = rr.Transform3D.columns(translation=poses[:, :3], quaternion=poses[:, [4, 5, 6, 3]])
        self._stream.send_columns(path, indexes=times(rows), columns=moved)

    def _series(self, path: str, rows: list[Moved], values: Array) -> None:
        data = rr.Scalars.columns(scalars=values.reshape(-1)).partition([values.shape[1]] * len(rows))
        self._stream.send_columns(path, indexes=times(rows), columns=data)


def times(rows: Sequence[Moved]) -> list[rr.TimeColumn]:
    """When, s of the cell's clock."""
    return [rr.TimeColumn("time", duration=[moved.sample.state.t for moved in rows])]
