"""The mirror of a hand that closes its own loop: what is driven is compared, with what the same loop does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.app.config import load_config
from allegro_twin.control.controllers import PositionControl
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_posture
from allegro_twin.loop import run, until
from allegro_twin.recording.recorder import record
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.observer.kalman import JointKalman
from allegro_twin.sim.observer.loop_observer import NOISE, motor_dynamics
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.cli.twin import mirror_run
from allegro_twin.twin.mirror.factory import make_loop_mirror
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.twin.mirror.on_recording import mirror_recording
from allegro_twin.types import Array, Sample, Vector
from tests.conftest import MakeSim
from tests.hands.models import HANDS, SOFT, hand

PUSHED = 1.3  # s.
OPEN = {"model_o": np.array([0.0, 0.6, 0.6, 0.6]), "qb_softhand": np.array([0.2])}


def middle(spec: HandSpec) -> Vector:
    return OPEN[spec.model] if spec.model in OPEN else np.asarray(load_posture("home", spec) + 0.2)


def moving(sim: SimBackend, finger: str = "", newtons: float = -0.5) -> Iterator[Sample]:
    """2 s to and fro about an open posture; a fingertip is pushed along the palm's x from PUSHED on."""
    spec, span = sim.spec, sim.spec.upper - sim.spec.lower
    moves = Moves([Waypoint(middle(spec) + d * span * (middle(spec) != 0.0), seconds=0.6) for d in (0.04, -0.04, 0.03)])
    for sample in until(2.2, run(sim, PositionControl(moves))):
        if finger and sample.state.t >= PUSHED:
            body = int(sim.model.site(spec.finger(finger).tip).bodyid[0])
            sim.data.xfrc_applied[body, 0] = newtons
        yield sample


def estimates(each: Mirror, samples: Iterator[Sample]) -> tuple[Vector, Array, Array]:
    """Times, disturbances, and how far what was expected was off."""
    rows = [
        (s.state.t, each.columns()["disturbance"], s.state.position - each.columns()["predicted"])
        for s in each.watch(samples)
    ]
    t, disturbance, off = (np.array(column) for column in zip(*rows[1:], strict=True))
    return t, disturbance, off


@pytest.mark.parametrize("name", ["leap", "model_o", "qb_softhand"])
def test_a_free_hand_in_its_own_loop_moves_as_expected(name: str, make_sim: MakeSim) -> None:
    spec = load_spec(name)
    sim = make_sim(spec, posture=middle(spec), period=0.02)
    each = make_loop_mirror(spec, 0.02)
    t, disturbance, off = estimates(each, moving(sim))
    late = t > 1.0
    assert np.abs(off[late]).max() < 1e-4
    assert (np.abs(disturbance[late]).max(axis=0) < 1e-3 * spec.actuation.torque_limit).all()
    assert each.contacts == ()


@pytest.mark.slow
def test_the_disturbance_of_a_servo_is_the_torque_from_outside(make_sim: MakeSim) -> None:
    spec = load_spec("leap")
    sim, push = make_sim(spec, posture=middle(spec)), np.zeros(16)
    push[[5, 6]] = 0.05, -0.03

    def led(samples: Iterator[Sample]) -> Iterator[Sample]:
        for sample in samples:
            if sample.state.t >= PUSHED:
                sim.push(push)
            yield sample

    each = make_loop_mirror(spec, 0.003)
    t, disturbance, _ = estimates(each, led(moving(sim)))
    np.testing.assert_allclose(disturbance[t > 1.7].mean(axis=0), push, atol=2e-3)
    assert each.contacts == ("middle",)


def test_a_push_on_a_tendon_finger_is_felt_by_the_motor_that_pulls_it(make_sim: MakeSim) -> None:
    spec = load_spec("model_o")
    sim = make_sim(spec, posture=middle(spec))
    t, disturbance, _ = estimates(make_loop_mirror(spec, 0.003), moving(sim, "thumb"))
    felt = np.abs(disturbance[t > 1.7].mean(axis=0))
    assert felt[spec.joints.index("thumb")] > 0.02
    assert np.delete(felt, spec.joints.index("thumb")).max() < 1e-3


def test_a_hand_with_one_motor_cannot_tell_which_finger_is_touched(make_sim: MakeSim) -> None:
    spec = load_spec("qb_softhand")
    sim, each = make_sim(spec, posture=middle(spec)), make_loop_mirror(spec, 0.003)
    seen = {each.contacts for _ in each.watch(moving(sim, "middle", -20.0))}
    assert seen == {(), tuple(finger.name for finger in spec.fingers)}


