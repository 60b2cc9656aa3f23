"""The mirror expects what a free hand does, tells what pushes it, and does both the same again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import mujoco
import numpy as np
import pytest

from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Hold, Moves, Waypoint
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.hands.description.calibration import HandCalibration, Version
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.loop import run, until
from allegro_twin.recording.reader import load
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.observer.observer import StateObserver, joint_filter
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.surfaces.hand import Hand
from allegro_twin.twin.identify.results.gap import drive_parameters
from allegro_twin.twin.mirror.contact_detection import (
    ContactTimer,
    MovingJoints,
    contact_thresholds,
    find_contacts,
    held_friction,
    joint_thresholds,
    push_ratio,
)
from allegro_twin.twin.mirror.factory import describe_backlash, make_mirror
from allegro_twin.twin.mirror.fault_detection import FreeShapes, Thresholds
from allegro_twin.twin.mirror.mirror import Mirror, NoiseEstimator
from allegro_twin.types import Array, Sample, Vector
from benchmarks.mirror import touched_fingers
from tests.conftest import MakeSim

N = 16
STILL = np.zeros((20_000, N), dtype=bool)
ONE, ZERO = np.ones(N), np.zeros(N)


def mirror(spec: HandSpec, above: Vector | None = None, stop: tuple[str, ...] = ()) -> Mirror:
    calm = None if above is None else Thresholds(np.stack([above, above]), np.full(4, np.inf))
    return Mirror(spec, StateObserver(spec, drive_parameters(spec, ONE, np.zeros(N)), 0.003), ONE, calm, stop)


def moving(spec: HandSpec, backend: SimBackend, push: Vector | None = None, at: float = 2.0) -> Iterator[Sample]:
    """4 s to and fro, pushed from `at` on."""
    middle = (spec.lower + spec.upper) / 2.0
    moves = Moves([Waypoint(middle + d, seconds=1.0) for d in (0.2, -0.2, 0.15, -0.1)])
    for sample in until(4.0, run(backend, PD(moves, load_gains("v4", spec)))):
        if push is not None and sample.state.t >= at:
            backend.push(push)
        yield sample


def estimates(each: Mirror, samples: Iterator[Sample]) -> tuple[Vector, Array, Array]:
    """Times, disturbances, and how far what was expected was off."""
    t, disturbance, off = [], [], []
    for sample in each.watch(samples):
        latest = each.columns()
        t.append(sample.state.t)
        disturbance.append(latest["disturbance"])
        off.append(sample.state.position - latest["predicted"])
    return np.array(t[1:]), np.array(disturbance[1:]), np.array(off[1:])


@pytest.fixture
def hand(spec: HandSpec, make_sim: MakeSim) -> SimBackend:
    return make_sim(spec, posture=(spec.lower + spec.upper) / 2.0)


def test_a_free_hand_moves_as_expected_and_nothing_pushes_it(spec: HandSpec, hand: SimBackend) -> None:
    t, disturbance, off = estimates(mirror(spec), moving(spec, hand))
    settled = t > 1.0
    assert np.abs(off[settled]).max() < 1e-4
    assert np.abs(disturbance[settled]).max() < 0.004
    above = contact_thresholds(disturbance, STILL[: len(disturbance)], ZERO, 0.003, spec)[0]
    assert not touched_fingers(disturbance[settled], above, spec).any()


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_finger_that_is_pushed_into_its_stop_is_not_pushed_ever_more(spec: HandSpec, side: str) -> None:
    observer = StateObserver(spec, drive_parameters(spec, ONE, ZERO), 0.003)
    stop, way = getattr(spec, side).copy(), 1.0 if side == "upper" else -1.0
    observer.reset(stop)
    beyond = stop + 0.002 * way * (np.arange(N) == 0)  # As another hand's stop may be, or as its own gives.
    for _ in range(1000):
        pushed = observer.step(ZERO, np.zeros(3), beyond).disturbance[0]
    assert abs(pushed) < 0.05


@pytest.mark.slow
def test_the_disturbance_is_the_torque_from_outside(spec: HandSpec, hand: SimBackend) -> None:
    push = np.zeros(N)
    push[[5, 6]] = 0.05, -0.03
    t, disturbance, _ = estimates(mirror(spec), moving(spec, hand, push))
    late = t > 2.3
    np.testing.assert_allclose(disturbance[late][:, [5, 6]].mean(axis=0), [0.05, -0.03], rtol=0.1)
    assert np.abs(disturbance[late][:, 8:]).max() < 0.006
    above = np.full(N, 0.01)
    touched = np.logical_and(touched_fingers(disturbance, above, spec), (t > 1.0)[:, None])
    found = find_contacts(t, touched, disturbance, above, spec)
    assert [contact.finger for contact in found] == ["middle"]
    assert 2.0 < found[0].begin < 2.04
    assert found[0].torque == pytest.approx(0.05, rel=0.2)


@pytest.mark.parametrize("version", ["v4", "v5"])
def test_the_grain_of_encoders_is_no_touch_and_hides_none(spec: HandSpec, hand: SimBackend, version: Version) -> None:
    """A count of a v5 hand is 1.5 mrad, 17 of a v4 hand."""
    count, push = make_codec(version).rad_per_count, np.zeros(N)
    push[9] = 0.06

    def felt(samples: Iterator[Sample]) -> list[tuple[float, tuple[str, ...]]]:
        each = make_mirror(spec, "", version, HandCalibration(), 0.003)
        rounded = (
            sample._replace(state=replace(sample.state, position=count * np.round(sample.state.position / count)))
            for sample in samples
        )
        return [(s.state.t, each.contacts) for s in each.watch(rounded) if each.contacts and s.state.t > 0.5]

    assert felt(moving(spec, hand)) == []
    touches = felt(moving(spec, hand, push))
    assert {fingers for _, fingers in touches} == {("ring",)}
    assert 2.0 < touches[0][0] < 2.06


def test_a_coarse_encoder_that_often_repeats_its_count_has_the_noise_of_its_steps_and_not_of_a_knock() -> None:
    count, rng = make_codec("v5").rad_per_count, np.random.default_rng(0)
    path = 0.05 * 0.003 * np.arange(400)[:, None] + 1e-4 * rng.standard_normal((400, 2))
    path[200:, 1] += 0.1
    estimator = NoiseEstimator(2)
    for reported in count * np.rint(path / count):
        estimator.add(reported, 1)
    third = np.diff(count * np.rint(path / count), n=3, axis=0)
    assert ((third == 0.0).mean(axis=0) > 0.5).all()
    np.testing.assert_allclose(estimator.estimate(), np.sqrt(np.square(third[:, 0]).mean() / 20.0), rtol=0.2)


@pytest.mark.slow
def test_a_mirror_over_the_same_samples_is_the_same_to_the_last_bit(spec: HandSpec, hand: SimBackend) -> None:
    samples = list(moving(spec, hand))
    first, again = (estimates(mirror(spec), iter(samples)) for _ in range(2))
    np.testing.assert_array_equal(first[1], again[1])
    np.testing.assert_array_equal(first[2], again[2])


def test_a_touch_can_stop_the_hand(spec: HandSpec, hand: SimBackend) -> None:
    push = np.zeros(N)
    push[9] = 0.06
    with pytest.raises(HandFault, match=r"something touches ring: ring_1 is pushed by \+\d+ mN·m at 2\.0\d\d s"):
        estimates(mirror(spec, np.full(N, 0.02), ("contact",)), moving(spec, hand, push))


def test_one_period_above_is_no_touch_and_a_short_pause_no_end(spec: HandSpec) -> None:
    disturbance = np.zeros((1000, N))
    disturbance[400, 2] = 1.0
    disturbance[600:640, 13] = -0.5
    disturbance[650:700, 13] = 0.7
    above = np.full(N, 0.1)
    assert not touched_fingers(disturbance, above, spec)[400].any()
    timer, touched = ContactTimer(4, 0.003), []
    for ratio in push_ratio(disturbance, above, spec):
        timer.add(ratio > 1.0)
        touched.append(timer.touched)
    (only,) = find_contacts(np.linspace(0.0, 2.997, 1000), np.array(touched), disturbance, above, spec)
    assert (only.finger, only.torque, only.joint) == ("thumb", 0.7, 13)
    assert only.begin == pytest.approx(1.803)
    assert only.end == pytest.approx(2.097)


@pytest.mark.parametrize("place", [1, 2, 3])
def test_a_push_is_never_told_to_be_further_out_than_it_is(spec: HandSpec, make_sim: MakeSim, place: int) -> None:
    hand = make_sim(spec, posture=(spec.lower + spec.upper) / 2.0)
    model, data, joint = hand.model, hand.data, spec.fingers[1].joints[place]
    body, beside = int(model.joint(spec.joints[joint]).bodyid[0]), mirror(spec, np.full(N, 0.01))
    for sample in beside.watch(
        until(2.5, run(hand, PD(Hold((spec.lower + spec.upper) / 2.0), load_gains("v4", spec))))
    ):
        torque = np.zeros(model.nv)
        across = 2.0 * data.xmat[body].reshape(3, 3)[:, 0] * (sample.state.t > 2.0)
        mujoco.mj_applyFT(model, data, across, np.zeros(3), data.xipos[body].copy(), body, torque)
        hand.push(torque[:N])
    told = beside.touched_joints
    assert list(told) == ["middle"]
    assert spec.fingers[1].joints[1] <= told["middle"] <= joint


def test_joints_that_are_pushed_a_little_each_are_a_touch_together(spec: HandSpec) -> None:
    above, disturbance = np.full(N, 0.01), np.zeros((3, N))
    disturbance[:, [9, 10]] = 0.008, -0.008
    assert touched_fingers(disturbance, above, spec)[2].tolist() == [False, False, True, False]
    disturbance[:, 10] = 0.0
    assert not touched_fingers(disturbance, above, spec).any()


def test_a_minute_of_noise_sets_thresholds_that_half_an_hour_of_it_does_not_reach(spec: HandSpec) -> None:
    rng, usual = np.random.default_rng(0), np.linspace(0.002, 0.004, N)

    def noise(periods: int) -> Array:  # A disturbance keeps its value for some periods.
        return np.asarray(usual * np.repeat(rng.standard_normal((periods // 4, N)), 4, axis=0))

    above = contact_thresholds(noise(20_000), STILL, ZERO, 0.003, spec)
    assert (above / usual < 8.5).all()
    assert not any(touched_fingers(noise(60_000), above[0], spec).any() for _ in range(10))


def test_joints_at_rest_whose_friction_holds_anything_do_not_blunt_moving_ones(spec: HandSpec) -> None:
    rng, still = np.random.default_rng(1), np.repeat(np.arange(20_000)[:, None] // 400 % 2 == 0, N, axis=1)
    free = np.where(still, 0.02, 0.002) * np.repeat(rng.standard_normal((5_000, N)), 4, axis=0)
    above = contact_thresholds(free, ~still, ZERO, 0.003, spec)
    assert (above[1] < 0.02).all()
    assert (above[0] > 0.07).all()
    hidden = np.where(still, held_friction(free, ~still, ZERO, 0.003), 0.0)
    assert not touched_fingers(free, joint_thresholds(above, ~still), spec, hidden).any()
    held = contact_thresholds(free, ~still, np.full(N, 0.5), 0.003, spec)
    np.testing.assert_allclose(held[0], held[1] + 0.5)
    free[[801, 802, 803, 1201, 1202, 1203], 6] = 0.03
    seen = touched_fingers(free, joint_thresholds(above, ~still), spec, hidden)
    assert [bool(seen[rows, 1].any()) for rows in (slice(801, 804), slice(1201, 1204))] == [False, True]


def test_what_friction_holds_in_every_joint_of_a_finger_at_rest_is_no_touch(spec: HandSpec) -> None:
    """A file that fits in motion, and is off by 4 mN·m in joints at rest, each joint in another rest."""
    rng, still = np.random.default_rng(2), np.repeat(np.arange(20_000)[:, None] // 400 % 2 == 0, N, axis=1)
    one = np.arange(N) % 4 == (np.arange(20_000) // 800 % 4)[:, None]
    free = 0.0015 * rng.standard_normal((20_000, N)) + np.where(still & one, 0.008, 0.0)
    calm = Thresholds.from_free_motion(free, ~still, ZERO, FreeShapes(np.ones(N), np.zeros((100, 4))), 0.003, spec)
    rests = np.full(N, 0.012)  # All of them at once, and more than ever in the free motion.
    joint = np.where(np.arange(N) == 1, 0.05, 0.0)
    for push, fingers in ((rests, [False] * 4), (rests + joint, [True, False, False, False])):
        beyond = push_ratio(push, calm.contact[0], spec, held=calm.held)
        assert (beyond > 1.0).tolist() == fingers
    assert push_ratio(rests, calm.contact[1], spec).min() > 1.0  # In motion nothing is hidden.


def test_a_joint_moves_once_it_has_been_faster_for_a_tenth_of_a_second() -> None:
    pace, fast = MovingJoints(2, 0.003), np.array([0.05, 0.02])
    told = [pace(fast).tolist() for _ in range(40)]
    assert told[32] == [False, False]
    assert told[34] == [True, False]
    assert not pace(np.zeros(2)).any()


def test_a_short_free_motion_sets_no_thresholds_and_a_hand_without_gravity_has_no_mirror(
    spec: HandSpec, hand: SimBackend
) -> None:
    with pytest.raises(ConfigError, match="a free motion of 0.3 s says too little: at least 4 s"):
        contact_thresholds(np.zeros((100, N)), STILL[:100], ZERO, 0.003, spec)
    state, command = next(moving(spec, hand))
    lost = Sample(replace(state, gravity=np.full(3, np.nan)), command)
    with pytest.raises(ConfigError, match="must know where down is"):
        list(mirror(spec).watch([lost]))


def test_heavier_joints_are_corrected_no_faster() -> None:
    both = joint_filter(np.array([0.003, 0.006]), np.full(2, 0.07), 0.003, np.full(2, 6e-5))
    light, heavy = both.gains(np.ones(2, dtype=bool)).T
    assert 0.0 < heavy[0] < light[0] < 1.0
    assert (light > 0).all()


@pytest.mark.slow
def test_the_left_hand_has_a_mirror_too(make_sim: MakeSim, tmp_path: Path) -> None:
    left = load_spec(side="left")
    backend = make_sim(left, posture=(left.lower + left.upper) / 2.0)
    t, disturbance, _ = estimates(mirror(left), moving(left, backend))
    assert np.abs(disturbance[t > 1.0]).max() < 0.004


@pytest.mark.slow
def test_the_command_plays_a_recording_past_the_mirror_and_runs_a_hand_beside_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from tests.surfaces.cli import conftest

    command = conftest.command.__wrapped__(capsys, monkeypatch)  # type: ignore[attr-defined]
    code, out, _ = command("mirror", "can_virtual", "--record", tmp_path / "run.arrow")
    assert (code, "Nothing touched it." in out) == (0, True)
    columns = load(tmp_path / "run.arrow").columns
    assert columns["predicted"].shape == columns["disturbance"].shape == (1001, N)
    np.testing.assert_allclose(columns["predicted"][400:], columns["position"][400:], atol=5e-4)
    code, out, _ = command("mirror", tmp_path / "run.arrow")
    assert code == 0
    mirrored_again = [line for line in out.splitlines() if "index_1" in line]
    assert len(mirrored_again) == 1
    code, _, error = command("mirror", "sim_right")
    assert code == 2
    assert "a simulated hand is its own twin" in error


@pytest.mark.slow
def test_encoders_that_are_off_are_no_push(spec: HandSpec, make_sim: MakeSim) -> None:
    off = replace(spec, drive=Drive.from_values({"encoder_offset": 0.05, "delay": 0.004}, N))
    drive = drive_parameters(off, ONE, np.full(N, 0.05))
    each = Mirror(spec, StateObserver(spec, drive, 0.003), ONE)
    hand = make_sim(off, posture=(spec.lower + spec.upper) / 2.0)
    t, disturbance, error = estimates(each, moving(off, hand))
    assert np.abs(error[t > 1.0]).max() < 1e-4
    assert np.abs(disturbance[t > 1.0]).max() < 0.005
    observer = StateObserver(spec, drive, 0.003)
    for sample in moving(off, hand):
        if sample.state.tick == 0:
            observer.reset(sample.state.position)
        else:
            where = observer.step(sample.state.torque, sample.state.gravity, sample.state.position).position
            np.testing.assert_allclose(where, hand.data.qpos[:N], atol=1e-4)


def test_a_hand_on_a_bus_has_a_mirror_and_a_simulated_one_is_its_own() -> None:
    with Hand.open("can_virtual") as hand:
        hand.move_to("rock")
        assert not hand.mirror.contacts
        hand.move_to("home")
        assert np.abs(hand.mirror.external_torque).max() < 0.01
        assert not hand.mirror.faults
        assert hand.mirror is hand.mirror
    with Hand.open("sim_right") as hand, pytest.raises(ConfigError, match="a simulated hand is its own twin"):
        hand.mirror  # noqa: B018  # Asking is what fails.


def test_a_mirror_says_that_it_leaves_out_the_backlash_of_a_hands_file(spec: HandSpec, tmp_path: Path) -> None:
    file = tmp_path / "loose.yaml"
    file.write_text("drive: {backlash: 0.004}\n")
    assert describe_backlash(spec, str(file)).startswith(
        f"{file} has up to 4.0 mrad of backlash, which a mirror leaves out"
    )
    assert describe_backlash(spec, "") == ""


@pytest.fixture
def sticky(spec: HandSpec) -> HandSpec:
    """Its friction breaks away, and its encoders are noisy."""
    own = replace(spec.actuation, frictionloss=np.full(N, 0.05))
    shape = {"stiction": 1.5, "stribeck_speed": 0.15, "bristle": 1e-3, "load_friction": 0.05}
    return replace(
        spec, actuation=own, drive=Drive.from_values({**shape, "encoder_noise": 5e-5, "quantisation": 9e-5}, N)
    )


def resting(spec: HandSpec, make_sim: MakeSim, push: Vector | None = None) -> tuple[Vector, Array, Mirror]:
    """Times and disturbances of a hand that moves for 1 s and rests for 7, pushed from 6 s on, and its mirror."""
    backend, middle = make_sim(spec, posture=(spec.lower + spec.upper) / 2.0), (spec.lower + spec.upper) / 2.0
    each = Mirror(spec, StateObserver(spec, drive_parameters(spec, ONE, np.zeros(N)), 0.003, bristly=True), ONE)
    away = Moves([Waypoint(middle + np.tile([0.05, 0.3, -0.2, 0.2], 4), seconds=1.0)])

    def samples() -> Iterator[Sample]:
        for sample in until(8.0, run(backend, PD(away, load_gains("v4", spec)))):
            if push is not None and sample.state.t >= 6.0:
                backend.push(push)
            yield sample

    t, disturbance, _ = estimates(each, samples())
    return t, disturbance, each


@pytest.mark.slow
def test_noise_does_not_unbend_the_bristles_of_a_hand_that_rests(sticky: HandSpec, make_sim: MakeSim) -> None:
    """Friction of 75 mN·m held what the disturbance then had to: 20 mN·m and more."""
    t, disturbance, _ = resting(sticky, make_sim)
    assert np.abs(disturbance[t > 3.0].mean(axis=0)).max() < 0.003


@pytest.mark.slow
def test_a_push_that_a_resting_joints_friction_holds_bends_its_bristles_and_is_felt(
    sticky: HandSpec, make_sim: MakeSim
) -> None:
    push = np.zeros(N)
    push[9] = 0.04
    t, disturbance, each = resting(sticky, make_sim, push)
    felt = disturbance[(t > 6.02) & (t < 6.1)].mean(axis=0)
    assert each.observer.held[9] + 0.01 < felt[9] < 0.05
    assert np.abs(np.delete(felt, 9)).max() < 0.008


@pytest.mark.slow
def test_a_hand_that_rests_is_not_touched_however_long(spec: HandSpec, make_sim: MakeSim) -> None:
    """The engine's friction creeps under a load: what held it in the mirror was 16 to 30 mN·m after 20 s."""
    backend = make_sim(spec, posture=(spec.lower + spec.upper) / 2.0)
    each = mirror(spec)
    away = (spec.lower + spec.upper) / 2.0 + np.tile([0.05, 0.3, -0.2, 0.2], 4)
    samples = until(20.0, run(backend, PD(Moves([Waypoint(away, seconds=1.0)]), load_gains("v4", spec))))
    t, disturbance, _ = estimates(each, samples)
    assert np.abs(disturbance[t > 15.0]).max() < 0.006


