"""A checkup walks a link in steps, says what to do about the first that is broken, and never moves the hand."""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import Any

import numpy as np
import pytest

from allegro_twin.app.rig import SimulatedScene
from allegro_twin.app.serve_can import virtual_firmware
from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.frames import Frame, JointFrames, single
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.can.link.adapter import AdapterLink
from allegro_twin.drivers.can.opening import codec_of, host_settings
from allegro_twin.drivers.can.tools import findings
from allegro_twin.drivers.can.tools.checkup import Checkup
from allegro_twin.drivers.can.tools.findings import Finding
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.drivers.can.virtual.lockstep import LockstepBus
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
from allegro_twin.errors import ConfigError, HandFault, LinkError, LinkTimeout
from allegro_twin.hands.description.calibration import Version
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.spec import HandSpec
from tests.conftest import can_config

ALL = ["interface", "bus", "identity", "fingers", "reports", "motors", "temperature", "joints", "load", "limp", "side"]
STAMPS = list(np.arange(667) * 0.003)


class Room(VirtualHands):
    """Hands on a bus, with what was said to them, and with somebody else who talks at every tick; `deaf`: to these the
    hand does not listen, or only after so many."""

    def __init__(
        self, firmware: Firmware, faults: Any, noise: tuple[Frame, ...], off_at: float, deaf: dict[type, float]
    ) -> None:
        super().__init__([firmware], faults)
        self.said: list[Frame] = []
        self._noise, self._off_at, self._deaf = noise, off_at, dict(deaf)

    def receive(self, frame: Frame | JointFrames) -> list[Frame]:
        self.said += single([frame])
        if isinstance(frame, Frame) and not frame.remote:
            kind = type(self.firmwares[0].codec.decode(frame))
            if self._deaf.get(kind, 0) > 0:
                self._deaf[kind] -= 1
                return []
        return super().receive(frame)

    def step(self) -> list[Frame | JointFrames]:
        if self.now >= self._off_at:
            self.firmwares[0].receive(self.firmwares[0].codec.encode(m.ServoOff()))
        return [*self._noise, *single(super().step())]


def walk_of(
    said: Version = "v4",
    really: Version | None = None,
    *,
    noise: tuple[Frame, ...] = (),
    off_at: float = math.inf,
    reporting: bool = False,
    serials: tuple[str, str] = ("", ""),
    side: str = "right",
    deaf: dict[type, float] = {},  # noqa: B006  # It is copied.
    reports_every: float = 0.003,
    **backend: Any,
) -> tuple[Generator[Finding], Room]:
    """A checkup with a config that says one thing, of a hand that is another; its findings to come, and the hand."""
    ours, theirs = can_config(said, **backend), can_config(really or said, side=side, **backend)  # type: ignore[arg-type]
    ours, theirs = (
        config.model_copy(update={"hand": config.hand.model_copy(update={"serial": serial})})
        for config, serial in zip((ours, theirs), serials, strict=True)
    )
    assert isinstance(ours.backend, CanSettings)
    hand = virtual_firmware(theirs, SimulatedScene(), step=reports_every, restart=False)
    if reporting:
        for message in (*hand.codec.opening(reports_every, 0.0, 0.0), m.ServoOn()):
            hand.receive(hand.codec.encode(message))
    room = Room(hand, ours.backend.faults, noise, off_at, deaf)
    link, codec = AdapterLink(LockstepBus(room)), codec_of(ours.backend, ours.hand)
    return Checkup(load_spec(), codec, link.port, host_settings(ours.backend, ours.period)).walk(), room


def walked(*versions: Version, **hand: Any) -> tuple[list[Finding], Room]:
    """What such a checkup finds, and the hand."""
    walk, room = walk_of(*versions, **hand)
    return list(walk), room


def broken(found: list[Finding]) -> Finding:
    """The last finding, which must be the only one that is broken."""
    assert [finding.ok for finding in found] == [True] * (len(found) - 1) + [False]
    assert found[-1].remedy
    return found[-1]


@pytest.mark.parametrize("version", ["v1", "v2", "v3", "v4", "v5", "v5plus"])
def test_a_hand_of_every_version_passes_and_was_told_nothing_but_zero_torque(version: Version) -> None:
    found, room = walked(version)
    assert [finding.name for finding in found] == ALL
    assert all(finding.ok for finding in found)
    (hand,) = room.firmwares
    torques = [message for frame in room.said if isinstance(message := hand.codec.decode(frame), m.SetTorque)]
    assert len(torques) > 1000
    assert {torque.torque for torque in torques} == {(0.0, 0.0, 0.0, 0.0)}
    assert not hand.serving
    assert room.step() == []


