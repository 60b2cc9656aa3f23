"""What lies flat is pushed over the table's edge and taken there."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from pydantic import ValidationError

from allegro_twin.app.session import _moments
from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse_settings
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner
from allegro_twin.grasping.plan import pushing
from allegro_twin.grasping.plan.candidate import Candidate, candidate_scenario
from allegro_twin.grasping.plan.pushing import ASTRAY, pushed_stage, tilt_along_push, with_push
from allegro_twin.grasping.plan.search import GraspSearch, search_symmetry
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.scenario import Phase, Scenario, load_protocol
from allegro_twin.grasping.timeline import first_posture, make_stage, pushed_until, with_push_phases
from allegro_twin.grasping.trial import Trial
from allegro_twin.grasping.uncertainty import Perturbation
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import Library, load_grasp, load_posture
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.orientation import (
    matrix_facing,
    matrix_from_quaternion,
    quaternion_from_vector,
    quaternion_product,
)
from allegro_twin.sim.contact.grasp_scene import GraspScene
from allegro_twin.sim.model.scene import compile_scene
from allegro_twin.sim.model.wrist import WRIST_JOINTS, wrist_angles
from allegro_twin.spec import Side

SPEC = load_spec()
BOARD = {"name": "board", "shape": "box", "size": (0.2, 0.14, 0.008), "mass": 0.2}
AT_THE_EDGE = {"position": (0.2, 0, 0), "facing": (-1, 0, 0), "fingers": (0, 1, 0), "retreat": (0.1, 0, 0)}


def scenario(thing: dict[str, Any] = BOARD, **more: Any) -> Scenario:
    content = {"objects": [thing], "grasp": "prismatic_3_finger", "wrist": AT_THE_EDGE, "edge": 0.15} | more
    return parse_settings(Scenario, content, "test")


@pytest.mark.parametrize("hand", ["allegro", "leap", "model_o", "sih"])
def test_fingers_that_push_end_at_one_height(hand: str) -> None:
    spec = load_spec(hand)
    posture, tips = pushing._level_fingers(spec)
    names = [finger.name for finger in spec.fingers if "thumb" not in finger.name]
    ends = hand_kinematics(spec).fingertip_jacobians(posture, names)[0][:, 2]
    assert len(tips) >= 2
    assert np.ptp(tips[:, 2]) < 0.001
    assert ends.max() < tips[:, 2].max() + 0.02
    flat, bent = load_posture("flat", spec), load_posture("home", spec)
    assert (posture >= np.minimum(flat, bent) - 1e-4).all()
    assert (posture <= np.maximum(flat, bent) + 1e-4).all()


def test_the_hand_comes_down_behind_the_object_and_leaves_its_centre_on_the_table() -> None:
    push = with_push(scenario(), SPEC).push
    assert push is not None
    tips = hand_kinematics(SPEC).fingertip_jacobians(np.array(push.posture), ["middle"])[0][0]
    tip = np.array(push.wrist.position) + matrix_facing(push.wrist.facing, push.wrist.fingers) @ tips
    behind = -0.1 - tip[0]
    assert pushing.BEHIND < behind < pushing.BEHIND + 0.02
    assert_allclose(push.distance - pushing.BEHIND, 0.15 - pushing.KEPT, atol=1e-3)


@pytest.mark.parametrize(
    ("thing", "edge", "said"),
    [
        ({"name": "die", "shape": "box", "size": (0.04, 0.04, 0.04), "mass": 0.1}, 0.15, r"object die: .* 0 mm of it"),
        (BOARD, 0.02, r"object board: pushed until"),
    ],
)
def test_what_would_not_stand_out_is_refused_with_its_length(thing: dict[str, Any], edge: float, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        with_push(scenario(thing, edge=edge), SPEC)


def test_a_push_needs_an_edge() -> None:
    with pytest.raises(ConfigError, match="needs the table's edge"):
        with_push(scenario(edge=None), SPEC)
    push = with_push(scenario(), SPEC).model_dump()["push"]
    with pytest.raises(ConfigError, match="`push` needs `edge`"):
        scenario(edge=None, push=push)


def test_the_table_ends_at_its_edge_and_nothing_else_of_a_scene_changes() -> None:
    ends = []
    for edge in (None, 0.15):
        model = compile_scene(SPEC, make_stage(scenario(edge=edge), load_protocol("table_pick"), "right", Path()))
        table = model.geom("table")
        ends.append((table.pos[0] - table.size[0], table.pos[0] + table.size[0]))
    assert_allclose(ends, [(-0.45, 0.45), (-0.45, 0.15)])


@pytest.mark.parametrize("side", ["right", "left"])
def test_after_the_push_the_palm_comes_to_where_the_grasp_has_it(side: Side) -> None:
    spec, pushed = load_spec(side=side), with_push(scenario(), SPEC)
    trial = Trial(pushed, spec, load_grasp("prismatic_3_finger", spec))
    model, data = trial.backend.model, mujoco.MjData(trial.backend.model)
    names = [window.name for window in trial.windows]
    assert names[:9] == ["settle", "push_down", "push", "push_back", "push_up", "push_over", "push_beside",
                         "push_ready", "approach"]  # fmt: skip
    set_points = trial.backend.drive
    assert set_points is not None
    step = round(trial.windows[names.index("approach")].end / model.opt.timestep) - 1
    load = float(model.body_subtreemass[model.body("palm_link").id]) * 9.81 / 2e4
    for axis, name in enumerate(WRIST_JOINTS):
        data.qpos[model.joint(name).qposadr[0]] = set_points[step, axis] - (load if axis == 2 else 0.0)
    mujoco.mj_kinematics(model, data)
    assert trial.windows[names.index("approach")].begin < 8.0, "the palm turns as fast as it travels"
    mirror = np.diag([1.0, -1.0 if side == "left" else 1.0, 1.0])
    palm = data.body("palm_link")
    wrist = pushed.wrist
    assert_allclose(palm.xpos, mirror @ (np.add(wrist.position, (0, 0, 0.0041))), atol=1e-4)
    assert_allclose(palm.xmat.reshape(3, 3), mirror @ matrix_facing(wrist.facing, wrist.fingers) @ mirror, atol=1e-6)


def test_the_object_comes_to_lie_where_the_push_ends() -> None:
    pushed = with_push(scenario(), SPEC)
    stage = make_stage(pushed, load_protocol("table_pick"), "right", Path())
    after = pushed_stage(pushed, stage, SPEC, grasp_templates(SPEC)[0])
    x, y, z = after.objects[0].position
    assert_allclose((x, y, z), (0.125, 0.0, 0.004), atol=0.015)
    assert pushed_until(Trial(pushed, SPEC, grasp_templates(SPEC)[0]).windows) > 2.0


def test_what_rolls_away_was_not_pushed() -> None:
    ball = {"name": "ball", "shape": "sphere", "size": (0.12,), "mass": 0.2}
    rolling = with_push(scenario(ball), SPEC)
    stage = make_stage(rolling, load_protocol("table_pick"), "right", Path())
    with pytest.raises(ConfigError, match="object ball: the push leaves it .* from where it was to come"):
        pushed_stage(rolling, stage, SPEC, grasp_templates(SPEC)[0])


@pytest.fixture(scope="module")
def search() -> GraspSearch:
    return GraspSearch(with_push(scenario(), SPEC), SPEC, grasp_templates(SPEC))


@pytest.fixture(scope="module")
def bench(search: GraspSearch) -> GraspScene:
    return search._proposer(load_protocol("table_pick"), np.random.default_rng(0)).bench


def test_what_the_fingers_do_not_reach_was_not_pushed() -> None:
    pushed = with_push(scenario(), SPEC).model_dump()
    x, *others = pushed["push"]["wrist"]["position"]
    pushed["push"]["wrist"]["position"] = (x - 0.05, *others)
    short = Scenario.model_validate(pushed)
    stage = make_stage(short, load_protocol("table_pick"), "right", Path())
    with pytest.raises(ConfigError, match=r"object board: the push leaves it \d\d mm .* tilted by 0°"):
        pushed_stage(short, stage, SPEC, grasp_templates(SPEC)[0])


def test_a_left_hand_pushes_in_the_mirror_image_of_the_posture() -> None:
    pushed, grasp = with_push(scenario(), SPEC), load_grasp("prismatic_3_finger", SPEC)
    right, left = (
        first_posture(with_push_phases(load_protocol("table_pick"), pushed), grasp, load_spec(side=side))
        for side in ("right", "left")
    )
    assert_allclose(left, SPEC.mirror_posture(right))
    assert (left != right).any()


def test_a_hand_that_begins_elsewhere_pushes_in_the_same_posture() -> None:
    pushed, home = with_push(scenario(), SPEC), load_posture("home", SPEC) + 0.1
    trial = Trial(pushed, SPEC, load_grasp("prismatic_3_finger", SPEC), start=home)
    push = next(window for window in trial.windows if window.name == "push")
    assert pushed.push is not None
    assert_allclose(trial.reference.begin(home)(push.begin).position, pushed.push.posture)


def test_a_phase_has_a_posture_of_its_own_or_one_of_the_grasp() -> None:
    with pytest.raises(ValidationError, match="`hand` or `posture`, not both"):
        Phase(name="x", seconds=1.0, hand="close", posture=(0.0,))
    push = with_push(scenario(), SPEC).model_dump()
    push["push"]["posture"] = (0.0, 0.1)
    with pytest.raises(ConfigError, match="posture: 2 joints; allegro_right has 16"):
        Trial(Scenario.model_validate(push), SPEC, load_grasp("prismatic_3_finger", SPEC))


def test_the_push_is_no_part_of_the_lift_that_is_asked_for() -> None:
    grasp = load_grasp("prismatic_3_finger", SPEC)
    assert Trial(with_push(scenario(), SPEC), SPEC, grasp).rule == Trial(scenario(), SPEC, grasp).rule


def test_a_strip_of_pictures_begins_with_the_push() -> None:
    trial = Trial(with_push(scenario(), SPEC), SPEC, load_grasp("prismatic_3_finger", SPEC))
    ends = {window.name: window.end for window in trial.windows}
    rig: Any = SimpleNamespace(trial=trial)
    assert _moments(rig) == [ends[name] for name in ("push", "squeeze", "hold", "turn", "shake")]


def test_in_the_air_there_is_no_push() -> None:
    pushed, protocol = with_push(scenario(), SPEC), load_protocol("fc")
    assert with_push_phases(protocol, pushed) is protocol


def test_what_begins_inside_the_object_is_refused() -> None:
    with pytest.raises(ConfigError, match="cannot stand on the table behind it"):
        with_push(scenario({"name": "plank", "shape": "box", "size": (0.8, 0.1, 0.02), "mass": 1.0}, edge=0.5), SPEC)


def test_at_an_edge_no_two_ways_round_a_box_are_the_same(search: GraspSearch, bench: GraspScene) -> None:
    assert len(search_symmetry(search).turns) == 1
    np.testing.assert_allclose(search_symmetry(search).centre, bench.placed.position, atol=ASTRAY)
    free = GraspSearch(scenario(edge=None), SPEC, grasp_templates(SPEC))
    assert len(search_symmetry(free).turns) > 1


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_palm_that_turns_by_a_quarter_is_turned_by_the_hinges(sign: float) -> None:
    wanted = np.array([[0.0, 0.0, sign], [sign, 0.0, 0.0], [0.0, 1.0, 0.0]])
    x, y, z = (matrix_from_quaternion(quaternion_from_vector(v)) for v in np.diag(wrist_angles(wanted)))
    assert_allclose(x @ y @ z, wanted, atol=1e-9)


@given(st.floats(-3.0, 3.0), st.sampled_from([-np.pi / 2, np.pi / 2, 0.3, -1.2]), st.floats(-3.0, 3.0))
def test_the_wrists_hinges_turn_the_palm_as_asked_for_where_two_of_them_are_one_axis_too(
    a: float, b: float, c: float
) -> None:
    def turned(angles: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y, z = (matrix_from_quaternion(quaternion_from_vector(v)) for v in np.diag(angles))
        product: NDArray[np.float64] = x @ y @ z
        return product

    wanted = turned(np.array([a, b, c]))
    assert_allclose(turned(wrist_angles(wanted)), wanted, atol=1e-6)


def test_a_grasp_at_the_edge_is_told_from_where_the_object_is_at_first(search: GraspSearch, bench: GraspScene) -> None:
    assert bench.placed.position[0] > 0.1
    at, zero = np.array([0.3, 0.0, 0.02]), np.zeros(SPEC.n_joints)
    candidate = Candidate(at, np.eye(3), np.array([0.1, 0, 0]), zero, zero, zero, zero, zero, "x")
    assert_allclose(
        candidate_scenario(candidate, bench, search.scenario).wrist.position, at - (0, 0, 0.0041), atol=1e-4
    )


def test_a_hand_beyond_the_edge_may_be_lower_than_the_table(bench: GraspScene) -> None:
    open_, down = load_posture("flat", SPEC), matrix_facing((-1, 0, 0), (0, 0, -1))
    assert bench.lowest(np.array([0.5, 0.0, 0.1]), down, open_) == np.inf
    assert bench.lowest(np.array([0.0, 0.0, 0.1]), down, open_) < 0.0


GRASP = """
entries:
  board:
    kind: grasp
    description: Of plan board.stl --mass 0.2 --edge 0.15 --time 60, seed 0
    taxonomy: {number: 7, name: Prismatic 3 Finger, type: precision, opposition: pad, virtual_fingers: thumb}
    evidence: board
    side: right
    speed: 1.0
    preshape:
      index: [-0.1309, 0.3792, 0.3748, 0.6397]
      middle: [0.0119, 0.324, 0.475, 0.5969]
      ring: [0.2987, 0.308, 0.406, 0.6531]
      thumb: [1.3384, 0.3589, 0.7936, 0.9226]
    close:
      index: [-0.1308, 0.8164, 0.8151, 0.6386]
      middle: [0.0345, 0.7575, 0.9121, 0.5941]
      ring: [0.2614, 0.7463, 0.8553, 0.6496]
      thumb: [1.3359, 0.3598, 1.0227, 0.6904]
    squeeze:
      index: [-0.1278, 0.8164, 0.8165, 0.6399]
      middle: [0.0423, 0.7585, 0.9106, 0.5926]
      ring: [0.2471, 0.7429, 0.8561, 0.6512]
      thumb: [1.3314, 0.3554, 1.0204, 0.6894]
    grip: {kind: latch}
