"""The distances between a hand's parts are those of the shapes that its simulation lets touch."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_posture, posture_names
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.sim.contact.self_clearance import SIGHT, SelfClearance, colliding_geoms
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec, Side
from tests.sim.test_foreign import menagerie_like


def nearest(
    clearance: SelfClearance, posture: np.ndarray[tuple[int], np.dtype[np.float64]]
) -> dict[tuple[str, str], float]:
    apart = clearance(posture[None])[0]
    return {pair: float(d) for pair, d in zip(clearance.pairs, apart, strict=True) if d < SIGHT}


def test_two_fingertips_that_pinch_are_as_far_apart_as_their_spheres(spec: HandSpec) -> None:
    """The posture `ok` has index and thumb tip to tip: spheres of 12 mm, each at the end of a capsule."""
    ok = load_posture("ok", spec)
    tips = hand_kinematics(spec).fingertips(ok)
    expected = float(np.linalg.norm(tips["index"].position - tips["thumb"].position)) - 0.024
    seen = nearest(SelfClearance(spec), ok)
    assert list(seen) == [("index", "thumb")]
    assert seen["index", "thumb"] == pytest.approx(expected, abs=1e-5)


def test_parts_that_do_not_touch_are_told_apart_up_to_the_sight(spec: HandSpec) -> None:
    """Two fingertips that leave each other: their spheres stay the nearest of their links."""
    clearance, model = SelfClearance(spec), hand_kinematics(spec)
    ok, column = load_posture("ok", spec), SelfClearance(spec).pairs.index(("index", "thumb"))
    rows = ok + np.linspace(0.0, 0.35, 60)[:, None] * np.where(np.arange(16) == 1, -1.0, 0.0)
    tips = [model.fingertips(row) for row in rows]
    expected = [float(np.linalg.norm(tip["index"].position - tip["thumb"].position)) - 0.024 for tip in tips]
    np.testing.assert_allclose(clearance(rows)[:, column], np.minimum(expected, SIGHT), atol=2e-5)
    assert sum(0.005 < distance < SIGHT for distance in expected) > 5


def test_every_distance_is_the_engines_own_of_the_two_nearest_shapes(spec: HandSpec) -> None:
    """Of all pairs that may touch, over random postures; and those may touch that the simulation makes contacts of."""
    clearance = SelfClearance(spec)
    model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
    data = mujoco.MjData(model)
    places = [int(model.joint(name).qposadr[0]) for name in spec.joints]
    postures = np.random.default_rng(3).uniform(spec.lower, spec.upper, (80, 16))
    least, touched = clearance(postures).min(axis=1), 0
    for posture, seen in zip(postures, least, strict=True):
        data.qpos[places] = posture
        mujoco.mj_forward(model, data)
        apart = [mujoco.mj_geomDistance(model, data, a, b, SIGHT, None) for a, b in colliding_geoms(model)]
        assert seen == min(apart)
        assert (seen < 0) == (data.ncon > 0)
        touched += data.ncon > 0
    assert touched > 5
    assert ((least > 0) & (least < SIGHT)).sum() > 5


@pytest.mark.parametrize("side", ["right", "left"])
def test_both_hands_and_other_peoples_models_are_the_same_distance_apart(side: Side, tmp_path: Path) -> None:
    right, other = load_spec(), load_spec(side=side, serial=str(menagerie_like(tmp_path, side)))
    names = posture_names()
    seen = SelfClearance(right)(np.array([load_posture(name, right) for name in names]))
    theirs = SelfClearance(other)
    assert theirs.pairs == SelfClearance(right).pairs
    assert ("thumb", "palm") in theirs.pairs
    np.testing.assert_allclose(theirs(np.array([load_posture(name, other) for name in names])), seen, atol=2e-4)


def test_no_posture_that_ships_is_further_in_itself_than_a_quarter_of_a_millimetre(side: Side) -> None:
    spec = load_spec(side=side)
    for name in posture_names():
        assert min(nearest(SelfClearance(spec), load_posture(name, spec)).values(), default=SIGHT) > -0.25e-3, name


def test_links_on_a_palm_that_stands_still_may_touch_it_as_they_do_in_the_simulation() -> None:
    text = """<mujoco><worldbody><body name="palm"><geom type="box" size="0.05 0.05 0.01"/>
      <body name="link" pos="0 0 0.03"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 0.05" size="0.008"/>
      <body name="next" pos="0 0 0.05"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 0.05" size="0.008"/>
      </body></body></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    assert colliding_geoms(model) == [(0, 1), (0, 2)]
    data = mujoco.MjData(model)
    data.qpos[:] = 2.0, 0.0
    mujoco.mj_forward(model, data)
    assert {tuple(sorted(contact.geom.tolist())) for contact in data.contact} == {(0, 1), (0, 2)}
