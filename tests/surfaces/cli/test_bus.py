"""Commands for buses: what they show, their exit codes, and one line with the way out for whatever is wrong."""

from __future__ import annotations

import errno
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import can
import pytest
import yaml

from allegro_twin.app.config import load_config
from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import Message
from allegro_twin.drivers.can.codec.text import describe
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.link.buses import open_bus
from allegro_twin.drivers.can.tools.sniff import Sniffer
from allegro_twin.errors import ConfigError
from allegro_twin.recording.reader import load
from allegro_twin.surfaces.cli.hand_override import on_hand
from allegro_twin.surfaces.cli.twin.rehearse import config_of
from tests.patience import wait_for
from tests.surfaces.cli.conftest import Run
from tests.surfaces.cli.test_main import SUITE, allegro_twin

V2, V4 = make_codec("v2"), make_codec("v4")


@pytest.fixture
def config(tmp_path: Path) -> Any:
    """Write a config of a hand on a bus."""

    def write(hand: dict[str, Any] | None = None, **backend: Any) -> Path:
        path = tmp_path / "bus.yaml"
        content = {
            "hand": hand or {},
            "backend": {"kind": "can", "version": "v4", "interface": "allegro-virtual", **backend},
            "controller": {"kind": "pid", "gravity": [0, 0, -9.81]},
            "seconds": 0.6,
        }
        path.write_text(yaml.safe_dump(content))
        return path

    return write


def can_message(message: Message | Frame, codec: Any = V4) -> can.Message:
    frame = message if isinstance(message, Frame) else codec.encode(message)
    return can.Message(
        arbitration_id=frame.id,
        is_extended_id=False,
        data=frame.data,
        is_remote_frame=frame.remote,
        dlc=len(frame.data),
    )


def test_a_checkup_is_a_table_with_a_row_a_step(command: Run) -> None:
    code, shown, errors = command("check", "can_virtual")
    assert (code, errors) == (0, "")
    steps = re.findall(r"│ (\w+) +│ ok +│", shown)
    assert steps == [
        "interface", "bus", "identity", "fingers", "reports", "motors", "temperature", "joints", "load", "limp", "side",
    ]  # fmt: skip
    assert "333.0 a second; interval p50 3.00, p99 3.00, worst 3.00 ms; 0 of 667 lost" in shown


