"""Several fingertips at once: what is reachable is reached, limits and clearance are kept, and the rest is reported."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.hand import HandKinematics, hand_kinematics
from allegro_twin.sim.contact.fingertip_ik import FingertipSolver
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Array, Vector

CLEARANCE = 0.003
Hand = tuple[HandSpec, FingertipSolver, HandKinematics]
Hands = dict[str, Hand]


@pytest.fixture(scope="module")
def hands() -> Hands:
    specs = [load_spec(side=side) for side in ("right", "left")]
    return {spec.side: (spec, FingertipSolver(spec), hand_kinematics(spec)) for spec in specs}


def points(model: HandKinematics, position: Vector) -> dict[str, Array]:
    return {name: pose.position for name, pose in model.fingertips(position).items()}


def apart(solver: FingertipSolver, model: HandKinematics, position: Vector) -> float:
    """Least distance between links at a posture: a solve that starts at its goal stays there."""
    return solver.solve(points(model, position), position, clearance=None, steps=1).closest


def free_postures(hand: Hand, n: int, seed: int) -> list[Vector]:
    spec, solver, model = hand
    rng = np.random.default_rng(seed)
    found: list[Vector] = []
    while len(found) < n:
        q = rng.uniform(spec.lower, spec.upper)
        if apart(solver, model, q) >= CLEARANCE + 0.0005:
            found.append(q)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("start", ["nearby", "middle"])
def test_all_four_tips_reach_what_a_free_posture_reaches(hands: Hands, side: Side, start: str) -> None:
    spec, solver, model = hands[side]
    rng = np.random.default_rng(3)
    reached = 0
    postures = free_postures(hands[side], 40, 1)
    for q in postures:
        begin = (spec.lower + spec.upper) / 2
        if start == "nearby":
            begin = np.clip(q + rng.normal(0, 0.1, spec.n_joints), spec.lower, spec.upper)
        solved = solver.solve(points(model, q), begin)
        tips = points(model, solved.position)
        for name, target in points(model, q).items():
            assert solved.distance[name] == pytest.approx(float(np.linalg.norm(tips[name] - target)), abs=1e-9)
        assert solved.reached == (max(solved.distance.values()) <= 1e-4 and solved.closest >= CLEARANCE)
        reached += solved.reached
    assert reached >= 39  # Of 40; measured over 500: all from the middle, 99.8 % from nearby.


def test_orientations_are_met_where_the_posture_that_has_them_exists(hands: Hands) -> None:
    spec, solver, model = hands["right"]
    for q in free_postures(hands["right"], 10, 5):
        poses = model.fingertips(q)
        turns = {name: pose.rotation for name, pose in poses.items()}
        solved = solver.solve(points(model, q), np.clip(q + 0.1, spec.lower, spec.upper), rotations=turns)
        assert solved.reached
        assert max(solved.angle.values()) < 1e-3


def test_limits_and_margin_are_kept(hands: Hands) -> None:
    spec, solver, model = hands["right"]
    rng = np.random.default_rng(4)
    on_the_edge = 0
    for margin in (0.0, 0.15):
        for _ in range(8):
            far = {name: point * 1.6 for name, point in points(model, rng.uniform(spec.lower, spec.upper)).items()}
            solved = solver.solve(far, np.zeros(16), margin=margin)
            room = np.minimum(solved.position - spec.lower, spec.upper - solved.position)
            assert room.min() >= margin - 1e-12
            on_the_edge += int((room < margin + 1e-6).any())
    assert on_the_edge >= 14  # The targets do press against the limits.


def test_two_tips_driven_to_one_point_stay_apart(hands: Hands) -> None:
    _, solver, model = hands["right"]
    start = np.tile([0.0, 0.6, 0.6, 0.6], 4)
    start[12:] = [0.8, 0.6, 0.6, 0.6]
    tips = points(model, start)
    meeting = (tips["index"] + tips["middle"]) / 2
    through = solver.solve({"index": meeting, "middle": meeting}, start, clearance=None)
    assert through.reached
    assert through.closest < -0.01
    kept = solver.solve({"index": meeting, "middle": meeting}, start, clearance=CLEARANCE)
    assert not kept.reached
    assert CLEARANCE <= kept.closest < CLEARANCE + 0.0002  # As near as it may.
    assert apart(solver, model, kept.position) == pytest.approx(kept.closest, abs=1e-6)
    assert kept.pair is not None
    # Two 12 mm spheres that leave the clearance: the centres are at least 27 mm apart.
    assert sum(kept.distance.values()) >= 0.024 + CLEARANCE - 1e-6


def test_a_start_that_collides_is_never_brought_deeper(hands: Hands) -> None:
    spec, solver, model = hands["right"]
    rng = np.random.default_rng(6)
    tried = 0
    while tried < 8:
        start = rng.uniform(spec.lower, spec.upper)
        if (before := apart(solver, model, start)) < 0.0:
            tried += 1
            solved = solver.solve(points(model, rng.uniform(spec.lower, spec.upper)), start)
            assert solved.closest >= before - 1e-6
            stays = solver.solve(points(model, start), start)
            assert max(stays.distance.values()) < 1e-4
            assert not stays.reached  # It collides, and says so.


def test_one_finger_alone_agrees_with_the_closed_form(hands: Hands, side: Side) -> None:
    spec, solver, _ = hands[side]
    rng = np.random.default_rng(8)
    begin = (spec.lower + spec.upper) / 2
    for finger in spec.fingers:
        exact, joints = ClosedFormFinger(spec, finger.name), list(finger.joints)
        for _ in range(5):
            point = exact.fk(rng.uniform(spec.lower[joints], spec.upper[joints])).position
            solved = solver.solve({finger.name: point}, begin, clearance=None)
            assert solved.reached
            np.testing.assert_allclose(exact.fk(solved.position[joints]).position, point, atol=1e-6)
            pose = exact.fk(solved.position[joints])
            branches = exact.ik(pose.position, near=solved.position[joints]).best(near=solved.position[joints])
            np.testing.assert_allclose(branches.posture, solved.position[joints], atol=1e-5)


def test_a_target_out_of_reach_is_a_result_with_the_distance_of_the_nearest_point(hands: Hands) -> None:
    spec, solver, _ = hands["right"]
    far = np.array([0.15, 0.05, 0.25])
    solved = solver.solve({"index": far}, (spec.lower + spec.upper) / 2, clearance=None)
    exact = ClosedFormFinger(spec, "index").ik(far).nearest()
    assert not solved.reached
    assert solved.distance["index"] == pytest.approx(float(exact.distance), abs=1e-5)
    assert np.isfinite(solved.position).all()


def test_without_the_extra_the_error_says_what_to_install(spec: HandSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mink", None)
    with pytest.raises(ConfigError, match=r"^FingertipSolver needs mink: pip install 'allegro-twin\[ik\]'$"):
        FingertipSolver(spec)


def test_arguments_that_do_not_fit_are_refused(hands: Hands) -> None:
    _, solver, _ = hands["right"]
    start, point = np.zeros(16), [0.05, 0.04, 0.1]
    cases: list[tuple[str, dict[str, object]]] = [
        ("no targets", {"targets": {}}),
        ("no finger named 'indx'; did you mean 'index'", {"targets": {"indx": point}}),
        ("target of index needs finite numbers", {"targets": {"index": [0.1, np.nan, 0.1]}}),
        ("start needs one value or 16", {"start": np.zeros(4)}),
        ("not a rotation matrix", {"rotations": {"index": 2 * np.eye(3)}}),
        ("rotation for thumb, which has no target", {"rotations": {"thumb": np.eye(3)}}),
        ("margin 2.0 rad does not fit", {"margin": 2.0}),
        ("clearance 0.5 m is not between", {"clearance": 0.5}),
        ("must be above zero", {"steps": 0}),
    ]
    for message, change in cases:
        arguments: dict[str, object] = {"targets": {"index": point}, "start": start} | change
        with pytest.raises(ConfigError, match=message):
            solver.solve(**arguments)  # type: ignore[arg-type]  # Wrong on purpose.
