"""What each hand's trials begin from: its cell's arm, and the grasps that were planned for it, a file for each hand."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin import ConfigError, RecordingError
from allegro_twin.cell.arm import CollisionSettings
from allegro_twin.files import Positive, Settings, atomic_file, data_root, parse_settings, read_yaml
from allegro_twin.types import Array
from studies.preemption.protocol import ArmStudy, StudyObject

FOLDER = Path(__file__).parent / "grasps"


class PreparedGrasp(NamedTuple):
    """How a hand on the arm takes an object in the middle of the table."""

    grasp: str
    """By its name."""
    posture: Array
    """Of the arm where the approach begins, (n,), rad."""
    palm: tuple[Array, Array]
    """Where it grasps: position and rotation, (3,) and (3, 3), m, world."""
    preshape: Array
    """Of the hand, (n,), rad, and"""
    close: Array
    squeeze: Array


class ArmSection(Settings):
    """Of a cell's settings what a trial goes by."""

    model: str
    stiffness: Positive
    """N/m."""
    angular_stiffness: Positive
    """N·m/rad."""
    collision: CollisionSettings


def arm_content(study: ArmStudy, hand: str, root: Path) -> dict[str, Any]:
    """The same as it is written down, from a checkout's folder. Raises ConfigError."""
    path = root / "conf" / f"{study.hands[hand]}.yaml"
    content = read_yaml(path).get("arm", {})
    return {key: content[key] for key in ArmSection.model_fields if key in content}


def arm_of(study: ArmStudy, hand: str) -> ArmSection:
    """The arm of a hand's cell. Raises ConfigError."""
    return parse_settings(ArmSection, arm_content(study, hand, data_root()), f"conf/{study.hands[hand]}.yaml: arm")


def placed_content(name: str, one: StudyObject) -> dict[str, Any]:
    """An object in the middle of the table, as a config says it."""
    return {"name": name, **one.model_dump(), "at": (0.0, 0.0)}


def write_prepared(folder: Path, hand: str, found: Mapping[str, PreparedGrasp]) -> Path:
    """A hand's file. Raises RecordingError where the disk refuses."""
    plain = {name: _plain(one) for name, one in sorted(found.items())}
    path = folder / f"{hand}.json"
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps(plain, indent=1) + "\n")
    return path


def grasps_file(hand: str) -> Path:
    """Where the grasps of a hand are. Raises ConfigError where none are prepared."""
    path = FOLDER / f"{hand}.json"
    if not path.exists():
        raise ConfigError(f"{path}: no grasps are prepared for {hand}: python -m studies.preemption prepare")
    return path


def read_prepared(hand: str) -> dict[str, PreparedGrasp]:
    """By object. Raises ConfigError where nothing is prepared, and RecordingError for what cannot be read."""
    path = grasps_file(hand)
    try:
        content = json.loads(path.read_text())
        return {name: _prepared(one) for name, one in content.items()}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RecordingError(f"{path}: no prepared grasps can be read: {error!r}; prepare them anew") from error


def _plain(one: PreparedGrasp) -> dict[str, Any]:
    position, rotation = one.palm
    return {
        "grasp": one.grasp, "posture": _rounded(one.posture),
        "palm": {"position": _rounded(position), "rotation": _rounded(rotation)},
        "preshape": _rounded(one.preshape), "close": _rounded(one.close), "squeeze": _rounded(one.squeeze),
    }  # fmt: skip


def _prepared(content: Mapping[str, Any]) -> PreparedGrasp:
    def array(key: str) -> Array:
        return np.array(content[key], dtype=np.float64)

    palm = content["palm"]
    return PreparedGrasp(
        str(content["grasp"]), array("posture"), (np.array(palm["position"]), np.array(palm["rotation"])),
        array("preshape"), array("close"), array("squeeze"),
    )  # fmt: skip


def _rounded(values: Array) -> Any:
    return np.round(values, 9).tolist()
