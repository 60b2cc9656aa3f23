"""What is wrong with a hand is called by its name: from windows that are made up, and from a hand that goes wrong."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np
import pytest

from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.hands.description.calibration import HandCalibration
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.loop import run, until
from allegro_twin.sim.drivetrain.lugre_friction import steady_deflection
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.observer.observer import CREEP, Estimate, StateObserver
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Ailment, Drive
from allegro_twin.twin.identify.results.gap import drive_parameters
from allegro_twin.twin.mirror.factory import make_mirror
from allegro_twin.twin.mirror.fault_detection import (
    CLEAR,
    EVERY,
    RARE,
    ROWS,
    WAIT,
    FaultDetector,
    FreeShapes,
    LinkWeights,
    Thresholds,
)
from allegro_twin.twin.mirror.fault_list import FaultList
from allegro_twin.twin.mirror.fault_signatures import (
    NOISE,
    fit_signature,
    free_noise,
    largest_gains,
    signature_fault,
    signature_gains,
    still_shows,
)
from allegro_twin.twin.mirror.faults import (
    NAMES,
    ROW,
    Fault,
    FaultName,
    FaultReport,
    MirrorWindow,
    direct_faults,
    fault_text,
    report_text,
)
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Array, HandState, Sample
from tests.conftest import MakeSim

N, K = 16, 50
QUIET = np.full(4, 1e-4)
PULL = np.random.default_rng(3).uniform(-1.0, 1.0, (K, N, N)) * np.tril(np.ones((N, N))).T  # Any will do.

MIDDLE = np.arange(N) // 4 == 1
OF_MIDDLE = np.random.default_rng(7).uniform(-1.0, 1.0, (4, N)) * MIDDLE


def window(**changed: Any) -> MirrorWindow:
    """A free motion of every joint, each at a pace of its own, with torques of its own."""
    t = np.arange(K)[:, None] * ROW * 0.003
    rng = np.random.default_rng(1)
    pace, phase = rng.uniform(2.0, 6.0, N), rng.uniform(0.0, 6.0, (2, N))
    values: dict[str, Any] = {
        "disturbance": 0.0005 * rng.standard_normal((K, N)),
        "torque": 0.1 * np.sin(2.3 * pace * t + phase[1]),
        "velocity": 0.5 * np.cos(pace * t + phase[0]),
        "side": np.tanh(0.5 * np.cos(pace * t + phase[0]) / CREEP),
        "position": 0.5 / pace * np.sin(pace * t + phase[0]),
        "jump": np.full((K, N), 1e-4),
        "pull": PULL,
        "temperature": np.full((K, N), np.nan),
        "holds": np.zeros((K, 4), dtype=bool),
    }
    return MirrorWindow(**values | changed)


def late(row: Array) -> Array:
    return np.asarray((2.0 * row + np.concatenate([row[:1], row[:-1]])) / 3.0)


@pytest.fixture(name="sticky")
def _sticky(spec: HandSpec) -> HandSpec:
    """A hand whose friction breaks away."""
    return replace(spec, drive=Drive.from_values({"stiction": 1.5, "stribeck_speed": 0.1, "bristle": 1e-3}, N))


def test_a_free_motion_has_no_name(spec: HandSpec) -> None:
    assert not direct_faults(window(), spec)
    assert signature_fault(window(), QUIET, spec) is None


@pytest.mark.parametrize("joint", [1, 6, 15])
def test_each_fault_is_called_by_its_name_with_its_joint_and_its_size(spec: HandSpec, joint: int) -> None:
    free = window()
    d = free.disturbance
    for name, amount, push in (
        ("weak", 0.4, -0.4 * np.eye(N)[joint] * late(free.torque)),
        ("friction", 0.03, -0.03 * np.eye(N)[joint] * late(free.side)),
        ("payload", 0.02, 0.02 * free.pull[:, joint] * (np.arange(N) // 4 == joint // 4)),
    ):
        found = signature_fault(free._replace(disturbance=d + push), QUIET, spec)
        assert found is not None, name
        assert (found.name, found.joint) == (name, joint)
        assert found.amount == pytest.approx(amount, rel=0.1)
        assert found.lead > CLEAR


@pytest.mark.parametrize("joint", [1, 6, 15])
def test_friction_that_no_motor_overcomes_has_no_name(spec: HandSpec, joint: int) -> None:
    """An encoder that counts the wrong way looks like that."""
    free, limit, only = window(), spec.actuation.torque_limit[joint], np.eye(N)[joint]
    for times, name in ((0.9, "friction"), (1.1, None), (300.0, None)):
        push = -times * limit * only * late(free.side)
        found = signature_fault(free._replace(disturbance=free.disturbance + push), QUIET, spec)
        assert (None if found is None else found.name) == name


def test_named_friction_that_grows_beyond_its_motor_is_withdrawn(spec: HandSpec) -> None:
    each, limit = FaultList(spec, compensates=True), spec.actuation.torque_limit[6]
    each.add(Fault("friction", 6, 0.6 * limit), 1.0, 2.0)
    each.resize(each.active[0], 0.3 * limit, 3.0)
    assert [one.name for one in each.active] == ["friction"]
    each.resize(each.active[0], 0.3 * limit, 4.0)
    assert not each.active
    assert each.reports[0].ended == 4.0


def test_a_jump_a_joint_that_stays_and_a_hot_motor_are_seen_directly(spec: HandSpec) -> None:
    free = window()
    jump, position, warm, push = free.jump.copy(), free.position.copy(), np.full((K, N), 40.0), free.disturbance.copy()
    jump[20, 9], jump[30, 2] = -0.05, 0.02
    jumps = [Fault("encoder_step", 2, 0.02), Fault("encoder_step", 9, -0.05)]
    assert direct_faults(free._replace(jump=jump), spec) == jumps
    position[:, 4], push[:, 4] = 0.3, -free.torque[:, 4]
    (found,) = direct_faults(free._replace(position=position, disturbance=push), spec)
    assert (found.name, found.joint) == ("stuck", 4)
    warm[-1, 12] = 71.0
    assert direct_faults(free._replace(temperature=warm), spec) == [Fault("hot", 12, 71.0)]


def test_many_weak_joints_on_many_fingers_are_the_wrong_file(spec: HandSpec) -> None:
    free = window()
    found = signature_fault(free._replace(disturbance=free.disturbance - 0.3 * late(free.torque)), QUIET, spec)
    assert found is not None
    assert found.name == "wrong_file"


@pytest.mark.parametrize(("finger", "names"), [(None, ["wrong_file"]), (3, [])])
def test_a_hand_with_a_finger_that_presses_on_something_has_no_wrong_file(
    finger: int | None, names: list[str], spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = window()
    holds = np.zeros((K, 4), dtype=bool)
    if finger is not None:
        holds[: K // 2, finger] = True
    seen = free._replace(disturbance=free.disturbance - 0.3 * late(free.torque), holds=holds)
    each = FaultDetector(spec, Thresholds(np.full((2, N), 0.02), QUIET), 0.003)
    monkeypatch.setattr(each, "_last", lambda count: seen)
    each._count, each._sign[:] = 100, 0
    assert each._wrong_file()
    assert [report.fault.name for report in each.faults.reports] == names


@pytest.mark.parametrize("check", ["wrong_file", "supply"])
@pytest.mark.parametrize(("fingers", "named"), [(0, True), (1, True), (2, False), (4, False)])
def test_a_hand_that_closes_on_something_has_no_wrong_file_though_a_joint_of_each_finger_moves_on(
    check: str, fingers: int, named: bool, spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And no low supply."""
    free, blocked = window(), np.isin(np.arange(N), [4 * finger + 1 for finger in range(fingers)])
    share = 0.3 * late(free.torque) if check == "wrong_file" else 0.3 * free.torque
    closing = free._replace(
        torque=np.where(blocked, 0.14, free.torque),
        velocity=np.where(blocked, 0.0, free.velocity),
        disturbance=np.where(blocked, -0.12, free.disturbance - share),
    )
    each = FaultDetector(spec, Thresholds(np.full((2, N), 0.02), QUIET), 0.003)
    monkeypatch.setattr(each, "_last", lambda count: closing)
    each._count, each._sign[:] = 100, 0
    each._wrong_file() if check == "wrong_file" else each._supply()
    assert [report.fault.name for report in each.faults.reports] == ([check] if named else [])


