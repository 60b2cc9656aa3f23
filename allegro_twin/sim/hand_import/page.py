"""The page of an imported hand: what its file says, what is guessed, and what nobody knows yet; as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from allegro_twin.sim.hand_import.imported_motor import UNKNOWN


def hand_page(name: str, source: str, card: Mapping[str, Any], notes: Sequence[str], film: bool) -> str:
    """`source`: the file that it was made of. `film`: whether there is one beside it."""
    driven, followers = card["driven"], card.get("followers", ())
    fingers_of = {
        row["name"]: ", ".join(name for name, each in card["fingers"].items() if row["name"] in each["joints"])
        for row in driven
    }
    wrist = card.get("wrist", {}).get("joints", ())
    lines = [
        f"# {name}",
        f"Written by `allegro-twin hand new` from `{source}`.",
        f"![{name}: fingers by colour, driven joints by number]({name}.png)"
        + (f" [Each joint moved]({name}.mp4)." if film else ""),
        "## Known: from the file",
        _table(
            ("number", "joint", "finger", "from", "to", "effort", "followed by"),
            [
                (
                    k,
                    f"`{row['name']}`",
                    "wrist" if row["name"] in wrist else fingers_of[row["name"]],
                    f"{row['lower']:g}",
                    f"{row['upper']:g}",
                    row["effort"] if row["effort"] == UNKNOWN else f"{row['effort']:g}",
                    ", ".join(f"`{each['name']}`" for each in followers if each["follows"] == row["name"]),
                )
                for k, row in enumerate(driven)
            ],
        ),
        "rad and N·m; m and N on a slide or a tendon. A range is the joint's, met with what the command can ask for.",
        "## Guessed: look at them",
        f"- Body that stands still: `{card['root']}`. The palm faces {card['palm']['facing']}, fingers point along "
        f"{card['palm']['fingers']}, in its frame.",
        *[
            f"- `{finger}` ends at `{row['tip'][0]}`, fingertip at {row['tip'][1]} m."
            for finger, row in card["fingers"].items()
        ],
        *[f"- {note}." for note in notes if not note.startswith("effort unknown")],
        "## Missing",
        *(
            _missing(driven)
            or [
                "- Nothing that simulation needs. Friction and inertia of motors are the file's; nobody "
                "compared them with a real hand."
            ]
        ),
    ]
    return _blocks(lines)


def _missing(driven: Sequence[Mapping[str, Any]]) -> list[str]:
    unknown = [row["name"] for row in driven if row["effort"] == UNKNOWN]
    if not unknown:
        return []
    which = "every motor" if len(unknown) == len(driven) else ", ".join(f"`{name}`" for name in unknown)
    return [
        f"- The effort of {which}. The file limits no force: in simulation none is limited, verdicts cannot say what "
        "share of a motor a grasp needs, and a grasp may rest on a torque that the real hand does not have. Write the "
        "maker's figure as `effort` into the card."
    ]


def _table(head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    return "\n".join("| " + " | ".join(str(each) for each in row) + " |" for row in (head, ["---"] * len(head), *rows))


def _blocks(lines: Sequence[str]) -> str:
    """Paragraphs, with the items of a list on lines of their own."""
    text = lines[0]
    for before, line in pairwise(lines):
        text += ("\n" if before.startswith("- ") and line.startswith("- ") else "\n\n") + line
    return text + "\n"
