"""One hidden hand from an unknown to a judged one: the rehearsal that `allegro-twin rehearse` performs, by who knows
the truth."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from allegro_twin import HandError
from allegro_twin.grasping import Perturbation
from allegro_twin.twin.rehearsal import Conversation, HandRehearsal, RehearsalProtocol
from studies.rehearsal.hidden_hand import HiddenHand, draw_hand
from studies.rehearsal.sessions import RehearsedHiddenHand


def rehearse(number: int, protocol: Mapping[str, Any]) -> dict[str, Any]:
    """Everything that is done with one hand. Its errors are of its true joints."""
    hand, began = draw_hand(number, protocol["seed"]), time.process_time()
    draws = drawn_objects(hand, protocol)
    steps = RehearsalProtocol(
        poses=protocol["poses"], postures=tuple(protocol["postures"]), posture_poses=tuple(protocol["posture_poses"]),
        controllers=tuple(protocol["controllers"]), grasps=tuple(draws), twins=tuple(protocol["twins"]),
        seed=100 * number,
    )  # fmt: skip
    about: dict[str, Any] = {"number": number, "side": hand.side, "version": hand.version, "traits": list(hand.traits)}
    marks: list[tuple[str, float]] = []
    with TemporaryDirectory() as name:
        talk = Conversation(begin=lambda step: marks.append((step, time.process_time())))
        rehearsal = HandRehearsal(RehearsedHiddenHand(hand, draws), steps, Path(name), talk=talk)
        try:
            rehearsal.run()
        except HandError as error:
            about["ended"] = str(error)  # What was measured until then counts.
        found, file = rehearsal.result(), Path(name) / "hand.yaml"
        text = file.read_text() if file.exists() else ""
    ends = [*(at for _, at in marks[1:]), time.process_time()]
    cpu = {step: end - at for (step, at), end in zip(marks, ends, strict=True)}
    about |= {"learnt": _learnt(hand, found, protocol, cpu), "file": text, "problems": found["problems"]}
    about |= {"draws": {scenario: asdict(draw) for scenario, draw in draws.items()}}
    about["cpu_s"] = time.process_time() - began
    return about | {twin: found[twin] for twin in protocol["twins"]}


def _learnt(
    hand: HiddenHand, found: Mapping[str, Any], protocol: Mapping[str, Any], cpu: Mapping[str, float]
) -> dict[str, Any]:
    """The time on the bus until the host knew its hand, s, that of the processor, and how far the values are from the
    truth."""
    steps, learning = found["steps"], ("ends", "excite", "identify")
    bus = sum(row.get("hand_s", 0.0) for name, row in steps.items() if name.startswith(learning))
    learnt: dict[str, Any] = {"bus_s": bus, "in_time": bus <= protocol["bus_seconds"]}
    learnt["cpu_s"] = sum(seconds for name, seconds in cpu.items() if name.startswith(learning))
    row = steps.get("identify", {})
    if row.get("state") != "done":
        return learnt | {"error": row.get("text", "")}
    constant = np.array(row["constant"])
    learnt |= {"constant_off": (constant / hand.physics.constant - 1.0).tolist(), "written": row["written"]}
    learnt |= {"constant_half": (np.array(row["constant_half"]) / constant).tolist(), "residual": row["residual"]}
    return learnt | {"said": row["text"]}


def drawn_objects(hand: HiddenHand, protocol: Mapping[str, Any]) -> dict[str, Perturbation]:
    """The scenarios of a hand, and what its host is not told of their objects."""
    names, many = protocol["grasps"], protocol["grasps_a_hand"]
    rng, off = np.random.default_rng((protocol["seed"], hand.number, 3)), protocol["unknown"]
    draws = {}
    for k in range(many):
        x, y, yaw, size, mass = rng.uniform(-1.0, 1.0, 5).tolist()
        draws[names[(many * hand.number + k) % len(names)]] = Perturbation(
            off["position"] * x, off["position"] * y, float(np.radians(off["yaw"])) * yaw, 1.0 + off["size"] * size,
            1.0 + off["mass"] * mass,
        )  # fmt: skip
    return draws
