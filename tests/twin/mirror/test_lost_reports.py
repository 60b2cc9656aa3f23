"""Reports that are lost, and noisy ones, are no touch and no fault; what is one is noticed all the same."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.drivers.can.driver.clock import HandClock
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.hands.description.calibration import HandCalibration
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.loop import run, until
from allegro_twin.recording.recorder import record
from allegro_twin.sim.observer.observer import NOISE, Estimate, StateObserver, joint_filter
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.surfaces.cli.twin.mirror_run import missing_checks
from allegro_twin.twin.identify.results.gap import drive_parameters
from allegro_twin.twin.mirror.factory import encoder_noise, make_mirror
from allegro_twin.twin.mirror.fault_detection import FreeShapes, Thresholds
from allegro_twin.twin.mirror.faults import NAMES
from allegro_twin.twin.mirror.mirror import BLIND, DIM, LostPeriods, Mirror
from allegro_twin.twin.mirror.on_recording import MirrorResult, mirror_recording
from allegro_twin.types import Array, HandState, Sample, Vector, frozen
from tests.conftest import MakeSim
from tests.twin.mirror.test_mirror import N, mirror

SECONDS = 4.0
LEARNED = 0.01  # N·m: about what a free motion of a matched hand ends with.


class Deaf:
    """A backend whose reports are lost for `lost[tick]` periods; meanwhile the hand keeps its torques."""

    def __init__(self, inner: object, lost: dict[int, int]) -> None:
        self._inner, self._lost = inner, lost

    def __getattr__(self, name: str) -> object:
        return getattr(self._inner, name)

    def write(self, command: object) -> None:
        self._command = command
        self._inner.write(command)  # type: ignore[attr-defined]

    def read(self) -> HandState:
        state: HandState = self._inner.read()  # type: ignore[attr-defined]
        for _ in range(self._lost.get(state.tick, 0)):
            self._inner.write(self._command)  # type: ignore[attr-defined]
            state = self._inner.read()  # type: ignore[attr-defined]
        return state


def losses(share: float, longest: int, seed: int = 0) -> dict[int, int]:
    """Ticks at which so many periods are lost."""
    rng = np.random.default_rng(seed)
    return {tick: int(rng.integers(1, longest + 1)) for tick in range(5000) if rng.random() < share}


def noisy(spec: HandSpec, noise: float) -> HandSpec:
    return replace(spec, drive=Drive.from_values({"encoder_noise": noise, "quantisation": 8.9e-5, "seed": 1}, N))


def motion(spec: HandSpec, make_sim: MakeSim, lost: dict[int, int], push: Vector | None = None) -> Iterator[Sample]:
    """To and fro at up to 1 rad/s; pushed from 2 s on."""
    middle = (spec.lower + spec.upper) / 2.0
    backend = make_sim(spec, posture=middle)
    moves = Moves([Waypoint(middle + d, seconds=0.6) for d in (0.3, -0.25, 0.2, -0.3, 0.1, -0.2)])
    for sample in until(SECONDS, run(Deaf(backend, lost), PD(moves, load_gains("v4", spec)))):  # type: ignore[arg-type]
        if push is not None and sample.state.t >= 2.0:
            backend.push(push)
        yield sample


def watch(spec: HandSpec, samples: Iterator[Sample], above: float = LEARNED) -> tuple[Mirror, list[tuple[float, str]]]:
    """The mirror afterwards, and every finger that it called touched, and when."""
    each, touches = mirror(spec, np.full(N, above)), []
    for sample in each.watch(samples):
        touches += [(sample.state.t, name) for name in each.contacts]
    return each, touches


@pytest.mark.parametrize(("share", "longest"), [
    (0.05, 2), *(pytest.param(*row, marks=pytest.mark.slow) for row in ((0.001, 2), (0.2, 3), (0.01, 20))),
])  # fmt: skip
def test_lost_periods_are_no_touch_and_no_fault(spec: HandSpec, make_sim: MakeSim, share: float, longest: int) -> None:
    each, touches = watch(spec, motion(spec, make_sim, losses(share, longest)))
    assert not touches
    assert not each.faults


@pytest.mark.parametrize("late", [pytest.param(0.0, marks=pytest.mark.slow), 0.9])
def test_a_period_of_which_a_host_heard_nothing_is_no_touch_before_its_clock_counts_it(
    spec: HandSpec, make_sim: MakeSim, late: float
) -> None:
    def heard() -> Iterator[Sample]:
        """By a host's own clock; `late`: of stamps of some states of which nothing is lost before, periods."""
        clock, begun = HandClock(0.003, 0.0, 0), 0
        for state, command in motion(spec, make_sim, {} if late else dict.fromkeys(range(400, 1300, 40), 1)):
            if state.tick:
                begun += 1
                clock.advance(state.t + (0.003 * late if state.tick % 40 == 0 else 0.0), begun)
            yield Sample(replace(state, tick=clock.tick, t=clock.t), command)

    each, touches = watch(spec, heard())
    assert not touches
    assert not each.faults


