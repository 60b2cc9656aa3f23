"""What a hand holds slips: fingers that rest and press follow it, and nobody told them to."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.errors import HandFault
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner
from allegro_twin.grasping.scenario import load_protocol, load_scenario
from allegro_twin.grasping.trial import Trial
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.loop import run, until
from allegro_twin.sim.observer.observer import Estimate, StateObserver
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.results.gap import drive_parameters
from allegro_twin.twin.mirror.fault_detection import FaultDetector, LinkWeights, Thresholds
from allegro_twin.twin.mirror.loose_link import LooseLinkDetector
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.twin.mirror.slip_detection import Slip, SlipDetector
from allegro_twin.types import HandState, Vector

N, ROW = 16, 0.03
DOWN = np.array([0.0, 0.0, -9.81])
PUSH = np.zeros(N)  # What presses on the index and on the thumb, N·m.
PUSH[[1, 2, 3]], PUSH[[13, 14]] = (-0.2, -0.1, -0.05), (-0.15, -0.15)
STIFF = 2.0  # N·m/rad, of the loop that holds the fingers.


def told(
    spec: HandSpec,
    change: Vector,
    moved: Vector,
    torque: Vector | None = None,
    down: Vector = DOWN,
    hold: Vector = PUSH,
) -> Slip | None:
    """After half a second of holding: what pushes back changes by a share of it, (n,), joints move, rad, and motors
    by themselves, N·m, (n,), beside what the loop makes of the motion."""
    slips, none = SlipDetector(spec, ROW, np.full(N, 0.02)), np.zeros(N)
    for _ in range(16):
        assert slips.add(hold, -hold, none, DOWN) is None
    assert slips.holds.any()
    for part in (0.5, 1.0, 1.0):
        motors = -hold - STIFF * part * moved + part * (none if torque is None else torque)
        found = slips.add(hold * (1.0 - part * change), motors, part * moved, down)
        if found is not None:
            return found
    return None


INDEX = np.isin(np.arange(N), (0, 1, 2, 3)).astype(float)
OBJECT = INDEX + 0.1 * np.isin(np.arange(N), (12, 13, 14, 15))  # What the index loses, the thumb feels, too.
IN = np.where(PUSH != 0.0, 0.01, 0.0)


def test_fingers_that_follow_what_gives_way_say_that_it_slips(spec: HandSpec) -> None:
    slip = told(spec, 0.6 * OBJECT, IN * INDEX)
    assert slip is not None
    assert slip.joint == 1
    assert 0.2 < slip.amount <= 0.6


def test_a_grip_that_stays_and_a_motion_that_loses_nothing_are_no_slip(spec: HandSpec) -> None:
    assert told(spec, np.zeros(N), np.zeros(N)) is None
    assert told(spec, 0.05 * INDEX, IN * INDEX) is None
    assert told(spec, 0.6 * INDEX, 0.1 * IN) is None


@pytest.mark.parametrize(
    ("change", "moved", "torque"),
    [
        pytest.param(0.6, -0.01, 0.8 * PUSH, id="opened"),
        pytest.param(0.3, 0.01, -0.5 * PUSH, id="closed"),
        pytest.param(-0.4, 0.0, -0.4 * PUSH, id="squeezed"),
    ],
)
def test_fingers_that_were_told_to_move_let_nothing_slip(
    spec: HandSpec, change: float, moved: float, torque: Vector
) -> None:
    assert told(spec, change * INDEX, np.sign(IN) * moved, torque) is None


def test_while_the_palm_turns_only_a_finger_that_lets_go_altogether_counts(spec: HandSpec) -> None:
    turned = np.array([0.0, 9.81 * np.sin(0.1), -9.81 * np.cos(0.1)])
    assert told(spec, 0.5 * OBJECT, IN * INDEX, down=turned) is None
    assert told(spec, 0.9 * OBJECT, IN * INDEX, down=turned) is not None


def test_a_push_on_one_finger_that_ends_is_no_slip_of_what_others_hold(spec: HandSpec) -> None:
    assert told(spec, 0.9 * OBJECT, IN * INDEX) is not None
    assert told(spec, 0.9 * INDEX, IN * INDEX) is None


def test_one_finger_alone_must_let_go_altogether(spec: HandSpec) -> None:
    alone = PUSH * INDEX
    assert told(spec, 0.5 * INDEX, 3.0 * IN * INDEX, hold=alone) is None
    assert told(spec, 0.9 * INDEX, 3.0 * IN * INDEX, hold=alone) is not None


def test_friction_that_the_file_does_not_know_of_holds_nothing(spec: HandSpec) -> None:
    slips = SlipDetector(spec, ROW, np.full(N, 0.004))
    for _ in range(20):
        slips.add(-0.03 * INDEX, 0.03 * INDEX, np.zeros(N), DOWN)
    assert not slips.holds.any()


def held(spec: HandSpec, name: str = "rubiks_cube") -> tuple[Trial, TrialRunner, float]:
    """An object in the hand; when it is held, s."""
    scenario, _ = load_scenario(name)
    protocol = load_protocol("table_pick")
    phases = protocol.phases[: 1 + [phase.name for phase in protocol.phases].index("hold")]
    bench = TrialRunner(spec, threads=1)
    case = TrialCase(scenario, load_grasp(scenario.grasp, spec), None, protocol.model_copy(update={"phases": phases}))
    trial = bench.trial(case)
    return trial, bench, next(window.begin for window in trial.windows if window.name == "hold")


@pytest.mark.slow
@pytest.mark.parametrize("slippery", [True, False])
def test_a_grasp_is_called_nothing_until_its_object_slips(spec: HandSpec, slippery: bool) -> None:
    trial, bench, at = held(spec)
    observer = StateObserver(spec, drive_parameters(spec, np.ones(N), np.zeros(N)), 0.003)
    calm = Thresholds(
        np.full((2, N), 0.01), np.full(4, 3e-4)
    )  # As of a free motion: what holds an object is far above.
    each = Mirror(spec, observer, np.ones(N), calm, stop=("slip",))
    samples = until(trial.seconds, run(trial.backend, bench.controller(trial)))

    def play() -> None:
        done = False
        for sample in trial.watched(each.watch(samples)):
            if slippery and not done and sample.state.t >= at + 0.5:
                assert not each.faults
                trial.backend.suffer("slippery", 0, 0.1)
                done = True

    if slippery:
        with pytest.raises(HandFault, match=r"what the hand holds slips: \w+ lost \d+ % of what pressed on it"):
            play()
    else:
        play()
        assert not each.faults


def test_a_link_that_falls_while_the_hand_holds_something_is_not_called_loose(
    spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LooseLinkDetector, "add", lambda self, off, noise: (7, 0.006))
    rest, middle = np.zeros(N), np.isin(np.arange(N), (4, 5, 6, 7))
    for push, free, name in ((rest, np.ones(N, bool), "loose"), (PUSH, np.ones(N, bool), None), (rest, middle, None)):
        each = FaultDetector(spec, Thresholds.default(spec), 0.003)
        for tick in range(600):
            state = HandState(0.003 * tick, tick, rest, rest, -push, np.full(N, np.nan), DOWN)
            weights = LinkWeights(np.zeros((N, N)), np.zeros((N, N)), free, DOWN) if each.row_due else None
            each.add(state, Estimate(rest, rest, push, rest, rest), -push, rest, weights)
            if name is None and tick < 200:  # Until it is known to hold.
                each.faults.reports.clear()
        assert [one.name for one in each.faults.active] == ([] if name is None else [name])


def test_a_fault_is_named_beside_a_slip_and_a_slip_of_another_time_beside_both(
    spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    coming = {60: Slip(1, 0.5), 62: Slip(2, 0.6), 120: Slip(1, 0.4)}  # By row.
    rows = iter(range(10_000))
    monkeypatch.setattr(SlipDetector, "add", lambda self, *row, jumped: coming.get(next(rows)))
    each, rest = FaultDetector(spec, Thresholds.default(spec), 0.003), np.zeros(N)
    for tick in range(1300):
        hot = np.full(N, 30.0)
        hot[[0, 3]] = 80.0 if tick > 700 else 30.0
        state = HandState(0.003 * tick, tick, rest, rest, rest, hot, DOWN)
        weights = LinkWeights(np.zeros((N, N)), None, np.ones(N, bool), DOWN) if each.row_due else None
        each.add(state, Estimate(rest, rest, rest, rest, rest), rest, rest, weights)
    said = [(report.fault.name, report.fault.joint, report.ended < np.inf) for report in each.faults.reports]
    assert said == [("slip", 1, True), ("hot", 0, False), ("hot", 3, False), ("slip", 1, False)]


OUT, PULLED = np.zeros(N), np.zeros(N)
OUT[[13, 14]] = 0.01, -0.03  # rad: the thumb is dragged outward. Of its motors one gives all that it has,
PULLED[13] = -0.06  # N·m, and the loop of the other pushes back.


def pulled(spec: HandSpec, drag: Vector, torque: Vector, rows: int) -> bool:
    """Whether a slip is named where an object is pulled out of the hand: within some rows it drags fingers, (n,), rad,
    whose motors change by so much, (n,), N·m; then nothing presses any more, and they go to where they are to be."""
    slips, none, home = SlipDetector(spec, ROW, np.full(N, 0.02)), np.zeros(N), -0.05 * np.sign(PUSH)
    parts = np.linspace(0.0, 1.0, rows + 1)[1:]
    held = [(PUSH, none, none)] * 16 + [(PUSH, part * torque, part * drag) for part in parts]
    gone = [(none, PUSH, home)] * 3
    found = [slips.add(d, -PUSH + more, position, DOWN) for d, more, position in held + gone]
    assert found[: len(held)] == [None] * len(held)
    return any(found)


@pytest.mark.parametrize("rows", [2, 20])
def test_an_object_that_drags_fingers_before_it_comes_out_is_no_command(spec: HandSpec, rows: int) -> None:
    assert pulled(spec, OUT, PULLED, rows)


def test_a_hand_that_opens_slowly_and_far_loses_nothing(spec: HandSpec) -> None:
    slips, home = SlipDetector(spec, ROW, np.full(N, 0.02)), 0.2 * np.sign(PUSH)
    for _ in range(16):
        slips.add(PUSH, -PUSH, np.zeros(N), DOWN)
    for part in np.linspace(0.0, 1.0, 40):
        assert slips.add((1.0 - part) * PUSH, -(1.0 - part) * PUSH, part * home, DOWN) is None


def test_a_slip_is_over_a_second_after_its_last_sign(spec: HandSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    coming = {20: Slip(1, 0.5), 40: Slip(2, 0.6)}  # By row; the second within a second of the first: the same.
    rows = iter(range(10_000))
    monkeypatch.setattr(SlipDetector, "add", lambda self, *row, jumped: coming.get(next(rows)))
    each, rest = FaultDetector(spec, Thresholds.default(spec), 0.003), np.zeros(N)
    for tick in range(1000):
        state = HandState(0.003 * tick, tick, rest, rest, rest, np.full(N, np.nan), DOWN)
        weights = LinkWeights(np.zeros((N, N)), None, np.ones(N, bool), DOWN) if each.row_due else None
        each.add(state, Estimate(rest, rest, rest, rest, rest), rest, rest, weights)
    (report,) = each.faults.reports
    assert each._since.tolist() == [41] * 4  # What was seen of the fingers before was what they held.
    assert report.ended == pytest.approx(0.03 * 41 + 1.0, abs=0.05)
