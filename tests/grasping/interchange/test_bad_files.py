"""Grasp files that cannot be used are answered in a line that says what is wrong and what to do."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.interchange.read import read_grasps
from allegro_twin.spec import HandSpec
from tests.grasping.interchange.samples import STAGES, bench, bodex, net, saved, stacked

Make = Callable[[HandSpec], Any]


def scaled(record: dict[str, Any], factor: float) -> dict[str, Any]:
    """Lengths of the hand and the object in another unit."""
    unit = np.array([factor] * 3 + [1.0] * 20)
    return record | {key: record[key] * unit[: len(record[key])] for key in (*STAGES, "obj_pose")}


def with_nan(record: dict[str, Any]) -> dict[str, Any]:
    squeeze = record["squeeze_qpos"].copy()
    squeeze[9] = math.nan
    return record | {"squeeze_qpos": squeeze}


def without(record: dict[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in record.items() if name != key}


def far(record: dict[str, Any]) -> dict[str, Any]:
    return record | {
        key: record[key] + np.array([5.0] + [0.0] * (len(record[key]) - 1)) for key in (*STAGES, "obj_pose")
    }


def shadow(spec: HandSpec) -> dict[str, Any]:
    record = bench(spec)
    return record | {key: np.concatenate([record[key], np.zeros(6)]) for key in STAGES}


def renamed(entries: list[dict[str, Any]], old: str, new: str) -> list[dict[str, Any]]:
    return [e | {"qpos": {new if k == old else k: v for k, v in e["qpos"].items()}} for e in entries]


WRONG: dict[str, tuple[Make, str]] = {
    "millimetres": (lambda s: scaled(bench(s), 1000), r"the object is 229\.1 m from the origin: are its lengths mill"),
    "a hand in millimetres": (
        lambda s: scaled(bench(s), 1000) | {"obj_pose": np.array([0, 0, 0, 1, 0, 0, 0])},
        r"the hand is \d+(\.\d)? m from the object: are its lengths millimetres\? They are read as m",
    ),
    "an object far away": (lambda s: far(bench(s)), r"the object is 5\.1\d* m from the origin: are its lengths millim"),
    "a number beyond all": (lambda s: scaled(bench(s), 1e200), r"the object is inf m from the origin"),
    "nan": (lambda s: with_nan(bench(s)), "grasp 0: joints holds nan; every number must be finite"),
    "no grasp_qpos": (
        lambda s: without(bench(s), "grasp_qpos"),
        "has no grasp_qpos; it has: 'obj_path', 'obj_pose', 'obj_scale', 'pregrasp_qpos', 'squeeze_qpos'",
    ),
    "text for numbers": (lambda s: bench(s) | {"grasp_qpos": "mug"}, "grasp_qpos is no array of numbers, but str"),
    "another hand": (shadow, "22 joints; allegro_right has 16: they are a Shadow Hand's"),
    "degrees": (lambda s: bench(s) | {k: np.append(bench(s)[k][:7], np.full(16, 40.0)) for k in STAGES}, "in degrees"),
    "no quaternion": (lambda s: bench(s) | {"obj_pose": np.zeros(7)}, "the object's quaternion .* has length 0, not 1"),
    "object poses": (
        lambda s: stacked(s) | {"obj_pose": np.zeros((3, 7))},
        r"obj_pose has the shape \(3, 7\) for 4 gr",
    ),
    "scales": (lambda s: stacked(s) | {"obj_scale": np.ones(3)}, "obj_scale has 3 values for 4 grasps"),
    "no scale": (lambda s: bench(s) | {"obj_scale": 0.0}, "the object's scale is 0; it must be above 0"),
    "stages": (
        lambda s: stacked(s) | {"grasp_qpos": np.zeros((2, 23))},
        "the stages do not fit each other: pregrasp_qp",
    ),
    "no rows": (lambda s: bench(s) | {k: np.zeros((0, 23)) for k in STAGES}, "holds no grasp"),
    "an empty list": (lambda s: [], "holds no grasp"),
    "too few numbers": (lambda s: bench(s) | {k: np.zeros(5) for k in STAGES}, "5 numbers a grasp: a pose of 7"),
    "a flat robot_pose": (lambda s: bodex(s) | {"robot_pose": np.zeros((2, 23))}, "robot_pose has the shape"),
    "joint names of another hand": (
        lambda s: bodex(s) | {"joint_names": [f"robot0:FFJ{k}" for k in range(16)]},
        "'robot0:FFJ0' is no joint of allegro_right: is it another hand's grasp",
    ),
    "joint names within names": (
        lambda s: bodex(s) | {"joint_names": ["ffj0", ["ffj1", "ffj2"]]},
        "joint_names is no list of names, but list",
    ),
    "a joint twice": (
        lambda s: bodex(s) | {"joint_names": ["ffj0", *s.joints[:15]]},
        "missing or twice: index_0, thumb_3",
    ),
    "entries without qpos": (lambda s: [{"scale": 1.0}], "grasp 0: is no mapping with a `qpos` of joints by name"),
    "entries of another hand": (lambda s: renamed(net(s), "joint_0.0", "robot0:FFJ3"), "'robot0:FFJ3' is no joint of"),
    "entries without a wrist": (lambda s: renamed(net(s), "WRJTx", "joint_0.0"), "grasp 0: qpos has no WRJTx"),
    "bare numbers": (lambda s: 7.0, "holds bare numbers; a grasp file is a dictionary, or a list of them"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_file_is_answered_in_a_line(tmp_path: Path, spec: HandSpec, what: str) -> None:
    make, answer = WRONG[what]
    with pytest.raises(ConfigError, match=answer) as caught:
        read_grasps(saved(tmp_path / "bad.npy", make(spec)), spec)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "bad.npy"))


def test_a_file_that_is_not_there_or_of_another_kind_is_said_to_be(tmp_path: Path, spec: HandSpec) -> None:
    with pytest.raises(ConfigError, match=r"no grasps at .*none\.npy"):
        read_grasps(tmp_path / "none.npy", spec)
    (tmp_path / "grasps.pkl").write_bytes(b"")
    with pytest.raises(ConfigError, match=r"grasps\.pkl: grasps are read from \.npy and \.yaml"):
        read_grasps(tmp_path / "grasps.pkl", spec)
    with pytest.raises(ConfigError, match="no order of joints named 'three'; did you mean 'tree'"):
        read_grasps(saved(tmp_path / "a.npy", bench(spec)), spec, order="three")


YAML = """object: mug
grasps:
- object_pose: [0, 0, 0, 1, 0, 0, 0]
  preshape: &a {pose: [0, 0, 0.1, 1, 0, 0, 0], angles: {index: [0, 0.5, 0.5, 0.5], middle: [0, 0.5, 0.5, 0.5],
    ring: [0, 0.5, 0.5, 0.5], thumb: [0.5, 0.5, 0.5, 0.5]}}
  close: *a
  squeeze: *a