@pytest.mark.slow
def test_rows_that_a_recording_lacks_are_no_touch_and_no_fault(spec: HandSpec, make_sim: MakeSim) -> None:
    rng = np.random.default_rng(2)
    whole = [sample for sample in motion(spec, make_sim, {}) if sample.state.tick == 0 or rng.random() > 0.1]
    each, touches = watch(spec, iter(whole), above=0.02)
    assert not touches
    assert not each.faults


def test_a_lost_period_moves_what_is_expected_on_by_two(spec: HandSpec, make_sim: MakeSim) -> None:
    each, off = mirror(spec), []
    for sample in each.watch(motion(spec, make_sim, losses(0.05, 2))):
        off.append(sample.state.position - each.columns()["predicted"])
    assert np.abs(np.array(off)[350:]).max() < 2e-4  # At 1 rad/s a period is 3 mrad.


@pytest.mark.slow
def test_a_finger_whose_report_alone_is_lost_is_expected_where_it_went(spec: HandSpec, make_sim: MakeSim) -> None:
    def without(samples: Iterator[Sample]) -> Iterator[Sample]:
        for state, command in samples:
            position = np.array(state.position)
            if state.tick % 7 == 3:
                position[4:8] = np.nan
            yield Sample(replace(state, position=frozen(position)), command)

    each, touches = watch(spec, without(motion(spec, make_sim, {})))
    assert not touches
    assert not each.faults
    assert np.isfinite(each.external_torque).all()


@pytest.mark.slow
@pytest.mark.parametrize("noise", [2e-4, *(pytest.param(each, marks=pytest.mark.slow) for each in (6e-5, 4e-4))])
def test_noisy_encoders_are_no_touch_and_no_fault_even_where_no_file_says_so(
    spec: HandSpec, make_sim: MakeSim, noise: float
) -> None:
    each, touches = watch(noisy(spec, noise), motion(noisy(spec, noise), make_sim, losses(0.01, 2)), above=0.02)
    assert not touches
    assert not each.faults
    assert each.observer.noise == pytest.approx(np.full(N, max(noise, NOISE)), rel=0.3)


@pytest.mark.slow
def test_a_push_is_noticed_in_time_though_reports_are_lost_and_noisy(spec: HandSpec, make_sim: MakeSim) -> None:
    push = np.zeros(N)
    push[5] = 0.06
    for share, noise in ((0.05, 6e-5), (0.05, 4e-4)):
        own = noisy(spec, noise)
        each, touches = watch(own, motion(own, make_sim, losses(share, 2), push), above=0.02)
        assert {name for _, name in touches} == {"middle"}
        assert 2.0 < touches[0][0] < 2.06
        assert each.external_torque[5] == pytest.approx(0.06, rel=0.25)


