"""COLLADA and glTF meshes of a URDF keep units, node transforms and colours; a broken file is one line."""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.sim.hand_import.adapt import compile_model
from allegro_twin.sim.hand_import.explore import explore_hand
from tests.surfaces.cli.wrong import built

CORNERS = " ".join(f"{x} {y} {z}" for x in (0, 1) for y in (0, 2) for z in (0, 3))
SIDES = "0 1 3 0 3 2 4 6 7 4 7 5 0 4 5 0 5 1 2 3 7 2 7 6 0 2 6 0 6 4 1 5 7 1 7 3"
DAE = f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="centimeter" meter="0.01"/><up_axis>UP_AXIS</up_axis></asset>
  <library_effects><effect id="paint"><profile_COMMON><technique sid="common"><lambert>
    <diffuse><color>1 0.5 0 1</color></diffuse></lambert></technique></profile_COMMON></effect></library_effects>
  <library_materials><material id="orange"><instance_effect url="#paint"/></material></library_materials>
  <library_geometries><geometry id="box"><mesh>
    <source id="corners"><float_array id="numbers" count="24">{CORNERS}</float_array><technique_common>
      <accessor source="#numbers" count="8" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
      <param name="Z" type="float"/></accessor></technique_common></source>
    <vertices id="points"><input semantic="POSITION" source="#corners"/></vertices>
    <triangles count="12" material="m"><input semantic="VERTEX" source="#points" offset="0"/><p>{SIDES}</p></triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="scene"><node id="outer"><translate>1 0 0</translate>
    <node id="inner"><scale>2 1 1</scale><instance_geometry url="#box"><bind_material><technique_common>
      <instance_material symbol="m" target="#orange"/></technique_common></bind_material></instance_geometry></node>
  </node></visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>
"""
"""A box of 1 × 2 × 3 cm, twice as long in x, 1 cm along x: it reaches from (1, 0, 0) to (3, 2, 3) cm."""
HAND = """<robot name="two">
  <link name="palm">{palm}</link>
  <link name="finger"><inertial><mass value="0.05"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>
    </inertial>{finger}</link>
  <joint name="bend" type="revolute"><parent link="palm"/><child link="finger"/><origin xyz="0 0 0.2"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
</robot>"""
BOX = '<collision><origin xyz="0 0 0.02"/><geometry><box size="0.02 0.02 0.04"/></geometry></collision>'


def mesh(kind: str, name: str, scale: str = "1 1 1") -> str:
    return f'<{kind}><geometry><mesh filename="{name}" scale="{scale}"/></geometry></{kind}>'


def hand(folder: Path, palm: str = BOX, finger: str = BOX) -> Path:
    path = folder / "two.urdf"
    path.write_text(HAND.format(palm=palm, finger=finger))
    return path


def shapes(path: Path, visual: bool) -> list[tuple[np.ndarray, np.ndarray, list[float]]]:
    """Lowest and highest corner, in the link's frame, and the colour of each mesh of the finger."""
    model = compile_model(explore_hand(path).spec)
    found = []
    for geom in range(model.ngeom):
        number = int(model.geom_dataid[geom])
        if number < 0 or bool(model.geom_contype[geom]) == visual or model.geom_bodyid[geom] != model.body("finger").id:
            continue
        first, count = model.mesh_vertadr[number], model.mesh_vertnum[number]
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        points = model.mesh_vert[first : first + count] @ turn.reshape(3, 3).T + model.geom_pos[geom]
        found.append((points.min(axis=0), points.max(axis=0), model.geom_rgba[geom].tolist()))
    return found


