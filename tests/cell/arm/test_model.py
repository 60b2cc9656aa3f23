"""The arms that are made from published tables."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.hands.description import arms, inertia
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics import arm
from allegro_twin.kinematics.arm import ArmModel
from allegro_twin.kinematics.pose import Pose
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import Array

ARMS = arms.arm_names()


def denavit_hartenberg(name: str, position: Array) -> Array:
    """The flange by Craig's convention, multiplied out from the table: (4, 4)."""
    table = read_yaml(data_root() / "models" / "arms" / f"{name}.yaml")
    rows = [(j["a"], j["d"], np.radians(j["twist"]), q) for j, q in zip(table["joints"], position, strict=True)]
    frame = np.eye(4)
    for a, d, alpha, theta in [*rows, (0.0, table["flange"], 0.0, 0.0)]:
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        frame = frame @ np.array(
            [[c, -s, 0, a], [s * ca, c * ca, -sa, -d * sa], [s * sa, c * sa, ca, d * ca], [0, 0, 0, 1]]
        )
    return frame


@pytest.mark.parametrize("name", ARMS)
def test_the_flange_is_where_the_maker_says(name: str) -> None:
    model = ArmModel(arms.load_arm_spec(name))
    np.testing.assert_allclose(model.pose(np.zeros(7)).position, [0.088, 0.0, 0.926], atol=1e-12)
    np.testing.assert_allclose(model.pose(model.spec.ready).position, [0.3069, 0.0, 0.5903], atol=5e-5)


@pytest.mark.parametrize("name", ARMS)
def test_mjcf_urdf_and_the_table_are_the_same_chain(name: str) -> None:
    spec = arms.load_arm_spec(name)
    model, chance = ArmModel(spec), np.random.default_rng(0)
    scene = mujoco.MjModel.from_xml_path(str(data_root() / "models" / "mjcf" / f"{name}.xml"))
    data = mujoco.MjData(scene)
    for position in chance.uniform(spec.lower, spec.upper, (50, 7)):
        data.qpos[:] = position
        mujoco.mj_kinematics(scene, data)
        wanted, pose, site = denavit_hartenberg(name, position), model.pose(position), data.site(spec.flange)
        for place, axes in ((pose.position, pose.rotation), (site.xpos, site.xmat.reshape(3, 3))):
            np.testing.assert_allclose(place, wanted[:3, 3], atol=1e-12)
            np.testing.assert_allclose(axes, wanted[:3, :3], atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_a_jacobian_is_what_a_small_motion_shows(name: str) -> None:
    spec = arms.load_arm_spec(name)
    model, step = ArmModel(spec), 1e-6
    place, _, jacobian = (np.array(each) for each in model.motion(spec.ready))
    for joint in range(7):
        moved = model.pose(spec.ready + step * np.eye(7)[joint]).position
        np.testing.assert_allclose((moved - place) / step, jacobian[:3, joint], atol=1e-5)


@pytest.mark.parametrize("name", ARMS)
def test_every_link_weighs_what_was_published_and_could_be_a_body(name: str) -> None:
    table = read_yaml(data_root() / "models" / "arms" / f"{name}.yaml")
    for link, row in zip(arms.load_arm_facts(name).links, table["links"], strict=True):
        assert link.body.mass == row["mass"]
        least, middle, largest = np.linalg.eigvalsh(link.body.inertia)
        assert least + middle >= largest


def test_only_the_fourth_link_of_one_arm_is_not_as_published() -> None:
    changed = {}
    for name in ARMS:
        table = read_yaml(data_root() / "models" / "arms" / f"{name}.yaml")
        for place, (link, row) in enumerate(zip(arms.load_arm_facts(name).links, table["links"], strict=True)):
            xx, yy, zz, xy, xz, yz = row["inertia"]
            off = np.abs(link.body.inertia - [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).max()
            if off > 0.0:
                changed[name, place] = off
    assert list(changed) == [("fer", 4)]
    assert changed["fer", 4] < 6e-4  # kg·m², of 0.0127.


def test_an_inertia_that_a_body_can_have_is_left_alone() -> None:
    tensor = np.diag([1.0, 2.0, 2.5])
    assert inertia.nearest_physical(tensor) is tensor


def test_a_pose_is_reached_inside_the_limits_or_the_message_says_how_near() -> None:
    spec = arms.load_arm_spec("fer")
    model = ArmModel(spec)
    home = model.pose(spec.ready)
    wanted = Pose(home.position + np.array([0.1, 0.1, -0.2]), home.rotation)
    found = model.reach(wanted, spec.ready)
    assert ((found >= spec.lower) & (found <= spec.upper)).all()
    np.testing.assert_allclose(model.pose(found).position, wanted.position, atol=1e-4)
    with pytest.raises(ConfigError, match=r"fer does not reach \[1.307, .* short; ask for one nearer"):
        model.reach(Pose(home.position + np.array([1.0, 0.0, 0.0]), home.rotation), spec.ready)


def test_a_pose_that_only_a_joint_beyond_its_end_would_reach_is_out_of_reach() -> None:
    spec = arms.load_arm_spec("fer")
    model = ArmModel(spec)
    with pytest.raises(ConfigError, match="fer does not reach"):
        model.reach(
            model.pose(np.array([0.0, -0.8, 0.0, -3.2, 0.0, 1.6, 0.8])), spec.ready
        )  # The fourth ends at -3.07.


def test_an_arm_is_a_spec_like_a_hands_and_a_typo_is_answered() -> None:
    spec = load_spec("fer")
    assert isinstance(spec, ArmSpec)
    assert (spec.name, spec.root, spec.flange, spec.n_joints) == ("fer", "fer_link0", "fer_flange", 7)
    with pytest.raises(ConfigError, match="an arm has no side"):
        load_spec("fer", "left")
    with pytest.raises(ConfigError, match="no arm named 'fr2'; did you mean 'fr3'"):
        arms.load_arm_spec("fr2")


def reached(model: ArmModel, off: Array) -> bool:
    """Whether the place of the ready posture with joints that are so far off is reached from there."""
    spec = model.spec
    try:
        model.reach(model.pose(np.clip(spec.ready + off, spec.lower + 0.1, spec.upper - 0.1)), spec.ready)
    except ConfigError:
        return False
    return True


def test_a_goal_that_comes_no_nearer_is_given_up_and_one_that_does_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = arms.load_arm_spec("fer")
    model, steps, step = ArmModel(spec), list[int](), ArmModel._motion

    def counted(own: ArmModel, position: Array) -> tuple[Array, Array, Array]:
        steps.append(1)
        return step(own, position)

    monkeypatch.setattr(ArmModel, "_motion", counted)
    arrived = dict[int, list[bool]]()
    for patience in (arm._STALLED, arm._STEPS):  # With as many steps as there are nothing is given up.
        draws = np.random.default_rng(3)
        monkeypatch.setattr(arm, "_STALLED", patience)
        arrived[patience] = [reached(model, draws.normal(0.0, 0.5, 7)) for _ in range(40)]
    assert len(set(map(tuple, arrived.values()))) == 1
    assert 20 < sum(arrived[arm._STEPS]) < 40
    monkeypatch.setattr(arm, "_STALLED", min(arrived))
    steps.clear()
    home = model.pose(spec.ready)
    with pytest.raises(ConfigError, match="fer does not reach"):
        model.reach(Pose(home.position + np.array([1.0, 0.0, 0.0]), home.rotation), spec.ready)
    assert len(steps) < 100