@pytest.mark.slow
def test_a_mirror_that_hears_nothing_for_long_begins_again_and_says_nothing_meanwhile(
    spec: HandSpec, make_sim: MakeSim
) -> None:
    long = round(BLIND / 0.003) + 1
    each, touches = watch(spec, motion(spec, make_sim, {600: long}))
    assert not touches
    each = mirror(spec, np.full(N, LEARNED))
    blind = [
        sample.state.tick
        for sample in each.watch(motion(spec, make_sim, {600: long}))
        if np.isnan(each.external_torque).any()
    ]
    assert blind == [0, 600 + long]


@pytest.mark.slow
def test_the_noise_of_encoders_is_that_of_the_hands_file(spec: HandSpec, tmp_path: Path) -> None:
    path = tmp_path / "noisy.yaml"
    path.write_text("wire: {version: v4}\nidentified: {noise: 3.0e-4}\n")
    each = make_mirror(spec, str(path), "v4", HandCalibration(), 0.003)
    np.testing.assert_array_equal(each.observer.noise, np.full(N, 3e-4))
    own = load_spec(serial=str(path))
    assert encoder_noise(str(path), noisy(own, 4e-4))[0] == pytest.approx(np.hypot(4e-4, 8.9e-5 / np.sqrt(12.0)))
    assert (encoder_noise("", spec) == 0.0).all()
    path.write_text("identified: {noise: loud}\n")
    with pytest.raises(ConfigError, match=r"identified\.noise needs a number of rad from 0 for each of 16 joints"):
        encoder_noise(str(path), own)


def test_gains_after_a_gap_are_kalmans_and_become_the_steady_ones_again_to_the_last_bit() -> None:
    noise, T, M, B = np.full(1, 1e-4), 0.003, 0.003, 0.07
    one, whole = joint_filter(np.array([M]), np.array([B]), T, noise), np.ones(1, dtype=bool)
    steady = one.gains(whole).copy()
    A = np.array([[1.0, T, 0.0], [0.0, np.exp(-B * T / M), T / M], [0.0, 0.0, 1.0]])
    Q, C = np.diag([1e-14, (T / M * 3e-3) ** 2, 2e-3**2]), np.array([[1.0, 0.0, 0.0]])
    P = np.eye(3)
    for _ in range(3000):  # As in any textbook, and not in Joseph's form.
        P = A @ (P - P @ C.T @ C @ P / (P[0, 0] + noise[0] ** 2)) @ A.T + Q
    np.testing.assert_allclose(steady[:, 0], P[:, 0] / (P[0, 0] + noise[0] ** 2), rtol=1e-6)
    for _ in range(3):
        one.missed(np.zeros(1))
        P = A @ P @ A.T + Q
    np.testing.assert_allclose(one.gains(whole)[:, 0], P[:, 0] / (P[0, 0] + noise[0] ** 2), rtol=1e-6)
    again = [one.gains(whole).copy() for _ in range(300)]
    np.testing.assert_array_equal(again[-1], steady)


def test_an_error_in_speed_grows_in_a_gap_as_falling_friction_makes_it_grow(spec: HandSpec) -> None:
    own = replace(spec.actuation, frictionloss=np.full(N, 0.04))
    shape = {"stiction": 1.7, "stribeck_speed": 0.14, "bristle": 1e-3}
    breaking = replace(spec, actuation=own, drive=Drive.from_values(shape, N))

    def gap(speed: float) -> Array:
        """Of a middle joint, period by period: rad/s, and what is left of an error in it, (20, 2)."""
        each = StateObserver(breaking, drive_parameters(breaking, np.ones(N), np.zeros(N)), 0.003, bristly=True)
        each.reset((spec.lower + spec.upper) / 2.0)
        player, data, kept, rows = each._player, each._data, 1.0, []
        data.qvel[player.dofs][5] = speed
        data.act[player.bristles][5] = 1e-3 * (1.0 + 0.7 * np.exp(-((speed / 0.14) ** 2))) / 1.7
        balance = 0.04 * (1.0 + 0.7 * np.exp(-((0.1 / 0.14) ** 2))) + 0.1 * spec.actuation.damping[5]
        duty = np.where(np.arange(N) == 5, balance, 0.0)
        for _ in range(20):
            kept *= each._kept(duty)[5]
            rows.append((each.missed(duty, np.zeros(3), np.zeros(N)).velocity[5], kept))
        return np.array(rows)

    slow, middle, fast = gap(0.095), gap(0.1), gap(0.105)
    apart = fast[:, 0] - slow[:, 0]
    grew = apart[-1] / apart[7]  # Until then bristles bend.
    assert grew > 2.0
    assert middle[-1, 1] / middle[7, 1] == pytest.approx(grew, rel=0.2)


