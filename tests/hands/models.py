"""Hands that nobody has seen before, as small MJCFs, and their cards."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.files.yaml_edit import write_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.hand_import.explore import explore_hand
from allegro_twin.spec import HandSpec

GRIPPER = """
<mujoco model="gripper">
  <option timestep="0.002"/>
  <worldbody>
    <light pos="0 0 1"/>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="base" pos="0 0 0.3" euler="0 0 90">
      <geom type="box" size="0.03 0.05 0.02" mass="0.4"/>
      <body name="left_finger" pos="0 0.02 0.04">
        <joint name="left" type="slide" axis="0 1 0" range="-0.02 0.03" damping="5"/>
        <geom type="box" size="0.01 0.005 0.03" pos="0 0 0.03" mass="0.05"/>
      </body>
      <body name="right_finger" pos="0 -0.02 0.04">
        <joint name="right" type="slide" axis="0 -1 0" range="-0.02 0.03" damping="5"/>
        <geom type="box" size="0.01 0.005 0.03" pos="0 0 0.03" mass="0.05"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="right" joint2="left" polycoef="0 1 0 0 0"/></equality>
  <actuator><position name="grip" joint="left" kp="400" kv="10" ctrlrange="-0.02 0.03" forcerange="-20 20"/></actuator>
</mujoco>
"""
"""One motor, two fingers on slides that a linkage couples, in metres."""

SOFT = """
<mujoco model="soft">
  <worldbody>
    <body name="base">
      <inertial pos="0.001 0 0" quat="0.9 0.1 0 0" mass="0.3" diaginertia="3e-4 2e-4 2e-4"/>
      <geom type="box" size="0.04 0.04 0.01"/>
      <body name="first" pos="0.055 0.02 -0.012">
        <joint name="first_1" axis="0 1 0" range="0 86" stiffness="0.10" damping="0.02" armature="1e-4"/>
        <geom type="capsule" fromto="0 0 0 0.04 0 0" size="0.008" mass="0.02"/>
        <body name="first_end" pos="0.045 0 0">
          <joint name="first_2" axis="0 1 0" range="0 86" stiffness="0.20" damping="0.02" armature="1e-4"/>
          <geom type="capsule" fromto="0 0 0 0.03 0 0" size="0.008" mass="0.02"/>
        </body>
      </body>
      <body name="second" pos="0.055 -0.02 -0.012">
        <joint name="second_1" axis="0 1 0" range="0 86" stiffness="0.10" damping="0.02" armature="1e-4"/>
        <geom type="capsule" fromto="0 0 0 0.04 0 0" size="0.008" mass="0.02"/>
        <body name="second_end" pos="0.045 0 0">
          <joint name="second_2" axis="0 1 0" range="0 86" stiffness="0.20" damping="0.02" armature="1e-4"/>
          <geom type="capsule" fromto="0 0 0 0.03 0 0" size="0.008" mass="0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="synergy">
      <joint joint="first_1" coef="0.3"/><joint joint="first_2" coef="0.2"/>
      <joint joint="second_1" coef="0.3"/><joint joint="second_2" coef="0.2"/>
    </fixed>
  </tendon>
  <actuator>
    <position name="closure" tendon="synergy" kp="50" kv="1" ctrlrange="0 1" forcerange="0 40"/>
  </actuator>
</mujoco>
"""
"""One motor pulls one tendon over four joints with springs, and the hand adapts to what it meets. Fingers along x."""

HANDS = {"gripper": GRIPPER, "soft": SOFT}


def made(name: str, folder: Path) -> Path:
    """The MJCF of a hand in a folder, and its card beside it; the card."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.xml").write_text(HANDS[name])
    found = explore_hand(folder / f"{name}.xml")
    write_settings(folder / f"{name}.yaml", found.card | {"mjcf": f"{name}.xml"}, name)
    return folder / f"{name}.yaml"


def hand(name: str, folder: Path) -> HandSpec:
    return load_spec(str(made(name, folder)))
