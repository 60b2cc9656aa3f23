"""Where a card says that fingertips are: what `hand new` writes there, and that a simulation obeys it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.yaml_edit import write_settings
from allegro_twin.hands import load_spec
from allegro_twin.kinematics import hand_kinematics
from allegro_twin.sim.hand_import.explore import ExploredHand, explore_hand
from allegro_twin.sim.model.scene import hand_spec

SERVO = '<position name="m_{0}" joint="{0}" kp="5" kv="0.2" ctrlrange="0 1" forcerange="-1 1"/>'
CAPSULE = '<geom type="capsule" fromto="0 0 0 0 0 0.035" size="0.009"/>'


def explored(folder: Path, end: str = CAPSULE, palm: str = "", more: str = "") -> ExploredHand:
    """Two fingers; `end`: what the last link of the first has. `more`: after the world."""
    path = folder / "two.xml"
    path.write_text(f"""<mujoco model="two"><compiler angle="radian"/>
      <asset><mesh name="tetra" vertex="-.006 -.006 0 .006 -.006 0 .006 .006 0 -.006 .006 0
        -.006 -.006 .04 .006 -.006 .04 .006 .006 .04 -.006 .006 .04"/></asset>
      <worldbody><body name="palm"><geom type="box" size="0.05 0.03 0.01" mass="0.5"/>{palm}
      <body name="a_1" pos="0.04 0 0.02"><joint name="a" axis="0 -1 0" range="0 1"/>{end}</body>
      <body name="b_1" pos="-0.04 0 0.02"><joint name="b" axis="0 1 0" range="0 1"/>{CAPSULE}</body>
      </body></worldbody>{more}<actuator>{SERVO.format("a")}{SERVO.format("b")}</actuator></mujoco>""")
    return explore_hand(path, fingers={"first": "a_1", "second": "b_1"})


ENDS: dict[str, tuple[str, list[float]]] = {
    "capsule": (CAPSULE, [0.0, 0.0, 0.035]),
    "sphere": (f'{CAPSULE}<geom size="0.012" pos="0 0 0.04"/>', [0.0, 0.0, 0.04]),
    "box": ('<geom type="box" size="0.007 0.008 0.02" pos="0 0 0.02"/>', [0.0, 0.0, 0.033]),
    "box of two": ('<geom type="box" size="0.007 0.008 0.02" pos="0 0 0.02"/>'
                   '<geom type="box" size="0.005 0.005 0.01" pos="0 0 0.05"/>', [0.0, 0.0, 0.055]),
    "cylinder": ('<geom type="cylinder" size="0.006 0.02" pos="0 0 0.02"/>', [0.0, 0.0, 0.034]),
    "box on its side": (
        '<geom type="box" size="0.02 0.007 0.008" pos="0 0 0.02" euler="0 1.5708 0"/>', [0.0, 0.0, 0.033]),
    "mesh": ('<geom type="mesh" mesh="tetra"/>', [0.0, 0.0, 0.034]),
    "sideways": ('<geom type="capsule" fromto="0.004 0 0 0.004 0 0.035" size="0.009"/>', [0.004, 0.0, 0.035]),
}  # fmt: skip


@pytest.mark.parametrize("shape", ENDS)
def test_a_guessed_fingertip_is_the_middle_of_the_pad_at_the_end_of_the_last_link(shape: str, tmp_path: Path) -> None:
    end, wanted = ENDS[shape]
    found = explored(tmp_path, end)
    body, place = found.card["fingers"]["first"]["tip"]
    assert body == "a_1"
    assert place == pytest.approx(wanted, abs=2e-4)
    assert any("fingertips are guesses, the middle of the pad" in note and "first" in note for note in found.notes)


def test_a_site_that_is_called_after_a_finger_is_its_tip_where_it_is_on_the_last_link(tmp_path: Path) -> None:
    found = explored(tmp_path, f'{CAPSULE}<site name="first_tip" pos="0 0.001 0.044"/>')
    assert found.card["fingers"]["first"]["tip"] == ["a_1", [0.0, 0.001, 0.044]]
    assert any("sites called FINGER_tip: first" in note for note in found.notes)
    elsewhere = explored(tmp_path, palm='<site name="first_tip" pos="0 0 0.03"/>')
    assert elsewhere.card["fingers"]["first"]["tip"] == ["a_1", [0.0, 0.0, 0.035]]


CROSSED = {
    "the last link": (f'{CAPSULE}<site name="first_tip" pos="0 0 0.02"/>', ""),
    "the palm, with a tendon over it": (
        CAPSULE, '<site name="first_tip" pos="0 0 0.03"/><site name="other" pos="0.02 0 0.03"/>'),
}  # fmt: skip


@pytest.mark.parametrize("where", CROSSED)
def test_a_fingertip_is_where_the_card_says_whatever_sites_and_sensors_the_file_has(where: str, tmp_path: Path) -> None:
    end, palm = CROSSED[where]
    more = '<sensor><touch name="first_touch" site="first_tip"/></sensor>'
    if palm:
        more += '<tendon><spatial name="t"><site site="first_tip"/><site site="other"/></spatial></tendon>'
    found = explored(tmp_path, end, palm, more)
    card: dict[str, Any] = found.card
    card["fingers"]["first"]["tip"] = ["a_1", [0.001, 0.002, 0.03]]
    write_settings(tmp_path / "two.yaml", card, "two")
    spec = load_spec(str(tmp_path / "two.yaml"))
    model = hand_spec(spec).compile()
    tip = model.site(spec.finger("first").tip)
    assert model.body(int(tip.bodyid[0])).name == "a_1"
    assert np.asarray(tip.pos) == pytest.approx([0.001, 0.002, 0.03])
    sensor = model.sensor("first_touch")
    assert int(sensor.type[0]) == mujoco.mjtSensor.mjSENS_CONTACT
    assert model.body(int(sensor.refid[0])).name == "a_1"
    at = hand_kinematics(spec).finger("first").fk([0.0]).position
    axes = card["palm"]
    facing, along = np.array(axes["facing"]), np.array(axes["fingers"])
    turn = np.stack([facing, np.cross(along, facing), along])
    assert np.asarray(at) == pytest.approx(turn @ [0.041, 0.002, 0.05], abs=1e-6)


def test_names_of_a_file_that_is_included_are_not_taken_for_fingertips(tmp_path: Path) -> None:
    explored(tmp_path, palm='<site name="first_tip"/>')
    text = (tmp_path / "two.xml").read_text()
    world = text[text.index("<worldbody>") : text.index("</worldbody>") + len("</worldbody>")]
    (tmp_path / "world.xml").write_text(f"<mujoco>{world}</mujoco>")
    (tmp_path / "two.xml").write_text(text.replace(world, '<include file="world.xml"/>'))
    write_settings(tmp_path / "two.yaml", explore_hand(tmp_path / "two.xml", fingers={"first": "a_1"}).card, "two")
    spec = load_spec(str(tmp_path / "two.yaml"))
    assert spec.finger("first").tip == "first_tip_centre"
    assert hand_spec(spec).compile().site("first_tip_centre").bodyid[0] > 0


@pytest.mark.parametrize("apart", [0.0, 0.01])
def test_a_site_with_a_tips_name_is_that_tip_only_where_the_hands_file_has_it(apart: float, tmp_path: Path) -> None:
    """Of a hand's file without a card, whose tips are called as our own model's sites are."""
    ends = {"index": 3, "middle": 7, "ring": 11, "thumb": 15}
    table = {
        "mjcf": str(data_root() / "models" / "mjcf" / "allegro_right.xml"),
        "root": "palm_link",
        "joints": [f"joint_{k}.0" for k in range(16)],
        "tips": {
            finger: [f"link_{k}.0", [0, 0, (0.0423 if finger == "thumb" else 0.0267) + apart]]
            for finger, k in ends.items()
        },
    }
    (tmp_path / "theirs.yaml").write_text(yaml.safe_dump(table))
    spec = load_spec("allegro", "right", str(tmp_path / "theirs.yaml"))
    if apart:
        with pytest.raises(ConfigError, match="a site is called link_3.0_tip already, elsewhere"):
            hand_spec(spec)
        return
    hand_spec(spec).compile()
