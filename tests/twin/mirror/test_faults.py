"""What is wrong with a hand is called by its name: from windows that are made up, and from a hand that goes wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.hands.description.calibration import HandCalibration
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.loop import run, until
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.observer.observer import Estimate, StateObserver
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
    LinkWeights,
    Thresholds,
)
from allegro_twin.twin.mirror.fault_signatures import signature_fault, signature_gains
from allegro_twin.twin.mirror.faults import CREEP, NAMES, ROW, Fault, MirrorWindow, direct_faults, fault_text
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
    stuck = free._replace(disturbance=np.where(np.arange(N) == 2, -free.torque, free.disturbance), position=still)
    assert [found.name for found in direct_faults(stuck, spec)] == ["stuck"]
    assert not direct_faults(stuck._replace(holds=both), spec)


def test_a_joint_is_not_stuck_where_others_of_its_finger_are_pushed_as_well(spec: HandSpec) -> None:
    free = window()
    three = np.isin(np.arange(N), (1, 2, 3))
    pressed = free._replace(
        disturbance=np.where(three, -free.torque, free.disturbance), position=np.where(three, 0.0, free.position)
    )
    assert not direct_faults(pressed, spec)


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


def test_a_mirror_knows_how_much_its_friction_is_more_than_in_fast_motion(sticky: HandSpec) -> None:
    parameters, speed = drive_parameters(sticky, np.ones(N), np.zeros(N)), np.array([0.0, 0.1, 5.0] + [0.0] * (N - 3))
    each, dry = (StateObserver(sticky, parameters, 0.003, bristly=bristly).rub(speed) for bristly in (True, False))
    np.testing.assert_allclose(each[:3], [1.5, 1.0 + 0.5 / np.e, 1.0])
    np.testing.assert_array_equal(dry, np.ones(N))


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
    weights = LinkWeights(np.zeros((N, N)), None, np.ones(N, dtype=bool), np.zeros(3), np.ones(N))
    named_at = None
    for tick, state in enumerate(states(spec)):
        wrong = tick > sign
        torque = 0.1 * np.sin(0.02 * tick + np.arange(N))
        push = np.where(np.arange(N) == 7, -0.5 * torque, 0.0) if wrong else np.zeros(N)
        speed = 0.9 * np.cos(3.0 * state.t + np.arange(N))
        position = np.where((np.arange(N) == 7) & wrong & stays, 0.1, state.position)
        state = replace(state, position=position)
        estimate = Estimate(state.position, state.position, push, speed)
        each.add(state, estimate, torque, np.zeros(N), weights if each.row_due else None)
        if each.faults.active:
            named_at = (tick - sign) / ROW
            break
        assert tick < 10000
    assert [(one.name, one.joint) for one in each.faults.active] == [(name, 7)]
    assert named_at is not None
    assert WAIT <= named_at <= (ROWS if stays else WAIT) + 3 * EVERY


@pytest.mark.parametrize(
    ("period", "jumps", "name"), [(0.003, True, "encoder_step"), (0.003, False, None), (0.02, True, None)]
)
def test_a_joint_that_is_stopped_or_may_go_so_far_in_its_period_is_no_encoder_that_jumps(
    spec: HandSpec, period: float, jumps: bool, name: str | None
) -> None:
    each, rest = FaultDetector(spec, Thresholds.default(spec), period), np.zeros(N)
    weights, only = (
        LinkWeights(np.zeros((N, N)), None, np.ones(N, dtype=bool), np.zeros(3), np.ones(N)),
        np.arange(N) == 6,
    )
    for tick in range(ROWS * ROW + 2 * EVERY * ROW):
        after = tick - 100
        # By 20 mrad at once, or at 20 mrad a period until it meets something.
        way = 0.02 * (after > 0) if jumps else -0.02 * max(-after, 0)
        state = HandState(period * tick, tick, way * only, rest, rest, np.full(N, np.nan), np.zeros(3))
        estimate = Estimate(state.position, state.position, rest, rest)
        each.add(state, estimate, rest, 0.02 * only * (after == 1), weights if each.row_due else None)
    assert [one.name for one in each.faults.active] == ([] if name is None else [name])


def test_thresholds_need_enough_looks(spec: HandSpec) -> None:
    rng = np.random.default_rng(0)
    free = 0.002 * rng.standard_normal((4000, N))
    few, many = (
        Thresholds.from_free_motion(
            free, np.zeros(free.shape, bool), np.zeros(N), 1e-6 * rng.exponential(size=(count, 4)), 0.003, spec
        )
        for count in (79, 400)
    )
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


def test_an_event_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigError, match="--stop-on: no event named 'wek'; did you mean 'weak'"):
        make_mirror(load_spec(), "", "v4", HandCalibration(), 0.003, stop=("wek",))
