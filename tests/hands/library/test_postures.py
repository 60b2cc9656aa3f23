"""The postures that ship are gestures that the hand can really make, on either side."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_posture, posture_names
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import TorqueCommand
from tests.conftest import MakeSim

GESTURES = [
    "home",
    "ready",
    "open",
    "fist",
    "rock",
    "paper",
    "scissors",
    "count_1",
    "count_2",
    "count_3",
    "count_4",
    "point",
    "ok",
    "off",
]
# Where two fingers are meant to meet; the tips of the others stay clear of everything.
MEANT = {
    "fist": ("middle", "thumb"),
    "count_1": ("middle", "thumb"),
    "count_2": ("ring", "thumb"),
    "ok": ("index", "thumb"),
}
OUT = {
    "count_1": {"index"},
    "count_2": {"index", "middle"},
    "count_3": {"index", "middle", "ring"},
    "count_4": {"index", "middle", "ring", "thumb"},
    "point": {"index"},
    "fist": set(),
    "ok": {"middle", "ring"},
}
STRETCHED = 0.5  # rad of flexion in all; a finger that is folded has more than 1.5.


def contacts(spec: HandSpec, make_sim: MakeSim, name: str) -> dict[tuple[str, str], float]:
    """How deep the parts of the hand are in each other, m."""
    backend = make_sim(spec, posture=load_posture(name, spec))
    backend.reset()
    mujoco.mj_forward(backend.model, backend.data)
    part = {backend.model.joint(spec.joints[j]).bodyid[0]: f.name for f in spec.fingers for j in f.joints}
    found: dict[tuple[str, str], float] = {}
    for contact in backend.data.contact:
        one, other = sorted(part.get(backend.model.geom_bodyid[g], "palm") for g in contact.geom)
        found[one, other] = max(found.get((one, other), 0.0), -float(contact.dist))
    return found


def test_every_gesture_ships_with_its_meaning_and_its_source() -> None:
    assert set(GESTURES) <= set(posture_names())
    for name in posture_names():
        text = (data_root() / "conf" / "postures" / f"{name}.yaml").read_text()
        assert text.startswith("description: ")
        assert "\n# " in text, f"{name} does not say where its values are from"


@pytest.mark.parametrize("name", posture_names())
def test_no_posture_presses_parts_of_the_hand_into_each_other(name: str, side: Side, make_sim: MakeSim) -> None:
    found = contacts(load_spec(side=side), make_sim, name)
    assert all(depth <= 1e-3 for depth in found.values()), found
    assert set(found) <= {MEANT[name]} if name in MEANT else not found


def test_the_ring_of_ok_is_closed_by_the_tips(side: Side, make_sim: MakeSim) -> None:
    spec = load_spec(side=side)
    assert contacts(spec, make_sim, "ok").keys() == {("index", "thumb")}
    backend = make_sim(spec, posture=load_posture("ok", spec))
    backend.reset()
    mujoco.mj_forward(backend.model, backend.data)
    tips = [backend.data.site(spec.finger(name).tip).xpos for name in ("index", "thumb")]
    assert np.linalg.norm(tips[0] - tips[1]) == pytest.approx(2 * 0.012, abs=5e-4)  # Spheres of 12 mm that touch.


@pytest.mark.parametrize("name", sorted(OUT))
def test_a_gesture_stretches_the_fingers_that_it_shows_and_folds_the_others(name: str) -> None:
    spec = load_spec()
    position = load_posture(name, spec)
    bends = {f.name: np.abs(position[list(f.joints)][1:]).sum() for f in spec.fingers}
    for finger, bend in bends.items():
        if finger in OUT[name]:
            assert bend < STRETCHED, finger
        elif finger != "thumb" or name != "point":
            assert bend > 1.4, finger


def test_an_upright_hand_without_torque_stays_in_off(side: Side, make_sim: MakeSim) -> None:
    spec = load_spec(side=side)
    off = load_posture("off", spec)
    backend = make_sim(spec, posture=off)
    backend.reset()
    for _ in range(300):
        backend.write(TorqueCommand(np.zeros(16)))
        state = backend.read()
    assert np.abs(state.position - off).max() < 0.01
