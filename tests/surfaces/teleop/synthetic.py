"""A person's hand made of lengths and angles, which opens, closes and pinches before a camera that it turns about.

`python -m tests.surfaces.teleop.synthetic` writes examples/hand_tracking.csv anew.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from allegro_twin.kinematics.orientation import matrix_from_euler
from allegro_twin.spec import Side
from allegro_twin.surfaces.teleop.tracks import HEADER
from allegro_twin.types import Array, Vector

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = ROOT / "examples" / "hand_tracking.csv"
# Of a middling adult, m, by ruler: knuckles as seen from the wrist (x out of the palm, y toward the index finger,
# z to the fingers) and the bones of each finger.
KNUCKLES = {"index": (0.0, 0.025, 0.088), "middle": (0.0, 0.0, 0.09), "ring": (0.0, -0.02, 0.084),
            "little": (0.0, -0.038, 0.075)}  # fmt: skip
BONES = {"index": (0.044, 0.026, 0.022), "middle": (0.048, 0.03, 0.023), "ring": (0.045, 0.028, 0.023),
         "little": (0.035, 0.021, 0.02)}  # fmt: skip
THUMB = (0.012, 0.022, 0.02)
THUMB_BONES = (0.044, 0.032, 0.026)
OPEN, CLOSED = 0.1, 1.3
"""rad that each knuckle is bent."""


def hand(bend: float, pinch: float = 0.0) -> Array:
    """Landmarks (21, 3), m, as seen from the wrist, of a right hand. `bend`, rad, of every knuckle but the thumb's;
    `pinch` from 0 to 1: how far the tips of thumb and index finger are on their way to each other."""
    points = [np.zeros(3), *_chain(np.array(THUMB), THUMB_BONES, _thumb(bend))]
    for name, knuckle in KNUCKLES.items():
        angles = np.cumsum([bend, 0.9 * bend, 0.6 * bend])
        points += _chain(np.array(knuckle), BONES[name], [np.array([np.sin(a), 0.0, np.cos(a)]) for a in angles])
    found = np.array(points)
    if pinch:
        between = np.array([0.06, 0.03, 0.1])
        for tip, joint in ((4, 3), (8, 7)):
            side = np.array([0.0, 0.006 if tip == 8 else -0.006, 0.0])
            step = pinch * (between + side - found[tip])
            found[tip] += step
            found[joint] += 0.6 * step
    return found


def performed(rate: float = 30.0, side: Side = "right") -> tuple[Vector, Array]:
    """Six seconds: opens, closes, opens, pinches, opens; the arm turns and moves meanwhile. Times (k,), s, and
    landmarks (k, 21, 3), m, in a camera's frame."""
    times = np.arange(round(6.0 * rate)) / rate
    bends = np.interp(times, [0, 1, 2, 3, 6], [OPEN, OPEN, CLOSED, OPEN, OPEN])
    pinches = np.interp(times, [0, 3.5, 4.5, 5.0, 5.8], [0, 0, 1, 1, 0])
    frames = np.array([hand(bend, pinch) for bend, pinch in zip(bends, pinches, strict=True)])
    if side == "left":
        frames = frames * [1.0, -1.0, 1.0]
    turns = [matrix_from_euler(np.array([0.4 * np.sin(t), 0.3 * np.cos(0.7 * t), 1.0 + 0.2 * t])) for t in times]
    places = np.column_stack([0.1 * np.sin(0.5 * times), 0.05 * times, 0.6 + 0.0 * times])
    return times, np.array([f @ turn.T + place for f, turn, place in zip(frames, turns, places, strict=True)])


def write_csv(path: Path, times: Vector, frames: Array) -> None:
    """A track in a file; rows of NaN are left empty."""
    lines = [",".join(HEADER)]
    for t, frame in zip(times, frames.reshape(len(times), -1), strict=True):
        lines.append(",".join([f"{t:.4g}", *("" if np.isnan(v) else f"{v:.4f}" for v in frame)]))
    path.write_text("\n".join(lines) + "\n")


def _thumb(bend: float) -> list[Vector]:
    closed = (bend - OPEN) / (CLOSED - OPEN)
    away = (1.0 - closed) * np.array([0.35, 0.75, 0.55]) + closed * np.array([0.6, 0.35, 0.72])
    across = (1.0 - closed) * np.array([0.3, 0.5, 0.8]) + closed * np.array([0.6, -0.2, 0.77])
    return [direction / np.linalg.norm(direction) for direction in (away, (away + across) / 2.0, across)]


def _chain(begin: Vector, bones: tuple[float, ...], directions: list[Vector]) -> list[Vector]:
    found = [begin]
    for length, direction in zip(bones, directions, strict=True):
        found.append(found[-1] + length * direction)
    return found


if __name__ == "__main__":
    write_csv(EXAMPLE, *performed(rate=10.0))
