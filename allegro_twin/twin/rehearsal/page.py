"""HTML page of a rehearsal: what was not done, the score beside the hidden hands', and every measurement.

One file, with nothing from elsewhere but the films of grasps, which are beside it where they were asked for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.twin.rehearsal.score import MEASURES, HiddenScores, hidden_scores, rank, score_of
from allegro_twin.viewing.report import html_page, html_table, strip_chart
from allegro_twin.viewing.report.html import film_figure

NO_HANDS = "No results of hidden hands are in this version of the package, so the score stands alone."


def write_page(path: Path, result: Mapping[str, Any]) -> None:
    """Write the page of a result. Raises RecordingError."""
    with atomic_file(path) as temporary:
        temporary.write_text(rehearsal_page(result, hidden_scores()), encoding="utf-8")


def rehearsal_page(result: Mapping[str, Any], hidden: HiddenScores | None) -> str:
    """Text of the HTML file."""
    hand, steps = result["hand"], result["states"]
    done = sum(state == "done" for state in steps.values())
    about = (
        f"{result['program']} · {hand['side']} {result['config']['backend'].get('version') or ''} · {done} of "
        f"{len(steps)} steps done · {result['hand_s'] / 60.0:.1f} min on the hand's clock"
    )
    title = f"Rehearsal of {hand['model']} {hand['serial']}".strip()
    return html_page(title, about, (_problems(result), _scores(result, hidden), *_measurements(result), _steps(result)))


def score_rows(result: Mapping[str, Any], hidden: HiddenScores | None) -> list[list[str]]:
    """Rows of a table: the measure, each twin's value, and where the last twin's stands among the hidden hands'."""
    twins = list(result["protocol"]["twins"])
    scores = {twin: score_of(result[twin]) for twin in twins}
    rows = []
    for measure, text in MEASURES.items():
        if not any(measure in score for score in scores.values()):
            continue
        row = [text, *(f"{scores[twin][measure]:.1f}" if measure in scores[twin] else "–" for twin in twins)]
        others = _others(hidden, twins[-1], measure)
        usual = f"{np.median(others):.1f} ({min(others):.1f}–{max(others):.1f})" if others else "–"
        own = scores[twins[-1]].get(measure)
        rows.append([*row, usual, rank(own, others, measure) if others and own is not None else "–"])
    return rows


def _others(hidden: HiddenScores | None, twin: str, measure: str) -> list[float]:
    if hidden is None:
        return []
    return [hand[twin][measure] for hand in hidden.hands if measure in hand.get(twin, {})]


def _problems(result: Mapping[str, Any]) -> str:
    if not result["problems"]:
        return "<p>Every step was done, and every posture was reached.</p>"
    lines = "".join(f"<li>{escape(line)}</li>" for line in result["problems"])
    return f"<h2>Not done, not reached, not held</h2><ul>{lines}</ul>"


def _scores(result: Mapping[str, Any], hidden: HiddenScores | None) -> str:
    twins = list(result["protocol"]["twins"])
    rows = score_rows(result, hidden)
    said = NO_HANDS if hidden is None else hidden.about
    text = f"<h2>Score</h2><p class='soft'>{escape(said)}</p>"
    text += "".join(f"<p>{escape(note)}</p>" for note in result.get("notes", ()))
    if not rows:
        return f"{text}<p>Nothing was measured yet.</p>"
    heads = ["", *(_label(result, twin) for twin in twins), "hidden hands: median (least–most)", "among them"]
    text += html_table(heads, rows)
    others = _others(hidden, twins[-1], "pd")
    if others and (own := score_of(result[twins[-1]]).get("pd")) is not None:
        columns = [("hidden hands", np.array(others)), ("this hand", np.array([own]))]
        good = np.ones(max(map(len, (values for _, values in columns))), dtype=bool)
        text += strip_chart(columns, good, "Postures under PD with the identified twin, mrad rms")
    return text


def _label(result: Mapping[str, Any], twin: str) -> str:
    serial = result["hand"]["serial"]
    return f"as configured ({Path(serial).name})" if twin == "nominal" and serial else twin


def _measurements(result: Mapping[str, Any]) -> Iterator[str]:
    twins = list(result["protocol"]["twins"])
    rows = [row for twin in twins for row in result[twin]["postures"]]
    if rows:
        judges = {row["judged_by"] for row in rows}
        how = "by the simulation" if judges == {"simulation"} else "by the encoders, with the offsets of the ends"
        yield html_table(
            ("twin", "pose", "posture", "controller", "rms, mrad", "by encoders", "worst joint, mrad", "not reached",
             "oscillates"),
            ([row["twin"], row["pose"], row["posture"], row["controller"], _rms(row["error"]),
              _rms(row["by_encoders"]), f"{1e3 * max(map(abs, row['error'])):.1f}", row["missed"],
              row.get("oscillates", "")]
             for row in rows),
            f"Postures: error of the last half second, judged {how}",
        )  # fmt: skip
    rows = [row for twin in twins for row in result[twin]["trajectories"]]
    if rows:
        yield html_table(
            ("twin", "level", "peak, rad/s", "inverse dynamics", "rms, mrad", "by encoders", "lag, ms",
             "at its end, mrad", "no torque left, % of time"),
            ([row["twin"], row["level"], f"{row['speed']:g}", "fed forward" if row.get("feedforward") else "",
              _rms(row["rms"]), _rms(row["by_encoders"]), f"{1e3 * row['lag']:.1f}", _rms(row["steady"]),
              ", ".join(f"{name} {100.0 * share:.0f}" for name, share in row.get("spent", {}).items())]
             for row in rows),
            "A minimum-jerk trajectory of all joints",
        )  # fmt: skip
    rows = [row for twin in twins for row in result[twin]["grasps"]]
    if rows:
        yield html_table(("twin", "grasp", "with", "outcome"), ([row["twin"], row["scenario"], row["with"],
                         grasp_text(row)] for row in rows), "Grasps")  # fmt: skip
        yield _films([row for row in rows if "film" in row])
    lines = result["steps"].get("identify", {}).get("lines")
    if lines:
        yield "<h2>What the hand has</h2>" + "".join(f"<p>{escape(line)}</p>" for line in lines)
        yield "<p><a href='identification.html'>All values with intervals</a></p>"


def _films(rows: Sequence[Mapping[str, Any]]) -> str:
    """Lost grasps first: they are what a person looks for."""
    found = sorted(rows, key=lambda row: row["held"])
    return "".join(
        film_figure(row["film"], f"{row['scenario']}, {row['twin']}: {'held' if row['held'] else 'not held'}")
        for row in found
    )


def grasp_text(row: Mapping[str, Any]) -> str:
    """What became of one grasp."""
    if "held" in row:
        return "held" if row["held"] else f"not held: {row['reason']}"
    took = "never closed" if row["closing_s"] is None else f"closed in {row['closing_s']:.2f} s"
    return f"{took} (planned {row['planned_s']:.2f} s); {_rms(row['error'])} mrad rms at the end"


def _steps(result: Mapping[str, Any]) -> str:
    rows = ([name, state, result["steps"].get(name, {}).get("text", "")] for name, state in result["states"].items())
    return "<h2>Steps</h2>" + html_table(("step", "state", "what was found"), rows)


def _rms(errors: list[float]) -> str:
    return f"{1e3 * float(np.sqrt(np.square(errors).mean())):.1f}"