def two_nodes(path: Path) -> None:
    """A glTF with a red box below and a blue one above it, which its node moves and turns."""
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.Scene()
    for name, color, turn, at in (
        ("low", [255, 0, 0, 255], np.eye(3), [0.0, 0.0, 0.0]),
        ("high", [0, 0, 255, 255], np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), [0.0, 0.0, 0.05]),
    ):
        box = trimesh.creation.box(extents=(0.02, 0.01, 0.03))
        box.visual = trimesh.visual.TextureVisuals(
            material=trimesh.visual.material.PBRMaterial(name=name, baseColorFactor=color)
        )
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, at
        scene.add_geometry(box, node_name=name, geom_name=name, transform=pose)
    path.write_bytes(scene.export(file_type="glb"))


@pytest.mark.parametrize("up", ["Z_UP", "Y_UP"])
def test_a_collada_mesh_has_its_unit_its_nodes_and_the_urdfs_scale_and_no_turn_of_its_axes(
    up: str, tmp_path: Path
) -> None:
    pytest.importorskip("collada")
    (tmp_path / "box.dae").write_text(DAE.replace("UP_AXIS", up))
    ((low, high, color),) = shapes(hand(tmp_path, finger=mesh("visual", "box.dae", "2 2 2") + BOX), visual=True)
    np.testing.assert_allclose(low, [0.02, 0.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(high, [0.06, 0.04, 0.06], atol=1e-7)
    np.testing.assert_allclose(color, [1.0, 0.5, 0.0, 1.0], atol=5e-3)


def test_the_nodes_of_a_gltf_stand_where_they_belong_each_in_its_colour_and_each_is_a_shape_that_touches(
    tmp_path: Path,
) -> None:
    two_nodes(tmp_path / "two.glb")
    path = hand(tmp_path, finger=mesh("visual", "two.glb") + mesh("collision", "two.glb"))
    corners = [([-0.01, -0.005, -0.015], [0.01, 0.005, 0.015]), ([-0.005, -0.01, 0.035], [0.005, 0.01, 0.065])]
    for visual in (True, False):
        found = sorted(shapes(path, visual), key=lambda each: float(each[0][2]))
        for (low, high, _), (lowest, highest) in zip(found, corners, strict=True):
            np.testing.assert_allclose(low, lowest, atol=1e-7)
            np.testing.assert_allclose(high, highest, atol=1e-7)
        if visual:
            assert [color for *_, color in found] == [[1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]]


def test_a_link_is_shown_by_its_visual_mesh_and_one_without_by_what_touches(tmp_path: Path) -> None:
    two_nodes(tmp_path / "two.glb")
    model = compile_model(explore_hand(hand(tmp_path, finger=mesh("visual", "two.glb") + BOX)).spec)
    groups = {(model.body(model.geom_bodyid[k]).name, bool(model.geom_contype[k])): int(model.geom_group[k])
              for k in range(model.ngeom)}  # fmt: skip
    assert groups == {("palm", True): 0, ("finger", False): 2, ("finger", True): 3}


def test_converted_meshes_lie_beside_the_card_and_the_page_names_what_was_converted_and_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    two_nodes(Path("two.glb"))
    Path("torn.glb").write_bytes(Path("two.glb").read_bytes()[:100])
    finger = "".join(mesh("visual", name) for name in ("two.glb", "torn.glb", "gone.glb")) + BOX
    built()(["hand", "new", str(hand(tmp_path, finger=finger)), "--no-film"], standalone_mode=False)
    Path("two.glb").unlink()
    assert compile_model(mujoco.MjSpec.from_file("mine/two.xml")).nmesh == 2
    assert sorted(path.name for path in Path("mine/two_meshes").iterdir()) == ["two_visual_0.obj", "two_visual_1.obj"]
    for said in (capsys.readouterr().out, Path("mine/two.md").read_text()):
        assert "meshes converted to OBJ, units and node transforms applied: two.glb" in said
        assert "visual meshes left out: torn.glb (not readable: " in said
        assert "gone.glb (no such file at " in said


def test_without_the_extra_a_visual_mesh_is_left_out_and_one_that_touches_is_refused_and_both_say_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "trimesh", None)
    (tmp_path / "box.dae").write_text(DAE)
    way = "pip install 'allegro-twin[meshes]' reads .dae"
    notes = explore_hand(hand(tmp_path, finger=mesh("visual", "box.dae") + BOX)).notes
    assert f"visual meshes left out: box.dae ({way})" in notes
    with pytest.raises(ConfigError) as raised:
        explore_hand(hand(tmp_path, finger=mesh("collision", "box.dae")))
    assert str(raised.value) == f"{tmp_path / 'two.urdf'}: link finger: collision mesh box.dae: {way}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty; an MJCF begins with <mujoco>, a URDF with <robot>"),
        ("solid part\n", r"not an XML file \(.*\); an MJCF begins with <mujoco>, a URDF with <robot>"),
        ("<html/>", "its first element is <html>; an MJCF begins with <mujoco>, a URDF with <robot>"),
        ("<robot><link name='a'>", "not a readable URDF: no element found"),
        ("<robot/>", "a URDF without a <link>"),
        ("<robot><link name='a'/></robot>", "has no actuators: no joint of it moves"),
        ("<robot><link name='a'/><joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint></robot>",
         "joint j: its child b is no <link> of the file"),
        ("<robot xmlns:xacro='http://www.ros.org/wiki/xacro'><link name='a'/><xacro:finger/></robot>",
         "it has xacro macros; `xacro hand.urdf > hand.urdf` resolves them"),
        ("<mujoco/>", "its first element is <mujoco>, so it is an MJCF: call it hand.xml"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_model_is_one_line_that_names_it_and_the_way_out(
    text: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "hand.urdf"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message) as raised:
        explore_hand(path)
    assert str(raised.value).startswith(str(path))
    assert "\n" not in str(raised.value)


def test_a_missing_mesh_of_an_mjcf_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "hand.xml"
    geom = "<worldbody><geom type='mesh' mesh='gone'/></worldbody>"
    path.write_text(f"<mujoco><asset><mesh file='gone.stl'/></asset>{geom}</mujoco>")
    with pytest.raises(ConfigError) as raised:
        explore_hand(path)
    way = "names are relative to the model file and its `meshdir`"
    assert str(raised.value) == f"{path}: Error opening file 'gone.stl'; {way}"


def test_a_mesh_of_a_package_is_looked_for_above_the_urdf_and_where_ros_looks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finger = mesh("collision", "package://my_hand/meshes/box.obj")
    with pytest.raises(ConfigError, match="no folder my_hand above the URDF or in ROS_PACKAGE_PATH"):
        explore_hand(hand(tmp_path, finger=finger))
    package = tmp_path / "ws" / "my_hand"
    (package / "meshes").mkdir(parents=True)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(package.parent))
    with pytest.raises(ConfigError, match="the package my_hand has no meshes/box.obj; put it there"):
        explore_hand(hand(tmp_path, finger=finger))
    corners = [f"v {x} {y} {z}" for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)]
    sides = [int(number) + 1 for number in SIDES.split()]
    faces = [f"f {a} {b} {c}" for a, b, c in zip(sides[::3], sides[1::3], sides[2::3], strict=True)]
    (package / "meshes" / "box.obj").write_text("\n".join([*corners, *faces]) + "\n")
    assert len(shapes(hand(tmp_path, finger=finger), visual=False)) == 1


def test_a_flat_label_is_shown_and_cannot_touch(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    label = trimesh.Trimesh(
        vertices=[[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0.01, 0.01, 0]], faces=[[0, 1, 2], [1, 3, 2]]
    )
    (tmp_path / "label.ply").write_bytes(label.export(file_type="ply"))
    assert len(shapes(hand(tmp_path, finger=mesh("visual", "label.ply") + BOX), visual=True)) == 1
    with pytest.raises(ConfigError, match="collision mesh label.ply: flat: it has no inside that could touch"):
        explore_hand(hand(tmp_path, finger=mesh("collision", "label.ply")))
