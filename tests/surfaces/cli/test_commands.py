"""Every option of `run`, `list`, `view` and `export` reaches what it is for, and what is printed is what was found."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from allegro_twin.app import session
from allegro_twin.app.session import Outputs, RunOutcome
from allegro_twin.errors import ConfigError, HandFault, LinkError, RecordingError
from allegro_twin.grasping.verdict import PhaseReport, TrialReport
from allegro_twin.recording.settings import ReplaySettings
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.cli import main
from allegro_twin.surfaces.cli.data.convert import convert
from allegro_twin.surfaces.cli.start import catalogue
from allegro_twin.surfaces.cli.start import view as looking
from allegro_twin.surfaces.cli.start.jobs import RunOptions as Options
from allegro_twin.surfaces.cli.start.jobs import configs_of
from allegro_twin.surfaces.cli.start.view import show
from tests.surfaces.cli.conftest import Run
from tests.test_safety import state


@pytest.mark.parametrize(
    ("error", "code"),
    [(ConfigError, 2), (RecordingError, 2), (LinkError, 3), (HandFault, 4), (KeyboardInterrupt, 130)],
)
def test_every_kind_of_error_has_its_exit_code(
    error: type[BaseException], code: int, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*arguments: object, **how: object) -> None:
        raise error("what happened")

    monkeypatch.setattr(main, "app", fails)
    expected = "" if error is KeyboardInterrupt else "allegro-twin: what happened\n"
    assert command() == (code, "", expected)


def test_one_list_is_only_that_list(command: Run) -> None:
    code, shown, _ = command("list", "objects")
    assert code == 0
    lemon = next(line for line in shown.splitlines() if "lemon" in line)
    assert [cell.strip() for cell in lemon.split("│")][-2] == "29"  # g.
    assert "quadpod" not in shown
    assert "trajectories" in command("list")[1]
    assert set(catalogue.KINDS) == {
        "objects", "postures", "grasps", "trajectories", "scenarios", "configs", "hands", "policies", "recipes",
        "protocols", "gains",
    }  # fmt: skip


def test_what_a_policy_does_is_told_to_the_end_of_its_sentence(command: Run) -> None:
    cells = [line.split("│")[2] for line in command("list", "policies")[1].splitlines() if "│" in line]
    told = " ".join(" ".join(cells).split())
    assert "and holds it through a push: the library's grasp plus up to 0.3 rad a joint." in told
    assert "Observations and actions" not in told


def test_a_scenario_is_a_job_for_each_hand_and_takes_another_grasp_and_object() -> None:
    jobs = configs_of(["lemon"], Options(side="both"))
    assert [(job.name, job.config.hand.side) for job in jobs] == [("lemon", "right"), ("lemon", "left")]
    (left,) = configs_of(["lemon"], Options(side="left", seconds=2.0, grasp="sphere_4_finger", object="golf_ball"))
    assert (left.name, left.config.hand.side, left.config.seconds) == ("golf_ball", "left", 2.0)
    assert left.config.task.grasp == "sphere_4_finger"
    assert left.config.task.object == "golf_ball"
    assert left.config.backend.kind == "sim"
    (config,) = configs_of(["sim_right"], Options(side="left", seconds=0.7))
    assert (config.config.hand.side, config.config.seconds) == ("left", 0.7)


def test_partial_reaches_the_replay(tmp_path: Path) -> None:
    for partial in (False, True):
        (job,) = configs_of(["conf/replay.yaml"], Options(partial=partial))
        assert isinstance(job.config.backend, ReplaySettings)
        assert job.config.backend.partial is partial
    with pytest.raises(ConfigError, match="--partial is for recordings; this config has backend sim"):
        configs_of(["sim_right"], Options(partial=True))


def test_a_folder_without_scenarios_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no scenarios in this folder"):
        configs_of([str(tmp_path)])


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (["--web"], Outputs(live="web")),
        (["--view"], Outputs(live="native")),
        (["--record", "a.arrow", "--image", "a.png"], Outputs(Path("a.arrow"), Path("a.png"))),
        (["--video", "a.mp4", "--rrd", "a.rrd"], Outputs(video=Path("a.mp4"), rrd=Path("a.rrd"))),
        (
            ["--out", "o"],
            Outputs(Path("o/unfinished/sim_right.arrow"), Path("o/unfinished/sim_right.png"), optional=True),
        ),
    ],
)
def test_what_a_run_shall_leave_behind_reaches_it(
    flags: list[str], expected: Outputs, command: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    given = []

    def perform(rig: Any, config: Any, outputs: Outputs, advance: Any, tell: Any) -> RunOutcome:
        given.append(outputs)
        rig.backend.close()
        tell("Open http://here")
        return RunOutcome(state(3), None, ("a [note]",))

    monkeypatch.setattr(session, "perform", perform)
    code, shown, errors = command("run", "sim_right", *flags)
    assert (code, given) == (0, [expected])
    assert "allegro_right at 0.009 s" in shown
    assert errors == "Open http://here\nsim_right right: a [note]\n"


@pytest.mark.parametrize(
    "flag", [["--web"], ["--view"], ["--rrd", "x.rrd"], ["--video", "x.mp4"], ["--image", "x.png"]]
)
def test_two_runs_do_not_share_an_output(flag: list[str], command: Run) -> None:
    code, _, errors = command("run", "lemon", "--side", "both", *flag)
    assert (code, errors) == (2, "allegro-twin: 2 runs cannot share one output; use --out FOLDER\n")


def phase(*, held: bool) -> PhaseReport:
    force = {"index": 1.5, "thumb": 2.5, "palm": 0.0}
    return PhaseReport("lift", 0.0123, 4.5, 0.02, force, 4.0, 0.0003, 0.5, check=True, held=held)


def test_many_trials_end_with_one_table_their_notes_once_and_code_5_if_one_fails(
    command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def perform(rig: Any, config: Any, outputs: Outputs, advance: Any, tell: Any) -> RunOutcome:
        rig.backend.close()
        held = rig.spec.side == "right"
        report = TrialReport(held, "" if held else "it fell", (phase(held=held),), 0.5, 0.08, 0.0003, {"thumb_2": 0.9})
        return RunOutcome(state(3), report, ("no pictures: none",))

    monkeypatch.setattr(session, "perform", perform)
    code, shown, errors = command("run", "lemon", "--side", "both", "--out", tmp_path, "--jobs", 1)
    assert code == 5
    assert errors.count("no pictures") == 1
    assert "1 of 2 held (mujoco" in shown
    assert (
        "right hand: 1 of 1 is 21–100 % (95 % Wilson interval); the left hand's trials mirror them: n = 1"
        in " ".join(shown.split())
    )
    assert "lemon, left: it fell" in shown
    assert "12.3" in shown
    assert (tmp_path / "report.json").is_file()
    assert f"allegro-twin view {tmp_path}/lemon_right.arrow --web" in shown
    assert "overview.png" not in shown
    assert command("run", "lemon", "--side", "right")[0] == 0


def test_every_export_is_of_its_own_format(recording_path: Path, tmp_path: Path, command: Run) -> None:
    heads = {".csv": b"t,", ".parquet": b"PAR1", ".rrd": b"RRF"}
    for suffix, head in heads.items():
        target = tmp_path / f"r{suffix}"
        code, shown, _ = command("export", recording_path, target)
        assert (code, " ".join(shown.split())) == (0, f"{target}: 251 rows")
        assert target.read_bytes().replace(b'"', b"").startswith(head)


def test_a_recording_that_was_cut_is_exported_and_viewed_only_with_partial(
    recording_path: Path, tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched(monkeypatch)
    recording_path.write_bytes(recording_path.read_bytes()[:-20_000])
    for arguments in (["export", recording_path, tmp_path / "r.csv"], ["view", recording_path]):
        code, _, errors = command(*arguments)
        assert code == 2
        assert "pass --partial to use them" in errors
        assert command(*arguments, "--partial")[0] == 0
    rows = (tmp_path / "r.csv").read_text().count("\n")
    assert 100 <= rows - 1 < 251


class Viewer:
    """In the place of Rerun's; keeps what became of it."""

    def __init__(self, spec: HandSpec, things: Any) -> None:
        self.spec, self.things, self.did = spec, things, list[Any]()

    def serve(self, **how: object) -> str:
        self.did.append(how)
        return "http://localhost:1"

    def spawn(self) -> None:
        self.did.append("spawn")

    def flush(self) -> None:
        self.did.append("flush")

    def close(self) -> None:
        self.did.append("close")


