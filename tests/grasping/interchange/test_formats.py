"""Grasps of every format come to the same arrays, frames and joints, and go back as they came."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.grasping.interchange.dexgraspbench import write_dexgraspbench
from allegro_twin.grasping.interchange.grasps import MENAGERIE, PALM, Grasps, check_grasps
from allegro_twin.grasping.interchange.orders import joint_orders, order_by_name, permute_joints, reorder_joints
from allegro_twin.grasping.interchange.ours import write_yaml_grasps
from allegro_twin.grasping.interchange.plain import load_plain
from allegro_twin.grasping.interchange.read import assumed_hand, own_hand, read_grasps
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.orientation import matrix_from_euler, matrix_from_quaternion
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Array
from tests.grasping.interchange.samples import STAGES, bench, bodex, net, poses, postures, saved, stacked


def placed(pose: Array, points: Array) -> Array:
    """Points of a frame in the one that its pose is in, (m, 3)."""
    return np.asarray(points @ matrix_from_quaternion(pose[3:]).T + pose[:3])


def tips(spec: HandSpec, joints: Array) -> Array:
    """In the palm, (4, 3)."""
    found = hand_kinematics(spec).fingertips(joints)
    return np.array([found[finger.name].position for finger in spec.fingers])


def in_menageries_world(spec: HandSpec, pose: Array, joints: Array) -> Array:
    """Fingertips in the world as DexGraspBench has them: the whole file, whose palm is turned, on a free joint."""
    file = mujoco.MjSpec.from_file(str(data_root() / "models" / "mjcf" / f"allegro_{spec.side}.xml"))
    file.body("palm_link").quat = [0, 1, 0, 1]  # As in Menagerie's.
    scene = mujoco.MjSpec()
    scene.option = file.option  # Nothing to choose between.
    root = scene.worldbody.add_frame().attach_body(file.worldbody, "hand-", "")
    root.add_freejoint(name="hand")
    model = scene.compile()
    data = mujoco.MjData(model)
    data.joint("hand").qpos[:] = pose
    for name, value in zip(spec.joints, joints, strict=True):
        data.joint(f"hand-{name}").qpos[0] = value
    mujoco.mj_kinematics(model, data)
    return np.array([data.site(f"hand-{finger.tip}").xpos for finger in spec.fingers])


def test_dexgraspbenchs_fingertips_are_where_its_own_scene_has_them(tmp_path: Path, spec: HandSpec) -> None:
    record = bench(spec)
    grasps = read_grasps(saved(tmp_path / "a.npy", record), spec)
    for stage, key in enumerate(STAGES):
        theirs = in_menageries_world(spec, record[key][:7], record[key][7:])
        ours = placed(record["obj_pose"], placed(grasps.palm[0, stage], tips(spec, grasps.joints[0, stage])))
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_bodex_gives_the_pose_of_our_palm_itself(tmp_path: Path, spec: HandSpec) -> None:
    record = bodex(spec)
    grasps = read_grasps(saved(tmp_path / "a_grasp.npy", record), spec)
    assert (len(grasps), grasps.frame, grasps.object) == (2, PALM, "core_bottle")
    np.testing.assert_allclose(grasps.palm[1, 1, :3], record["robot_pose"][0, 1, 1, :3] - [0, 0, 0.1])
    np.testing.assert_array_equal(grasps.close, [postures(spec)[1]] * 2)
    np.testing.assert_array_equal(grasps.scale, [0.1, 0.1])


def test_dexgraspnet_is_read_by_its_names_and_euler_angles(tmp_path: Path, spec: HandSpec) -> None:
    np.save(tmp_path / "core-mug-1.npy", np.array(net(spec), dtype=object), allow_pickle=True)
    grasps = read_grasps(tmp_path / "core-mug-1.npy", spec)
    assert (len(grasps), grasps.object) == (2, "core-mug-1")
    for row in range(2):
        np.testing.assert_array_equal(grasps.close[row], postures(spec)[1])
        np.testing.assert_allclose(grasps.palm[row, 1, :3], [0.01, -0.02, 0.1])
        turned = matrix_from_quaternion(grasps.palm[row, 1, 3:])
        np.testing.assert_allclose(turned, matrix_from_euler([0.3, -0.2, 1.0 + row]), atol=1e-12)
    np.testing.assert_array_equal(grasps.squeeze, 1.1 * grasps.close)
    np.testing.assert_allclose(grasps.scale, [0.06, 0.08])
    assert "pre-shape and squeeze: 0.9 and 1.1 times" in grasps.source


@pytest.mark.parametrize("make", [bench, stacked])
def test_dexgraspbench_goes_back_to_the_last_bit(tmp_path: Path, spec: HandSpec, make: Any) -> None:
    record = make(spec)
    grasps = read_grasps(saved(tmp_path / "a.npy", record), spec)
    write_dexgraspbench(tmp_path / "b.npy", grasps)
    again = load_plain(tmp_path / "b.npy")
    for key in (*STAGES, "obj_pose"):
        np.testing.assert_array_equal(again[key], record[key])
        assert again[key].shape == record[key].shape
    assert again["obj_path"] == record["obj_path"]
    np.testing.assert_array_equal(again["obj_scale"], record["obj_scale"])
    same(read_grasps(tmp_path / "b.npy", spec), grasps)


def same(first: Grasps, second: Grasps) -> None:
    for name in ("hand", "joints", "object_pose", "scale"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert (first.object, first.frame, first.spec.name) == (second.object, second.frame, second.spec.name)


def test_our_yaml_goes_back_to_the_last_bit(tmp_path: Path, side: Side) -> None:
    spec = load_spec(side=side)
    way = np.stack([stacked(spec)["pregrasp_qpos"]] * 2, axis=1)
    way[:, :, 7:] *= [[[0.2], [0.6]]]
    record = stacked(spec) | {"approach_qpos": way}
    grasps = read_grasps(saved(tmp_path / "a.npy", record), spec)
    np.testing.assert_allclose(grasps.approach[:, 0], 0.2 * grasps.preshape)
    np.testing.assert_allclose(grasps.approach[:, 1], 0.6 * grasps.preshape)
    write_yaml_grasps(tmp_path / "a.yaml", grasps)
    same(read_grasps(tmp_path / "a.yaml", spec), grasps)
    with pytest.raises(ConfigError, match=f"is of a {side} hand"):
        read_grasps(tmp_path / "a.yaml", load_spec(side="left" if side == "right" else "right"))


@pytest.mark.parametrize("model", ["leap", "model_o", "sih"])
@pytest.mark.parametrize("suffix", [".npy", ".yaml"])
def test_grasps_of_any_hand_go_back_and_are_refused_for_another(tmp_path: Path, model: str, suffix: str) -> None:
    """Also where one motor spreads several fingers."""
    spec, path = load_spec(model), tmp_path / f"a{suffix}"
    rows = np.linspace(0.6 * spec.lower + 0.4 * spec.upper, 0.4 * spec.lower + 0.6 * spec.upper, 3)
    made = check_grasps(
        spec, poses(1)[None], rows[None], [0.0, 0, 0, 1, 0, 0, 0], 1.0, object_name="apple", frame=PALM, source=""
    )
    write_dexgraspbench(path, made) if suffix == ".npy" else write_yaml_grasps(path, made)
    same(read_grasps(path, spec), made)
    with pytest.raises(ConfigError, match=f"is of the hand {model}; this one is allegro: ask for {model}"):
        read_grasps(path, load_spec())
    assert own_hand(path)[:2] == (model, "right")
    assert assumed_hand(path, spec, named=False) == ""


def test_what_a_file_does_not_say_of_its_hand_is_said(tmp_path: Path, spec: HandSpec) -> None:
    path = saved(tmp_path / "a.npy", bench(spec))
    told = "a.npy: says of no hand and names no joints: read as of allegro_right (--hand has others)"
    assert assumed_hand(path, spec, named=False) == told
    assert assumed_hand(path, spec, named=True) == ""
    assert "read as of our palm of leap_right" in assumed_hand(path, load_spec("leap"), named=True)
    for named in (saved(tmp_path / "b.npy", bodex(spec)), saved(tmp_path / "c.npy", net(spec))):
        assert assumed_hand(named, spec, named=False) == ""


def test_a_change_of_frame_does_not_move_the_palm(tmp_path: Path, spec: HandSpec) -> None:
    grasps = read_grasps(saved(tmp_path / "a.npy", stacked(spec)), spec)
    there = grasps.in_frame(PALM)
    assert there.frame == PALM
    np.testing.assert_allclose(there.palm, grasps.palm, atol=1e-12)
    np.testing.assert_allclose(np.abs(there.in_frame(MENAGERIE).hand), np.abs(grasps.hand), atol=1e-12)
    assert grasps.in_frame(MENAGERIE) is grasps


def test_frame_can_be_said_where_a_file_has_another(tmp_path: Path, spec: HandSpec) -> None:
    path = saved(tmp_path / "a.npy", bench(spec))
    assert read_grasps(path, spec, frame="palm").frame == PALM
    with pytest.raises(ConfigError, match="no frame named 'plam'; did you mean 'palm'"):
        read_grasps(path, spec, frame="plam")


def test_the_first_version_of_dexgraspbench_has_poses_apart(tmp_path: Path, spec: HandSpec) -> None:
    record = bench(spec)
    apart = {"grasp_pose": record["grasp_qpos"][:7], "pregrasp_pose": record["pregrasp_qpos"][:7]}
    split = record | {key: record[key][7:] for key in STAGES} | apart
    whole, parted = (read_grasps(saved(tmp_path / "a.npy", each), spec) for each in (record, split))
    np.testing.assert_array_equal(parted.joints, whole.joints)
    np.testing.assert_array_equal(parted.hand[:, :2], whole.hand[:, :2])
    np.testing.assert_array_equal(parted.hand[:, 2], whole.hand[:, 1])


def test_many_ways_to_one_grasp_are_its_approach(tmp_path: Path, spec: HandSpec) -> None:
    record = bench(spec)
    way = np.linspace(0.5, 1.0, 5)[:, None] * record["pregrasp_qpos"]
    way[:, :7] = record["pregrasp_qpos"][:7]
    many = record | {"pregrasp_qpos": way, **{key: record[key][None] for key in STAGES[1:]}}
    grasps = read_grasps(saved(tmp_path / "a.npy", many), spec)
    assert grasps.approach.shape == (1, 4, 16)
    np.testing.assert_array_equal(grasps.preshape[0], record["pregrasp_qpos"][7:])


def test_menageries_left_hand_counts_its_fingers_from_the_ring(tmp_path: Path) -> None:
    """Its file lists ring, middle, index, thumb; so do MuJoCo's joint positions."""
    spec = load_spec(side="left")
    record = bench(spec)
    theirs = [*range(8, 12), *range(4, 8), *range(4), *range(12, 16)]
    swapped = record | {key: np.concatenate([record[key][:7], record[key][7:][theirs]]) for key in STAGES}
    grasps = read_grasps(saved(tmp_path / "a.npy", swapped), spec)
    np.testing.assert_array_equal(grasps.joints[0], postures(spec))
    write_dexgraspbench(tmp_path / "b.npy", grasps)
    again = load_plain(tmp_path / "b.npy")
    assert again["joint_names"][:5] == ["rfj0", "rfj1", "rfj2", "rfj3", "mfj0"]
    np.testing.assert_array_equal(again["grasp_qpos"], swapped["grasp_qpos"])


