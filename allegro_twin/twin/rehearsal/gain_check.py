"""Gain check in a hand's own twin: which gains let it come to rest. Play and much damping make limit cycles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.drivers.can.config import VIRTUAL, CanSettings
from allegro_twin.errors import HandError, HandFault
from allegro_twin.files.schema import parse_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.twin.rehearsal.measures import oscillating_joints
from allegro_twin.twin.rehearsal.sessions import RehearsedHand, RehearsedTwin, hold_posture

POSE, STEP = "palm-up", 0.0005
"""s, of the simulation."""
CALMER = "loose"
"""Gains of the library for hands with play."""


def foretell_oscillation(
    hand: Mapping[str, Any], version: str | None, file: str, names: Iterable[str],
    postures: Sequence[str] = ("ok", "fist"),
) -> dict[str, str]:  # fmt: skip
    """Joints that oscillate under PD in simulations of a hand's file, by the name of gains; empty text for none.
    Nothing for a file without play. `hand`: its block in a config, of which `model` and `side` count. Raises
    HandError."""
    block = {"model": hand["model"], "side": hand["side"], "serial": file}
    bus = {"kind": "can", "interface": VIRTUAL, "scene": {"kind": "sim", "timestep": STEP}} | (
        {} if version is None else {"version": version}
    )
    config = parse_settings(RunConfig, {"hand": block, "backend": bus, "controller": {"kind": "pd"}}, file)
    own, settings = config.hand, config.backend
    assert isinstance(settings, CanSettings)
    spec = load_spec(own.model, own.side, file, settings.version)
    if spec.drive is None or not spec.drive.backlash.any():
        return {}
    found = {}
    for name in names:
        made = config.changed(controller={"gains": name})
        twin = RehearsedTwin("own", file, np.zeros(spec.n_joints))
        said = [_swings(RehearsedHand(made), twin, posture) for posture in postures]
        found[name] = max(said, key=len)
    return found


def _swings(hand: RehearsedHand, twin: RehearsedTwin, posture: str) -> str:
    try:
        found = hold_posture(hand, POSE, twin, posture, "pd")
    except HandFault as error:  # It swings too fast for the guard.
        return str(error)
    return oscillating_joints(found, found.known)


def advice_on_gains(hand: Mapping[str, Any], version: str | None, file: str, gains: str) -> str:
    """What simulations of a hand's file say of gains, and of those that are calmer; empty where these let it rest."""
    try:
        foretold = foretell_oscillation(hand, version, file, dict.fromkeys((gains, CALMER)))
    except HandError as error:
        return f"Whether the gains `{gains}` let it rest could not be simulated: {error}"
    return gain_advice(foretold)


def gain_advice(foretold: Mapping[str, str]) -> str:
    """One sentence about gains, the first of which are the hand's; empty where these let it rest."""
    (own, swings), *others = foretold.items() or [("", "")]
    if not swings:
        return ""
    calm = [f"`{name}`" for name, said in others if not said]
    rest = f"with {', '.join(calm)} it rests: set controller.gains" if calm else "take gains with less damping"
    return f"Its twin foretells that with the gains `{own}` it oscillates ({swings}); {rest}."
