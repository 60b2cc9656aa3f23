"""The palm of `Lift` comes straight down onto the grasp of the object's scenario, wherever that comes from."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.gym import EnvSettings, HandEnv
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.tasks.scenes import grasped_from_above, known_scenarios, table_scene
from allegro_twin.spec.hand import Side

HANDS = (("allegro", "right"), ("allegro", "left"), ("leap", "right"), ("qb_softhand", "right"))


@pytest.mark.parametrize(("hand", "side"), HANDS)
def test_the_palm_comes_down_onto_the_grasp_of_every_scenario(hand: str, side: Side) -> None:
    spec = load_spec(hand, side)
    settings, mirror = EnvSettings(hand=hand, side=side), np.array([1.0, -1.0 if side == "left" else 1.0, 1.0])
    aside = 0
    for name in grasped_from_above(spec.model):
        wrist = load_scenario(known_scenarios(spec.model)[name])[0].wrist
        scene = table_scene(name, spec, settings)
        data = mujoco.MjData(scene.model)
        mujoco.mj_kinematics(scene.model, data)
        palm = data.xpos[scene.model.body(spec.root).id]
        goal = scene.pose[:3] + mirror * wrist.position
        np.testing.assert_allclose(palm - scene.retreat, goal, atol=1e-6, err_msg=name)
        assert not scene.retreat[:2].any()
        aside += bool(np.any(wrist.retreat[:2]))
    assert aside > 0, "no scenario comes from aside"


@pytest.mark.parametrize(("name", "side"), [("lemon", "right"), ("pear", "left"), ("apple", "right")])
def test_the_script_lifts_what_stands_where_it_should(name: str, side: str) -> None:
    env = HandEnv("Lift", objects=(name,), level="easy", side=side, timestep=0.003, decimation=26)
    env.reset(seed=0, options={"position_noise": 0.0})
    over, success = False, False
    while not over:
        _, _, failed, ended, info = env.step(np.zeros(16, np.float32))
        over, success = failed or ended, bool(info["is_success"])
    assert success
    env.close()