def test_a_joint_that_creeps_under_its_load_in_soft_friction_is_not_pushed(spec: HandSpec, make_sim: MakeSim) -> None:
    """Friction of plain MuJoCo creeps by 3 mrad/s where 10 of 30 mN·m load it: the mirror's did not, and was pushed by
    the rest."""
    spec = replace(spec, actuation=replace(spec.actuation, frictionloss=np.full(N, 0.03)))
    middle = (spec.lower + spec.upper) / 2.0
    backend = make_sim(spec, posture=middle)
    backend.model.opt.noslip_iterations = 0
    slowly = Moves([Waypoint(middle + d, seconds=1.0) for d in (0.1, 0.1, 0.104, 0.108, 0.1, 0.1)])
    t, disturbance, _ = estimates(mirror(spec), until(6.0, run(backend, PD(slowly, load_gains("v4", spec)))))
    assert np.abs(disturbance[t > 2.0]).max() < 0.008


def test_a_mirror_that_begins_late_counts_the_time_from_the_session(
    spec: HandSpec, make_sim: MakeSim, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[float] = []
    monkeypatch.setattr(StateObserver, "reset", lambda _self, _position, time=0.0: begun.append(time))
    samples = list(islice(moving(spec, make_sim(spec)), 300))
    mirror(spec).observe(samples[200])
    assert begun == [samples[200].state.t]
    assert begun[0] > 0.5