"""


@pytest.mark.parametrize(
    ("old", "new", "answer"),
    [
        ("object: mug", "object: mug\nframe: hand", "frame is one of palm, menagerie, not 'hand'"),
        ("  close: *a\n", "", r"grasps\.0\.close: missing"),
        ("0, 0, 0.1, 1,", "0, 0, 100, 1,", "the hand is 100 m from the object: are its lengths millimetres"),
        ("thumb: [0.5, 0.5, 0.5, 0.5]", "thumb: [0.5]", "thumb has 4 joints, not 1"),
        (
            "  close: *a",
            "  close: {pose: [0, 0, 0.1, 1, 0, 0, 0], angles: {index: [0, 0.5, 60, 0.5], middle: [0, 0.5, 0.5, 0.5],"
            " ring: [0, 0.5, 0.5, 0.5], thumb: [0.5, 0.5, 0.5, 0.5]}}",
            r"grasp 0: index_2 = 60 rad is 58\.\d+ rad outside its limits .*; is it in degrees",
        ),
        ("index: [0, 0.5, 0.5", "index: [0, 30, 0.5", "index_1 = 30 rad is .* rad outside its limits"),
        ("grasps:", "graps:", "unknown key; did you mean 'grasps'"),
    ],
)
def test_our_own_yaml_is_answered_likewise(tmp_path: Path, spec: HandSpec, old: str, new: str, answer: str) -> None:
    (tmp_path / "a.yaml").write_text(YAML)
    assert len(read_grasps(tmp_path / "a.yaml", spec)) == 1
    (tmp_path / "a.yaml").write_text(YAML.replace(old, new))
    with pytest.raises(ConfigError, match=answer):
        read_grasps(tmp_path / "a.yaml", spec)