def test_a_leap_hands_joints_go_by_the_ids_of_their_servos() -> None:
    """As its URDF names them, and as its own program lists them: 1 is that by which the index finger bends."""
    leap = load_spec("leap")
    assert joint_orders(leap)["servos"][:4] == (1, 0, 2, 3)
    assert leap.joints[order_by_name(["1", "0", *map(str, range(2, 16))], leap, "a.npy")[0]] == "if_mcp"
    listed = order_by_name([f"leap/joint_{k}" for k in range(16)], leap, "a.npy")
    assert listed == joint_orders(leap)["servos"]
    for spec in (load_spec(), load_spec("model_o")):
        assert "servos" not in joint_orders(spec)


def test_joints_that_follow_others_are_refused_with_those_that_the_file_is_to_have() -> None:
    sih = load_spec("sih")
    way = "leave out those that follow; it has thumb_flexion, index, middle, ring_little, thumb_rotation"
    with pytest.raises(ConfigError, match=f"'urdf/index_0' follows another joint of sih_right: {way}"):
        order_by_name([*sih.joints, *(f"urdf/{each.name}" for each in sih.followers)], sih, "a.npy")
    with pytest.raises(ConfigError, match=f"{len(sih.all_joints)} joints, of which sih_right drives 5: {way}"):
        reorder_joints(np.zeros((1, 3, len(sih.all_joints))), sih, "a.npy")


