"""One hidden hand from an unknown to a judged one: a host learns it in five minutes of bus time, then performs."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from allegro_twin import HandError
from allegro_twin.files import atomic_file
from allegro_twin.grasping import Perturbation
from allegro_twin.recording import load
from allegro_twin.twin import identify_hand, write_hand_file
from studies.rehearsal.hidden_hand import HiddenHand, draw_hand
from studies.rehearsal.sessions import excited, grasp_trial, offsets_by_ends, posture_errors

SWEPT = "up"
"""Pose in which the joints are led to their ends."""


def rehearse(number: int, protocol: Mapping[str, Any]) -> dict[str, Any]:
    """Everything that is done with one hand."""
    hand = draw_hand(number, protocol["seed"])
    with TemporaryDirectory() as name:
        file = Path(name) / "hand.yaml"
        learnt = _learn(hand, protocol, Path(name), file)
        found = {twin: _perform(hand, "" if twin == "nominal" else str(file), protocol) for twin in protocol["twins"]}
        text = file.read_text() if file.exists() else ""
    about = {"number": number, "side": hand.side, "version": hand.version, "traits": list(hand.traits)}
    return about | {"learnt": learnt, "file": text} | found


def _learn(hand: HiddenHand, protocol: Mapping[str, Any], folder: Path, file: Path) -> dict[str, Any]:
    """Write the hand's file from what it shows in the time allowed. Returns the time on the bus, s, that of the
    processor, and how far the values are from the truth."""
    began = time.process_time()
    offsets, bus = offsets_by_ends(hand, SWEPT)
    with atomic_file(file) as temporary:
        wire = {"version": hand.version, "side": hand.side, "encoder_offset": offsets}
        temporary.write_text(yaml.safe_dump({"wire": wire}))
    paths = []
    for k, (pose, seconds) in enumerate(protocol["poses"].items()):
        paths.append(excited(hand, pose, k, seconds, folder, str(file)))
        bus += float(load(paths[-1]).columns["t"][-1])
    found: dict[str, Any] = {"bus_s": bus, "in_time": bus <= protocol["bus_seconds"]}
    try:
        result = identify_hand(paths, (), masses_known=False, hand=str(file))
        found["said"] = write_hand_file(file, result.fit, result.values, result.motions, "")
        constant, truth = result.values["torque_constant"], hand.physics.constant
        found["constant_off"] = (constant.value / truth - 1.0).tolist()
        found["constant_half"] = (constant.half / constant.value).tolist()
        found["written"] = [str(each) for each in result.written.source]
        found["residual"] = result.fit.spread.residual.tolist()
    except HandError as error:
        found["error"] = str(error)
    return found | {"cpu_s": time.process_time() - began}


def _perform(hand: HiddenHand, serial: str, protocol: Mapping[str, Any]) -> dict[str, Any]:
    postures = [
        {"posture": posture, "pose": pose, "controller": kind,
         "error": posture_errors(hand, serial, posture, pose, kind).tolist()}
        for posture in protocol["postures"] for pose in protocol["posture_poses"] for kind in protocol["controllers"]
    ]  # fmt: skip
    names, many = protocol["grasps"], protocol["grasps_a_hand"]
    chosen = [names[(many * hand.number + k) % len(names)] for k in range(many)]
    rng, off, grasps = np.random.default_rng((protocol["seed"], hand.number, 3)), protocol["unknown"], []
    for name in chosen:
        x, y, yaw, size, mass = rng.uniform(-1.0, 1.0, 5).tolist()
        draw = Perturbation(
            off["position"] * x, off["position"] * y, float(np.radians(off["yaw"])) * yaw, 1.0 + off["size"] * size,
            1.0 + off["mass"] * mass,
        )  # fmt: skip
        report = grasp_trial(hand, serial, name, draw)
        grasps.append({"scenario": name, "held": report.held, "reason": report.reason, "draw": asdict(draw)})
    return {"postures": postures, "grasps": grasps}


def rms_mrad(rows: list[dict[str, Any]]) -> float:
    """Of the errors of some postures, mrad."""
    return 1e3 * float(np.sqrt(np.mean([np.square(row["error"]) for row in rows])))
