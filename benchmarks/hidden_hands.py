"""Hidden hands drawn by chance, excited and identified: how far identification is off. The function of a sweep."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from allegro_twin.app.config import RunConfig
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.drivetrain.backlash import SMALLEST as LEAST_PLAY
from allegro_twin.sim.open_loop import DriveParameters, OpenLoopPlayer
from allegro_twin.twin.identify.fitting.parameterisation import PLAY, SHAPE
from allegro_twin.twin.identify.motions.motion import RecordedMotion, read_motion
from allegro_twin.twin.identify.pipeline import Identification, identify_hand, measure_gaps
from allegro_twin.twin.identify.record_excitation import pose_config, record_run, remaining_run
from allegro_twin.twin.identify.results.gap import SMALLEST, Gap, gap_errors
from allegro_twin.twin.identify.results.hand_file import write_hand_file
from allegro_twin.types import Array

POSES, UNSEEN = ("up", "palm-up", "side"), "palm-down"
HELD_OUT = 8.0  # s of another motion in an unseen pose.
TIMESTEP = 0.0005  # s, of the hidden hand.
_N = 16
NOISES = (5e-5, 3e-4)  # rad
_LOAD, _STICTION, _STRIBECK, _BRISTLE = (0.02, 0.08), (1.2, 1.8), (0.08, 0.2), (5e-4, 2e-3)
"""Of mismatched hands: friction per torque; F_s / F_c; rad/s; rad. docs/results/identification.md"""


def drawn(seed: int, kind: str) -> dict[str, Any]:
    """The truth of a hand: around the nominal one, as docs/results/identification.md says."""
    rng = np.random.default_rng((seed, 11))

    def row(low: float, high: float) -> list[float]:
        return [float(value) for value in rng.uniform(low, high, _N)]

    truth: dict[str, Any] = {
        "wire": {"torque_constant": row(0.8, 1.2)},
        "actuation": {"armature": row(0.0015, 0.0045), "damping": row(0.0368, 0.1102), "frictionloss": row(0.0, 0.06)},
        "drive": {
            "delay": float(rng.uniform(0.0, 0.009)),
            "encoder_offset": row(-0.02, 0.02),
            "encoder_noise": NOISES[seed % len(NOISES)],
            "mass_scale": row(0.9, 1.1),
        },
    }
    if kind == "mismatched":
        truth["drive"] |= {
            "stiction": row(*_STICTION), "stribeck_speed": row(*_STRIBECK), "bristle": row(*_BRISTLE),
            "load_friction": row(*_LOAD),
        }  # fmt: skip
    return truth


def rows(shared: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """`shared`: `seconds` in each pose. An item: `seed`, `kind` (matched or mismatched), `side`, `masses` (known or
    assumed). A row: errors joint by joint as JSON."""
    return [_row(float(shared["seconds"]), item) for item in items]


def _row(seconds: float, item: Mapping[str, Any]) -> dict[str, Any]:
    truth = drawn(item["seed"], item["kind"])
    truth["drive"] |= {"backlash": item.get("backlash", 0.0)}
    with TemporaryDirectory() as name:
        folder = Path(name)
        paths = [excited(truth, item, pose, seconds, folder, k) for k, pose in enumerate((*POSES, UNSEEN))]
        file = folder / "hand.yaml"
        known = item["masses"] == "known"
        file.write_text(yaml.safe_dump({"drive": {"mass_scale": truth["drive"]["mass_scale"]}} if known else {}))
        began = time.process_time()
        found = identify_hand(paths[:-1], (), masses_known=known, hand=str(file))
        cost = time.process_time() - began
        write_hand_file(file, found.fit, found.values, found.motions, "")
        (gap,) = measure_gaps(paths[-1:], str(file))
        truth_itself = best(truth, read_motion(paths[-1]))
    own = {"kind": item["kind"], "seed": item["seed"], "backlash_true": truth["drive"]["backlash"]}
    return {
        **own,
        **_errors(truth, found),
        **_prediction(gap),
        "truth_mrad": _text(1000 * truth_itself),
        "cpu_s": cost,
        "data_s": sum(m.seconds for m in found.motions),
    }


def excited(
    truth: Mapping[str, Any], item: Mapping[str, Any], pose: str, seconds: float, folder: Path, number: int
) -> Path:
    """A hidden hand's recording in one pose. `item`: its seed and side."""
    own = {**truth, "drive": {**truth["drive"], "seed": number}}
    backend = {
        "kind": "can", "version": "v4", "interface": "allegro-virtual", "imu": 0.05,
        "scene": {"kind": "sim", "timestep": TIMESTEP, "truth": own},
    }  # fmt: skip
    blocks = {"hand": {"side": item["side"]}, "backend": backend, "controller": {"kind": "torque"}}
    config = RunConfig.model_validate(blocks)
    todo = remaining_run(config, pose, HELD_OUT if pose == UNSEEN else seconds, 100 * item["seed"] + number, folder)
    assert todo is not None  # The folder is new.
    record_run(pose_config(config, todo.pose), todo, lambda t: None)
    return todo.file


