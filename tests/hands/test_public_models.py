"""Thirteen public hand models, of MuJoCo Menagerie and dex-urdf, become cards with the right fingers, joints and
couplings, counted by hand from the files. `tests/hands/get_models FOLDER` fetches them; HAND_MODELS names the
folder."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.sim.hand_import.explore import ExploredHand, explore_hand
from allegro_twin.surfaces.cli.main import app

FOLDER = os.environ.get("HAND_MODELS", "")
MENAGERIE, URDFS = "mujoco_menagerie", "dex-urdf/robots/hands"
FILES = {
    "menagerie_allegro": f"{MENAGERIE}/wonik_allegro/right_hand.xml",
    "menagerie_leap": f"{MENAGERIE}/leap_hand/right_hand.xml",
    "menagerie_shadow": f"{MENAGERIE}/shadow_hand/right_hand.xml",
    "menagerie_dexee": f"{MENAGERIE}/shadow_dexee/shadow_dexee.xml",
    "menagerie_2f85": f"{MENAGERIE}/robotiq_2f85/2f85.xml",
    "allegro": f"{URDFS}/allegro_hand/allegro_hand_right.urdf",
    "leap": f"{URDFS}/leap_hand/leap_hand_right.urdf",
    "shadow": f"{URDFS}/shadow_hand/shadow_hand_right.urdf",
    "svh": f"{URDFS}/schunk_hand/schunk_svh_hand_right.urdf",
    "barrett": f"{URDFS}/barrett_hand/bhand_model.urdf",
    "ability": f"{URDFS}/ability_hand/ability_hand_right.urdf",
    "inspire": f"{URDFS}/inspire_hand/inspire_hand_right.urdf",
    "dclaw": f"{URDFS}/dclaw_gripper/dclaw_gripper.urdf",
}


def numbered(pattern: str, *numbers: object) -> tuple[str, ...]:
    return tuple(pattern.format(number) for number in numbers)


FINGERS: dict[str, dict[str, tuple[str, ...]]] = {
    "menagerie_allegro": {name: numbered(f"{word}j{{}}", 0, 1, 2, 3) for name, word in
                          (("index", "ff"), ("middle", "mf"), ("ring", "rf"), ("thumb", "th"))},
    "menagerie_leap": {name: numbered(f"{word}_{{}}", "mcp", "rot", "pip", "dip") for name, word in
                       (("index", "if"), ("middle", "mf"), ("ring", "rf"))}
                      | {"thumb": ("th_cmc", "th_axl", "th_mcp", "th_ipl")},
    "menagerie_shadow": {name: (f"rh_{word}J4", f"rh_{word}J3", f"rh_A_{word}J0") for name, word in
                         (("index", "FF"), ("middle", "MF"), ("ring", "RF"))}
                        | {"little": ("rh_LFJ5", "rh_LFJ4", "rh_LFJ3", "rh_A_LFJ0"),
                           "thumb": numbered("rh_THJ{}", 5, 4, 3, 2, 1)},
    "menagerie_dexee": {f"f{k}": numbered(f"F{k}/J{{}}", 0, 1, 2, 3) for k in range(3)},
    "menagerie_2f85": {"right": ("fingers_actuator",), "left": ("fingers_actuator",)},
    "allegro": {f"link_{k}_0": numbered("joint_{}.0", *range(k, k + 4)) for k in (0, 4, 8, 12)},
    "leap": {"index": ("1", "0", "2", "3"), "middle": ("5", "4", "6", "7"), "ring": ("9", "8", "10", "11"),
             "thumb": ("12", "13", "14", "15")},
    "shadow": {name: numbered(f"{word}J{{}}", 4, 3, 2, 1) for name, word in
               (("index", "FF"), ("middle", "MF"), ("ring", "RF"))}
              | {"little": numbered("LFJ{}", 5, 4, 3, 2, 1), "thumb": numbered("THJ{}", 5, 4, 3, 2, 1)},
    "svh": {"index": numbered("right_hand_{}", "Finger_Spread", "Index_Finger_Proximal", "Index_Finger_Distal"),
            "middle": numbered("right_hand_Middle_Finger_{}", "Proximal", "Distal"),
            "ring": numbered("right_hand_{}", "Thumb_Opposition", "Finger_Spread", "Ring_Finger"),
            "little": numbered("right_hand_{}", "Thumb_Opposition", "Finger_Spread", "Pinky"),
            "thumb": numbered("right_hand_Thumb_{}", "Opposition", "Flexion")},
    "barrett": {"finger_1": numbered("finger_1_{}_joint", "prox", "med", "dist"),
                "finger_2": numbered("finger_2_{}_joint", "prox", "med", "dist"),
                "finger_3": numbered("finger_3_{}_joint", "med", "dist")},
    "ability": {"index": ("index_q1",), "middle": ("middle_q1",), "ring": ("ring_q1",), "little": ("pinky_q1",),
                "thumb": ("thumb_q1", "thumb_q2")},
    "inspire": {"index": ("index_proximal_joint",), "middle": ("middle_proximal_joint",),
                "ring": ("ring_proximal_joint",), "little": ("pinky_proximal_joint",),
                "thumb": ("thumb_proximal_yaw_joint", "thumb_proximal_pitch_joint")},
    "dclaw": {f"link_f{k}": numbered(f"joint_f{k}_{{}}", 0, 1, 2) for k in (1, 2, 3)},
}  # fmt: skip
COUPLED = {"menagerie_shadow": 8, "menagerie_2f85": 6, "svh": 11, "ability": 4, "inspire": 6}
"""Joints that follow a motor."""
UNKNOWN = ("menagerie_allegro", "menagerie_leap", "svh", "barrett")
"""Hands whose files limit no effort, or give 0 or 1000 N·m."""


@cache
def explored(name: str) -> ExploredHand:
    path = Path(FOLDER) / FILES[name]
    if not FOLDER or not path.is_file():
        pytest.skip(f"HAND_MODELS has no {FILES[name]}")
    return explore_hand(path)


@pytest.mark.parametrize("name", FILES)
def test_a_public_model_has_the_right_fingers_joints_and_couplings(name: str) -> None:
    card = explored(name).card
    assert {finger: tuple(row["joints"]) for finger, row in card["fingers"].items()} == FINGERS[name]
    assert len(card.get("followers", ())) == COUPLED.get(name, 0)
    wrist = {"menagerie_shadow": ["rh_WRJ2", "rh_WRJ1"], "shadow": ["WRJ2", "WRJ1"]}.get(name)
    assert card.get("wrist", {}).get("joints") == wrist


@pytest.mark.parametrize("name", FILES)
def test_an_effort_is_the_files_or_unknown(name: str) -> None:
    efforts = {row["effort"] for row in explored(name).card["driven"]}
    assert (efforts == {"unknown"}) == (name in UNKNOWN)
    assert all(each == "unknown" or each <= 30.0 for each in efforts)


@pytest.mark.parametrize("name", FILES)
def test_every_finger_of_a_public_model_is_solved_for(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    explored(name)
    monkeypatch.chdir(tmp_path)
    file, mine = str((Path(FOLDER) / FILES[name]).resolve()), f"my_{name}"  # Some are named as hands that ship.
    app(["hand", "new", file, "--name", mine, "--no-film"], standalone_mode=False)
    spec = load_spec(f"mine/{mine}.yaml", "right")
    assert (tmp_path / "mine" / f"{mine}.png").stat().st_size > 10_000
    hand = hand_kinematics(spec)
    for finger in spec.fingers:
        solver = hand.numeric(finger.name)
        postures = np.random.default_rng(1).uniform(solver.lower, solver.upper, (500, len(solver.lower)))
        targets = solver.fk(postures).position
        found = solver.ik(targets)
        reached = found.reachable
        assert reached.mean() >= 0.998
        assert np.linalg.norm(solver.fk(found.position[reached, 0]).position - targets[reached], axis=1).max() < 1e-5
