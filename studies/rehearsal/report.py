"""The table of a rehearsal: each twin's postures, trajectories and grasps, with 95 % intervals, and hand by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import binomtest  # type: ignore[import-untyped]  # Its types are a package of its own.

from allegro_twin.twin.rehearsal import score_of

WANTED_RMS = 3.0
"""mrad"""
TWINS = ("nominal", "identified")


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown."""
    twins = [name for name in TWINS if name in rows[0]]
    head = (
        "| twin | postures, PD: median of hands (worst), mrad rms | PID | hands within 3 mrad, PD, PID | "
        "trajectory, slow; fast: mrad rms, lag | grasps held |"
    )
    lines = [head, "|---|---|---|---|---|---|"]
    for twin in twins:
        scores = [score_of(row[twin]) for row in rows]
        per = [_column(scores, kind) for kind in ("pd", "pid")]
        held = [grasp["held"] for row in rows for grasp in row[twin]["grasps"]]
        within = ", ".join(f"{(each < WANTED_RMS).sum()} of {len(each)}" for each in per)
        shown = [f"{np.median(each):.1f} ({each.max():.1f})" if len(each) else "–" for each in per]
        lines.append(f"| {twin} | {shown[0]} | {shown[1]} | {within} | {_trajectories(scores)} | {_rate(held)} |")
    lines += ["", "| hand | | nominal: PD, PID, mrad; grasps | identified | learnt in |", "|---|---|---|---|---|"]
    for row in rows:
        cells = " | ".join(_cell(row[twin]) for twin in twins)
        what = f"{row['side']} {row['version']}: {', '.join(row['traits']) or 'as our drives'}"
        lines.append(f"| {row['number']} | {what} | {cells} | {row['learnt']['bus_s']:.0f} s, "
                     f"{row['learnt'].get('cpu_s', 0.0):.0f} CPU s |")  # fmt: skip
    return "\n".join(lines)


def policy_table(rows: list[dict[str, Any]]) -> str:
    """Markdown: of each policy and hand the episodes that succeeded with each host, and what simulations had said."""
    tried = [(row, each) for row in rows for each in row.get("policies", ())]
    if not tried:
        return ""
    head = "| policy | hand | host nominal | identified | simulated nominal: share, 95 % of such | posterior draws "
    lines = [f"{head}| covers |", "|---|---|---|---|---|---|---|"]  # fmt: skip
    for row, each in tried:
        won = [f"{each[twin]['successes']} of {each['episodes']}" for twin in TWINS]
        said = [_prediction(each[name]) for name in ("simulated", "posterior")]
        covers = {True: "yes", False: "**no**"}.get(each["posterior"].get("covers"), "–")
        lines.append(f"| {each['policy']} | {row['number']} | {' | '.join([*won, *said, covers])} |")
    known = [each["posterior"]["covers"] for _, each in tried if "covers" in each["posterior"]]
    return "\n".join([*lines, "", f"The posterior's 95 % covers {sum(known)} of {len(known)}."])


def trajectory_table(rows: list[dict[str, Any]]) -> str:
    """Markdown: how close the trajectory was followed by each twin at each peak speed, without and with inverse
    dynamics."""
    head = "| twin | peak | without: mrad rms, median of hands (worst); within 3 mrad; lag | with inverse dynamics |"
    lines = [head, "|---|---|---|---|"]
    for twin in TWINS:
        scores = [score_of(row[twin]) for row in rows]
        for level in ("slow", "fast"):
            cells = [_followed(scores, name) for name in (level, f"{level}_feedforward")]
            lines.append(f"| {twin} | {level} | {' | '.join(cells)} |")
    tried = any(row[twin].get("trajectories") for row in rows for twin in TWINS)
    return "\n".join(lines) if tried else ""


def _followed(scores: list[dict[str, float]], level: str) -> str:
    error, lag = _column(scores, level), _column(scores, f"lag_{level}")
    if not len(error):
        return "–"
    return (f"{np.median(error):.1f} ({error.max():.1f}); {(error < WANTED_RMS).sum()} of {len(error)}; "
            f"{np.median(lag):.1f} ms")  # fmt: skip


def planned_table(rows: list[dict[str, Any]]) -> str:
    """Markdown: of each twin the planned grasps that held and what their plans had said, and hand by hand."""
    tried = [row for row in rows if row.get("planned")]
    if not tried:
        return ""
    lines = ["| twin | planned grasps held | foretold by their plans |", "|---|---|---|"]
    for twin in TWINS:
        mine = [each for row in tried for each in row["planned"] if each["twin"] == twin]
        told = sum(each.get("foretold", 0) for each in mine) / max(sum(each.get("of", 0) for each in mine), 1)
        lines.append(f"| {twin} | {_rate([each['held'] for each in mine])} | {100 * told:.0f} % |")
    lines += ["", "| hand | nominal | identified | lost |", "|---|---|---|---|"]
    for row in tried:
        by_twin = [[each for each in row["planned"] if each["twin"] == twin] for twin in TWINS]
        cells = [f"{sum(each['held'] for each in mine)} of {len(mine)}" for mine in by_twin]
        lost = [f"{each['object']}, {each['twin']}: {each['reason']}" for each in row["planned"] if not each["held"]]
        lines.append(f"| {row['number']} | {' | '.join(cells)} | {'; '.join(lost).replace('|', '/') or '–'} |")
    return "\n".join(lines)


def _prediction(found: dict[str, Any]) -> str:
    if "error" in found:
        return str(found["error"]).replace("|", "/")
    return f"{100 * found['successes'] / found['of']:.0f} %, {found['low']}–{found['high']}"


def scores(rows: list[dict[str, Any]], about: str) -> dict[str, Any]:
    """What `allegro-twin rehearse` shows a real hand beside: the scores of some hands, by twin."""
    hands = [{name: row[name] for name in ("number", "side", "version", "traits")}
             | {twin: score_of(row[twin]) for twin in TWINS if twin in row} for row in rows]  # fmt: skip
    return {"about": about, "hands": hands}


def _column(scores: list[dict[str, float]], measure: str) -> Any:
    return np.array([score[measure] for score in scores if measure in score])


def _trajectories(scores: list[dict[str, float]]) -> str:
    cells = []
    for level in ("slow", "fast"):
        error, lag = _column(scores, level), _column(scores, f"lag_{level}")
        cells.append(f"{np.median(error):.1f} ({error.max():.1f}), {np.median(lag):.1f} ms" if len(error) else "–")
    return "; ".join(cells)


def _rate(held: list[bool]) -> str:
    if not held:
        return "–"
    low, high = binomtest(sum(held), len(held)).proportion_ci(method="wilson")
    share = 100 * sum(held) / len(held)
    return f"{sum(held)} of {len(held)}: {share:.0f} % ({100 * low:.0f}–{100 * high:.0f} %)"


def _cell(found: dict[str, Any]) -> str:
    score, grasps = score_of(found), found["grasps"]
    errors = ", ".join(f"{score[kind]:.1f}" if kind in score else "–" for kind in ("pd", "pid"))
    return f"{errors}; {sum(grasp['held'] for grasp in grasps)} of {len(grasps)}"
