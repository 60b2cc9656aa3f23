"""The score of a rehearsed hand, and those of the hidden hands that it stands beside."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.errors import RecordingError
from allegro_twin.files.assets import data_root

HIDDEN_HANDS = Path("conf/rehearsal/hidden_hands.json")
"""Scores of the hidden hands of docs/results/rehearsal.md, which its study's report writes."""
Score = Mapping[str, float]
MEASURES = {
    "pd": "postures under PD, mrad rms", "pid": "postures under PID, mrad rms",
    "slow": "slow trajectory, mrad rms", "slow_feedforward": "the same with inverse dynamics",
    "fast": "fast trajectory, mrad rms", "fast_feedforward": "the same with inverse dynamics",
    "lag_slow": "lag, slow, ms", "lag_slow_feedforward": "the same with inverse dynamics",
    "lag_fast": "lag, fast, ms", "lag_fast_feedforward": "the same with inverse dynamics",
    "held": "grasps held, %",
}  # fmt: skip
"""What a score has, by key; `held`, of grasps on objects, is the only one of which more is better."""


class HiddenScores(NamedTuple):
    """Scores of the hidden hands, and what they are of."""

    about: str
    hands: tuple[Mapping[str, Score], ...]
    """By twin, hand by hand."""


def score_of(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, float]:
    """The score of what was measured with one twin: rows `postures`, `trajectories` and `grasps` of a result. A measure
    of which there is no row is not in it."""
    score: dict[str, float] = {}
    for kind in ("pd", "pid"):
        if errors := [row["error"] for row in found.get("postures", ()) if row["controller"] == kind]:
            score[kind] = 1e3 * float(np.sqrt(np.square(errors).mean()))
    for row in found.get("trajectories", ()):
        level = f"{row['level']}_feedforward" if row.get("feedforward") else row["level"]
        score[level] = 1e3 * float(np.sqrt(np.square(row["rms"]).mean()))
        score[f"lag_{level}"] = 1e3 * float(row["lag"])
    if held := [row["held"] for row in found.get("grasps", ()) if "held" in row]:
        score["held"] = 100.0 * float(np.mean(held))
    return score


def hidden_scores(path: Path | None = None) -> HiddenScores | None:
    """The scores that ship with the package, or those of a file; None where there are none yet. Raises
    RecordingError."""
    file = data_root() / HIDDEN_HANDS if path is None else path
    if not file.is_file():
        return None
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        return HiddenScores(str(content["about"]), tuple(content["hands"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RecordingError(f"{file}: has no scores of hidden hands ({error})") from error


def rank(own: float, others: Sequence[float], measure: str) -> str:
    """How many of the others a value is better than, as text."""
    better = sum(own > each if measure == "held" else own < each for each in others)
    return f"better than {better} of {len(others)}"
