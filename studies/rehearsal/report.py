"""The table of a rehearsal: each twin's postures and grasps, with 95 % intervals, and hand by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import binomtest  # type: ignore[import-untyped]  # Its types are a package of its own.

from studies.rehearsal.rehearse import rms_mrad

WANTED_RMS = 3.0
"""mrad"""


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown."""
    twins = [name for name in ("nominal", "identified") if name in rows[0]]
    head = (
        "| twin | postures, PD: median of hands (worst), mrad rms | PID | hands within 3 mrad, PD, PID | grasps held |"
    )
    lines = [head, "|---|---|---|---|---|"]
    for twin in twins:
        per = {kind: np.array([_rms(row[twin], kind) for row in rows]) for kind in ("pd", "pid")}
        held = [grasp["held"] for row in rows for grasp in row[twin]["grasps"]]
        low, high = binomtest(sum(held), len(held)).proportion_ci(method="wilson")
        shown = [f"{np.median(each):.1f} ({each.max():.1f})" for each in per.values()]
        within = ", ".join(f"{(each < WANTED_RMS).sum()} of {len(each)}" for each in per.values())
        lines.append(f"| {twin} | {shown[0]} | {shown[1]} | {within} | {sum(held)} of {len(held)}: "
                     f"{100 * sum(held) / len(held):.0f} % ({100 * low:.0f}–{100 * high:.0f} %) |")  # fmt: skip
    lines += ["", "| hand | | nominal: PD, PID, mrad; grasps | identified | learnt in |", "|---|---|---|---|---|"]
    for row in rows:
        cells = []
        for twin in twins:
            each, grasps = row[twin], row[twin]["grasps"]
            cells.append(
                f"{_rms(each, 'pd'):.1f}, {_rms(each, 'pid'):.1f}; {sum(g['held'] for g in grasps)} of {len(grasps)}"
            )
        what = f"{row['side']} {row['version']}: {', '.join(row['traits']) or 'as our drives'}"
        lines.append(f"| {row['number']} | {what} | {' | '.join(cells)} | {row['learnt']['bus_s']:.0f} s, "
                     f"{row['learnt']['cpu_s']:.0f} CPU s |")  # fmt: skip
    return "\n".join(lines)


def _rms(found: dict[str, Any], kind: str) -> float:
    return rms_mrad([row for row in found["postures"] if row["controller"] == kind])
