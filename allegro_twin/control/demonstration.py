"""From what a person showed to a motion: without the waiting at both ends, and with no more knots than it needs."""

from __future__ import annotations

import numpy as np

from allegro_twin.control.motion import Motion
from allegro_twin.errors import ConfigError
from allegro_twin.types import Array


def taught(times: Array, positions: Array, *, still: float = 0.01, tolerance: float = 0.004) -> Motion:
    """The motion in a record of joint positions, trimmed and simplified. Raises ConfigError when nothing moved.

    What lies within `still` (rad) of the first or the last position at either end is waiting. Between its knots the
    result runs straight in time and leaves the record nowhere by more than `tolerance` (rad) in any joint.
    """
    begin = int(np.argmax((np.abs(positions - positions[0]) > still).any(axis=1)))
    moving = (np.abs(positions - positions[-1]) > still).any(axis=1)
    if not moving.any():
        raise ConfigError(f"nothing was taught: no joint moved by more than {still} rad")
    end = len(positions) - int(np.argmax(moving[::-1]))
    # Of a motion that is hardly longer than `still` all may be waiting, at the one end or the other.
    begin, end = max(min(begin, end) - 1, 0), min(max(begin, end), len(positions) - 1)
    keep = _knots(times[begin : end + 1], positions[begin : end + 1], tolerance)
    return Motion(times[begin + keep] - times[begin], positions[begin + keep])


def _knots(times: Array, positions: Array, tolerance: float) -> Array:
    """Row indices to keep: the ends, and wherever a straight line in time would miss a row (Douglas and Peucker)."""
    keep = {0, len(times) - 1}
    spans = [(0, len(times) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        part = ((times[first : last + 1] - times[first]) / (times[last] - times[first]))[:, None]
        straight = positions[first] + part * (positions[last] - positions[first])
        missed = np.abs(positions[first : last + 1] - straight).max(axis=1)
        worst = int(np.argmax(missed))
        if missed[worst] > tolerance:
            keep.add(first + worst)
            spans += [(first, first + worst), (first + worst, last)]
    return np.array(sorted(keep))
