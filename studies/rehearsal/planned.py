"""Planned grasps on hidden hands: `allegro-twin plan` for the nominal hand and for the file that was learnt, and the
best of each performed over the bus on objects that are not quite what their plan was told."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from allegro_twin import ConfigError, HandError
from allegro_twin.files import read_yaml
from studies.rehearsal.hidden_hand import draw_hand
from studies.rehearsal.rehearse import drawn_objects
from studies.rehearsal.sessions import RehearsedHiddenHand, learnt_file

NOTHING_HOLDS = 5
"""Exit code of `plan` where no grasp holds."""
GRASPS = 3
"""Of a plan; the first is performed."""


def try_planned(
    row: Mapping[str, Any], protocol: Mapping[str, Any], folder: Path, candidates: int,
    say: Callable[[str], None] = lambda line: None,
) -> list[dict[str, Any]]:  # fmt: skip
    """A row for each object and twin of one right hand's result. Plans lie in folder/nominal, which all hands share,
    and in a folder of the hand's number; one that is there is not made again. Raises ConfigError where `plan` fails."""
    hand = draw_hand(row["number"], protocol["seed"])
    draws, rows = drawn_objects(hand, protocol), []
    with learnt_file(row) as file:
        for thing, draw in draws.items():
            for twin in protocol["twins"]:
                serial = "" if twin == "nominal" else str(file)
                place = folder / ("nominal" if twin == "nominal" else f"{hand.number:02d}") / thing
                scenario = plan_grasp(thing, serial, place, candidates)
                found: dict[str, Any] = {"object": thing, "twin": twin}
                if scenario is None:
                    rows.append(found | {"held": False, "reason": "the plan found no grasp that holds"})
                else:
                    rehearsed = RehearsedHiddenHand(hand, {str(scenario): draw})
                    rows.append(found | foretold(scenario) | _performed(rehearsed, scenario, serial))
                say(f"hand {hand.number}: {thing}, {twin}: {rows[-1]['reason'] or 'held'}")
    return rows


def plan_grasp(thing: str, serial: str, place: Path, candidates: int) -> Path | None:
    """The scenario of the best planned grasp, or None where the plan finds none. Raises ConfigError with its words."""
    best, nothing = place / f"{thing}_1.yaml", place / "nothing"
    if not best.exists() and not nothing.exists():
        command = [sys.executable, "-m", "allegro_twin", "plan", thing, "--candidates", str(candidates), "--n",
                   str(GRASPS), "--no-pictures", "--out", str(place)]  # fmt: skip
        ended = subprocess.run(command + (["--twin", serial] if serial else []), capture_output=True, text=True)
        if ended.returncode == NOTHING_HOLDS:
            place.mkdir(parents=True, exist_ok=True)
            nothing.write_text(ended.stderr)
        elif ended.returncode:
            raise ConfigError(f"plan {thing} failed with {ended.returncode}: {ended.stderr.strip()}")
    return best if best.exists() else None


def foretold(scenario: Path) -> dict[str, Any]:
    """What the plan says of its grasp: in how many of its unseen draws it holds."""
    entries = read_yaml(scenario.parent / "grasps" / scenario.name)["entries"]
    plan = entries[scenario.stem]["planned"]
    return {"foretold": plan["held"], "of": plan["draws"]}


def _performed(hand: RehearsedHiddenHand, scenario: Path, serial: str) -> dict[str, Any]:
    try:
        report = hand.trial(str(scenario), serial)
    except HandError as error:  # The guard's, say: the grasp is lost.
        return {"held": False, "reason": str(error)}
    return {"held": report.held, "reason": report.reason}
