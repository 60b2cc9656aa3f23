"""A hand that answers, from a config: assembled, run, recorded, and refused with the way out."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.app.rig import assemble
from allegro_twin.app.session import recording_meta
from allegro_twin.drivers.polled.backend import PolledBackend
from allegro_twin.errors import ConfigError, LinkError, LinkTimeout
from allegro_twin.files.schema import parse_settings
from allegro_twin.loop import run, until
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.twin.branch.what_if import branch_recording
from tests.drivers.serial.polled_rigs import polled_config

HANDS = {"qb_softhand": "qb", "sih": "schunk"}


@pytest.mark.parametrize("name", ["qb_softhand_virtual", "sih_virtual"])
def test_a_virtual_hand_goes_where_its_config_says_and_its_time_is_its_own(name: str) -> None:
    rig = assemble(load_config(name))
    assert isinstance(rig.driver, PolledBackend)
    assert not rig.live
    with closing(rig.backend):
        last = list(until(3.0, run(rig.backend, rig.controller)))[-1].state
    middle = (rig.spec.lower + rig.spec.upper) / 2
    assert (np.abs(last.position) <= rig.spec.upper + 0.01).all()
    assert last.position.shape == middle.shape


@pytest.mark.parametrize("hand", HANDS)
def test_through_its_wire_a_hand_goes_where_it_goes_without_it(hand: str) -> None:
    config = polled_config(hand, HANDS[hand])
    content = config.model_dump(exclude={"backend"}) | {"backend": {"kind": "sim"}}
    wired, alone = assemble(config), assemble(parse_settings(RunConfig, content, "test"))
    pairs = zip(until(0.5, run(wired.backend, wired.controller)), run(alone.backend, alone.controller), strict=False)
    for there, here in pairs:
        np.testing.assert_allclose(there.state.position, here.state.position, atol=0.01)
    wired.backend.close()


@pytest.mark.slow
@pytest.mark.parametrize(("hand", "scenario"), [("qb_softhand", "qb_softhand_apple"), ("sih", "sih_lemon")])
def test_a_hand_picks_its_object_up_through_its_wire_turns_it_and_shakes_it(hand: str, scenario: str) -> None:
    content = polled_config(hand, HANDS[hand]).model_dump(exclude_unset=True, exclude={"seconds"})
    rig = assemble(parse_settings(RunConfig, content | {"period": 0.01, "task": {"scenario": scenario}}, "test"))
    assert rig.trial is not None
    assert rig.seconds is not None
    for sample in until(rig.seconds, run(rig.backend, rig.controller)):
        rig.trial.see(sample.state)
    rig.backend.close()
    assert rig.trial.report().held


@pytest.mark.parametrize("hand", HANDS)
def test_a_recording_says_what_its_ticks_were_worth_and_goes_on_as_it_did(hand: str, tmp_path: Path) -> None:
    config = polled_config(hand, HANDS[hand], faults={"script": [{"at": 9.0, "what": "torn_tendon"}]})
    rig = assemble(config)
    samples = until(0.3, run(rig.backend, rig.controller))
    for _ in record(samples, tmp_path / "r.arrow", rig.spec, 0.02, meta=recording_meta(rig, config)):
        pass
    rig.backend.close()
    table = load(tmp_path / "r.arrow").meta["calibration"]
    assert table["most"] in (19_000, 65_535)
    assert len(table["per_milliampere"]) == rig.spec.n_actuators
    both = branch_recording(tmp_path / "r.arrow", 0.1, {})
    np.testing.assert_array_equal(both.branched, both.recorded)


def test_faults_of_a_config_happen() -> None:
    rig = assemble(polled_config("sih", "schunk", faults={"script": [{"at": 0.1, "what": "silence"}]}))
    with pytest.raises(LinkTimeout, match="sih_right on virtual sih_right is silent"):
        for _ in run(rig.backend, rig.controller):
            pass
    rig.backend.close()


@pytest.mark.parametrize(
    ("hand", "kind", "backend", "names"),
    [
        ("sih", "schunk", {"mode": "velocity"}, "backend.mode velocity: sih_right takes position$"),
        ("qb_softhand", "qb", {"mode": "current"}, "backend.mode current: qb_softhand_right takes position, timed_pos"),
        ("sih", "qb", {}, "kind qb is for 1 motors that go to positions; sih_right has 5 actuators and takes position"),
        ("qb_softhand", "schunk", {}, "kind schunk is for 5 motors"),
        ("allegro", "schunk", {}, "allegro_right has 16 actuators and takes torque"),
        ("qb_softhand", "qb", {"baud": 115200}, "backend.baud is 115200; such a hand has 2000000 or 460800"),
        ("sih", "schunk", {"baud": 115200}, "backend.baud is 115200; such a hand has 1000000"),
        ("qb_softhand", "qb", {"id": 200}, "backend.id: input should be less than or equal to 127"),
        ("sih", "schunk", {"id": 1}, "backend.id: unknown key"),
        (
            "sih",
            "schunk",
            {"latency": 0.1},
            "backend.latency: the wire of a virtual hand is inside this program and has none",
        ),
        ("sih", "schunk", {"torque_per_ampere": [1.0, 2.0]}, "torque_per_ampere needs one number above 0 or 5"),
        ("sih", "schunk", {"watchdog": 9.0}, "watchdog 9 s must be from 0.02 to 5 s"),
        ("sih", "schunk", {"faults": {"script": [{"at": 0, "what": "torn"}]}}, "torn"),
        ("sih", "schunk", {"faults": {"script": [{"at": 0, "what": "dead_motor", "which": 5}]}}, "hand has 5 actuat"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(hand: str, kind: str, backend: dict[str, Any], names: str) -> None:
    with pytest.raises(ConfigError, match=names) as caught:
        assemble(polled_config(hand, kind, **backend))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["pd", "pid", "torque", "gravity"])
def test_a_controller_of_torques_is_refused_with_what_the_hand_takes(kind: str) -> None:
    config = polled_config("sih", "schunk").changed(controller={"kind": kind})
    with pytest.raises(ConfigError, match="commands torques; sih_right takes position: use position or limp"):
        assemble(config)


def test_a_hand_whose_file_says_nothing_of_its_motors_needs_to_be_told(tmp_path: Path) -> None:
    from tests.hands.models import made

    card = made("soft", tmp_path)
    with pytest.raises(ConfigError, match=r"torque_per_ampere is missing, and .*soft.yaml has no block `line`"):
        assemble(polled_config(str(card), "qb"))
    rig = assemble(polled_config(str(card), "qb", torque_per_ampere=2.0))
    rig.backend.close()
    card.write_text(card.read_text() + "line: {torque_per_amper: 2.0}\n")
    with pytest.raises(ConfigError, match=r"soft.yaml: line: torque_per_amper: unknown key; did you mean"):
        assemble(polled_config(str(card), "qb"))


def test_a_period_that_the_line_cannot_carry_is_refused() -> None:
    config = polled_config("sih", "schunk").changed(period=0.0005)
    with pytest.raises(ConfigError, match=r"period 0.0005 s is too short at 1000000 baud: 96 bytes take 0.00096 s"):
        assemble(config)


def test_a_port_that_is_not_there_is_one_line() -> None:
    with pytest.raises(LinkError, match="cannot open /dev/nowhere"):
        assemble(polled_config("sih", "schunk", port="/dev/nowhere"))