def test_a_checkup_in_a_notebook_is_one_table(command: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Notebooks set FORCE_COLOR, and keep all that is printed."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    _, shown, _ = command("check", "can_virtual")
    assert "\x1b[32mok" in shown
    assert (shown.count("interface"), shown.count("\x1b[2K")) == (1, 0)


@pytest.mark.parametrize(
    ("backend", "code", "row", "error"),
    [
        (
            {"interface": "slcan", "channel": "nowhere.tty"},
            3,
            "interface",
            "interface: slcan nowhere.tty does not open",
        ),
        ({"faults": {"script": [{"at": 0.0, "what": "silence", "which": 3}]}}, 3, "fingers", "fingers: thumb silent; "),
        ({"faults": {"script": [{"at": 1, "what": "joint_timeout"}]}}, 4, "reports", "a joint no longer answers"),
        ({"version": "v5", "scene": None, "faults": None}, 0, "side", ""),
    ],
)
def test_a_checkup_ends_with_the_exit_code_of_what_is_broken(
    backend: dict[str, Any], code: int, row: str, error: str, command: Run, config: Any
) -> None:
    found, shown, errors = command("check", config(**backend))
    assert found == code
    assert error in errors
    assert errors.count("\n") == (code != 0)
    assert re.findall(r"│ (\w+) +│ (?:ok|broken) +│", shown)[-1] == row


def test_only_a_bus_can_be_checked_listened_to_and_logged(command: Run, tmp_path: Path) -> None:
    assert command("check", "sim_right")[0::2] == (
        2, "allegro-twin: only a hand on a bus has a link to check; this config has backend sim: `allegro-twin "
        "check-backend` checks any backend against the contract\n"
    )  # fmt: skip
    assert "only a bus can be listened to" in command("sniff", "sim_right")[2]
    assert "is a bus inside one program; log it with" in command("sniff", "can_virtual")[2]
    code, _, errors = command("run", "sim_right", "--seconds", "0.1", "--wire-log", tmp_path / "x.log")
    assert (code, "only a hand on a CAN bus has frames to log, and a sim hand has none" in errors) == (2, True)
    code, _, errors = command("run", "can_virtual", "--wire-log", tmp_path / "x.txt")
    assert (code, "x.txt: must end in .blf or .log or .asc" in errors) == (2, True)
    assert not list(tmp_path.iterdir())


def test_a_run_logs_its_bus_and_the_log_exports_to_what_replays(command: Run, config: Any, tmp_path: Path) -> None:
    path, log, target = config(), tmp_path / "bus.asc", tmp_path / "bus.arrow"
    code, _, errors = command("run", path, "--wire-log", log)
    assert (code, errors) == (0, "")
    assert command("export", log, target)[2].strip().endswith("name a config of that hand with --config")
    assert command("export", log, target, "--config", path) == (0, f"{target}: 201 rows\n", "")
    replay = tmp_path / "replay.yaml"
    replay.write_text(f"backend: {{kind: replay, file: {target}}}\ncontroller: {{kind: torque}}\n")
    code, shown, _ = command("run", replay)
    assert (code, "allegro_right at 0.600 s" in shown) == (0, True)
    assert command("export", target, tmp_path / "bus.rrd")[0] == 0


@pytest.mark.parametrize(
    ("backend", "code", "message"),
    [
        ({"interface": "socketcan", "channel": "can7"}, 3, "then: ip link set can7 up type can bitrate 1000000"),
        (
            {"interface": "slcan", "channel": "no.tty"},
            3,
            "is the adapter plugged in, or `allegro-twin firmware` running",
        ),
        ({"interface": "gs_usb"}, 3, "the driver is missing"),
        ({"interface": "neovi"}, 3, "the driver is missing"),
        ({"interface": "socketcn"}, 2, "python-can has no interface 'socketcn'; there are: allegro-virtual"),
        ({"version": None}, 2, "backend.version is missing"),
        ({"version": "v2", "device": 1}, 2, "device 1 does not exist"),
    ],
)
def test_a_bus_that_cannot_be_had_is_one_line(
    backend: dict[str, Any], code: int, message: str, command: Run, config: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package in ("usb", "ics"):
        monkeypatch.setitem(sys.modules, package, None)
    found, shown, errors = command("run", config(**backend))
    assert (found, shown) == (code, "")
    assert errors.startswith("allegro-twin: ")
    assert message in errors
    assert errors.count("\n") == 1


def test_what_python_can_logs_beside_its_errors_is_not_shown(config: Any) -> None:
    done = allegro_twin("run", config(interface="neovi"))
    assert done.returncode == 3
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("how", ["directly", "by number", "as the cause"])
def test_no_permission_says_which_group_has_it(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    denied = PermissionError(errno.EACCES, "Permission denied")

    def refuse(*_: Any, **__: Any) -> None:
        if how == "directly":
            raise denied
        if how == "by number":
            raise can.CanInitializationError("no", error_code=errno.EPERM)
        raise can.CanInitializationError("could not create the serial device") from denied

    monkeypatch.setattr("allegro_twin.drivers.can.link.slcan.SlcanBus", refuse)
    with pytest.raises(
        ConnectionError, match="slcan x.tty: no permission .*; on a serial port, join the group dialout"
    ):
        open_bus("slcan", "x.tty", 1_000_000, {})


@pytest.mark.parametrize("verb", ["run", "check"])
def test_a_hand_file_with_fifteen_offsets_is_refused(verb: str, command: Run, config: Any, tmp_path: Path) -> None:
    text = (SUITE / "conf/hands/SAH020BR013.yaml").read_text().replace("-391, ", "")
    (tmp_path / "mine.yaml").write_text(text)
    code, _, errors = command(verb, config({"serial": str(tmp_path / "mine.yaml")}, version="v2"))
    assert code == 2
    assert errors.endswith("mine.yaml: wire.encoder_offset needs 16 values, one a joint; it has 15\n")


def test_the_sniffer_shows_every_frame_and_sends_none(command: Run) -> None:
    said: list[Message] = [
        m.FingerPosition(0, (0.1, 0.2, 0.3, -0.4)),
        m.SetTorque(3, (0.5, 0.0, 0.0, 0.0)),
        m.ServoOn(),
    ]
    with can.Bus(interface="virtual", channel="sniffed") as other:
        over = threading.Event()

        def talk() -> None:
            while not over.wait(0.02):
                for message in said:
                    other.send(can_message(message))

        talker = threading.Thread(target=talk)
        talker.start()
        code, shown, errors = command("sniff", "--interface", "virtual", "--channel", "sniffed", "--seconds", "0.5")
        over.set()
        talker.join()
        assert other.recv(0.0) is None
    assert code == 0
    lines = shown.splitlines()
    assert len(lines) >= 9
    assert {line[11:].strip() for line in lines} == {
        "080  67 04 cd 08 34 0d 66 ee  position index       +0.1000 +0.2000 +0.3000 -0.4000 rad",
        "18C  58 02 00 00 00 00 00 00  torque thumb         +0.5000 +0.0000 +0.0000 +0.0000 N·m",
        "100                           servo on",
    }
    assert "guessed: v4 hand; v5 and v5plus would do as well: say --version" in " ".join(errors.split())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--version", "v6"], "sniff: version: "),
        (["--option", "host"], "--option needs KEY=VALUE, not 'host'"),
    ],
)
def test_what_the_sniffer_does_not_take_is_one_line(arguments: list[str], message: str, command: Run) -> None:
    code, _, errors = command("sniff", "--interface", "virtual", *arguments)
    assert (code, errors.count("\n")) == (2, 1)
    assert message in errors


@pytest.mark.parametrize("codec", [V2, V4, make_codec("v5")], ids=lambda codec: str(codec.version))
def test_a_version_is_guessed_by_what_it_alone_can_read(codec: Any) -> None:
    sniffer = Sniffer()
    assert sniffer.title() == "no hand of any version"
    said: list[Message] = [m.FingerPosition(k, (0.0, 0.0, 0.0, 0.0)) for k in range(4)]
    if codec.version == "v5":
        said.append(m.FingertipPressure((0, 1), (0.0, 0.0)))
    for message in said:
        sniffer.hear(can_message(message, codec), 0.0)
    assert sniffer.versions[0] == codec.version


def test_a_row_counts_and_what_nobody_knows_stays_raw() -> None:
    sniffer = Sniffer("v4")
    for k in range(11):
        row = sniffer.hear(can_message(m.FingerPosition(1, (0.0, 0.0, 0.0, 0.0))), 0.1 * k)
    assert row is not None
    assert (row.count, round(row.rate, 6)) == (11, 10.0)
    strange = sniffer.hear(can_message(Frame(0x7FF, b"\x01\x02")), 2.0)
    assert strange is not None
    assert sniffer.line(strange) == "    2.0000       7FF  01 02"
    short = sniffer.hear(can_message(Frame(0x84, b"\x01")), 2.0)
    assert short is not None
    assert sniffer.description(short).name == "malformed"
    assert sniffer.hear(can.Message(is_error_frame=True), 2.0) is None
    assert (sniffer.frames, sniffer.errors, len(sniffer.rows)) == (14, 1, 2)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (m.FingerTemperature(2, (25.0, 26.0, 27.0, 28.0)), ("temperature ring", "25 26 27 28 °C")),
        (m.SetPeriod(0.003, 0.1, 0.5), ("set period", "position 0.003 s, imu 0.1 s, temperature 0.5 s")),
        (m.Status(m.StatusBits(5)), ("status", "SERVO_ON THROTTLED")),
        (m.Request(m.Topic.POSITION, 3), ("ask position thumb", "")),
        (m.SetMode(task=True), ("SetMode", "task True")),
        (
            m.Information(0x400, 0x101, "left", 31.0, m.StatusBits(0)),
            ("information", "hardware 0x0400, firmware 0x0101, left, 31 °C, motors off"),
        ),
    ],
)
def test_messages_are_said_in_words(message: Message, words: tuple[str, str]) -> None:
    assert describe(message) == words