"""
PINCH = {
    "position": (0.2621, 0.0038, 0.0351), "facing": (-0.9736, 0.1632, -0.1594),
    "fingers": (0.1479, -0.0808, -0.9857), "retreat": (0.0974, -0.0163, 0.0159),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("side", ["right", "left"])
def test_a_board_is_held_at_the_edge_wherever_it_lay_and_not_without_the_push(side: Side, tmp_path: Path) -> None:
    spec, file = load_spec(side=side), tmp_path / "board.yaml"
    file.write_text(GRASP)
    grasp = Library(tmp_path).grasp("board", spec)
    pushed = with_push(scenario(wrist=PINCH), SPEC)
    draws = [None, Perturbation(x=0.005, y=-0.005, yaw=0.15), Perturbation(x=-0.005, y=0.005, size=1.05, friction=0.5)]
    cases = [TrialCase(pushed, grasp, draw) for draw in draws]
    cases.append(TrialCase(pushed.model_copy(update={"push": None}), grasp))
    assert [verdict.held for verdict in TrialRunner(spec).verdicts(cases)] == [True, True, True, False]


@pytest.mark.parametrize(("axis", "tilted"), [((1, 0, 0), 0.0), ((0, 0, 1), 0.0), ((0, 1, 0), 0.3), ((0, -1, 0), 0.3)])
def test_what_rolls_about_the_way_it_is_pushed_or_turns_on_the_table_is_not_tilted(
    axis: tuple[int, int, int], tilted: float
) -> None:
    """Whatever it lay like before."""
    before = quaternion_from_vector(np.array([0.4, -0.2, 1.1]))
    after = quaternion_product(quaternion_from_vector(0.3 * np.array(axis)), before)
    assert tilt_along_push(before, after) == pytest.approx(tilted, abs=1e-9)