def watched(monkeypatch: pytest.MonkeyPatch) -> list[Viewer]:
    made: list[Viewer] = []

    def make(spec: HandSpec, things: Any, **how: object) -> Viewer:
        made.append(Viewer(spec, things))
        return made[-1]

    def shown(samples: Iterator[Any], viewer: Viewer, look: Callable[[], Any]) -> Iterator[Any]:
        for sample in samples:
            viewer.did.append((sample.state.t, len(look())))
            yield sample

    monkeypatch.setattr(session, "rerun_stage", lambda: (make, shown))
    return made


def test_a_recording_is_shown_whole_in_the_window_or_on_a_page_that_stays(
    recording_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = watched(monkeypatch)
    waited: list[int] = []
    monkeypatch.setattr(looking, "_wait", lambda: waited.append(len(made[-1].did)))
    assert command("view", recording_path) == (0, "", "")
    code, shown, _ = command("view", recording_path, "--web", "--port", "9123")
    assert (code, shown) == (0, "Open http://localhost:1 (Ctrl-C ends it)\n")
    window, page = made
    assert (window.did[0], page.did[0]) == ("spawn", {"open_browser": True, "web_port": 9123})
    for viewer in made:
        assert viewer.did[-2:] == ["flush", "close"]
        assert len(viewer.did) == 251 + 3
    assert waited == [251 + 2]  # With the page still there.


def test_the_outcome_of_showing_counts_its_rows(recording_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    watched(monkeypatch)
    totals, steps = list[int](), list[None]()
    show(
        recording_path,
        web=False,
        port=0,
        partial=False,
        camera="side",
        total=totals.append,
        advance=lambda: steps.append(None),
    )
    assert (totals, len(steps)) == ([251], 251)
    with pytest.raises(ConfigError, match="no export format"):
        convert(recording_path, Path("x.txt"), partial=False)


@pytest.mark.parametrize(("option", "text"), [("--size", "huge"), ("--camera", "behind")], ids=["a size", "a camera"])
def test_nonsense_about_pictures_is_one_line_and_nothing_is_run(option: str, text: str, command: Run) -> None:
    code, out, errors = command("run", "lemon", option, text)
    assert (code, out, errors.count("\n")) == (2, "", 1)
    assert f"{option.removeprefix('--')} {text}: " in errors