def _errors(truth: Mapping[str, Any], found: Identification) -> dict[str, Any]:
    constant = np.array(truth["wire"]["torque_constant"])
    true = {name: np.array(values) / constant for name, values in truth["actuation"].items()}
    true |= {"torque_constant": constant, "offset": np.array(truth["drive"]["encoder_offset"])}
    true["delay"] = np.round(np.array([truth["drive"]["delay"]]) / TIMESTEP) * TIMESTEP  # What the hidden hand obeys.
    true |= {name: np.broadcast_to(truth["drive"].get(name, 0.0), constant.shape) for name in (*SHAPE, *PLAY)}
    # A table has the same columns for every hand.
    result: dict[str, Any] = {
        f"{name}{end}": "[]" for name in (*SHAPE, *PLAY) for end in ("", "_inside", "_determined")
    }
    for name, value in found.values.items():
        error = value.value - true[name]
        relative = name in ("torque_constant", "armature", "damping", "stribeck_speed")
        result[name] = _text(error / true[name] if relative else error)
        result[f"{name}_inside"] = _text(np.abs(error) <= value.half)
        result[f"{name}_determined"] = _text(value.identifiable)
    result["friction_share"] = _text((found.values["frictionloss"].value - true["frictionloss"]) / true["frictionloss"])
    return result | {
        "residual": _text(found.fit.spread.residual),
        "bristly": found.fit.bristly,
        "loose": found.fit.loose,
    }


def _prediction(gap: Gap) -> dict[str, Any]:
    return {"nominal_mrad": _text(1000 * gap.before.joint[-1]), "open_loop_mrad": _text(1000 * gap.after.joint[-1])}


def best(truth: Mapping[str, Any], motion: RecordedMotion) -> Array:
    """What the hand's true parameters are off by over 5 s in the model that is fitted, whose time step is another: rad,
    (n,). Nearer no fit can come but by chance; a joint on the verge of breaking away is far off."""
    mine = load_spec(motion.spec.model, motion.spec.side)
    loose = truth["drive"]["backlash"] > 0.0
    player = OpenLoopPlayer(mine, motion.period, bristly="stiction" in truth["drive"], loose=loose)
    found: Array = gap_errors(motion, player, true_parameters(truth)).joint[-1]
    return found


def true_parameters(truth: Mapping[str, Any]) -> DriveParameters:
    """A hidden hand's drive, as the model that is fitted has it."""
    drive, usual = truth["drive"], {"stiction": 1.0, "stribeck_speed": 1.0, "bristle": 0.0, "load_friction": 0.0}
    every = {**truth["wire"], **truth["actuation"], **usual, **drive}
    rows = {name: np.broadcast_to(np.asarray(value, dtype=float), (_N,)).copy() for name, value in every.items()}
    return DriveParameters(
        **{name: rows[name] for name in ("torque_constant", *truth["actuation"], "mass_scale", *usual)}
        | {
            "offset": rows["encoder_offset"],
            "delay": np.round(rows["delay"] / TIMESTEP) * TIMESTEP,  # What the hidden hand obeys.
            "bristle": np.maximum(rows["bristle"], SMALLEST),
            "backlash": np.maximum(rows["backlash"], LEAST_PLAY),
        }
    )


def _text(row: Array | np.ndarray[Any, Any]) -> str:
    return json.dumps([float(f"{float(value):.4g}") for value in row])
