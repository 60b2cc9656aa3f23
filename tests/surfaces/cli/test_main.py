"""The command line does what it says, answers with its exit codes, and never shows a traceback.

Once as a program of its own; the rest in this process, which is many times faster.
"""

from __future__ import annotations

import ctypes
import errno
import json
import os
import re
import signal
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

from allegro_twin.recording.reader import load
from allegro_twin.surfaces.cli import exit_codes
from tests.conftest import can_config
from tests.surfaces.cli.conftest import Run

SUITE = Path(__file__).resolve().parents[3]


def allegro_twin(*arguments: str | Path, cwd: Path = SUITE) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "allegro_twin", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True)


@pytest.fixture(autouse=True)
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the folder of the repository, from which README.md and conf/ are typed."""
    monkeypatch.chdir(SUITE)


def piped(script: str, **more: str) -> subprocess.CompletedProcess[str]:
    """Of a shell, with `$AT` for the program."""
    program = f"AT='{sys.executable} -m allegro_twin'; set -o pipefail; "
    return subprocess.run(
        ["bash", "-c", program + script], capture_output=True, text=True, env=os.environ | more, errors="replace"
    )


def test_whoever_stops_to_listen_does_not_end_a_command_nor_lose_what_it_made(tmp_path: Path) -> None:
    done = piped(f"$AT run conf/sim_right.yaml --seconds 0.1 --out {tmp_path / 'out'} | true")
    assert (done.returncode, "unfinished" in done.stderr) == (0, False)
    assert (tmp_path / "out" / "sim_right.arrow").is_file()
    done = piped("$AT list | head -1")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_terminal_without_a_sign_shows_another_in_its_place(tmp_path: Path) -> None:
    done = piped("$AT hand show allegro", PYTHONIOENCODING="ascii", LC_ALL="POSIX")
    assert (done.returncode, done.stderr) == (0, "")
    assert "thumb" in done.stdout


@pytest.mark.parametrize("columns", ["20", "40", "60"])
def test_the_help_in_a_narrow_terminal_has_the_names_of_all_options(columns: str) -> None:
    wide, narrow = (piped("$AT run --help", COLUMNS=width, TERM="xterm").stdout for width in ("120", columns))
    names = set(re.findall(r"--[a-z-]{3,}", wide))
    assert len(names) > 15
    assert names <= set(re.findall(r"--[a-z-]{3,}", narrow))
    assert max(map(len, narrow.splitlines())) <= 80


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-", ">&- 2>&- <&-"])
def test_a_command_works_with_standard_streams_that_are_closed(tmp_path: Path, closed: str) -> None:
    recording = tmp_path / "it.arrow"
    done = piped(f"$AT run conf/sim_right.yaml --seconds 0.1 --record {recording} {closed}")
    assert (done.returncode, "Traceback" in done.stderr) == (0, False)
    assert len(load(recording)) > 30  # And nothing that is printed goes into it.


@pytest.mark.parametrize("buffered", ["", "1"])
@pytest.mark.parametrize("arguments", ["list", "--version", "list --help"])
def test_a_full_disk_under_standard_output_is_one_line(arguments: str, buffered: str) -> None:
    done = piped(f"$AT {arguments} > /dev/full", PYTHONUNBUFFERED=buffered)
    assert done.stderr == "allegro-twin: cannot write to standard output: No space left on device\n"
    assert done.returncode == 2


def test_a_full_disk_under_standard_output_or_error_loses_nothing_that_a_command_writes(tmp_path: Path) -> None:
    for where in (">", "2>"):
        folder = tmp_path / where
        done = piped(f"$AT run conf/sim_right.yaml --seconds 0.1 --out '{folder}' {where} /dev/full")
        assert (done.returncode, "Traceback" in done.stderr) == (2, False)
        assert (folder / "sim_right.arrow").is_file()
    assert piped("$AT nothing 2> /dev/full").returncode == 2


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "not enough memory: end other programs, or raise the limit (`ulimit -v`)"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "not enough memory: "),
        (ImportError("libx.so: failed to map segment from shared object"), "not enough memory: "),
        (OSError(errno.EMFILE, "Too many open files", "x.py"), "too many open files: raise the limit (`ulimit -n`)"),
    ],
)
def test_a_limit_of_the_computer_is_one_line(error: Exception, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    def app(*_: object, **__: object) -> None:
        raise error

    with pytest.raises(SystemExit) as ended:
        exit_codes.run(app, [], "allegro-twin")  # type: ignore[arg-type]  # As typer's are called.
    shown = capsys.readouterr().err
    assert (ended.value.code, shown.count("\n")) == (2, 1)
    assert shown.startswith(f"allegro-twin: {said}")


def test_a_fault_of_this_package_keeps_its_traceback() -> None:
    def app(*_: object, **__: object) -> None:
        raise OSError(errno.ENOENT, "No such file or directory", "x.yaml")

    with pytest.raises(OSError, match="x.yaml"):
        exit_codes.run(app, [], "allegro-twin")  # type: ignore[arg-type]  # As typer's are called.


def test_an_interrupt_in_a_callback_of_a_library_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def app(*_: object, **__: object) -> None:
        raise ctypes.ArgumentError("argument 1: KeyboardInterrupt: ")

    with pytest.raises(SystemExit) as ended:
        exit_codes.run(app, [], "allegro-twin")  # type: ignore[arg-type]  # As typer's are called.
    assert ended.value.code == 130


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_a_signal_ends_has_128_and_its_number_as_exit_code(number: signal.Signals) -> None:
    program = (
        "import os, signal, time\n"
        "from allegro_twin.surfaces.cli import exit_codes\n"
        "def app(*_, **__):\n"
        f"    os.kill(os.getpid(), {int(number)})\n"
        "    time.sleep(60)\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
        "exit_codes.run(app, [], 'allegro-twin')\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (128 + number, "")


def test_a_config_runs_records_and_replays_through_the_same_loop(tmp_path: Path, command: Run) -> None:
    recording = tmp_path / "home.arrow"
    code, shown, errors = command("run", "conf/sim_right.yaml", "--seconds", "1.5", "--record", recording)
    assert code == 0, errors
    assert "allegro_right at 1.500 s" in shown
    config = tmp_path / "replay.yaml"
    config.write_text((SUITE / "conf/replay.yaml").read_text().replace("out/recording.arrow", str(recording)))
    code, shown, errors = command("run", config)
    assert code == 0, errors
    assert "allegro_right at 1.500 s" in shown


@pytest.mark.slow
def test_a_scenario_ends_with_a_table_and_its_files(tmp_path: Path) -> None:
    done = allegro_twin("run", "lemon", "--out", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "lemon, right hand: held" in done.stdout
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["engine"].startswith("mujoco 4.0")
    assert report["trials"]["lemon_right"]["held"] is True
    assert (tmp_path / "lemon_right.arrow").stat().st_size > 1_000_000


def test_a_grasp_that_fails_is_exit_code_5(tmp_path: Path, command: Run) -> None:
    text = (SUITE / "scenarios/demo/lemon.yaml").read_text()
    rules = (SUITE / "conf/protocols/table_pick.yaml").read_text().replace("4.5, shake", "0.3, shake")
    (tmp_path / "short.yaml").write_text(rules.replace("seconds: 2.0", "seconds: 0.3"))
    text = text.replace("friction: 0.8", "friction: 0.05") + f"protocol: {tmp_path}/short.yaml\n"
    (tmp_path / "bare.yaml").write_text(text)
    code, shown, _ = command("run", tmp_path / "bare.yaml")
    assert code == 5
    assert "not held" in shown


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "conf/sim_rigt.yaml"], "conf/sim_rigt.yaml: no such config or scenario file"),
        (["run", "sim_rigt"], "no config or scenario named 'sim_rigt'; did you mean 'sim_right'"),
        (["run", "lemmon"], "did you mean 'lemon'"),
        (["run", "lemon", "--seconds", "-1"], "--seconds must be positive and finite, not -1.0"),
        (["run", "lemon", "mug", "--record", "x.arrow"], "2 runs cannot share one output; use --out FOLDER"),
        (["list", "grasp"], "no list named 'grasp'; did you mean 'grasps'"),
        (["export", "nothing.arrow", "x.csv"], "no recording at nothing.arrow"),
        (["export", "README.md", "x.csv"], "README.md is not a recording: expected an Arrow IPC stream"),
        (["export", "README.md", "x.xlsx"], "no export format named '.xlsx'"),
        (["view", "nothing.arrow"], "no recording at nothing.arrow"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments: list[str], message: str, command: Run) -> None:
    code, _, errors = command(*arguments)
    assert code == 2
    assert message in errors
    assert errors.count("\n") == 1
    assert "Traceback" not in errors


def test_an_episode_that_loses_its_object_is_exit_code_5(tmp_path: Path, command: Run) -> None:
    config = tmp_path / "limp.yaml"
    episode = "{task: Rotate, environment: {timestep: 0.003}}"
    config.write_text(f"backend: {{kind: sim}}\ntask: {{episode: {episode}}}\ncontroller: {{kind: limp}}\nseconds: 3\n")
    code, _, errors = command("run", config)
    assert (code, "Rotate: lost at " in errors) == (5, True)


def test_a_fault_is_exit_code_4(tmp_path: Path, command: Run) -> None:
    config = tmp_path / "fast.yaml"
    config.write_text(
        "backend: {kind: sim}\ncontroller: {kind: torque, torque: 0.3}\nlimits: {velocity: 0.5}\nseconds: 1\n"
    )
    code, _, errors = command("run", config, "--record", tmp_path / "fault.arrow")
    assert code == 4
    assert "over its limit of 0.50 rad/s; reset to go on" in errors
    assert errors.count("\n") == 1
    assert command("export", tmp_path / "fault.arrow", tmp_path / "fault.csv")[0] == 0


def test_a_grasp_on_a_hand_that_loses_its_power_says_first_that_nothing_comes_from_it(
    tmp_path: Path, command: Run
) -> None:
    config = tmp_path / "power.yaml"
    cut = {"script": [{"at": 0.3, "what": "power_cut"}]}
    config.write_text(can_config("v4", timeout=0.1, faults=cut).model_dump_json(exclude_unset=True))
    code, _, errors = command("grasp", "grasp_3", "--config", config)
    assert code == 3
    line = next(line for line in errors.splitlines() if line.startswith("allegro-twin: "))
    assert re.match("allegro-twin: no report from the hand for 0.1 s .*; the hand has not confirmed that it is", line)


def test_a_period_that_does_not_fit_is_refused(tmp_path: Path, command: Run) -> None:
    config = tmp_path / "odd.yaml"
    config.write_text("backend: {kind: sim}\ncontroller: {kind: torque}\nperiod: 0.0025\n")
    code, _, errors = command("run", config)
    assert (code, errors.count("\n")) == (2, 1)
    assert "period 0.0025 s is not a whole number of physics steps of 0.001 s" in errors


def test_a_replay_of_another_hand_is_refused(tmp_path: Path, command: Run) -> None:
    recording = tmp_path / "left.arrow"
    assert command("run", "conf/sim_left.yaml", "--seconds", "0.1", "--record", recording)[0] == 0
    config = tmp_path / "replay.yaml"
    config.write_text((SUITE / "conf/replay.yaml").read_text().replace("out/recording.arrow", str(recording)))
    code, _, errors = command("run", config)
    assert code == 2
    assert "is of the hand allegro_left; the config says allegro_right: change `hand`" in errors


def test_everything_that_ships_can_be_listed(command: Run) -> None:
    code, shown, _ = command("list")
    assert code == 0
    for word in ("tomato_soup_can", "home", "quadpod", "golf_ball", "conf/replay.yaml", "menagerie_right"):
        assert word in shown


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".rrd"])
def test_a_recording_exports(suffix: str, tmp_path: Path, recording_path: Path, command: Run) -> None:
    code, _, errors = command("export", recording_path, tmp_path / f"r{suffix}")
    assert code == 0, errors
    assert (tmp_path / f"r{suffix}").stat().st_size > 10_000


def test_pictures_and_films_are_made_or_their_absence_is_explained(tmp_path: Path, command: Run) -> None:
    image, video = tmp_path / "a.png", tmp_path / "a.mp4"
    code, _, errors = command("run", "conf/sim_right.yaml", "--seconds", "0.3", "--image", image, "--video", video)
    if image.exists():
        assert code == 0
        assert image.read_bytes().startswith(b"\x89PNG")
        assert video.stat().st_size > 1000
    else:
        assert code == 2
        assert "headless rendering needs EGL: apt-get install" in " ".join(errors.split())


def test_a_compiled_library_that_does_not_load_is_one_line_that_leads_to_the_doctor(tmp_path: Path) -> None:
    (tmp_path / f"pinocchio{EXTENSION_SUFFIXES[0]}").write_bytes(b"no library")
    done = subprocess.run(
        [sys.executable, "-m", "allegro_twin", "run", "lemon"],
        cwd=tmp_path, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": f"{tmp_path}:{SUITE}"},
    )  # fmt: skip
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert done.stderr.startswith("allegro-twin: ")
    assert "pinocchio cannot be imported: " in done.stderr
    assert done.stderr.endswith("; `allegro-twin doctor` says what mends it\n")


@pytest.mark.parametrize(
    ("package", "text", "why"),
    [
        ("pinocchio", "import gone_for_good", "No module named 'gone_for_good'"),
        ("pinocchio", "raise ImportError('built for another Python')", "built for another Python"),
        ("mujoco", "import ctypes; ctypes.CDLL('libgone.so')", "libgone.so: cannot open shared object file"),
        ("rich", "raise ImportError('half installed')", "half installed"),
        ("pydantic", "raise ImportError('half installed')", "half installed"),  # Which typer imports.
    ],
)
def test_a_package_that_cannot_be_imported_is_one_line_that_names_it(
    tmp_path: Path, package: str, text: str, why: str
) -> None:
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").write_text(text)
    done = piped("$AT run conf/sim_right.yaml --seconds 0.1", PYTHONPATH=f"{tmp_path}:{SUITE}")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    if package in ("rich", "pydantic"):  # The doctor needs them too.
        done = piped("$AT doctor", PYTHONPATH=f"{tmp_path}:{SUITE}")
        assert done.stderr.endswith("; `pip install --force-reinstall allegro-twin` may mend it\n")
    assert done.stderr.startswith(f"allegro-twin: {package} cannot be imported: {why}")


def test_an_empty_argument_is_not_the_current_folder(command: Run, tmp_path: Path) -> None:
    for words, what in (
        (("run", "lemon", "--out", ""), "--out"),
        (("run", "lemon", "--out="), "--out"),
        (("examples", ""), "the argument after examples"),
    ):
        code, shown, said = command(*words)
        assert (code, shown) == (2, "")
        assert said.startswith(f"allegro-twin: {what} is empty: give it a value, or leave it out")