@pytest.mark.parametrize(
    ("faults", "step", "text", "kind"),
    [
        ({"script": [{"at": 0.0, "what": "power_cut"}]}, "identity", "no v4 hand answers", LinkTimeout),
        ({"script": [{"at": 0.0, "what": "bus_off"}]}, "bus", "is bus-off", LinkError),
        ({"script": [{"at": 0.0, "what": "silence", "which": 2}]}, "fingers", "ring silent", LinkTimeout),
        ({"script": [{"at": 1.5, "what": "silence", "which": 2}]}, "reports", "lost", LinkError),
        ({"script": [{"at": 1.0, "what": "joint_timeout"}]}, "reports", "JOINT_TIMEOUT", HandFault),
        ({"drop": 0.1}, "reports", "lost", LinkError),
    ],
)
def test_the_first_broken_step_is_the_last(faults: dict[str, Any], step: str, text: str, kind: type[Exception]) -> None:
    found, _ = walked(faults=faults)
    last = broken(found)
    assert (last.name, last.broken) == (step, kind)
    assert text in last.text
    assert [finding.name for finding in found] == ALL[: len(found)]


def test_a_hand_that_switches_its_motors_off_by_itself_is_a_fault() -> None:
    last = broken(walked(off_at=0.9)[0])
    assert (last.name, last.text, last.broken) == ("reports", "the hand switched its motors off", HandFault)


def test_a_hand_that_is_not_left_limp_is_a_broken_row_whatever_else_is_in_order() -> None:
    last = broken(walked(deaf={m.ServoOff: math.inf})[0])
    assert (last.name, last.remedy, last.broken) == ("limp", "cut its power", HandFault)
    assert last.text == "the hand has not confirmed that it is limp (it says that its motors are still on)"
    last = broken(walked("v2", deaf={m.ServoOff: math.inf})[0])
    assert last.text == "the hand has not confirmed that it is limp (it goes on reporting)"
    found, _ = walked(faults={"script": [{"at": 1.5, "what": "power_cut"}]})
    assert [(finding.name, finding.ok) for finding in found[-2:]] == [("reports", False), ("limp", False)]
    assert "(it does not answer)" in found[-1].text


def test_a_checkup_that_is_broken_off_leaves_the_hand_limp_or_logs_that_it_has_not(
    caplog: pytest.LogCaptureFixture,
) -> None:
    obeys, keeps_on = dict[type, float](), dict[type, float]({m.ServoOff: math.inf})
    for deaf, lines in (obeys, []), (keeps_on, ["(it says that its motors are still on): cut its power"]):
        caplog.clear()
        walk, room = walk_of(deaf=deaf)
        while next(walk).name != "fingers":
            pass
        assert room.firmwares[0].serving
        walk.close()
        assert room.firmwares[0].serving == bool(deaf)
        assert [record.message.partition("limp ")[2] for record in caplog.records] == lines


def test_motors_that_never_go_on_are_a_broken_row_and_a_frame_that_is_lost_is_sent_again() -> None:
    servo = {"servo": "ignored"}  # It reports all the same.
    last = broken(walked(deaf={m.ServoOn: math.inf}, firmware=servo)[0])
    assert (last.name, last.broken) == ("motors", HandFault)
    assert last.text == "the hand was told 3 times to switch them on, and says that they are off"
    found, _ = walked(deaf={m.ServoOn: 2}, firmware=servo)
    assert (found[5].text, len(found)) == ("on, says the hand", len(ALL))
    assert walked("v2")[0][5].text == "a v2 hand has not said whether they are on"


def test_a_hand_that_answers_and_never_switches_its_motors_on_is_not_said_to_have_a_bad_cable() -> None:
    last = broken(walked(deaf={m.ServoOn: math.inf})[0])
    assert (last.name, last.broken) == ("fingers", HandFault)
    assert last.text == (
        "none reports, though the hand answers that its motors are off: it was told 3 times to switch them on"
    )
    assert last.remedy == "switch the hand off and on; check its supply"
    last = broken(walked(deaf={m.SetPeriod: math.inf})[0])
    assert last.text == "none reports, though the hand answers that its motors are on"


def test_a_hand_that_must_not_be_driven_is_refused_before_its_motors_go_on() -> None:
    found, room = walked(faults={"script": [{"at": 0.0, "what": "joint_timeout"}]})
    last = broken(found)
    assert (last.name, last.broken) == ("identity", HandFault)
    assert "JOINT_TIMEOUT" in last.text
    assert not any(isinstance(make_codec("v4").decode(frame), m.ServoOn) for frame in room.said)


