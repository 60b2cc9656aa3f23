"""The parts of the facade one by one: bounds, straight lines, the driver, what was felt and what was taught."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig
from allegro_twin.backend import limp_of
from allegro_twin.control.bumpless_switch import BumplessSwitch
from allegro_twin.control.controllers import PD, PID
from allegro_twin.control.demonstration import TaughtMotion
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.errors import ConfigError, HandFault, LinkTimeout
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_grasp, load_posture
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.plugins import PluginController
from allegro_twin.sim.contact.collision_free_paths import CollisionFreePaths
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.hand.bounds import JointBounds
from allegro_twin.surfaces.hand.cartesian import straight_line_motion
from allegro_twin.surfaces.hand.demonstration import Demonstration
from allegro_twin.surfaces.hand.grasps import GraspOutcome, aperture, for_width, grasp_outcome
from allegro_twin.surfaces.hand.loop_thread import LoopThread
from allegro_twin.surfaces.hand.motion import Goal, MotionMonitor
from allegro_twin.types import Command, HandState, Sample, TorqueCommand, Vector
from tests.test_safety import state


def config(**controller: object) -> RunConfig:
    return RunConfig.model_validate({"backend": {"kind": "sim"}, "controller": {"kind": "pd"} | controller})


def sample(tick: int, position: Vector | None = None) -> Sample:
    at = state(tick) if position is None else state(tick, position=position)
    return Sample(at, TorqueCommand(np.zeros(16)))


def test_a_margin_may_take_up_to_half_of_the_least_range(spec: HandSpec) -> None:
    half = float((spec.upper - spec.lower).min()) / 2
    bounds = JointBounds(spec)
    bounds.set_margin(half - 1e-6, None, None)
    assert (bounds.limits[0] < bounds.limits[1]).all()
    with pytest.raises(ConfigError, match="leaves some joint no range"):
        bounds.set_margin(half, None, None)
    assert bounds.use_margin
    with pytest.raises(ConfigError, match="takes one of general, percent and per_joint; 2 are given"):
        bounds.set_margin(0.1, 5.0, None)


def test_a_straight_line_peaks_at_its_speed_from_rest_to_rest(spec: HandSpec, home: Vector) -> None:
    model = hand_kinematics(spec)
    start = model.fingertips(home)["index"].position
    goal = start + np.array([0.012, 0.0, -0.02])
    moves = straight_line_motion(model, home, {"index": goal}, 0.04)
    path = moves.begin(home)
    times = np.arange(0.0, path.seconds, 1e-3)
    tips = np.array([model.fingertips(path(t).position)["index"].position for t in times])
    speeds = np.linalg.norm(np.diff(tips, axis=0), axis=1) / 1e-3
    assert speeds.max() == pytest.approx(0.04, rel=0.03)
    assert max(speeds[0], speeds[-1]) < 0.01
    np.testing.assert_allclose(model.fingertips(path(path.seconds).position)["index"].position, goal, atol=1e-9)
    others = np.setdiff1d(np.arange(16), spec.finger("index").joints)
    np.testing.assert_array_equal(path(path.seconds).position[others], home[others])


@pytest.mark.parametrize("speed", [0.0, -0.1, float("nan")])
def test_a_line_without_a_speed_is_refused(speed: float, spec: HandSpec, home: Vector) -> None:
    with pytest.raises(ConfigError, match="speed must be positive, in m/s"):
        straight_line_motion(hand_kinematics(spec), home, {"index": [0.05, 0.04, 0.1]}, speed)


def test_a_line_to_where_the_tip_is_stays_there(spec: HandSpec, home: Vector) -> None:
    model = hand_kinematics(spec)
    here = model.fingertips(home)["thumb"].position
    (only,) = straight_line_motion(model, home, {"thumb": here}, 0.05).waypoints
    np.testing.assert_array_equal(only.posture, home)


def fails(error: BaseException | None) -> Iterator[Sample]:
    yield sample(0)
    yield sample(1)
    if error is not None:
        raise error


@pytest.mark.parametrize("background", [False, True])
@pytest.mark.parametrize("error", [LinkTimeout("no report from ring"), None], ids=["error", "end"])
def test_what_ended_the_loop_is_told_to_everybody_who_asks(error: Exception | None, background: bool) -> None:
    driver = LoopThread(fails(error), background=background)
    kind, message = (HandFault, "the hand has ended") if error is None else (LinkTimeout, "no report from ring")
    for _ in range(2):
        with pytest.raises(kind, match=message):
            driver.wait(lambda s: s.state.tick > 5)
        with pytest.raises(kind, match=message):
            _ = driver.latest
    driver.close()
    driver.close()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_error_of_the_program_in_the_loops_thread_is_told_to_whoever_waits() -> None:
    driver = LoopThread(fails(ZeroDivisionError("by nothing")), background=True)
    with pytest.raises(HandFault, match="an error of the program, ZeroDivisionError: by nothing") as caught:
        driver.wait(lambda s: s.state.tick > 5)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    driver.close()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ZeroDivisionError("by nothing"), "by an error of the program, ZeroDivisionError: by nothing; open the hand"),
        (AssertionError(), "by an error of the program, AssertionError; open the hand again"),
        (KeyboardInterrupt(), "by Ctrl-C; open the hand again"),
    ],
)
def test_in_the_foreground_an_error_of_the_program_is_raised_as_it_is_and_named_afterwards(
    error: BaseException, words: str
) -> None:
    driver = LoopThread(fails(error), background=False)
    with pytest.raises(type(error)):
        driver.wait(lambda s: s.state.tick > 5)
    for _ in range(2):
        with pytest.raises(HandFault, match=f"the loop has ended {words}") as caught:
            driver.wait(lambda s: s.state.tick > 5)
        assert caught.value.__cause__ is error
    driver.close()


def test_a_closed_driver_ends_its_samples_and_says_that_the_hand_is_closed() -> None:
    ended = []

    def endless() -> Iterator[Sample]:
        try:
            tick = 0
            while True:
                yield sample(tick)
                tick += 1
        finally:
            ended.append(tick)

    for background in (False, True):
        driver = LoopThread(endless(), background=background)
        driver.wait(lambda s: s.state.tick >= 3)
        driver.close()
        assert len(ended) == (2 if background else 1)
        with pytest.raises(HandFault, match="the hand is closed; open it again"):
            driver.wait(lambda s: s.state.tick < 0)


def test_what_a_finger_presses_is_what_its_torques_do_beyond_its_own_weight(spec: HandSpec) -> None:
    """1.5 N at the index fingertip against a squeeze that stops 0.2 rad short."""
    grasp, model = load_grasp("pinch_index", spec), hand_kinematics(spec)
    position = grasp.squeeze.copy()
    weight = np.linspace(0.01, 0.05, 16)
    for finger in ("index", "thumb"):
        position[list(spec.finger(finger).joints)] -= 0.2
    _, (index, thumb) = model.fingertip_jacobians(position, ["index", "thumb"])
    torque = weight + index.T @ [1.5, 0.0, 0.0] + thumb.T @ [0.0, 0.0, 2.5]
    seen = grasp_outcome(grasp, _pressing(position, torque), model, spec, weight)
    assert seen.touching == ("index", "thumb")
    assert seen.force == pytest.approx({"index": 1.5, "thumb": 2.5})
    assert seen.width == aperture(model, position, spec, ("index", "thumb"))
    free = grasp_outcome(grasp, _pressing(grasp.squeeze, weight), model, spec, weight)
    assert (free.touching, free.force, np.isnan(free.width)) == ((), {}, True)


def test_a_grasp_that_is_told_a_width_says_whether_anything_as_wide_is_there(spec: HandSpec) -> None:
    model = hand_kinematics(spec)
    grasp, rest = for_width(load_grasp("grasp_3", spec), 0.05, model, spec), np.zeros(16)

    def outcome(position: Vector, sized: bool = True) -> GraspOutcome:
        met = CollisionFreePaths(spec).touching(position, 0.002)
        return grasp_outcome(grasp, _pressing(position, rest), model, spec, rest, sized, met)

    held = outcome(grasp.close)  # Stopped where an object of 50 mm would stop it.
    assert (held.empty, held.met) == (False, ())
    assert outcome(grasp.close + 0.4 * (grasp.squeeze - grasp.close)).empty is False  # A smaller one.
    through = outcome(grasp.squeeze)
    assert through.touching == ()
    assert through.empty
    assert not outcome(grasp.squeeze, sized=False).empty  # Nobody said that anything were there.
    assert through.describe().endswith("nothing as wide as the object is there")
    pinch = load_grasp("pinch_index", spec)
    ok = load_posture("ok", spec)
    met = CollisionFreePaths(spec).touching(ok, 0.002)
    found = grasp_outcome(pinch, _pressing(ok, rest), model, spec, rest, True, met)
    assert found.met == ("index", "thumb")
    assert "index and thumb touch each other" in found.describe()


def _pressing(position: Vector, torque: Vector) -> HandState:
    return state(3, position=position, torque=torque)


def test_the_aperture_is_between_the_surfaces_of_the_fingertips(spec: HandSpec, home: Vector) -> None:
    model = hand_kinematics(spec)
    tips = model.fingertips(home)
    between = np.linalg.norm(tips["thumb"].position - tips["index"].position)
    assert aperture(model, home, spec, ("index", "thumb")) == pytest.approx(between - 0.024)  # Spheres of 12 mm.


def test_what_is_taught_ends_at_the_limits_and_a_joint_that_went_far_beyond_is_named(spec: HandSpec) -> None:
    leaning, far = spec.upper + 0.01, spec.upper + np.where(np.arange(16) == 2, 0.05, 0.01)
    demonstration = Demonstration(spec)
    assert demonstration.clipped() == ""
    demonstration(sample(0, leaning))
    np.testing.assert_array_equal(demonstration.posture(), spec.upper)
    assert demonstration.clipped() == ""
    demonstration(sample(1, far))
    demonstration(sample(2, leaning))
    demonstration(sample(3, spec.lower))
    moved = demonstration.motion().positions
    np.testing.assert_array_equal(moved, np.clip(moved, spec.lower, spec.upper))
    assert demonstration.clipped() == "index_2 went 0.050 rad beyond its limit; what is stored ends there"
    assert demonstration.clipped(motion=False) == ""


def test_a_joint_that_is_read_further_beyond_its_limit_than_a_stop_yields_is_refused(spec: HandSpec) -> None:
    demonstration = Demonstration(spec)
    demonstration(sample(0, spec.upper + np.where(np.arange(16) == 2, 2.0, 0.0)))
    with pytest.raises(ConfigError, match=r"index_2 was read 2\.00 rad beyond its limit"):
        demonstration.posture()
    demonstration(sample(1, spec.upper))
    np.testing.assert_array_equal(demonstration.posture(), spec.upper)
    with pytest.raises(ConfigError, match="its encoder's zero or the limit is wrong"):
        demonstration.motion()


def test_a_hand_moves_under_a_packages_controller_whose_member_has_a_name_of_ours(spec: HandSpec) -> None:
    class Theirs:
        motion = "slow"

        def start(self, state: HandState) -> None:
            return None

        def __call__(self, state: HandState, memory: None) -> tuple[Command, None]:
            return limp_of(spec), None

    rig = assemble(config())
    with closing(
        Hand(replace(rig, controller=PluginController(Theirs(), "mine")), load_gains("default", spec))
    ) as hand:
        hand.set_controller("pd")
        hand.move_to("home", 2.0)
        assert np.abs(hand.errors).max() < 0.1


def test_a_motion_that_never_settles_is_over_half_a_second_after_its_end() -> None:
    with Hand.open(config()) as hand:
        hand.set_controller("pd")  # PID would bring it there.
        hand.move_to("home", 2.0)
        assert hand.sim is not None
        hand.move_to("open", 2.0, wait=False)
        hand.sim.push(np.where(np.arange(16) == 2, 0.27, 0.0))
        goal = hand._mover.goal  # When the motion is over.
        assert goal is not None
        hand.wait()
        late = hand.state.t - goal.began - goal.seconds
        assert np.abs(hand.errors).max() > 0.02
    assert late == pytest.approx(0.5, abs=0.01)


def watched(goal: Goal, gains: str, positions: Callable[[float], Vector], spec: HandSpec, seconds: float) -> list[bool]:
    """What a watch says of a hand that is in such positions, a sample every 3 ms, until it has arrived."""
    watch, said = MotionMonitor(goal, spec, load_gains(gains, spec)), list[bool]()
    for tick in range(1, int(seconds / 0.003)):
        said.append(watch(Sample(state(tick, position=positions(0.003 * tick)), TorqueCommand(np.zeros(16)))))
        if watch.arrived or said[-1]:
            break
    return said


def test_a_joint_that_does_not_move_for_half_a_second_is_stuck(spec: HandSpec, home: Vector) -> None:
    path = Moves([Waypoint(home + 0.5, seconds=1.0, profile="linear")]).begin(home)
    goal = Goal(path, 0.0, 1.0, pressing=np.inf)
    said = watched(goal, "default", lambda t: home, spec, 5.0)
    assert said[-1]
    assert 0.003 * len(said) == pytest.approx(0.03 / 0.5 + 0.5, abs=0.01)  # Half a second after it was 0.03 rad behind.
    assert not watched(goal, "default", lambda t: path(t - 0.05).position, spec, 5.0)[-1]


def test_what_shakes_in_a_contact_is_stuck_three_seconds_after_its_end(spec: HandSpec, home: Vector) -> None:
    goal = Goal(Moves([Waypoint(home + 0.5, seconds=1.0)]).begin(home), 0.0, 1.0, pressing=np.inf)
    said = watched(goal, "default", lambda t: home + 0.3 + 0.02 * (t // 0.3 % 2), spec, 9.0)
    assert said[-1]
    assert 0.003 * len(said) == pytest.approx(1.0 + 3.0, abs=0.01)


def test_what_dry_friction_alone_keeps_from_its_place_is_not_stuck(spec: HandSpec, home: Vector) -> None:
    """With gains of 0.42 N·m/rad, 0.02 N·m of friction are 0.048 rad."""
    goal = Goal(Moves([Waypoint(home + 0.05, seconds=0.5)]).begin(home), 0.0, 0.5, pressing=np.inf)
    short = np.where(np.arange(16) == 4, 0.045, 0.0)
    for gains, stuck in (("rock_paper_scissors", False), ("default", True)):
        assert watched(goal, gains, lambda t: home + 0.05 - short, spec, 3.0)[-1] == stuck


def test_a_hand_that_has_arrived_may_be_pushed_for_as_long_as_one_likes() -> None:
    with Hand.open(config()) as hand:
        hand.move_to("home", 3.0)
        assert hand.sim is not None
        hand.sim.push(np.where(np.arange(16) == 2, 1.0, 0.0))
        hand.wait(2.0)
        assert np.abs(hand.errors).max() > 0.1
        hand.sim.push(np.zeros(16))
        hand.wait(1.0)
        assert np.abs(hand.errors).max() < 0.01
        assert hand.stalled is None


def test_a_move_is_waited_for_until_the_joints_are_there() -> None:
    with Hand.open(config()) as hand:
        hand.move_to("home", 1.0)
        assert hand.state.t > 0.5
        assert np.abs(hand.state.position - load_posture("home", hand.spec)).max() < 0.02
        assert np.abs(hand.state.velocity).max() < 0.05


def test_the_config_names_the_gains_and_the_wish_names_the_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("default", "v4"):
        with Hand.open(config(gains=name)) as hand:
            gains = load_gains(name, hand.spec)
            np.testing.assert_array_equal(hand._mover.gains.kp, gains.kp)
            for kind, made in (("pd", PD), ("pid", PID)):
                handed: list[object] = []
                monkeypatch.setattr(
                    BumplessSwitch, "switch", lambda relay, controller, handed=handed: handed.append(controller)
                )
                hand.set_controller(kind)  # type: ignore[arg-type]  # Both are kinds.
                assert [type(controller) for controller in handed] == [made]


def test_nobody_is_told_after_they_stopped_listening() -> None:
    told: list[float] = []
    with Hand.open(config()) as hand:
        with hand.listening(lambda s: told.append(s.state.t)):
            hand.wait(0.03)
        heard = len(told)
        hand.wait(0.03)
        with hand.teach() as demonstration:
            hand.wait(0.03)
        assert hand.controller == "pid"
        left = demonstration.posture()
        hand.wait(0.3)
        np.testing.assert_array_equal(demonstration.posture(), left)
    assert heard == len(told) == 10


def test_a_taught_motion_is_repeated_as_many_times_as_fast_as_asked(home: Vector) -> None:
    motion = TaughtMotion(np.array([0.0, 0.5, 1.0]), np.array([home, home + 0.05, home]))
    with Hand.open(config()) as hand:
        for speed in (1.0, 2.0):
            hand.play(motion, speed, approach=3.0, wait=False)
            goal = hand._mover.goal
            assert goal is not None
            assert goal.seconds == pytest.approx(1.0 / speed)
            np.testing.assert_allclose(goal.path(0.5 / speed).position, home + 0.05)