@pytest.mark.slow
def test_a_served_hand_is_checked_from_another_process_and_its_log_survives_sigterm(
    command: Run, config: Any, tmp_path: Path
) -> None:
    terminal, log = tmp_path / "hand.tty", tmp_path / "hand.blf"
    path = config(interface="slcan", channel=str(terminal), options={"sleep_after_open": 0.0}, scene={"kind": "sim"})
    served = subprocess.Popen(
        [sys.executable, "-m", "allegro_twin", "firmware", path, "--wire-log", log],
        cwd=SUITE,
        stdout=subprocess.DEVNULL,
    )
    try:
        wait_for(lambda: terminal.exists() or served.poll() is not None)
        code, shown, errors = command("check", path)
        time.sleep(0.5)  # The checkup's last words are still on their way to a busy process.
    finally:
        served.send_signal(signal.SIGTERM)
        assert served.wait() == 0
    rows = dict(re.findall(r"│ (\w+) +│ (ok|broken) +│", shown))
    assert (rows["identity"], rows["fingers"]) == ("ok", "ok")
    # On a machine that is busy with something else, reports may be lost; nothing else may be wrong.
    assert code == 0 or (rows["reports"] == "broken" and "lost" in errors)
    assert not terminal.exists()
    assert command("export", log, tmp_path / "log.arrow", "--config", path)[0] == 0
    recording = load(tmp_path / "log.arrow")
    assert len(recording) > 200
    assert (recording.columns["torque"] == 0.0).all()
    heard = [Frame(one.arbitration_id, bytes(one.data)) for one in can.LogReader(log) if one.is_rx]
    assert heard[-2:] == [V4.encode(m.ServoOff()), V4.encode(m.SetPeriod(0.0))]