@pytest.mark.slow
def test_after_a_long_gap_no_new_touch_is_told_for_as_long_again_and_one_that_lasts_is(
    spec: HandSpec, make_sim: MakeSim
) -> None:
    push = np.zeros(N)
    push[5] = 0.06
    for lost in (round(DIM / 0.003) - 1, 20):  # Periods, before which the push begins.
        gap = (lost + 1) * 0.003
        _, touches = watch(spec, motion(spec, make_sim, {666: lost}, push))
        after = touches[0][0] - (666 * 0.003 + gap)
        assert {name for _, name in touches} == {"middle"}
        assert len(touches) > 100
        assert after == pytest.approx(gap + 0.005 if gap > DIM else 0.015, abs=0.007)


@pytest.mark.slow
def test_a_hand_is_stopped_by_a_touch_and_by_no_lost_report(spec: HandSpec, make_sim: MakeSim, tmp_path: Path) -> None:
    push = np.zeros(N)
    push[9] = 0.06
    lost = losses(0.03, 2)
    stops = ("contact", *NAMES)
    for _ in mirror(spec, np.full(N, LEARNED), stops).watch(motion(spec, make_sim, lost)):
        pass
    with pytest.raises(HandFault, match="something touches ring"):
        list(mirror(spec, np.full(N, LEARNED), stops).watch(motion(spec, make_sim, lost, push)))
    meta = {"calibration": {"version": "v4", "torque_constant": [1.0] * N}}
    for _ in record(motion(spec, make_sim, lost), tmp_path / "free.arrow", spec, 0.003, meta=dict(meta)):
        pass
    found = mirror_recording(tmp_path / "free.arrow", "", None)
    assert not found.contacts
    assert not found.faults


def test_thresholds_go_out_with_what_noise_alone_makes_now(spec: HandSpec) -> None:
    above, one = np.full((2, N), 0.01), np.ones(N)
    observer = StateObserver(spec, drive_parameters(spec, one, np.zeros(N)), 0.003)
    calm = Thresholds(above, np.full(4, np.inf), observer.spread)
    each = Mirror(spec, observer, one, calm)
    np.testing.assert_array_equal(each.contact_thresholds, above[0])
    observer.noisier(np.full(N, 4e-4))
    heard = np.ones(N, dtype=bool)
    for _ in range(100):
        observer._kalman.gains(heard)
    assert (each.contact_thresholds > 0.011).all()


def test_an_encoder_that_jumps_while_reports_are_lost_is_named(spec: HandSpec, make_sim: MakeSim) -> None:
    def jumps(samples: Iterator[Sample]) -> Iterator[Sample]:
        for state, command in samples:
            off: Array = np.where(np.arange(N) == 6, 0.03 * (state.t >= 2.4), 0.0)
            yield Sample(replace(state, position=frozen(state.position + off)), command)

    each, _ = watch(spec, jumps(motion(spec, make_sim, {799: 2})))
    assert [(one.fault.name, one.fault.joint) for one in each.faults] == [("encoder_step", 6)]


