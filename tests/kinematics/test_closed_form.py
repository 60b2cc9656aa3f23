"""The closed forms agree with Pinocchio and undo themselves, for every finger of both hands."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.closed_form.geometry import load_geometry
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.spec import SIDES, Side
from allegro_twin.types import Array
from tests.kinematics.hands import EVERY, FINGERS, LONG, SPECS, held, postures, shortly, solve

N = 100_000
HANDS = {side: hand_kinematics(SPECS[side]) for side in SIDES}
Key = tuple[Side, str]


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(SIDES))
def test_forward_kinematics_is_that_of_pinocchio(seed: int, side: Side) -> None:
    spec = SPECS[side]
    position = np.random.default_rng(seed).uniform(spec.lower, spec.upper)
    for name, pose in HANDS[side].fingertips(position).items():
        ours = FINGERS[side, name].fk(position[list(spec.finger(name).joints)])
        np.testing.assert_allclose(ours.position, pose.position, rtol=0, atol=1e-12)
        np.testing.assert_allclose(ours.rotation, pose.rotation, rtol=0, atol=1e-12)


@pytest.mark.parametrize("key", shortly(EVERY), ids=str)
@pytest.mark.slow
def test_a_hundred_thousand_postures_are_found_again(key: Key) -> None:
    finger = FINGERS[key]
    q = postures(finger, N)
    pose = finger.fk(q)
    for given_ in held(finger, q):
        solutions = solve(finger, pose.position, given_)
        error = np.abs(solutions.position - q[:, None]).max(axis=-1)
        assert np.where(solutions.within, error, np.inf).min(axis=-1).max() <= 1e-8, given_.keys()
        for there in (solutions.within, solutions.exists):
            found = finger.fk(solutions.position[there]).position
            wanted = np.broadcast_to(pose.position[:, None], (*there.shape, 3))[there]
            # The promise is 1e-12; rounding of lengths up to 0.2 m is what is left.
            assert np.linalg.norm(found - wanted, axis=-1).max() <= 1e-15, given_.keys()


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_branches_inside_the_limits_have_the_angle_asked_for_and_no_other_is_marked(key: Key) -> None:
    finger = FINGERS[key]
    q = postures(finger, 5000, seed=1)
    pose = finger.fk(q)
    for given_ in held(finger, q)[1:]:
        solutions = solve(finger, pose.position, given_)
        for name, value in given_.items():
            angles = solutions.position
            of = {
                "q0": angles[..., 0],
                "q1": angles[..., 1],
                "psi": angles[..., 2:].sum(-1),
                "pitch": angles[..., 1:].sum(-1),
            }
            off = np.abs(np.exp(1j * of[name]) - np.exp(1j * value)[:, None])
            assert off[solutions.exists].max() <= 1e-12
        inside = ((solutions.position >= finger.lower) & (solutions.position <= finger.upper)).all(axis=-1)
        np.testing.assert_array_equal(solutions.within, inside)
        assert (solutions.exists & ~solutions.within).any()


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_a_full_pose_of_the_finger_is_found_with_no_angle_left(key: Key) -> None:
    finger = FINGERS[key]
    q = postures(finger, 5000, seed=2)
    pose = finger.fk(q)
    for given_ in ({"rotation": pose.rotation}, {"quaternion": pose.quaternion}, {"euler": pose.euler}):
        best = solve(finger, pose.position, given_).best(near=q)
        assert best.reached.all()
        assert best.angle.max() <= 1e-8  # 1e-16 in φ beside a straight elbow moves the elbow by its square root.
        np.testing.assert_allclose(best.posture, q, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("key", shortly(LONG), ids=str)
def test_the_rotation_found_is_the_nearest_that_the_finger_can_have_there(key: Key) -> None:
    """Against every pitch in steps of 1e-3 rad, limits left aside and limits kept."""
    finger = FINGERS[key]
    rng = np.random.default_rng(3)
    q = postures(finger, 60, seed=3)
    wanted = finger.fk(np.roll(postures(finger, 60, seed=4), 1)).rotation
    wanted[::2] = np.linalg.qr(rng.normal(size=(30, 3, 3)))[0]
    wanted *= np.sign(np.linalg.det(wanted))[:, None, None]
    pitch = np.arange(-np.pi, np.pi, 1e-3)
    for point, rotation in zip(finger.fk(q).position, wanted, strict=True):
        found = finger.ik(point, rotation=rotation)
        dense = finger.ik(np.broadcast_to(point, (pitch.size, 3)), pitch=pitch)
        relative = rotation.T @ finger.fk(dense.position).rotation
        with np.errstate(invalid="ignore"):
            angle = np.arccos(np.clip((np.einsum("...ii->...", relative) - 1) / 2, -1, 1))
        inside = np.where(dense.within, angle, np.inf).min()
        best = found.best()
        assert best.reached
        np.testing.assert_allclose(finger.fk(best.posture).position, point, rtol=0, atol=1e-12)
        assert best.angle <= inside + 1e-6
        assert best.angle >= inside - 2e-3  # Half a step, and a narrow range between two steps.
        anywhere = np.where(dense.exists, angle, np.inf).min()
        assert np.nanmin(found.angle) <= anywhere + 1e-6


def at_double_roots(n: int) -> Array:
    """Postures of the thumb at which two of the branches with one ψ meet: ∂(x, |(y, z)|)/∂(q₁, q₂) is singular."""

    def determinant(q: Array) -> Array:
        def shape(q: Array) -> Array:
            pose = finger.fk(q).position - geometry.origin
            x, y, z = geometry.base.T @ pose.T
            return np.stack([x, np.hypot(y, z)])

        step = 1e-6 * np.eye(4)
        a, b = (shape(q + d) - shape(q - d) for d in (step[1], step[2] - step[3]))
        return np.asarray(a[0] * b[1] - a[1] * b[0], dtype=np.float64)

    finger, geometry = FINGERS["right", "thumb"], load_geometry("allegro", "thumb")
    ends = postures(finger, 4 * n, seed=10)
    ends[:, 3] = np.clip(ends[:, 3], 0.3, 1.2)
    other = postures(finger, 4 * n, seed=11)
    other[:, 3] = ends[:, 3]
    meet = np.sign(determinant(ends)) != np.sign(determinant(other))
    a, b = ends[meet][:n], other[meet][:n]
    assert len(a) == n
    for _ in range(60):
        middle = (a + b) / 2
        same = np.sign(determinant(middle)) == np.sign(determinant(a))
        a, b = np.where(same[:, None], middle, a), np.where(same[:, None], b, middle)
    link, tip = geometry.links
    r = link * np.sin(a[:, 2]) + tip * np.sin(a[:, 2] + a[:, 3])
    return np.asarray(
        a[np.abs(r) > 1e-8], dtype=np.float64
    )  # Beside joint 1's axis q₁ is free: docs/explanation/kinematics.md#singularities.


def test_where_two_roots_of_the_quartic_meet_the_posture_is_still_found() -> None:
    finger = FINGERS["right", "thumb"]
    q = at_double_roots(300)
    points, psi = finger.fk(q).position, q[:, 2:].sum(axis=1)
    best = finger.ik(points, psi=psi).best(near=q)
    assert best.reached.all()
    np.testing.assert_allclose(best.posture, q, rtol=0, atol=1e-4)  # A double root: the square root of rounding.
    for (x, y, z), angle, posture in zip(points, psi, q, strict=True):
        found = np.array(finger.scalar.at_psi(x, y, z, angle)).reshape(-1, 4)
        assert np.abs(found - posture).max(axis=1).min(initial=np.inf) <= 1e-4


def test_no_branch_is_given_twice() -> None:
    finger = FINGERS["right", "thumb"]
    q = postures(finger, N, seed=12)
    found = finger.ik(finger.fk(q).position, psi=q[:, 2:].sum(axis=1)).position
    gaps = np.abs(found[:, :, None] - found[:, None]).max(axis=-1) + np.eye(4)
    assert np.nanmin(gaps) > 1e-10


@pytest.mark.parametrize("key", shortly(EVERY), ids=str)
def test_a_margin_keeps_every_joint_away_from_its_limits(key: Key) -> None:
    finger = FINGERS[key]
    q = postures(finger, 3000, seed=6)
    room = np.minimum(q - finger.lower, finger.upper - q).min(axis=1)
    for given_ in [*held(finger, q), {"near": q}, {}]:
        solutions = solve(finger, finger.fk(q).position, given_, margin=0.1)
        chosen = solutions.position[solutions.within]
        assert (chosen.min(axis=0) >= finger.lower + 0.1 - 1e-8).all()
        assert (chosen.max(axis=0) <= finger.upper - 0.1 + 1e-8).all()
        assert solutions.reachable[room > 0.1 + 1e-8].all()
        assert not solutions.reachable.all()


@pytest.mark.parametrize("name", ["index", "middle", "ring", "thumb"])
def test_the_left_finger_is_the_mirrored_right_one(name: str) -> None:
    right, left = FINGERS["right", name], FINGERS["left", name]
    q = postures(right, 500, seed=7)
    flip = np.array([1.0 if name == "thumb" else -1.0, 1, 1, 1])
    pose, mirror = right.fk(q), np.diag([1.0, -1.0, 1.0])
    np.testing.assert_array_equal(left.fk(q * flip).position, pose.position @ mirror)
    for on_right, on_left in zip(held(right, q), held(left, q * flip), strict=True):
        ours = solve(left, pose.position @ mirror, on_left)
        theirs = solve(right, pose.position, on_right)
        np.testing.assert_allclose(ours.position, theirs.position * flip, rtol=0, atol=1e-7)
        np.testing.assert_array_equal(ours.within, theirs.within)


@pytest.mark.parametrize("key", LONG, ids=str)
def test_a_tip_on_the_abduction_axis_is_reached(key: Key) -> None:
    """There every q₀ will do: a pose says which, a pitch leaves it at zero, and a position alone is reached too."""
    finger, (side, name) = FINGERS[key], key
    geometry, mirror = load_geometry("allegro", name), np.array([1.0, -1.0 if side == "left" else 1.0, 1.0])
    height = np.linspace(0.125, 0.1354, 9)  # Just below the length of the finger, where its limits let it come.
    on_axis = (geometry.origin + height[:, None] * geometry.base[:, 2]) * mirror
    reachable = finger.ik(on_axis)
    assert reachable.reachable.any()
    points, q = on_axis[reachable.reachable], reachable.position[reachable.reachable, 0]
    at_pitch = finger.ik(points, pitch=q[:, 1:].sum(axis=1))
    assert at_pitch.reachable.all()
    assert np.abs(at_pitch.position[at_pitch.within][:, 0]).max() == 0.0
    q[:, 0] = 0.4
    posed = finger.ik(points, rotation=finger.fk(q).rotation).best(near=q)
    np.testing.assert_allclose(posed.posture, q, rtol=0, atol=1e-8)
    assert posed.angle.max() <= 1e-12


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_a_straight_elbow_is_found_with_all_its_digits(key: Key) -> None:
    finger = FINGERS[key]
    q = postures(finger, 2000, seed=8)
    q[:, 3 if finger.name == "thumb" else 2] = 0.0
    pose = finger.fk(q)
    for given_ in held(finger, q):
        solutions = solve(finger, pose.position, given_)
        there = np.where(
            solutions.within[..., None], finger.fk(solutions.position).position - pose.position[:, None], 0.0
        )
        assert solutions.reachable.all(), given_.keys()
        assert np.abs(there).max() <= 1e-12
        error = np.abs(solutions.position - q[:, None]).max(axis=-1)
        # Rounding of 1e-16 in d² / 2 l₁ l₂ is (1e-8)² of the elbow.
        assert np.where(solutions.within, error, np.inf).min(axis=-1).max() <= 1e-6


def test_targets_keep_their_shape_and_scalars_spread() -> None:
    finger = FINGERS["right", "index"]
    q = postures(finger, 12, seed=9).reshape(3, 4, 4)
    points = finger.fk(q).position
    assert finger.fk(q).rotation.shape == (3, 4, 3, 3)
    solutions = finger.ik(points, pitch=1.0)
    assert (solutions.position.shape, solutions.within.shape) == ((3, 4, 4, 4), (3, 4, 4))
    assert solutions.best().posture.shape == (3, 4, 4)
    one = finger.ik(points[1, 2], pitch=1.0)
    np.testing.assert_array_equal(one.position, solutions.position[1, 2])
    assert finger.ik(np.zeros((0, 3)), pitch=1.0).position.shape == (0, 4, 4)


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("index", {"q0": 0.1}, "index has no q0: with a position it takes one of pitch"),
        ("thumb", {"pitch": 0.1}, "thumb has no pitch"),
        ("index", {"pitch": 0.1, "near": np.zeros(4)}, "give one of pitch and near"),
        ("thumb", {"q0": 0.1, "q1": 0.1}, "give one of q0 and q1"),
        ("index", {"pitch": np.zeros(3)}, "pitch \\(3,\\) does not go with positions \\(2, 3\\)"),
        ("index", {"pitch": np.nan}, "pitch must be finite"),
        ("index", {"pitch": "steep"}, "pitch must be numbers"),
        ("index", {"rotation": np.ones((3, 3))}, "no rotation matrix"),
        ("index", {"rotation": np.diag([1.0, 1.0, -1.0])}, "no rotation matrix"),
        (
            "index",
            {"quaternion": [0.0, 1e300, 0.0, 0.0]},
            "a quaternion is w x y z of length 1; this one is longer",
        ),
        ("index", {"near": np.zeros(16)}, "near needs shape \\(..., 4\\)"),
        ("index", {"margin": -0.1}, "margin -0.1 rad does not fit"),
        ("index", {"margin": 0.5}, "half the least range is 0.470 rad"),
        ("thumb", {"q1": np.pi / 2}, "give q0 or psi"),
    ],
)
def test_arguments_that_do_not_fit_are_refused_in_one_line(
    name: str, arguments: dict[str, float], message: str
) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        FINGERS["right", name].ik(np.zeros((2, 3)), **arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["index", "thumb"])
@pytest.mark.parametrize("far", [1.1e9, -1e160, 1e300])
def test_a_position_that_doubles_cannot_tell_a_posture_for_is_refused_in_m(name: str, far: float) -> None:
    finger, point = FINGERS["right", name], np.array([0.0, far, 0.0])
    for points in (point, np.stack([np.zeros(3), point])):
        with pytest.raises(ConfigError, match=rf"^{name}: position is in m, at most 1e\+09; it is 1(.1)?e\+\d+$"):
            finger.ik(points)
    best = finger.ik([0.0, 0.9e9, 0.0]).best()
    assert np.isfinite(best.posture).all()
    assert best.distance == pytest.approx(0.9e9)


def test_an_integer_that_is_no_double_is_refused_as_a_position() -> None:
    with pytest.raises(ConfigError, match="position must be numbers"):
        FINGERS["right", "index"].ik([10**400, 0, 0])


def test_positions_of_the_wrong_shape_are_refused() -> None:
    with pytest.raises(ConfigError, match="position needs shape"):
        FINGERS["right", "index"].ik(np.zeros(2), pitch=0.0)
    with pytest.raises(ConfigError, match="4 joints"):
        FINGERS["right", "index"].fk(np.zeros(16))


def test_an_unknown_finger_is_answered_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="did you mean 'index'"):
        ClosedFormFinger(SPECS["right"], "indx")


def test_lengths_come_from_the_table_of_facts() -> None:
    index, thumb = load_geometry("allegro", "index"), load_geometry("allegro", "thumb")
    assert index.links == (0.054, 0.0384, 0.0267)
    assert (thumb.rise, thumb.links) == (0.0177, (0.0514, 0.0423))