@pytest.mark.parametrize("order", ["tree", "breadth", "thumb_first"])
def test_another_order_of_joints_is_found_out_and_named(tmp_path: Path, spec: HandSpec, order: str) -> None:
    record = bench(spec)
    theirs = list(joint_orders(spec)[order])
    other = record | {key: np.concatenate([record[key][:7], record[key][7:][theirs]]) for key in STAGES}
    path = saved(tmp_path / "a.npy", other)
    with pytest.raises(ConfigError, match=rf"rad outside its limits .*fit the order .*'{order}'"):
        read_grasps(path, spec)
    np.testing.assert_array_equal(read_grasps(path, spec, order=order).joints[0], postures(spec))
    named = saved(tmp_path / "b.npy", other | {"joint_names": [f"rh/{spec.joints[j]}" for j in theirs]})
    np.testing.assert_array_equal(read_grasps(named, spec).joints[0], postures(spec))


def test_an_order_says_where_each_column_of_the_file_goes(spec: HandSpec) -> None:
    assert joint_orders(spec)["tree"] == (0, 1, 2, 3, 12, 13, 14, 15, 4, 5, 6, 7, 8, 9, 10, 11)
    assert joint_orders(spec)["breadth"][:5] == (0, 4, 8, 12, 1)
    assert joint_orders(spec)["thumb_first"][:5] == (12, 13, 14, 15, 0)
    with pytest.raises(ConfigError, match=r"an order has each number from 0 to 15 once, not \[0, 0, 1"):
        reorder_joints(np.zeros((1, 3, 16)), spec, "a.npy", (0, 0, *range(1, 15)))
    for order in joint_orders(spec).values():
        np.testing.assert_array_equal(permute_joints(np.array(order, dtype=float), order), np.arange(16))