def test_a_late_state_that_ticks_count_as_lost_periods_is_known_by_how_far_the_joints_went(spec: HandSpec) -> None:
    speed, none = np.linspace(0.9, 1.1, N), np.zeros(N)
    estimate = Estimate(none, none, none, speed, none)

    def counted(*states: tuple[float, int, float], faster: float = 0.0) -> list[int]:
        """Of states that come this many periods after the last, by their stamps, by ticks, and by the motion, in which
        joints speed up, rad/s²."""
        lost, t, tick, where = LostPeriods(0.003), 0.0, 0, np.zeros(N)
        found: list[int] = []
        for stamped, ticks, went in ((1.0, 1, 1.0), *states):
            t, tick, where = t + 0.003 * stamped, tick + ticks, where + 0.003 * speed * went
            where += faster * (0.003 * went) ** 2 / 2.0
            state = HandState(t, tick, where, speed, none, np.full(N, np.nan), none[:3])
            found.append(lost.count(state, ticks, estimate if len(found) else None))
        return found[1:]

    assert counted((2.97, 3, 1), (0.93, 3, 3), (1.0, 1, 1)) == [1, 3, 1]  # As on a busy computer.
    assert counted((3.0, 3, 3), (1.0, 1, 1)) == [3, 1]
    assert counted((2.2, 1, 2), (1.0, 1, 1), (1.0, 2, 1)) == [2, 1, 1]
    assert counted((8.0, 8, 8), (1.0, 1, 1), faster=-20.0) == [8, 1]
    assert counted((2.4, 1, 1), (0.2, 1, 1), (1.0, 1, 1)) == [1, 1, 1]


def test_names_that_no_free_motion_told_about_are_said_to_be_off(spec: HandSpec) -> None:
    shapes = ("weak", "friction", "payload", "wrong_file", "supply")
    assert mirror(spec).unchecked_faults == shapes
    free, none = 0.002 * np.random.default_rng(0).standard_normal((8000, N)), np.zeros((8000, N), dtype=bool)
    rng = np.random.default_rng(1)
    for looks, off in ((79, shapes), (80, ())):
        calm = Thresholds.from_free_motion(
            free, none, np.zeros(N), FreeShapes(np.ones(N), 1e-6 * rng.exponential(size=(looks, 4))), 0.003, spec
        )
        assert calm.unchecked_faults == off
    found = MirrorResult(np.zeros(2), none, none, none, (), (), shapes)
    assert (
        "weak, friction, payload, wrong_file and supply are not looked for, because there is no --free"
        in missing_checks(found, None)
    )
    assert "f.arrow is too short: record 22 s" in missing_checks(found, Path("f.arrow"))


@pytest.mark.slow
def test_a_sample_that_an_imu_or_a_torque_missed_is_no_touch_and_no_fault(
    spec: HandSpec, make_sim: MakeSim, tmp_path: Path
) -> None:
    """A recording goes on with what came last, and a hand that runs with the last gravity."""
    unknown = frozen(np.full(N, np.nan))

    def without(samples: Iterator[Sample], column: str) -> Iterator[Sample]:
        for state, command in samples:
            lacks = replace(state, gravity=unknown[:3]) if column == "gravity" else replace(state, torque=unknown)
            yield Sample(lacks if state.tick == 500 else state, command)

    for column in ("gravity", "torque"):
        path, meta = tmp_path / f"{column}.arrow", {"calibration": {"version": "v4", "torque_constant": [1.0] * N}}
        seen = list(without(until(2.5, motion(spec, make_sim, {})), column))
        for _ in record(iter(seen), path, spec, 0.003, meta=meta):
            pass
        found = mirror_recording(path, "", None)
        assert not found.contacts
        assert not found.faults
        assert np.isfinite(found.disturbance).all()
        each, touches = watch(spec, iter(seen))
        assert not touches
        assert not each.faults


def test_a_mirror_that_no_longer_hears_where_down_is_says_so(spec: HandSpec, make_sim: MakeSim) -> None:
    def without(samples: Iterator[Sample]) -> Iterator[Sample]:
        for state, command in samples:
            yield Sample(replace(state, gravity=frozen(np.full(3, np.nan))) if state.tick > 100 else state, command)

    with pytest.raises(ConfigError, match=r"has not said where down is since 0\.300 s"):
        watch(spec, without(motion(spec, make_sim, {})))