@pytest.mark.slow
def test_a_touch_of_a_hand_in_its_own_loop_can_stop_it(make_sim: MakeSim) -> None:
    spec = load_spec("leap")
    sim = make_sim(spec, posture=middle(spec))
    with pytest.raises(HandFault, match="something touches middle: .* is pushed by"):
        estimates(make_loop_mirror(spec, 0.003, stop=("contact",)), moving(sim, "middle", -2.0))


def test_the_filter_corrects_a_heavy_motor_no_faster_and_a_stiff_loop_stays_stable() -> None:
    light, heavy = (gains(m, 3.0, 0.1, 0.3, 0.003) for m in (0.003, 0.006))
    assert 0.0 < heavy[0] < light[0] < 1.0
    assert (gains(0.003, 300.0, 0.1, 0.3, 0.02) > 0.0).all()


def gains(*of: float) -> Vector:
    A, Q = motor_dynamics(*of)
    return JointKalman(A[None], Q[None], np.array([NOISE]), of[-1]).gains(np.ones(1, dtype=bool))[:, 0]


@pytest.mark.slow
def test_a_recording_of_any_hand_plays_past_its_mirror_and_says_where_down_is_or_is_told(
    make_sim: MakeSim, tmp_path: Path
) -> None:
    spec = load_spec("leap")
    sim = make_sim(spec, posture=middle(spec))
    for name, meta in (("told", {}), ("known", {"gravity": [0.0, 0.0, -9.81]})):
        lost = (Sample(replace(s.state, gravity=np.full(3, np.nan)), s.command) for s in moving(sim))
        for _ in record(lost, tmp_path / f"{name}.arrow", spec, 0.003, meta=dict(meta)):
            pass
    with pytest.raises(ConfigError, match="must know where down is: --gravity"):
        mirror_recording(tmp_path / "told.arrow", "", None)
    one = mirror_recording(tmp_path / "told.arrow", "", None, mirror_run.parse_gravity("0,0,-9.81"))
    other = mirror_recording(tmp_path / "known.arrow", "", None)
    np.testing.assert_array_equal(one.disturbance, other.disturbance)
    assert one.contacts == ()
    with pytest.raises(ConfigError, match="of a leap_right, and model_o_right has other joints: say --hand"):
        mirror_recording(tmp_path / "known.arrow", "model_o", None)


@pytest.mark.parametrize("text", ["down", "0,0", "0,0,nan"])
def test_gravity_is_three_numbers(text: str) -> None:
    with pytest.raises(ConfigError, match="three numbers with commas between"):
        mirror_run.parse_gravity(text)


def test_a_hand_whose_tendon_runs_through_space_says_that_it_has_no_mirror(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sites = '<site name="a" pos="0 0.02 0.02"/>'
    through = (
        SOFT.replace('<body name="first" pos', f'{sites}<body name="first" pos')
        .replace('size="0.008" mass="0.02"/>', 'size="0.008" mass="0.02"/><site name="b" pos="0.03 0 -0.01"/>', 1)
        .replace('<fixed name="synergy">', '<fixed name="unused">')
        .replace("</tendon>", '<spatial name="synergy"><site site="a"/><site site="b"/></spatial></tendon>')
        .replace('ctrlrange="0 1"', 'ctrlrange="0.05 0.09"')
    )
    monkeypatch.setitem(HANDS, "through", through)
    spec = hand("through", tmp_path)
    with pytest.raises(ConfigError, match="cannot be mirrored: a tendon through space says not where its joints are"):
        make_loop_mirror(spec, 0.003)


@pytest.mark.slow
def test_a_virtual_leap_hand_on_its_servos_line_is_mirrored_with_their_counts(tmp_path: Path) -> None:
    pytest.importorskip("dynamixel_sdk", reason="the servos' own SDK: extra dynamixel")
    config = load_config("leap_virtual")
    record = tmp_path / "it.arrow"
    found, ended = mirror_run.run_with_mirror(
        config, "", mirror_run.MirrorOutputs(record=record), lambda t: None, lambda text: None, lambda text: None
    )
    assert ended is None
    assert found is not None
    assert found.contacts == ()
    assert np.abs(found.residual[found.t > 1.0]).max() < 0.005
    again = mirror_recording(record, "", None)
    np.testing.assert_array_equal(again.disturbance, found.disturbance)
