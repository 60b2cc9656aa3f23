"""Trajectories on hidden hands whose files were learnt before: steps that results of the registered campaign lack."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from allegro_twin.twin.rehearsal import HandRehearsal, RehearsalProtocol
from studies.rehearsal.hidden_hand import draw_hand
from studies.rehearsal.sessions import RehearsedHiddenHand

LEARNT = ("ends", "excite", "identify")


def try_trajectories(row: Mapping[str, Any], protocol: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """By twin, as `HandRehearsal` has it: a rehearsal that goes on after its learning, with the file of a result, and
    has nothing but trajectories left. Raises HandError."""
    steps = RehearsalProtocol(
        poses=protocol["poses"], postures=(), posture_poses=tuple(protocol["posture_poses"]),
        controllers=tuple(protocol["controllers"]), twins=tuple(protocol["twins"]),
    )  # fmt: skip
    with TemporaryDirectory() as name:
        (Path(name) / "hand.yaml").write_text(row["file"])
        rehearsal = HandRehearsal(RehearsedHiddenHand(draw_hand(row["number"], protocol["seed"])), steps, Path(name))
        states = rehearsal.result()["states"]
        rehearsal.steps |= {step: {"state": "done"} for step in states if step.startswith(LEARNT)}
        found = rehearsal.run()
    return {twin: found[twin]["trajectories"] for twin in protocol["twins"]}