@pytest.mark.parametrize("every", [0.001, 0.002, 0.004, 0.006])
def test_a_hand_with_another_period_than_the_configs_is_not_said_to_have_a_bad_cable(every: float) -> None:
    last = broken(walked(reporting=True, reports_every=every, deaf={m.SetPeriod: math.inf})[0])
    assert (last.name, last.broken) == ("reports", ConfigError)
    assert last.remedy == "the config says period: 0.003 s; set what the hand does"


def test_a_run_says_who_reports_instead_of_the_configs_hand(spec: HandSpec) -> None:
    theirs, ours = can_config("v4"), can_config("v2")
    hand = virtual_firmware(theirs, SimulatedScene(), step=0.003, restart=False)
    for message in (m.SetPeriod(0.003), m.ServoOn()):
        hand.receive(hand.codec.encode(message))
    assert isinstance(ours.backend, CanSettings)
    link = AdapterLink(LockstepBus(VirtualHands([hand])))
    backend = CanBackend(spec, codec_of(ours.backend, ours.hand), link.port, host_settings(ours.backend, ours.period))
    with pytest.raises(
        LinkTimeout, match=r"a v2 \(but a v4, v5 or v5plus hand reports: correct `version`\), for 0.5 s"
    ):
        backend.reset()


def test_a_few_lost_reports_are_told_but_no_reason_to_stop() -> None:
    found, _ = walked(faults={"drop": 0.005})
    (reports,) = [finding for finding in found if finding.name == "reports"]
    assert "0 of 667 lost" not in reports.text
    assert len(found) == len(ALL)


@pytest.mark.parametrize("message", [m.SetTorque(1, (0.1, 0.0, 0.0, 0.0)), m.SetPeriod(0.002)])
def test_another_program_that_commands_the_hand_is_found_before_anything_is_said(message: m.Message) -> None:
    frame = make_codec("v4").encode(message)
    found, room = walked(noise=(frame,))
    last = broken(found)
    assert (last.name, last.remedy, last.broken) == ("bus", "stop one of the two", LinkError)
    assert f"another program commands this hand: {type(message).__name__}, frame {frame}" in last.text
    assert not room.firmwares[0].serving


@pytest.mark.parametrize(
    ("said", "really", "step", "text"),
    [
        ("v4", "v2", "identity", "(but a v1, v2 or v3 hand reports)"),
        ("v2", "v4", "fingers", "none reports, but a v4, v5 or v5plus hand does"),
        ("v5", "v4", "identity", "hardware 0x0400, which is no v5 hand"),
        ("v4", "v5", "identity", "hardware 0x0500, which is no v4 hand"),
        ("v5", "v5plus", "identity", "serial 5TBR0001 is a v5plus hand"),
    ],
)
def test_a_hand_of_another_version_than_the_config_says(said: Version, really: Version, step: str, text: str) -> None:
    last = broken(walked(said, really, reporting=True)[0])
    assert last.name == step
    assert text in last.text
    assert "version" in last.remedy


def test_the_other_side_is_found_where_the_hand_tells_and_left_open_where_it_does_not() -> None:
    last = broken(walked("v4", side="left")[0])
    assert (last.name, last.text) == ("identity", "this is a left hand")
    assert last.remedy == "the config says right: correct `hand: {side: …}`"
    found, _ = walked("v2", side="left")
    assert "cannot be told from here; make sure that it is a right hand" in found[-1].text


def test_somebody_elses_encoder_table_puts_joints_out_of_range() -> None:
    last = broken(walked("v2", serials=("SAH020BR013", ""))[0])
    assert (last.name, last.broken) == ("joints", ConfigError)
    assert last.text == "out of range: ring_2 -0.65 rad (range -0.17 to +1.71)"
    assert "this very hand's" in last.remedy


def test_others_on_the_bus_are_named_and_counted_in_its_load() -> None:
    neighbour = make_codec("v4", device=2)
    noise = tuple(neighbour.encode(m.FingerPosition(k, (0.0, 0.0, 0.0, 0.0))) for k in range(4))
    alone, _ = walked()
    found, _ = walked(noise=(*noise, Frame(0x7FF, b"\x01")))
    assert found[-3].text.startswith("57% of 1 Mbit/s measured; this hand takes 36% at worst; a v4 (device 2)")
    assert "frames with unknown identifiers" in found[-3].text
    assert alone[-3].text == "36% of 1 Mbit/s measured; this hand takes 36% at worst"