@pytest.mark.parametrize("style", ["{}", "ffj", "index_joint_0"])
def test_joints_are_known_by_many_names(tmp_path: Path, spec: HandSpec, style: str) -> None:
    prefixes = ("ff", "mf", "rf", "th")
    names = {
        "{}": list(spec.aliases),
        "ffj": [f"{prefix}j{k}" for prefix in prefixes for k in range(4)],
        "index_joint_0": [f"{finger.name}_joint_{k}" for finger in spec.fingers for k in range(4)],
    }[style]
    path = saved(tmp_path / "a.npy", bodex(spec) | {"joint_names": np.array(names)})
    np.testing.assert_array_equal(read_grasps(path, spec).close[0], postures(spec)[1])


def test_the_palm_can_be_had_from_the_middle_of_the_mesh(tmp_path: Path, spec: HandSpec) -> None:
    grasps = read_grasps(saved(tmp_path / "a.npy", stacked(spec)), spec)
    shifted = grasps.palm_from([0.01, 0.02, 0.03])
    np.testing.assert_allclose(grasps.palm[..., :3] - shifted[..., :3], np.broadcast_to([0.01, 0.02, 0.03], (4, 3, 3)))
    np.testing.assert_array_equal(shifted[..., 3:], grasps.palm[..., 3:])


def test_grasps_are_picked_and_brought_inside_the_limits(tmp_path: Path, spec: HandSpec) -> None:
    grasps = read_grasps(saved(tmp_path / "a.npy", stacked(spec)), spec)
    assert len(grasps.pick([0, 2])) == 2
    np.testing.assert_array_equal(grasps.pick(2).hand[0], grasps.hand[2])
    np.testing.assert_array_equal(grasps.pick([False, False, True, False]).scale, grasps.scale[2:3])
    over = read_grasps(saved(tmp_path / "b.npy", bench(spec)), spec)
    pressed = over.joints.copy()
    pressed[0, 2, 0] = 3.0
    inside = Grasps(over.hand, pressed, over.object_pose, over.scale, over.object, spec, PALM, "").within(spec)
    assert inside.squeeze[0, 0] == spec.upper[0]
