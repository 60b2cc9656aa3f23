"""A servo that gives way under its finger's weight has arrived; one that something holds has not."""

from __future__ import annotations

from pathlib import Path

import pytest

from allegro_twin import Hand
from allegro_twin.errors import MotionStalled
from allegro_twin.files.yaml_edit import write_settings
from allegro_twin.sim.hand_import.explore import explore_hand

SOFT = """
<mujoco model="soft_servos">
  <compiler angle="radian"/>
  <worldbody>
    <body name="palm">
      <geom type="box" size="0.04 0.04 0.01"/>
      {wall}
      <body name="left" pos="0.05 0.02 0">
        <joint name="left" axis="0 1 0" range="-0.4 1.5" damping="0.02" armature="1e-4"/>
        <geom name="left" type="capsule" fromto="0 0 0 0.08 0 0" size="0.008" mass="0.05"/>
      </body>
      <body name="right" pos="0.05 -0.02 0">
        <joint name="right" axis="0 1 0" range="-0.4 1.5" damping="0.02" armature="1e-4"/>
        <geom type="capsule" fromto="0 0 0 0.08 0 0" size="0.008" mass="0.05"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="left" joint="left" kp="{kp}" kv="0.02" forcerange="-1 1"/>
    <position name="right" joint="right" kp="{kp}" kv="0.02" forcerange="-1 1"/>
  </actuator>
  {pair}
</mujoco>
"""
WALL = {
    "wall": '<geom name="wall" type="box" pos="0.1 0 -0.06" size="0.02 0.04 0.01" contype="0" conaffinity="0"/>',
    "pair": '<contact><pair geom1="wall" geom2="left"/></contact>',
}
"""What paths are not planned around, for it touches one geom alone."""


def opened(folder: Path, kp: float, **more: str) -> Hand:
    (folder / "soft.xml").write_text(SOFT.format(**{"kp": kp, "wall": "", "pair": ""} | more))
    write_settings(folder / "soft.yaml", explore_hand(folder / "soft.xml").card | {"mjcf": "soft.xml"}, "soft")
    scene = {"kind": "sim", "facing": (0.0, 0.0, -1.0), "fingers": (1.0, 0.0, 0.0)}
    block = {"hand": {"model": "soft.yaml"}, "backend": scene, "controller": {"kind": "position"}}
    write_settings(folder / "sim.yaml", block, "sim")
    return Hand.open(folder / "sim.yaml")


def test_a_soft_servo_that_its_fingers_weight_bends_has_arrived(tmp_path: Path) -> None:
    with opened(tmp_path, kp=0.3) as hand:
        hand.move_to([0.1, 0.1], speed=1.0)
        hand.wait(2.0)
        assert hand.stalled is None
        assert 0.03 < abs(hand.state.position - 0.1).max() < 0.1  # m g l / k = 0.065 rad.


def test_a_soft_servo_that_meets_something_has_not(tmp_path: Path) -> None:
    with opened(tmp_path, kp=0.3, **WALL) as hand, pytest.raises(MotionStalled, match="stalled"):
        hand.move_to([1.4, 1.4], speed=1.0)
        hand.wait()
