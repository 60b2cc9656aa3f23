"""A bus log holds a session: what it becomes as a recording is what the hand's own program recorded."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from allegro_twin.app import assemble
from allegro_twin.app.bus_log import make_recording
from allegro_twin.app.config import RunConfig
from allegro_twin.app.session import Outputs, perform
from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import Message
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.opening import codec_of
from allegro_twin.drivers.can.tools.log import SUFFIXES, WireLog, frames_of_log, samples_of_log
from allegro_twin.drivers.can.tools.samples import Found
from allegro_twin.errors import ConfigError, HandFault, RecordingError
from allegro_twin.hands.description.calibration import FULL_SCALE, Version
from allegro_twin.hands.settings import LimitSettings
from allegro_twin.recording.reader import Recording, load
from allegro_twin.recording.replay import ReplayBackend, replay_samples
from tests.conftest import can_config

V4 = make_codec("v4")
FRAMES_A_SECOND = 8 / 0.003


def logged(config: RunConfig, folder: Path, suffix: str) -> tuple[Path, Path]:
    """Run a config; its recording and its bus log."""
    recording, log = folder / "run.arrow", folder / f"bus{suffix}"
    perform(assemble(config), config, Outputs(record=recording, wire_log=log))
    return recording, log


def exported(config: RunConfig, log: Path) -> tuple[Recording, Found]:
    target = log.with_name("exported.arrow")
    told = make_recording(config, log, target)
    return load(target), told


def candump(path: Path, *said: tuple[float, str, Message | Frame]) -> Path:
    """As `candump -l` writes it: no direction. Each is s, bus, and a message of a v4 hand or a frame."""
    lines = []
    for t, bus, message in said:
        frame = message if isinstance(message, Frame) else V4.encode(message)
        lines.append(f"({1_700_000_000 + t:.6f}) {bus} {frame}\n")
    path.write_text("".join(lines))
    return path


def reports(t: float, bus: str = "can0", bend: float = 0.1) -> list[tuple[float, str, Message | Frame]]:
    return [(t + 1e-4 * k, bus, m.FingerPosition(k, (bend, 0.2, 0.3, 0.4))) for k in range(4)]


def torques(t: float, torque: float) -> list[tuple[float, str, Message | Frame]]:
    return [(t + 1e-4 * k, "can0", m.SetTorque(k, (torque, 0.0, 0.0, 0.0))) for k in range(4)]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("version", ["v2", "v4", "v5"])
def test_a_log_becomes_the_recording_that_the_run_itself_made(version: Version, suffix: str, tmp_path: Path) -> None:
    # Soft stops out of reach: what the bus carries is what the guard let through.
    config = can_config(version).model_copy(update={"seconds": 0.9, "limits": LimitSettings(margin=-0.5)})
    recording, log = logged(config, tmp_path, suffix)
    mine, (theirs, found) = load(recording), exported(config, log)
    assert (found.states, found.missed, found.incomplete, found.malformed, found.uncommanded) == (301, 0, 0, 0, 0)
    for name in ("tick", "position", "velocity", "torque", "temperature", "gravity"):
        np.testing.assert_array_equal(mine.columns[name], theirs.columns[name], name)
    np.testing.assert_allclose(mine.columns["t"], theirs.columns["t"], rtol=0, atol=1.1e-6)  # The logs' microsecond.
    assert isinstance(config.backend, CanSettings)
    codec = codec_of(config.backend, config.hand)
    count = 1.0 / FULL_SCALE[codec.version]
    limit = np.array(codec.pwm_limits) * count
    wanted = np.clip(mine.columns["command_torque"], -limit, limit)
    np.testing.assert_allclose(wanted, theirs.columns["command_torque"], rtol=0, atol=count)
    assert np.abs(wanted).max() > 10 * count


def test_a_log_whose_times_count_from_the_frame_before_is_refused_and_one_of_a_set_clock_is_read(
    tmp_path: Path,
) -> None:
    said = [each for k in range(20) for each in reports(0.003 * k)]
    steps = [(after[0] - before[0], *after[1:]) for before, after in pairwise([said[0], *said])]
    refusal = "its times count from the frame before, .*: save it with absolute times"
    with pytest.raises(RecordingError, match=f"delta.log: {refusal}"):
        exported(can_config("v4"), candump(tmp_path / "delta.log", *steps))
    frames = [(t, one if isinstance(one, Frame) else V4.encode(one)) for t, _, one in steps]
    lines = [f"   {t:.6f} 1  {frame.id:X}  Rx   d 8 {frame.data.hex(' ')}" for t, frame in frames]
    for kind in ("relative", "absolute"):
        head = f"date Tue Nov 14 10:13:20 PM 2023\nbase hex  timestamps {kind}\nno internal events logged"
        (tmp_path / f"{kind}.asc").write_text("\n".join([head, *lines[:8]]) + "\n")
    with pytest.raises(RecordingError, match=f"relative.asc: {refusal}"):
        exported(can_config("v4"), tmp_path / "relative.asc")
    assert len(list(frames_of_log(tmp_path / "absolute.asc"))) == 8
    set_back = [(t - 5.0 if t > 0.03 else t, *rest) for t, *rest in said]
    assert len(list(samples_of_log(candump(tmp_path / "clock.log", *set_back), V4, CanHostSettings()))) == 20  # type: ignore[arg-type]


Said = list[tuple[float, str, Message | Frame]]


def _of_two_clocks(said: Said) -> Said:
    return [each for t, _, one in said for each in ((t, "can0", one), (t + 500.0, "can1", one))]


def _with_sent_frames_at_zero(said: Said) -> Said:
    own = [[(-1_700_000_000.0, bus, one) for _, bus, one in torques(0.0, 0.1)] for _ in said[::4]]
    return [each for k, sent in enumerate(own) for each in (*said[4 * k : 4 * k + 4], *sent)]


def _in_blocks_of_eight_buses(said: Said) -> Said:
    return [(t, f"can{n}", one) for k in range(0, 400, 80) for n in range(8) for t, _, one in said[k : k + 80]]


def _stamped_out_of_order(said: Said) -> Said:
    late = np.random.default_rng(1).uniform(0.0, 1e-3, len(said))
    return [(t + late[k], *rest) for k, (t, *rest) in enumerate(said)]


def _in_eight_sessions(said: Said) -> Said:
    return [each for k in range(0, 400, 52) for each in said[: min(52, 400 - k)]]


@pytest.mark.parametrize(
    "changed",
    [
        _of_two_clocks,
        _with_sent_frames_at_zero,
        _in_blocks_of_eight_buses,
        _stamped_out_of_order,
        _in_eight_sessions,
    ],
)
def test_a_log_of_several_clocks_or_sessions_is_read(changed: Callable[[Said], Said], tmp_path: Path) -> None:
    said = [each for k in range(100) for each in reports(0.003 * k)]
    log = candump(tmp_path / "c.log", *changed(said))
    assert len(list(samples_of_log(log, V4, CanHostSettings(), bus="can0"))) == 100


@pytest.mark.parametrize(("late", "begins"), [(0.0, 0), (0.0, 5), (5e-5, 0), (5e-5, 5)])
def test_delta_times_are_known_by_how_often_they_go_back(late: float, begins: int, tmp_path: Path) -> None:
    """With an even clock and an uneven one, and where the hand is switched on while the log runs."""
    wait, later = [20.0 if k >= begins else 0.0 for k in range(100)], np.random.default_rng(1).uniform(0.0, late, 800)
    said = [
        each for k in range(100) for each in (*reports(0.003 * k + wait[k]), *torques(0.003 * k + wait[k] + 1e-3, 0.1))
    ]
    stamps = [t + later[k] for k, (t, _, _) in enumerate(said)]
    steps = [(now - before, *rest) for before, now, (_, *rest) in zip([stamps[0], *stamps], stamps, said, strict=False)]
    with pytest.raises(RecordingError, match="its times count from the frame before"):
        list(samples_of_log(candump(tmp_path / "c.log", *steps), V4, CanHostSettings()))


def test_a_log_of_another_version_is_refused_where_its_joints_stand_beyond_their_ends(tmp_path: Path) -> None:
    said = [each for k in range(20) for each in reports(0.003 * k, bend=0.5)]
    log = candump(tmp_path / "v4.log", *said)
    with pytest.raises(
        RecordingError, match=r"v4.log: as a v5 hand's its joints stand up to 8\.\d rad .*: correct `backend.version`$"
    ):
        exported(can_config("v5"), log)
    assert not (tmp_path / "exported.arrow").exists()
    exported(can_config("v4"), log)


def test_a_v5_hands_log_is_refused_as_a_v4_hands_by_its_pressures(tmp_path: Path) -> None:
    v5 = make_codec("v5")
    said = [(t, bus, v5.encode(each)) for k in range(20) for t, bus, each in reports(0.003 * k)
            if not isinstance(each, Frame)]  # fmt: skip
    pressure = v5.encode(m.FingertipPressure((0, 1), (100.0, 200.0)))
    config = can_config("v4")
    for number, (identify, bus) in enumerate([(True, "can0"), (False, "can0"), (True, "can1")]):
        log = candump(tmp_path / f"{number}.log", *said[:40], (0.0298, bus, pressure), *said[40:])
        own = config.model_copy(update={"backend": config.backend.model_copy(update={"identify": identify})})
        if bus == "can1":
            exported(own, log)
            continue
        with pytest.raises(ConfigError, match=r"^frame .* is a v5 hand's pressure .* no v4 hand has: correct `backend"):
            exported(own, log)
        exported(can_config("v5"), log)


@pytest.mark.parametrize("shape", [{"remote": True}, {"data": bytes(4)}])
def test_a_frame_of_another_device_with_a_pressures_identifier_does_no_harm_to_a_v4_hands_log(
    shape: dict[str, Any], tmp_path: Path
) -> None:
    other = Frame(make_codec("v5").encode(m.FingertipPressure((0, 1), (0.0, 0.0))).id, **shape)
    log = candump(tmp_path / "c.log", *reports(0.0), (0.001, "can0", other), *reports(0.003), *reports(0.006))
    assert len(list(samples_of_log(log, V4, CanHostSettings()))) == 3


def test_a_log_in_which_a_hand_says_another_side_or_version_than_the_config_is_refused(tmp_path: Path) -> None:
    right = m.Information(0x0400, 0x0100, "right")
    log = candump(tmp_path / "c.log", (0.0, "can0", right), *reports(0.001), *reports(0.004))
    config = can_config("v4")
    exported(config, log)
    (tmp_path / "exported.arrow").unlink()
    left = config.model_copy(update={"hand": config.hand.model_copy(update={"side": "left"})})
    with pytest.raises(ConfigError, match="this is a right hand; the config says left: correct `hand: {side: …}`$"):
        exported(left, log)
    assert not (tmp_path / "exported.arrow").exists()
    exported(left, candump(tmp_path / "other.log", (0.0, "can1", right), *reports(0.001), *reports(0.004)))
    silent = left.model_copy(update={"backend": left.backend.model_copy(update={"identify": False})})
    exported(silent, log)
    older = m.Information(0x0300, 0x0100, "left")
    with pytest.raises(ConfigError, match="the hand says hardware 0x0300, which is no v4 hand; correct `version`"):
        exported(left, candump(tmp_path / "old.log", (0.0, "can0", older), *reports(0.001), *reports(0.004)))


def test_a_serial_in_a_log_tells_the_side_of_a_v5_hand(tmp_path: Path) -> None:
    v5 = make_codec("v5")
    said: list[tuple[float, str, Message | Frame]] = [(0.0, "can0", v5.encode(m.Serial("5TAR0017")))]
    for k in range(3):
        said += [
            (0.003 * k + t, bus, v5.encode(each)) for t, bus, each in reports(0.001) if not isinstance(each, Frame)
        ]
    log = candump(tmp_path / "c.log", *said)
    for side in ("right", "left"):
        with pytest.raises(ConfigError, match="this is a right hand") if side == "left" else nullcontext():
            list(samples_of_log(log, v5, CanHostSettings(), side=side))


def test_an_exported_log_replays_as_a_hand(tmp_path: Path) -> None:
    config = can_config("v4").model_copy(update={"seconds": 0.3})
    recording, _ = exported(config, logged(config, tmp_path, ".log")[1])
    assert recording.complete
    assert recording.meta["log"] == "bus.log"
    assert recording.meta["calibration"]["version"] == "v4"
    assert recording.meta["calibration"]["pwm_limit"][:4] == [375, 675, 450, 285]
    samples = list(replay_samples(ReplayBackend(recording)))
    assert [sample.state.tick for sample in samples] == list(range(101))


@pytest.mark.parametrize("fails", [False, True])
def test_a_log_ends_with_the_words_that_leave_the_hand_limp_also_when_the_run_fails(
    fails: bool, tmp_path: Path
) -> None:
    script = [{"at": 1.2, "what": "joint_timeout"}] if fails else []
    config = can_config("v4", faults={"script": script}).model_copy(update={"seconds": None if fails else 0.6})
    log = tmp_path / "bus.blf"
    with pytest.raises(HandFault, match="JOINT_TIMEOUT") if fails else nullcontext():
        perform(assemble(config), config, Outputs(wire_log=log))
    said = [
        V4.decode(Frame(message.arbitration_id, bytes(message.data)))
        for message in can.LogReader(log)
        if not message.is_rx
    ]
    assert said[-6:-2] == [m.SetTorque(finger, (0.0, 0.0, 0.0, 0.0)) for finger in range(4)]
    assert said[-2:] == [m.ServoOff(), m.SetPeriod(0.0)]
    assert len(said) > 0.4 * FRAMES_A_SECOND / 2


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_program_that_is_killed_loses_a_tenth_of_a_second_of_its_log(suffix: str, tmp_path: Path) -> None:
    path, frames = tmp_path / f"bus{suffix}", round(0.5 * FRAMES_A_SECOND)
    log = WireLog(path)
    for k in range(frames):
        log(
            can.Message(
                arbitration_id=0x80,
                is_extended_id=False,
                data=k.to_bytes(8, "little"),
                timestamp=1e9 + k / FRAMES_A_SECOND,
            )
        )
    left = tmp_path / f"left{suffix}"
    left.write_bytes(path.read_bytes())  # As it is on the disk while the program runs.
    assert sum(1 for _ in frames_of_log(left)) > frames - 0.1 * FRAMES_A_SECOND
    log.close()
    assert sum(1 for _ in frames_of_log(path)) == frames


def test_a_captured_candump_has_no_directions_and_may_begin_in_the_middle(tmp_path: Path) -> None:
    said = [*reports(0.0), *reports(0.003), *torques(0.004, 0.5), *reports(0.006), *reports(0.009)]
    found = Found()
    samples = list(samples_of_log(candump(tmp_path / "c.log", *said), V4, CanHostSettings(), found))
    assert [sample.state.tick for sample in samples] == [0, 1, 2, 3]
    first, second, third, _ = samples
    # Before the first torques nobody knows what the hand does: its torque is NaN, the command zero, and counted.
    assert np.isnan(first.state.torque).all()
    assert np.isnan(second.state.torque).all()
    assert found.uncommanded == 1
    assert (first.command.torque == 0.0).all()  # type: ignore[union-attr]
    assert second.command.torque[[0, 4, 8, 12]].tolist() == [0.5] * 4  # type: ignore[union-attr]
    assert third.state.torque[[0, 4, 8, 12]].tolist() == [0.5] * 4
    assert np.isnan(third.state.temperature).all()


def test_what_a_hand_reports_with_its_joints_is_of_that_state_and_what_comes_later_of_the_next(tmp_path: Path) -> None:
    warm = (0.0015, "can0", m.FingerTemperature(0, (30.0, 31.0, 32.0, 33.0)))
    before = [*reports(0.0), warm, *torques(0.002, 0.1), *reports(0.003)]
    after = [*reports(0.0), *torques(0.001, 0.1), warm, *reports(0.003)]
    for frames, known in ((before, True), (after, False)):
        first, second = samples_of_log(candump(tmp_path / "c.log", *frames), V4, CanHostSettings())
        assert np.isfinite(first.state.temperature[:4]).all() == known
        assert second.state.temperature[:4].tolist() == [30.0, 31.0, 32.0, 33.0]


def test_a_lost_report_costs_two_states_and_shows_in_the_tick(tmp_path: Path) -> None:
    """The moment that lacks it, and the next, which might hold it late."""
    whole = [frame for k in (0, 2, 3) for frame in reports(0.003 * k, bend=0.1 * k)]
    frames = sorted([*whole, *reports(0.003, bend=0.1)[:3]], key=lambda frame: frame[0])
    found = Found()
    samples = list(samples_of_log(candump(tmp_path / "c.log", *frames), V4, CanHostSettings(), found))
    assert [sample.state.tick for sample in samples] == [0, 3]
    assert found.missed == 2
    assert "2 periods without a state" in found.summary()


def test_of_a_log_of_two_buses_one_must_be_named(tmp_path: Path) -> None:
    path = candump(tmp_path / "c.log", *reports(0.0), *reports(0.001, "can1", 0.9), *reports(0.003))
    with pytest.raises(ConfigError, match="hands report on can0 and on can1: say which with --bus"):
        list(samples_of_log(path, V4, CanHostSettings()))
    (only,) = samples_of_log(path, V4, CanHostSettings(), bus="can1")
    assert only.state.position[0] == pytest.approx(0.9, abs=1e-4)


def test_a_bus_that_a_log_has_not_is_refused_with_those_that_it_has(tmp_path: Path) -> None:
    path = candump(tmp_path / "c.log", *reports(0.0), *reports(0.001, "can1", 0.9))
    with pytest.raises(ConfigError, match=r"c.log: no bus named 'vcan'; did you mean 'can1' or 'can0'\?$"):
        list(samples_of_log(path, V4, CanHostSettings(), bus="vcan"))
    with pytest.raises(RecordingError, match=r"no whole v4 hand in 3 frames$"):
        list(samples_of_log(candump(path, *reports(0.0)[:3]), V4, CanHostSettings(), bus="can0"))


def test_an_error_frame_in_a_candump_is_no_bus_of_its_own(tmp_path: Path) -> None:
    path = candump(tmp_path / "c.log", *reports(0.0))
    path.write_text(f"(1700000000.000000) can0 20000080#0000000000000000\n{path.read_text()}")
    for bus in ("None", "x"):
        with pytest.raises(ConfigError, match=f"c.log: no bus named '{bus}'; there are: can0$"):
            list(samples_of_log(path, V4, CanHostSettings(), bus=bus))
    assert len(list(samples_of_log(path, V4, CanHostSettings(), bus="can0"))) == 1


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ((0, 0, 1, 1, 2, 2, 3, 3), "each report is there twice: keep one of the two"),
        (
            (1, 0, 2, 3),
            "fingers report in the order index, ring, thumb, middle; a hand's is index, middle, ring, thumb",
        ),
    ],
)
def test_a_log_whose_reports_are_double_or_in_another_order_says_so(
    order: tuple[int, ...], said: str, tmp_path: Path
) -> None:
    frames = [(0.003 * k + 1e-4 * n, *reports(0.0)[j][1:]) for k in range(10) for n, j in enumerate(order)]
    with pytest.raises(RecordingError, match=f"no whole v4 hand in {10 * len(order)} frames: {said}$"):
        list(samples_of_log(candump(tmp_path / "c.log", *frames), V4, CanHostSettings()))


def test_a_log_of_another_hand_says_whose_it_is(tmp_path: Path) -> None:
    path = candump(tmp_path / "c.log", *reports(0.0))
    with pytest.raises(RecordingError, match="no whole v2 hand in 4 frames; but a v4, v5 or v5plus hand reports"):
        list(samples_of_log(path, make_codec("v2"), CanHostSettings()))
    with pytest.raises(RecordingError, match=r"no whole v4 hand in 3 frames$"):
        list(samples_of_log(candump(path, *reports(0.0)[:3]), V4, CanHostSettings()))


def test_a_log_of_another_period_says_which(tmp_path: Path) -> None:
    path = candump(tmp_path / "c.log", *[one for k in range(60) for one in reports(0.006 * k)])
    with pytest.raises(ConfigError, match=r"reports every 6.0 ms; the config says period: 0.003 s"):
        list(samples_of_log(path, V4, CanHostSettings()))
    late = np.random.default_rng(1).uniform(0.0, 0.0015, 300)  # As a busy computer stamps.
    path = candump(tmp_path / "c.log", *[one for k in range(300) for one in reports(0.002 * k + late[k])])
    with pytest.raises(ConfigError, match=r"reports every 2.0 ms; the config says period: 0.003 s"):
        list(samples_of_log(path, V4, CanHostSettings()))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("x.log", "can0  080   [8]  00 11\n", "no bus log that python-can can read.*make it with `candump -l`"),
        ("x.blf", "LOGG but no log", "no bus log that python-can can read"),
        ("x.asc", "", "no whole v4 hand in 0 frames"),
        ("missing.log", None, "no bus log at"),
    ],
)
def test_what_is_no_log_is_one_error(name: str, content: str | None, message: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(RecordingError, match=message):
        list(samples_of_log(tmp_path / name, V4, CanHostSettings()))


@pytest.mark.parametrize("suffix", [".log", ".asc"])
def test_a_text_log_that_is_cut_inside_a_line_has_the_frames_before_and_a_note(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"bus{suffix}"
    log = WireLog(path)
    for t, _, message in [one for k in range(3) for one in reports(0.003 * k)]:
        assert not isinstance(message, Frame)
        said = V4.encode(message)
        log(can.Message(timestamp=1e9 + t, arbitration_id=said.id, data=said.data, is_extended_id=False))
    log.close()
    *lines, last = [line for line in path.read_bytes().splitlines(keepends=True) if not line.startswith(b"End")]
    for size in range(len(last)):
        path.write_bytes(b"".join(lines) + last[:size])
        found = Found()
        assert len(list(samples_of_log(path, V4, CanHostSettings(), found))) == 2
        assert found.frames == 11
        assert found.summary().endswith("a last line that is cut") == (size > 0)


def test_a_blf_that_is_cut_inside_a_block_has_the_frames_before_and_a_note(tmp_path: Path) -> None:
    path = tmp_path / "bus.blf"
    log = WireLog(path)
    for k in range(300):
        log(can.Message(timestamp=1e9 + k, arbitration_id=0x80, data=k.to_bytes(8, "little"), is_extended_id=False))
    log.close()
    content, frames = path.read_bytes(), list(frames_of_log(path))
    block = content.rindex(b"LOBJ")
    for size in [*range(block, len(content) - 3), len(content)]:  # The last object may lack its padding.
        path.write_bytes(content[:size])
        found = Found()
        left = list(frames_of_log(path, found=found))
        assert left == frames[: len(left)]
        assert len(left) > 200
        assert (found.cut == "block") == (block < size < len(content)), size


def test_a_broken_line_inside_a_log_is_refused_with_its_number(tmp_path: Path) -> None:
    path = candump(tmp_path / "c.log", *reports(0.0), *reports(0.003))
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([*lines[:5], lines[5][:20] + "\n", *lines[6:]]))
    with pytest.raises(RecordingError, match=r"c.log, line 6: no frame that python-can can read"):
        list(samples_of_log(path, V4, CanHostSettings()))


def test_a_log_that_cannot_become_a_recording_leaves_none(tmp_path: Path) -> None:
    path = candump(tmp_path / "c.log", *reports(0.0), *reports(0.001, "can1"))
    with pytest.raises(ConfigError):
        make_recording(can_config("v4"), path, tmp_path / "out.arrow")
    assert [file.name for file in tmp_path.iterdir()] == ["c.log"]


def test_an_unknown_suffix_is_an_error_that_names_the_good_ones(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"x.txt: a bus log ends in .blf, .log or .asc"):
        WireLog(tmp_path / "x.txt")


def test_a_disk_that_is_full_does_not_stop_the_hand_and_is_said_at_the_end(tmp_path: Path) -> None:
    full = tmp_path / "bus.log"
    full.symlink_to("/dev/full")
    config = can_config("v4").model_copy(update={"seconds": 0.9})
    outcome = perform(assemble(config), config, Outputs(record=tmp_path / "run.arrow", wire_log=full))
    assert re.match("cannot go on logging the bus to .*bus.log: No space left", outcome.unwritten)
    assert len(load(tmp_path / "run.arrow")) == 301
