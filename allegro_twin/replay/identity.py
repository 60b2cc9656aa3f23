"""A hand's spec as JSON, so that a recording says on its own which hand it is of."""

from __future__ import annotations

from typing import Any

from allegro_twin.drive import Drive
from allegro_twin.spec import Actuation, Finger, HandSpec
from allegro_twin.types import frozen

_ACTUATION = ("torque_limit", "damping", "armature", "frictionloss")


def spec_to_json(spec: HandSpec) -> dict[str, Any]:
    drive = {} if spec.drive is None else {"drive": spec.drive.plain()}
    return drive | {
        "model": spec.model,
        "side": spec.side,
        "serial": spec.serial,
        "joints": list(spec.joints),
        "aliases": list(spec.aliases),
        "fingers": [{"name": f.name, "joints": list(f.joints), "tip": f.tip} for f in spec.fingers],
        "lower": spec.lower.tolist(),
        "upper": spec.upper.tolist(),
        "actuation": {key: getattr(spec.actuation, key).tolist() for key in _ACTUATION},
        "mirror_flips": list(spec.mirror_flips),
    }


def spec_from_json(content: dict[str, Any]) -> HandSpec:
    drive = content.get("drive")
    return HandSpec(
        drive=None if drive is None else Drive.made(drive, len(content["joints"])),
        model=content["model"],
        side=content["side"],
        serial=content["serial"],
        joints=tuple(content["joints"]),
        aliases=tuple(content["aliases"]),
        fingers=tuple(Finger(f["name"], tuple(f["joints"]), f["tip"]) for f in content["fingers"]),
        lower=frozen(content["lower"]),
        upper=frozen(content["upper"]),
        actuation=Actuation(**{key: frozen(content["actuation"][key]) for key in _ACTUATION}),
        mirror_flips=tuple(content["mirror_flips"]),
    )