@pytest.mark.parametrize(
    ("odd", "frozen", "names"), [(1, False, ["payload"]), (3, False, []), (1, True, [])],
    ids=["one finger", "three fingers at once", "an encoder of the finger is frozen"],
)  # fmt: skip
def test_a_payload_is_of_one_finger_whose_posture_is_known(
    odd: int, frozen: bool, names: list[str], spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = window()
    seen = free._replace(disturbance=free.disturbance + 0.05 * free.pull[:, 6] * MIDDLE)
    each = FaultDetector(spec, Thresholds(np.full((2, N), 0.02), QUIET), 0.003)
    monkeypatch.setattr(each, "_last", lambda count: seen)
    each._count, each._sign[:] = 100, -1
    each._sign[1 : 1 + odd] = 0
    if frozen:
        each.faults.add(Fault("stuck", 5, 0.1), 0.0, 0.0)
        for _ in range(ROWS * ROW + 1):
            each._repeats.add(*np.ones((3, N), dtype=bool))
    each._name_signature(1)
    assert [report.fault.name for report in each.faults.reports if report.fault.name != "stuck"] == names


def test_what_is_too_heavy_for_the_motors_is_no_payload(spec: HandSpec) -> None:
    free = window()
    for amount, name in ((0.05, "payload"), (5.0, None)):
        push = amount * free.pull[:, 6] * MIDDLE
        found = signature_fault(free._replace(disturbance=free.disturbance + push), QUIET, spec)
        assert (None if found is None else found.name) == name


def test_a_force_that_lessens_or_is_over_is_no_fault(spec: HandSpec) -> None:
    free = window(pull=np.repeat(np.sign(PULL[:1]), K, axis=0))
    weight, late_on = free.pull[:, 6] * MIDDLE, (np.arange(K) > 40)[:, None]
    even, lessens = 0.3 * weight, np.linspace(0.5, 0.15, K)[:, None] * weight
    for push, convinces in ((even, True), (lessens, False)):
        pushed = free._replace(disturbance=free.disturbance + push)
        assert fit_signature(pushed, "payload", 6, spec).convinces(1e-4) is convinces
    for push, shows in ((even, True), (np.where(late_on, 0.0, even), False)):
        assert still_shows(free._replace(disturbance=push), "payload", 6, 0.3, spec) is shows
    push = np.where(late_on, 0.0, -0.8 * np.eye(N)[6])
    assert still_shows(free._replace(disturbance=push, torque=np.full((K, N), 0.3)), "weak", 6, 0.8, spec) is False
    assert still_shows(free, "payload", 6, 0.02, spec)  # Friction may hide so little.


def test_a_name_that_makes_a_touch_is_withdrawn_with_it(spec: HandSpec) -> None:
    touch, none = np.array([False, False, False, True]), np.zeros(4, dtype=bool)
    cases = (
        (none, touch, touch, True),
        (touch, touch, touch, False),
        (none, touch, none, False),
        (none,) * 3 + (False,),
    )
    for before, soon, later, withdrawn in cases:
        each = FaultDetector(spec, Thresholds.default(spec), 0.003, compensates=True)
        each._name(Fault("payload", 14, 0.7), 0.4, 1.0)
        for tick in range(300):
            each.judge_touches(before if tick < 1 else soon if tick < 100 else later, 1.0 + 0.003 * tick)
        assert [report.ended < np.inf for report in each.faults.reports] == [withdrawn]


def test_a_joint_that_its_file_does_not_fit_hides_no_fault_of_its_neighbours(spec: HandSpec) -> None:
    """Free motion leaves 40 mN·m of joint 5, which come again with its angle."""

    def misfit(k: int, push: Array | float = 0.0) -> MirrorWindow:
        free = window()
        wave = 0.04 * np.sin(12.0 * free.position + 0.7 * k) * (np.arange(N) == 5)
        return free._replace(disturbance=free.disturbance + wave + push)

    free = [misfit(k) for k in range(9)]
    noise = free_noise(free, spec)
    assert noise[5] == pytest.approx(0.028, rel=0.3)
    assert (np.delete(noise, 5) < 7e-4).all()
    named: dict[str, list[bool]] = {}
    for weight in (np.ones(N), NOISE / noise):
        quiet = np.max([largest_gains(each._replace(weight=weight), spec) for each in free], axis=0)
        for name, joint, push in (
            ("friction", 6, -0.03 * np.eye(N)[6] * late(window().side)),
            ("weak", 7, -0.3 * np.eye(N)[7] * late(window().torque)),
            ("payload", 6, 0.03 * window().pull[:, 6] * MIDDLE),
        ):
            seen = misfit(3, push)._replace(weight=weight)
            found = signature_fault(seen, 2.0 * quiet, spec)
            right = found is not None and (found.name, found.joint) == (name, joint)
            convinces = fit_signature(seen, name, joint, spec).convinces(2.0 * quiet[1])  # type: ignore[arg-type]
            named.setdefault(name, []).append(right and convinces)
        assert all(signature_fault(each._replace(weight=weight), 2.0 * quiet, spec) is None for each in free)
    assert set(map(tuple, named.values())) == {(False, True)}


def test_a_joint_at_rest_says_nothing(spec: HandSpec) -> None:
    free = window()
    still = free.velocity.copy()
    still[:, :4] = 0.0
    pushed = free.disturbance.copy()
    pushed[:, :4] = 0.05
    assert not signature_gains(free._replace(velocity=still, disturbance=pushed), spec)["index"]


def test_fingers_that_hold_something_have_no_shape_and_no_stuck_joint(spec: HandSpec) -> None:
    free, both = window(), np.tile([True, False, False, True], (K, 1))
    weak = np.where(np.arange(N) == 2, -0.5 * late(free.torque), free.disturbance)
    assert signature_fault(free._replace(disturbance=weak), QUIET, spec) is not None
    assert signature_fault(free._replace(disturbance=weak, holds=both), QUIET, spec) is None
    still = np.where(np.arange(N) == 2, 0.0, free.position)
    press = free.torque + 0.2 * (np.arange(N) == 2)  # One way only.
    pushed = np.where(np.arange(N) == 2, -press, free.disturbance)
    stuck = free._replace(torque=press, disturbance=pushed, position=still)
    assert [found.name for found in direct_faults(stuck, spec)] == ["stuck"]
    assert not direct_faults(stuck._replace(holds=both), spec)


def test_a_joint_is_not_stuck_where_others_of_its_finger_are_pushed_as_well(spec: HandSpec) -> None:
    free = window()
    three = np.isin(np.arange(N), (1, 2, 3))
    press = free.torque + 0.2 * three
    pressed = free._replace(
        torque=press,
        disturbance=np.where(three, -press, free.disturbance),
        position=np.where(three, 0.0, free.position),
    )
    assert not direct_faults(pressed, spec)


def test_a_joint_that_creeps_though_its_motor_works_hard_does_not_follow_it(spec: HandSpec) -> None:
    """As one whose motor is dead does in soft friction."""
    free, one = window(), np.arange(N) == 2
    torque = np.where(one, 2.0 * free.torque + 0.15, free.torque)
    creeps = free._replace(
        torque=torque,
        disturbance=np.where(one, -torque, free.disturbance),
        position=np.where(one, np.linspace(0.0, 0.015, K)[:, None], free.position),
    )
    assert [(found.name, found.joint) for found in direct_faults(creeps, spec)] == [("stuck", 2)]
    goes = np.where(one, np.linspace(0.0, 0.03, K)[:, None], free.position)
    assert not direct_faults(creeps._replace(position=goes), spec)


def test_what_a_finger_holds_only_pushes_and_what_resists_both_ways_is_the_joint(spec: HandSpec) -> None:
    free, whole, held = window(), np.arange(N) < 4, np.ones((K, 4), dtype=bool)
    torque = np.where(whole, 4.0 * free.torque, free.torque)
    still = free._replace(
        torque=torque,
        holds=held,
        disturbance=np.where(whole, -torque, free.disturbance),
        position=np.where(whole, 0.0, free.position),
    )
    assert {found.joint for found in direct_faults(still, spec)} == {0, 1, 2, 3}
    one_way = np.where(whole, torque + 0.4, torque)
    assert not direct_faults(still._replace(torque=one_way, disturbance=np.where(whole, -one_way, 0.0)), spec)


def test_a_joint_whose_torque_follows_its_own_displacement_is_pushed_and_not_stuck(spec: HandSpec) -> None:
    """As of a finger that another one blocks lightly, in a grasp that is shaken."""
    free, one, shake = window(), np.arange(N) == 2, 0.0012 * np.sin(np.arange(K) / 3.0)[:, None]
    torque = np.where(one, 0.08 + 15.0 * shake, free.torque)
    fixed = free._replace(
        torque=torque, disturbance=np.where(one, -torque, free.disturbance), position=np.where(one, 0.0, free.position)
    )
    assert [(found.name, found.joint) for found in direct_faults(fixed, spec)] == [("stuck", 2)]
    noisy = np.where(one, np.random.default_rng(1).normal(scale=6e-5, size=(K, 1)), free.position)
    assert direct_faults(fixed._replace(position=noisy), spec)
    assert not direct_faults(fixed._replace(position=np.where(one, -shake, free.position)), spec)


def frozen(spec: HandSpec, noise: float, count: float, *, holds: bool = True) -> list[tuple[str, int]]:
    """Names of a hand whose encoders freeze after 3 s, while its motors work on."""
    each, rng = FaultDetector(spec, Thresholds(np.full((2, N), 0.02), QUIET), 0.003), np.random.default_rng(2)
    weights, position = LinkWeights(np.zeros((N, N)), None, np.ones(N, dtype=bool), np.zeros(3)), np.zeros(N)
    for tick in range(1800):
        t = 0.003 * tick
        if t < 3.0 or not holds:
            position = count * np.round((0.3 + noise * rng.standard_normal(N)) / count)
        torque = np.full(N, 0.1 + 0.05 * t)
        state = HandState(t, tick, position, np.zeros(N), torque, np.full(N, np.nan), np.zeros(3))
        estimate = Estimate(position, position, -torque, np.zeros(N), np.zeros(N))
        each.add(state, estimate, torque, np.zeros(N), weights if each.row_due else None)
    return [(report.fault.name, report.fault.joint) for report in each.faults.reports]


def test_noisy_encoders_that_repeat_to_the_bit_are_named_all_of_them_and_quiet_ones_are_not(spec: HandSpec) -> None:
    assert sorted(frozen(spec, 5e-5, 9e-5)) == [("stuck", joint) for joint in range(N)]
    assert not frozen(spec, 5e-5, 9e-5, holds=False)
    assert not frozen(spec, 5e-5, 1.5e-3)


def test_a_steady_push_is_no_friction_no_weak_motor_and_no_weight(spec: HandSpec) -> None:
    """In strokes of one direction a push is friction, under a steady torque a weak motor, in one posture a weight."""
    free, one = window(), np.arange(N) == 6
    ways = {
        "friction": {"velocity": np.where(one, 0.3, free.velocity), "side": np.where(one, 1.0, free.side)},
        "weak": {"torque": np.where(one, 0.15, free.torque)},
        "payload": {"pull": np.where(one, 0.5 * (1.0 + 0.03 * np.sin(np.arange(K) / 9.0))[:, None, None], 0.0)
                    * one[:, None]},
    }  # fmt: skip
    for changed in ways.values():
        steady = np.where(one, -0.15, free.disturbance) * (1.0 if "pull" not in changed else -1.0)
        assert signature_fault(free._replace(disturbance=steady, **changed), QUIET, spec) is None


def test_a_joint_whose_encoder_repeats_makes_no_names_for_its_neighbours(spec: HandSpec) -> None:
    each = FaultList(spec, compensates=True)
    for name, joint in (("payload", 5), ("weak", 9)):
        each.add(Fault(cast(FaultName, name), joint, 0.5), 1.0, 2.5)
    each.end_since(2.0, 6, 3.0)
    assert [fault.joint for fault in each.active] == [9]


def test_friction_that_no_file_knows_does_not_turn_a_payload_into_that_of_another_link(spec: HandSpec) -> None:
    free = window()
    pull = free.pull.copy()
    pull[:, 6], pull[:, 7] = 0.3 * OF_MIDDLE[2], 0.3 * OF_MIDDLE[3]
    rubs = 0.002 * free.side * np.array([0, 0, 0, 1] * 4)
    d = free.disturbance + 0.02 * pull[:, 6] + rubs
    found = signature_fault(free._replace(disturbance=d, pull=pull), QUIET / 100, spec)
    assert found is not None
    assert (found.name, found.joint) == ("payload", 6)


def test_of_two_links_that_weigh_alike_the_lighter_payload_is_likelier(spec: HandSpec) -> None:
    free, pull = window(), PULL.copy()
    pull[:, 4] = 0.05 * pull[:, 5]
    found = signature_fault(
        free._replace(disturbance=free.disturbance + 0.02 * pull[:, 5] * MIDDLE, pull=pull), QUIET, spec
    )
    assert found is not None
    assert (found.name, found.joint) == ("payload", 5)


def test_noise_of_the_other_joints_does_not_hide_a_small_payload(spec: HandSpec) -> None:
    free = window()
    d = 4e-4 * np.random.default_rng(5).standard_normal((K, N))
    only = 0.2 * free.pull * (np.arange(N) == 5)
    d += 0.006 * only[:, 5]
    found = signature_fault(free._replace(disturbance=d, pull=only), QUIET / 10, spec)
    assert found is not None
    assert (found.name, found.joint) == ("payload", 5)


def test_a_disturbance_that_is_on_its_way_as_a_joint_turns_says_nothing(spec: HandSpec) -> None:
    free = window()
    rubbed = free.disturbance - 0.03 * late(free.side) * (np.arange(N) == 5)
    turned = 1 + np.flatnonzero(np.diff(np.sign(free.velocity[:, 5])))
    assert len(turned)
    rubbed[turned, 5] = 0.3
    found = signature_fault(free._replace(disturbance=rubbed), QUIET, spec)
    assert found is not None
    assert (found.name, found.joint) == ("friction", 5)
    assert found.amount == pytest.approx(0.03, rel=0.05)


def test_more_friction_that_breaks_away_is_no_weak_motor(spec: HandSpec) -> None:
    free, own = window(), np.arange(N) == 5
    side = free.side * (1.0 + 0.6 * np.exp(-np.square(free.velocity / 0.15)))
    turned = 1 + np.flatnonzero(np.diff(np.sign(free.velocity[:, 5])))
    bending = np.unique(np.concatenate([turned, turned + 1, turned + 2]))
    rubbed = free.disturbance - 0.03 * late(side) * own
    rubbed[bending[bending < K], 5] *= 0.3  # Bristles are not bent yet.
    found = signature_fault(
        free._replace(disturbance=rubbed, side=side, torque=free.torque - rubbed * own), QUIET, spec
    )
    assert found is not None
    assert (found.name, found.joint) == ("friction", 5)
    assert found.amount == pytest.approx(0.03, rel=0.05)


def test_a_mirror_knows_how_much_its_friction_is_more_than_in_fast_motion_and_what_its_bristles_hold(
    sticky: HandSpec,
) -> None:
    parameters, speed = drive_parameters(sticky, np.ones(N), np.zeros(N)), np.array([0.1, 0.2, -5.0] + [0.0] * (N - 3))
    each, dry = (StateObserver(sticky, parameters, 0.003, bristly=bristly) for bristly in (True, False))
    for observer in (each, dry):
        observer.reset(np.zeros(N))
    bent = steady_deflection(parameters.stiction, parameters.stribeck_speed, parameters.bristle, speed)
    each._data.act[each._player.bristles] = bent
    np.testing.assert_allclose(
        each._side(speed)[:4], [1.0 + 0.5 / np.e, 1.0 + 0.5 * np.exp(-4.0), -1.0, 0.0], rtol=1e-3
    )
    np.testing.assert_array_equal(each._side(-speed), each._side(speed), "bristles of a joint that turns back are bent")
    np.testing.assert_allclose(dry._side(speed)[:4], np.tanh(speed / CREEP)[:4])


def test_a_joint_that_friction_holds_in_hand_and_mirror_alike_is_not_stuck(spec: HandSpec) -> None:
    free = window()
    position, push, torque = free.position.copy(), free.disturbance.copy(), free.torque.copy()
    position[:, 4], torque[:, 4] = 0.3, 0.05 + 0.02 * np.sin(np.arange(K) / 5.0)
    push[:, 4] = -0.04
    assert not direct_faults(free._replace(position=position, disturbance=push, torque=torque), spec)
    push[:, 4] = -torque[:, 4]
    assert direct_faults(free._replace(position=position, disturbance=push, torque=torque), spec)


def test_every_name_has_words(spec: HandSpec) -> None:
    said = {fault_text(Fault(name, 5, 0.02), spec) for name in NAMES}
    assert len(said) == len(NAMES)
    assert "middle_1 carries 20 g too much" in said


def states(spec: HandSpec) -> Iterator[HandState]:
    t = 0
    while True:
        t += 1
        position = 0.3 * np.sin(3.0 * 0.003 * t + np.arange(N))
        yield HandState(0.003 * t, t, position, np.zeros(N), np.zeros(N), np.full(N, np.nan), np.zeros(3))


@pytest.mark.parametrize(("stays", "name"), [(False, "weak"), (True, "stuck")])
def test_the_name_waits_until_all_that_it_rests_on_is_of_the_fault(spec: HandSpec, stays: bool, name: str) -> None:
    each, sign = FaultDetector(spec, Thresholds(np.full((2, N), 0.02), QUIET), 0.003), 3 * ROWS * ROW
    weights = LinkWeights(np.zeros((N, N)), None, np.ones(N, dtype=bool), np.zeros(3))
    named_at = None
    for tick, state in enumerate(states(spec)):
        wrong = tick > sign
        torque = 0.1 * np.sin(0.02 * tick + np.arange(N))
        push = np.where(np.arange(N) == 7, -0.5 * torque, 0.0) if wrong else np.zeros(N)
        speed = 0.9 * np.cos(3.0 * state.t + np.arange(N))
        position = np.where((np.arange(N) == 7) & wrong & stays, 0.1, state.position)
        state = replace(state, position=position)
        estimate = Estimate(state.position, state.position, push, speed, np.tanh(speed / CREEP))
        each.add(state, estimate, torque, np.zeros(N), weights if each.row_due else None)
        if each.faults.active:
            named_at = (tick - sign) / ROW
            break
        assert tick < 10000
    assert [(one.name, one.joint) for one in each.faults.active] == [(name, 7)]
    assert named_at is not None
    assert WAIT <= named_at <= (ROWS if stays else WAIT) + 3 * EVERY
    assert not stays or each.faults.reports[0].begin == pytest.approx(0.003 * sign, abs=1.5 * 0.003 * ROW)


@pytest.mark.parametrize(
    ("period", "jumps", "name"), [(0.003, True, "encoder_step"), (0.003, False, None), (0.02, True, None)]
)
def test_a_joint_that_is_stopped_or_may_go_so_far_in_its_period_is_no_encoder_that_jumps(
    spec: HandSpec, period: float, jumps: bool, name: str | None
) -> None:
    each, rest = FaultDetector(spec, Thresholds.default(spec), period), np.zeros(N)
    weights, only = (
        LinkWeights(np.zeros((N, N)), None, np.ones(N, dtype=bool), np.zeros(3)),
        np.arange(N) == 6,
    )
    for tick in range(ROWS * ROW + 2 * EVERY * ROW):
        after = tick - 100
        # By 20 mrad at once, or at 20 mrad a period until it meets something.
        way = 0.02 * (after > 0) if jumps else -0.02 * max(-after, 0)
        state = HandState(period * tick, tick, way * only, rest, rest, np.full(N, np.nan), np.zeros(3))
        estimate = Estimate(state.position, state.position, rest, rest, rest)
        each.add(state, estimate, rest, 0.02 * only * (after == 1), weights if each.row_due else None)
    assert [one.name for one in each.faults.active] == ([] if name is None else [name])
    for report in each.faults.reports:
        assert report.begin == pytest.approx(0.3, abs=0.03)


def test_thresholds_need_enough_looks(spec: HandSpec) -> None:
    rng = np.random.default_rng(0)
    free = 0.002 * rng.standard_normal((4000, N))
    shapes = (FreeShapes(np.full(N, NOISE), 1e-6 * rng.exponential(size=(count, 4))) for count in (79, 400))
    still = np.zeros(free.shape, bool)
    few, many = (Thresholds.from_free_motion(free, still, np.zeros(N), each, 0.003, spec) for each in shapes)
    assert np.isinf(few.gains).all()
    exact = 1e-6 * np.log(RARE)  # Of an exponential tail.
    np.testing.assert_allclose(many.gains, exact, rtol=0.4)


def suffering(
    spec: HandSpec, hand: SimBackend, what: Ailment, joint: int, amount: float, at: float = 2.0
) -> Iterator[Sample]:
    """To and fro with something that goes wrong; the torques are those that were sent."""
    sent, done, middle = np.zeros(N), False, (spec.lower + spec.upper) / 2.0
    ways = Moves([Waypoint(middle + d, seconds=1.0) for d in (0.2, -0.2, 0.15, -0.1, 0.2, -0.2)])
    for sample in until(6.0, run(hand, PD(ways, load_gains("v4", spec)))):
        yield Sample(replace(sample.state, torque=sent), sample.command)
        sent = sample.command.torque  # type: ignore[union-attr]
        if not done and sample.state.t >= at:
            hand.suffer(what, joint, amount)
            done = True


@pytest.mark.slow
@pytest.mark.parametrize(("what", "joint", "amount"), [("weak", 6, 0.4), ("encoder_step", 9, 0.05)])
def test_what_goes_wrong_with_a_hand_can_stop_it(
    spec: HandSpec, make_sim: MakeSim, what: Ailment, joint: int, amount: float
) -> None:
    hand = make_sim(spec, posture=(spec.lower + spec.upper) / 2.0)
    calm = Thresholds(np.full((2, N), 0.02), np.full(4, 3e-4))
    observer = StateObserver(spec, drive_parameters(spec, np.ones(N), np.zeros(N)), 0.003)
    each = Mirror(spec, observer, np.ones(N), calm, (what,))
    with pytest.raises(
        HandFault, match=r"(the motor of middle_2 gives \d+ %|the encoder of ring_1 jumped by [+-]\d+ mrad)"
    ):
        for _ in each.watch(suffering(spec, hand, what, joint, amount)):
            pass
    np.testing.assert_array_equal(each.columns()["event"][4:], 2 ** NAMES.index(what) * (np.arange(N) == joint))


class Course(NamedTuple):
    """What disturbs one joint of a made-up motion, from one time to another, s."""

    name: str
    joint: int
    amount: float
    begin: float
    end: float = np.inf


def detected(spec: HandSpec, seconds: float, *courses: Course) -> list[FaultReport]:
    """Faults that are named in a motion of every joint, beside a model that takes the sizes of those that were."""
    each = FaultDetector(spec, Thresholds(np.full((2, N), 0.02), QUIET), 0.003, compensates=True)
    weights = LinkWeights(np.zeros((N, N)), None, np.ones(N, dtype=bool), np.zeros(3))
    pace, rng = np.linspace(3.0, 6.0, N), np.random.default_rng(4)
    for tick in range(round(seconds / 0.003)):
        t = 0.003 * tick
        torque, speed = 0.1 * np.sin(2.3 * pace * t + np.arange(N)), 0.9 * np.cos(pace * t + np.arange(N))
        push, change, strength = 0.0005 * rng.standard_normal(N), each.faults.model_change(), np.ones(N)
        for name, joint, amount, begin, end in courses:
            size = amount * (begin <= t < end)
            if name == "weak":
                strength[joint] *= 1.0 - size
            elif name == "supply":
                strength *= 1.0 - size
            else:
                push[joint] -= (size - change.friction[joint]) * np.tanh(speed[joint] / CREEP)
        push += (strength - change.strength) * torque
        position = 0.9 / pace * np.sin(pace * t + np.arange(N))
        state = HandState(t, tick, position, speed, torque, np.full(N, np.nan), np.zeros(3))
        each.add(
            state,
            Estimate(position, position, push, speed, np.tanh(speed / CREEP)),
            torque * change.strength,
            np.zeros(N),
            weights if each.row_due else None,
        )
    return each.faults.reports


@pytest.mark.parametrize("later", [0.0, 3.0])
def test_two_faults_are_both_named_once_whether_at_once_or_one_after_the_other(spec: HandSpec, later: float) -> None:
    weak, friction = Course("weak", 7, 0.4, 2.0), Course("friction", 13, 0.03, 2.0 + later)
    found = detected(spec, 9.0, weak, friction)
    assert {(one.fault.name, one.fault.joint) for one in found} == {("weak", 7), ("friction", 13)}
    assert len(found) == 2
    for one, true in zip(sorted(found, key=lambda each: each.fault.joint), (weak, friction), strict=True):
        assert one.fault.amount == pytest.approx(true.amount, rel=0.1)
        assert true.begin < one.begin <= one.named < true.begin + 3.0
        assert one.ended == np.inf


def test_a_second_fault_of_a_finger_is_named_beside_its_first(spec: HandSpec) -> None:
    found = detected(spec, 9.0, Course("weak", 5, 0.4, 2.0), Course("friction", 6, 0.03, 5.0))
    assert [(one.fault.name, one.fault.joint) for one in found] == [("weak", 5), ("friction", 6)]


@pytest.mark.parametrize("amount", [0.15, 0.4])
def test_a_share_that_all_motors_lack_is_the_supply_and_hides_no_fault_of_a_joint(
    spec: HandSpec, amount: float
) -> None:
    found = detected(spec, 9.0, Course("supply", 0, amount, 2.0), Course("weak", 5, 0.4, 5.0))
    assert [one.fault.name for one in found] == ["supply", "weak"]
    assert found[0].fault.amount == pytest.approx(amount, rel=0.05)
    assert found[1].fault.joint == 5
    assert found[1].fault.amount == pytest.approx(0.4, rel=0.1)
    assert 2.0 < found[0].begin <= found[0].named < 4.5
    assert all(one.ended == np.inf for one in found)


def test_a_supply_that_is_whole_again_is_said_to_be(spec: HandSpec) -> None:
    (found,) = detected(spec, 9.0, Course("supply", 0, 0.3, 2.0, 5.0))
    assert (found.fault.name, found.named < 4.5 < found.ended < 8.0) == ("supply", True)
    assert report_text(found, spec).startswith("all motors give 70 % of their torque: is the supply low?")
    assert "; whole again at " in report_text(found, spec)


def test_motors_that_lack_different_shares_are_no_low_supply(spec: HandSpec) -> None:
    courses = [Course("weak", joint, 0.1 + 0.05 * (joint % 8), 2.0) for joint in range(N)]
    assert "supply" not in {one.fault.name for one in detected(spec, 6.0, *courses)}
    few = [Course("weak", joint, 0.3, 2.0) for joint in range(8)]
    assert "supply" not in {one.fault.name for one in detected(spec, 6.0, *few)}


def test_what_ends_before_it_has_a_name_has_none(spec: HandSpec) -> None:
    assert not detected(spec, 7.0, Course("weak", 7, 0.4, 2.0, 3.2))


def test_a_name_is_withdrawn_once_nothing_is_left_of_what_it_explains(spec: HandSpec) -> None:
    (found,) = detected(spec, 9.0, Course("weak", 7, 0.4, 2.0, 5.0))
    assert (found.fault.name, found.fault.joint) == ("weak", 7)
    assert found.named < 5.0 < found.ended < 8.0
    assert "middle_3 gives 60 % of its torque (since 2." in report_text(found, spec)
    assert re.search(r"; withdrawn at [67]\.\d\d s$", report_text(found, spec))


def test_a_shape_that_leaves_a_part_unexplained_is_no_fault(spec: HandSpec) -> None:
    free, rows = window(), np.arange(K)[:, None]
    weak = -0.4 * late(free.torque) * (np.arange(N) == 5)
    fits = [
        fit_signature(free._replace(disturbance=free.disturbance + push), "weak", 5, spec)
        for push in (weak, weak * (rows < 35), weak + 0.02 * MIDDLE)
    ]
    assert [fit.convinces(QUIET[1]) for fit in fits] == [True, False, False]
    assert fits[0].amount == pytest.approx(0.4, rel=0.1)


def test_what_an_error_in_a_named_size_leaves_is_no_second_fault_and_what_is_beside_it_is(spec: HandSpec) -> None:
    free = window()
    known = -0.8 * late(free.torque) * (np.arange(N) == 5)
    left = free._replace(disturbance=free.disturbance + 0.15 * known)
    assert signature_fault(left, QUIET, spec) is not None
    assert signature_fault(left._replace(known=known), QUIET, spec) is None
    more = left.disturbance - 0.3 * late(free.torque) * (np.arange(N) == 6)
    found = signature_fault(left._replace(known=known, disturbance=more), QUIET, spec)
    assert found is not None
    assert (found.name, found.joint) == ("weak", 6)


def test_faults_of_a_stuck_joint_follow_from_it_and_its_encoder_and_other_joints_do_not(spec: HandSpec) -> None:
    each = FaultList(spec, compensates=True)
    names: tuple[tuple[FaultName, int], ...] = (
        ("stuck", 6), ("weak", 6), ("friction", 6), ("encoder_step", 6), ("weak", 7), ("stuck", 6)
    )  # fmt: skip
    assert [each.add(Fault(name, joint, 0.05), 1.0, 2.0) for name, joint in names] == [
        True, False, False, True, True, False
    ]  # fmt: skip
    np.testing.assert_array_equal(np.flatnonzero(each.hidden), [6])
    each.resize(each.active[1], -0.05, 4.0)
    assert report_text(each.reports[1], spec).endswith("jumped back at 4.00 s")
    assert [one.name for one in each.active] == ["stuck", "weak"]


def test_encoders_of_several_fingers_that_jump_in_one_period_are_lost_periods(spec: HandSpec) -> None:
    rest, names = np.zeros(N), []
    weights = LinkWeights(np.zeros((N, N)), None, np.ones(N, dtype=bool), np.zeros(3))
    for joints in ((6,), (6, 9)):
        each, only = FaultDetector(spec, Thresholds.default(spec), 0.003), np.isin(np.arange(N), joints)
        for tick in range(ROWS * ROW + 2 * EVERY * ROW):
            state = HandState(
                0.003 * tick, tick, np.where(only & (tick > 100), 0.02, 0.0), rest, rest, np.full(N, np.nan), rest[:3]
            )
            estimate = Estimate(state.position, state.position, rest, rest, rest)
            each.add(
                state, estimate, rest, np.where(only & (tick == 101), 0.02, 0.0), weights if each.row_due else None
            )
        names.append([one.name for one in each.faults.active])
    assert names == [["encoder_step"], []]


@pytest.mark.parametrize("name", ["weak", "friction", "payload", "encoder_step"])
def test_a_mirror_that_knows_a_fault_expects_what_the_hand_does(
    spec: HandSpec, make_sim: MakeSim, name: Ailment
) -> None:
    amount = {"weak": 0.5, "friction": 0.05, "payload": 0.03, "encoder_step": 0.05}[name]
    faults = FaultList(spec, compensates=True)
    faults.add(Fault(cast(FaultName, name), 6, amount), 0.0, 0.0)
    each = StateObserver(spec, drive_parameters(spec, np.ones(N), np.zeros(N)), 0.003)
    pushed: list[Array] = []
    for sample in suffering(spec, make_sim(spec, posture=(spec.lower + spec.upper) / 2.0), name, 6, amount, at=0.0):
        state = sample.state
        if state.tick == 1:
            each.reset(state.position)
            each.compensate(faults.model_change())
        elif state.tick > 1:
            pushed.append(each.step(state.torque, state.gravity, state.position).disturbance)
        if state.t > 2.0:
            break
    assert np.abs(pushed[300:]).max() < 0.004


def test_what_a_named_fault_explains_is_no_touch_and_a_push_on_its_finger_is(spec: HandSpec, make_sim: MakeSim) -> None:
    hand = make_sim(spec, posture=(spec.lower + spec.upper) / 2.0)
    calm = Thresholds(np.full((2, N), 0.01), np.full(4, 3e-4))
    observer = StateObserver(spec, drive_parameters(spec, np.ones(N), np.zeros(N)), 0.003)
    each, touches, push = Mirror(spec, observer, np.ones(N), calm), [], np.zeros(N)
    for sample in each.watch(suffering(spec, hand, "friction", 5, 0.05)):
        push[6] = 0.05 * (5.0 <= sample.state.t < 5.3)
        hand.push(push)
        touches += [(sample.state.t, name) for name in each.contacts if each.faults]
    (named,) = each.faults
    assert (named.fault.name, named.fault.joint) == ("friction", 5)
    assert named.fault.amount == pytest.approx(0.05, rel=0.1)
    after = np.array([t for t, _ in touches if t > named.named + 0.2])
    assert 5.0 < after.min() < 5.05
    assert after.max() < 5.5
    assert {name for _, name in touches} == {"middle"}
    np.testing.assert_array_equal(np.flatnonzero(each.columns()["event"]), [4 + 5])


def test_a_joint_that_reports_nothing_is_said_until_it_reports_again(spec: HandSpec, make_sim: MakeSim) -> None:
    hand = make_sim(spec, posture=(spec.lower + spec.upper) / 2.0)
    observer = StateObserver(spec, drive_parameters(spec, np.ones(N), np.zeros(N)), 0.003)
    each, lost = Mirror(spec, observer, np.ones(N), Thresholds.default(spec)), np.arange(N) == 6

    def samples() -> Iterator[Sample]:
        for state, command in suffering(spec, hand, "weak", 0, 0.0, at=np.inf):
            gone = lost & (1.5 <= state.t < 2.0)
            yield Sample(replace(state, position=np.where(gone, np.nan, state.position)), command)
            if state.t > 2.5:
                return

    said = [[fault_text(one.fault, spec) for one in each.faults if one.ended == np.inf] for _ in each.watch(samples())]
    assert list(dict.fromkeys(map(tuple, said))) == [(), ("middle_2 reports nothing",)]
    assert said[-1] == []
    (silent,) = each.faults
    assert (silent.begin, silent.ended) == pytest.approx((1.5, 2.0), abs=0.004)
    assert silent.named == pytest.approx(1.6, abs=0.01)
    stopped = Mirror(spec, observer, np.ones(N), Thresholds.default(spec), stop=("silent",))
    with pytest.raises(HandFault, match=r"middle_2 reports nothing, at 1\.6"):
        hand = make_sim(spec, posture=(spec.lower + spec.upper) / 2.0)
        list(stopped.watch(samples()))


def test_an_event_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigError, match="--stop-on: no event named 'wek'; did you mean 'weak'"):
        make_mirror(load_spec(), "", "v4", HandCalibration(), 0.003, stop=("wek",))
