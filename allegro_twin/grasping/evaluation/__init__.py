"""Evaluation campaigns: their trials, tables, statistics and reports.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.grasping.evaluation.campaign import EvaluationTarget, SamplingSettings, find_targets
    from allegro_twin.grasping.evaluation.html_report import write_html_report
    from allegro_twin.grasping.statistics import Interval, PairedCounts, count_pairs, pairs_needed, wilson

__all__ = [
    "EvaluationTarget",
    "Interval",
    "PairedCounts",
    "SamplingSettings",
    "count_pairs",
    "find_targets",
    "pairs_needed",
    "wilson",
    "write_html_report",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "evaluation.campaign": (
            "EvaluationTarget",
            "SamplingSettings",
            "find_targets",
        ),
        "evaluation.html_report": ("write_html_report",),
        "statistics": (
            "Interval",
            "PairedCounts",
            "count_pairs",
            "pairs_needed",
            "wilson",
        ),
    },
    root="allegro_twin.grasping",
)