@pytest.mark.long
@pytest.mark.parametrize("signalled", [signal.SIGINT, signal.SIGTERM])
def test_a_program_that_is_interrupted_leaves_the_hand_limp(
    signalled: signal.Signals, config: Any, tmp_path: Path
) -> None:
    terminal, log = tmp_path / "hand.tty", tmp_path / "hand.blf"
    patient = {"timeout": 1.0, "deadman": 1.0, "gravity": [0.0, 0.0, -9.81]}
    line = {"interface": "slcan", "channel": str(terminal), "options": {"sleep_after_open": 0.0}}
    path = Path(config(**line, **patient, scene={"kind": "sim"}))
    allegro = [sys.executable, "-m", "allegro_twin"]
    with subprocess.Popen(
        [*allegro, "firmware", path, "--wire-log", log], cwd=SUITE, stdout=subprocess.DEVNULL
    ) as hand:
        wait_for(lambda: terminal.exists() or hand.poll() is not None)
        try:
            host = subprocess.Popen([*allegro, "run", path, "--seconds", "60"], cwd=SUITE)
            time.sleep(5.0)
            host.send_signal(signalled)
            code = host.wait()
            time.sleep(0.5)
        finally:
            hand.send_signal(signal.SIGTERM)
    assert code == 128 + signalled
    heard = [Frame(one.arbitration_id, bytes(one.data)) for one in can.LogReader(log) if one.is_rx]
    assert any(frame.id == 0x180 and any(frame.data) for frame in heard)  # It had pushed before.
    limp = [V4.encode(m.SetTorque(finger, (0.0, 0.0, 0.0, 0.0))) for finger in range(4)]
    assert heard[-6:] == [*limp, V4.encode(m.ServoOff()), V4.encode(m.SetPeriod(0.0))]


@pytest.mark.parametrize(
    "words",
    [["check", "CONFIG"], ["run", "CONFIG"], ["excite", "CONFIG", "--pose", "up", "--yes"],
     ["posture", "home", "--config", "CONFIG"], ["rehearse", "CONFIG", "--yes"], ["mirror", "CONFIG"]],
)  # fmt: skip
def test_the_file_of_a_left_hand_is_refused_for_a_right_hand_before_its_port_is_opened(
    words: list[str], tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("left.yaml").write_text("wire: {side: left}\n")
    bus = "{kind: can, version: v5, interface: slcan, channel: nowhere, gravity: [0, 0, -9.81]}"
    Path("bus.yaml").write_text(f"hand: {{side: right}}\nbackend: {bus}\ncontroller: {{kind: pd}}\n")
    code, _, errors = command(*(word.replace("CONFIG", "bus.yaml") for word in words), "--hand", "left.yaml")
    assert code == 2
    assert "left.yaml is a left hand; hand.side is right" in errors
    assert "nowhere" not in errors


def test_a_simulated_hand_becomes_the_hand_of_a_file_and_a_config_without_a_side_has_that_of_the_file(
    tmp_path: Path,
) -> None:
    file, config = tmp_path / "left.yaml", tmp_path / "bus.yaml"
    file.write_text("wire: {side: left}\n")
    config.write_text("backend: {kind: can, version: v5, channel: nowhere}\ncontroller: {kind: pd}\n")
    for name in ("sim_right", "can_virtual", config):
        assert on_hand(load_config(name), str(file)).hand.side == "left"
    assert config_of("can0", "v5", None).hand.side == "right"
    assert on_hand(config_of("can0", "v5", None), str(file)).hand.side == "left"
    with pytest.raises(ConfigError, match="is a left hand; hand.side is right"):
        on_hand(config_of("can0", "v5", "right"), str(file))
