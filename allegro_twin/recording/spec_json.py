"""Hand specs as JSON, so that a recording says by itself which hand it is of."""

from __future__ import annotations

import os
from dataclasses import asdict
from functools import partial
from typing import Any

from allegro_twin.spec import Actuation, Finger, HandSpec
from allegro_twin.spec.arm import ArmSpec, Load, Slowing
from allegro_twin.spec.coupled_joints import CoupledJoint
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.spec.thermal import ThermalData
from allegro_twin.types import frozen

_ACTUATION = ("torque_limit", "damping", "armature", "frictionloss", "stiffness", "velocity_limit", "torque_rate")
_SLOWING = ("a", "b", "lower", "upper")


def spec_to_json(spec: HandSpec) -> dict[str, Any]:
    drive = {} if spec.drive is None else {"drive": spec.drive.plain()}
    return (
        drive
        | _optional_entries(spec)
        | {
            "model": spec.model,
            "side": spec.side,
            "serial": spec.serial,
            "joints": list(spec.joints),
            "aliases": list(spec.aliases),
            "fingers": [{"name": f.name, "joints": list(f.joints), "tip": f.tip} for f in spec.fingers],
            "lower": spec.lower.tolist(),
            "upper": spec.upper.tolist(),
            "actuation": {k: v.tolist() for k in _ACTUATION if (v := getattr(spec.actuation, k)) is not None},
            "mirror_flips": list(spec.mirror_flips),
        }
    )


def spec_from_json(content: dict[str, Any]) -> HandSpec:
    drive, thermal = content.get("drive"), content.get("thermal")
    kind = HandSpec if "arm" not in content else partial(ArmSpec, **_arm_from(content["arm"]))
    return kind(
        drive=None if drive is None else Drive.from_values(drive, len(content["joints"])),
        thermal=None if thermal is None else ThermalData(**thermal),
        model=content["model"],
        side=content["side"],
        serial=content["serial"],
        joints=tuple(content["joints"]),
        aliases=tuple(content["aliases"]),
        fingers=tuple(Finger(f["name"], tuple(f["joints"]), f["tip"]) for f in content["fingers"]),
        lower=frozen(content["lower"]),
        upper=frozen(content["upper"]),
        actuation=Actuation(**{key: frozen(row) for key, row in content["actuation"].items()}),
        commands=tuple(content.get("commands", ("torque",))),
        followers=tuple(
            CoupledJoint(f["name"], f["driven"], frozen(f["positions"])) for f in content.get("followers", ())
        ),
        mirror_flips=tuple(content["mirror_flips"]),
        card=content.get("card", ""),
    )


def _optional_entries(spec: HandSpec) -> dict[str, Any]:
    """Entries that only some hands have: without a torque motor on every joint, with thermal data; and arms."""
    content: dict[str, Any] = {} if spec.commands == ("torque",) else {"commands": list(spec.commands)}
    if spec.thermal is not None:
        content["thermal"] = asdict(spec.thermal)
    if isinstance(spec, ArmSpec):
        load = None if spec.load is None else {"mass": spec.load.mass, "centre": spec.load.centre.tolist()}
        content["arm"] = {"silence": spec.silence, "ready": spec.ready.tolist(), "load": load}
        if spec.slowing is not None:
            content["arm"]["slowing"] = {name: getattr(spec.slowing, name).tolist() for name in _SLOWING}
    if spec.card:
        content["card"] = os.path.abspath(spec.card)
    if spec.followers:
        content["followers"] = [
            {"name": f.name, "driven": f.driven, "positions": f.positions.tolist()} for f in spec.followers
        ]
    return content


def _arm_from(content: dict[str, Any]) -> dict[str, Any]:
    load, slowing = content["load"], content.get("slowing")
    return {
        "slowing": None if slowing is None else Slowing(**{name: frozen(slowing[name]) for name in _SLOWING}),
        "silence": content["silence"],
        "ready": frozen(content["ready"]),
        "load": None if load is None else Load(load["mass"], frozen(load["centre"])),
    }