def test_a_hand_that_does_not_answer_passes_where_the_config_says_so() -> None:
    silent = {"drop": 0.0, "script": [{"at": 0.0, "what": "power_cut"}, {"at": 0.6, "what": "recover"}]}
    found, _ = walked(identify=False, faults=silent)
    assert found[2].text == "does not answer; fine, for a v4 hand was not told to (`identify: false`)"
    assert len(found) == len(ALL)


def test_a_bus_that_does_not_open_is_the_first_finding(spec: HandSpec) -> None:
    def refuse() -> Any:
        raise LinkError("socketcan can7 does not open: no such device; plug the adapter in")

    (only,) = Checkup(spec, make_codec("v4"), refuse, host_settings(can_config("v4").backend, 0.003)).walk()  # type: ignore[arg-type]
    assert (only.name, only.remedy, only.broken) == ("interface", "plug the adapter in", LinkError)


def test_error_frames_point_to_the_bitrate() -> None:
    found = findings.bus(0, 0.3, 12, 500_000, "", "")
    assert (found.text, found.broken) == ("silent, as a hand is until it is told to report, 12 error frames", LinkError)
    assert "500000 bit/s" in found.remedy


def test_reports_are_judged_by_their_period_their_losses_and_their_longest_gap() -> None:
    good = findings.timing(STAMPS, 2.0, 0.003, 0, 0.05)
    assert good.text == ("333.5 a second; interval p50 3.00, p99 3.00, worst 3.00 ms; 0 of 667 lost, 0 incomplete")
    slow = findings.timing(STAMPS[::2], 2.0, 0.003, 0, 0.05)
    assert (slow.broken, "period: 0.003 s" in slow.remedy) == (ConfigError, True)
    gap = findings.timing([*STAMPS[:300], *STAMPS[320:]], 2.0, 0.003, 0, 0.05)
    assert (gap.broken, "worst 63.00 ms; 19 of 667 lost" in gap.text) == (LinkError, True)
    rng = np.random.default_rng(1)
    for every, kind in ((0.002, ConfigError), (0.003, None), (0.004, ConfigError), (0.006, ConfigError)):
        times = np.arange(0.0, 2.0, every)
        scattered = np.sort(times + rng.uniform(0.0, 0.0016, len(times)))
        assert findings.timing(list(scattered), 2.0, 0.003, 0, 0.05).broken is kind, every
    lossy = findings.timing([t for t in STAMPS if rng.random() > 0.25], 2.0, 0.003, 0, 0.05)
    assert (lossy.broken, "cable" in lossy.remedy) == (LinkError, True)
    torn = findings.timing(STAMPS[::2], 2.0, 0.003, 100, 0.05)
    assert (torn.broken, "cable" in torn.remedy) == (LinkError, True)
    bursts = findings.timing([t // 0.012 * 0.012 + 1e-4 * k for k, t in enumerate(STAMPS)], 2.0, 0.003, 0, 0.05)
    assert bursts.ok  # A busy computer reads late, the hand is not to blame.


def test_temperatures_are_judged_as_the_guard_does() -> None:
    assert findings.temperature(np.full(16, np.nan), "v2").ok
    warm, hot = np.full(16, 30.0), np.full(16, 30.0)
    warm[3], hot[3] = 62.0, 75.0
    assert findings.temperature(warm, "v4").text == "30 to 62 °C, warm: the guard lets less torque through"
    assert findings.temperature(hot, "v4").broken is HandFault


def test_joints_that_cannot_be_are_named(spec: HandSpec) -> None:
    rest = np.clip(np.linspace(0.0, 0.1, 16), spec.lower, spec.upper)
    bent = rest.copy()
    bent[1] = spec.upper[1] + findings.BEYOND - 0.01
    assert findings.joints(np.array([rest, rest]), spec, "v4").ok
    assert findings.joints(np.array([bent, bent]), spec, "v4").ok
    bent[1] += 0.02
    assert (
        findings.joints(np.array([bent]), spec, "v4").text == "out of range: index_1 +1.77 rad (range -0.20 to +1.61)"
    )
    low = rest.copy()
    low[1] = spec.lower[1] - findings.BEYOND + 0.01
    assert findings.joints(np.array([low, low]), spec, "v4").ok
    bent[1] = rest[1] + 0.2
    jumping = findings.joints(np.array([rest, bent]), spec, "v4")
    assert jumping.text == "index_1 jumps by 0.20 rad between two reports"
    dead = findings.joints(np.zeros((3, 16)), spec, "v4")
    assert (dead.text, dead.broken) == ("all read 0.000 rad", LinkError)
