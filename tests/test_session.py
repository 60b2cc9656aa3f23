"""One run with everything around it: what was asked for is made, at its moments, and nothing outlives the run."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from PIL import Image

import allegro_twin
from allegro_twin.app import Rig, assemble, session
from allegro_twin.app.config import RunConfig
from allegro_twin.app.controllers import with_speed_check
from allegro_twin.app.session import Outputs, perform
from allegro_twin.control.controllers import PD, ReferenceMemory
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.evaluation.rejudge import write_reports
from allegro_twin.grasping.verdict import TrialReport
from allegro_twin.hands.library.library import load_posture
from allegro_twin.plugins import PluginController
from allegro_twin.recording.reader import load
from allegro_twin.sim.contact.collision_free_paths import CollisionFreeMove
from allegro_twin.types import HandState, Sample, Vector
from allegro_twin.viewing import camera
from allegro_twin.viewing.stills import picture_all
from tests.full_disk import full_disk


def config(**blocks: object) -> RunConfig:
    return RunConfig.model_validate(
        {"backend": {"kind": "sim"}, "task": {"posture": "home"}, "controller": {"kind": "pd"}, "seconds": 0.3} | blocks
    )


def performed(outputs: Outputs, **blocks: object) -> tuple[Rig, session.RunOutcome, list[float]]:
    settings, times = config(**blocks), list[float]()
    rig = assemble(settings)
    return rig, perform(rig, settings, outputs, times.append), times


class Fake:
    """In the place of Rerun's viewer and of the camera; keeps what became of it."""

    made: list[Fake]

    def __init__(self, *about: object, **settings: object) -> None:
        self.about, self.did, self.drawn = about, list[str](), list[tuple[Sample, Any]]()
        self.made.append(self)

    @contextmanager
    def recorded(self, path: Path) -> Iterator[Fake]:
        try:
            yield self
            path.write_bytes(b"drawn")
        finally:
            self.close()

    def serve(self) -> str:
        self.did.append("serve")
        return "http://localhost:1"

    def spawn(self) -> None:
        self.did.append("spawn")

    def take(self) -> camera.Picture:
        self.did.append("take")
        return np.zeros((8, 8, 3), dtype=np.uint8)

    def conclude(self, held: object, words: object) -> None:
        self.did.append("conclude")

    def close(self) -> None:
        self.did.append("close")

    @staticmethod
    def shown(samples: Iterable[Sample], viewer: Fake, look: Any) -> Iterator[Sample]:
        for sample in samples:
            viewer.drawn.append((sample, look()))
            yield sample


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> list[Fake]:
    Fake.made = []
    monkeypatch.setattr(session, "rerun_stage", lambda: (Fake, Fake.shown))
    monkeypatch.setattr(camera, "Camera", Fake)
    monkeypatch.setattr(session, "paced", lambda samples: samples)
    return Fake.made


def test_a_run_lasts_as_long_as_it_says_and_tells_every_moment() -> None:
    rig, outcome, times = performed(Outputs())
    assert (times[0], len(times)) == (0.0, 101)
    assert times[-1] == pytest.approx(0.3)
    assert outcome.last.t == times[-1]
    assert (outcome.report, outcome.notes) == (None, ())
    assert rig.sim is not None
    assert not rig.sim.data.ctrl.any()


def test_a_run_that_is_broken_off_leaves_the_hand_limp_its_recording_and_no_picture(
    tmp_path: Path, fakes: list[Fake]
) -> None:
    settings = config()
    rig = assemble(settings)

    def breaks(t: float) -> None:
        assert rig.sim is not None
        if t > 0.1:
            assert rig.sim.data.ctrl.any()
            raise KeyboardInterrupt

    outputs = Outputs(tmp_path / "a.arrow", tmp_path / "a.png", rrd=tmp_path / "a.rrd", live="web")
    with pytest.raises(KeyboardInterrupt):
        perform(rig, settings, outputs, breaks)
    assert rig.sim is not None
    assert not rig.sim.data.ctrl.any()
    assert all(fake.did[-1] == "close" for fake in fakes)
    assert len(fakes) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["a.arrow"]


def test_a_recording_says_how_it_was_made_and_where_the_controller_wanted_the_joints(tmp_path: Path) -> None:
    rig, _, _ = performed(Outputs(tmp_path / "a.arrow"))
    recording = load(tmp_path / "a.arrow")
    assert recording.meta["allegro_twin"] == allegro_twin.__version__
    assert RunConfig.model_validate(recording.meta["config"]) == config()
    assert recording.meta["engine"].startswith("mujoco")
    home = load_posture("home", rig.spec)
    start = recording.columns["position"][0]
    wish = getattr(rig.controller, "reference").begin(start)  # noqa: B009 - A controller need have none.
    for t, target in zip(recording.columns["t"], recording.columns["target"], strict=True):
        np.testing.assert_array_equal(target, wish(t).position)
    assert recording.columns["target"].shape == (101, 16)
    assert np.isfinite(home).all()


def test_the_target_of_a_motion_is_counted_from_the_state_it_began_at(tmp_path: Path) -> None:
    """A replay whose clock does not begin at zero, with a controller that moves."""
    _, _, _ = performed(Outputs(tmp_path / "a.arrow"))
    replay = config(backend={"kind": "replay", "file": str(tmp_path / "a.arrow")})
    rig = assemble(replay)
    rig.backend.reset()
    moves = Moves([Waypoint(load_posture("home", rig.spec), seconds=0.2)])
    beside = session._Beside(Rig(rig.spec, rig.backend, _With(moves), None), seen=False)  # Its clock is the point.
    samples = [s for s in _late(tmp_path / "a.arrow") if s.state.t >= 0.15]
    path = moves.begin(samples[0].state.position)
    for sample in beside.followed(iter(samples)):
        expected = path(sample.state.t - samples[0].state.t).position
        np.testing.assert_array_equal(beside()["target"], expected)


class TheirPD(PD):
    """A package's controller on the base of this one's."""

    did: ClassVar[list[str]] = []

    def start(self, state: HandState) -> ReferenceMemory:
        self.did.append("started")
        return super().start(state)


def test_the_path_of_a_packages_controller_is_planned_once_before_it_starts_and_its_targets_are_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, did, prepare = config(), list[str](), CollisionFreeMove.prepare

    def prepared(move: CollisionFreeMove, position: Vector) -> None:
        did.append("planned")
        prepare(move, position)

    monkeypatch.setattr(CollisionFreeMove, "prepare", prepared)
    monkeypatch.setattr(TheirPD, "did", did)
    rig = assemble(settings)
    assert isinstance(rig.controller, PD)
    theirs = TheirPD(rig.controller.reference, rig.controller.gains, rig.controller.gravity)
    controller = with_speed_check(PluginController(theirs, "mine"), rig.check_speed)
    perform(replace(rig, controller=controller), settings, Outputs(tmp_path / "a.arrow"))
    assert did == ["planned", "started"]
    columns = load(tmp_path / "a.arrow").columns
    path = theirs.reference.begin(columns["position"][0])
    np.testing.assert_array_equal(columns["target"], [path(t).position for t in columns["t"]])


class _With:
    """A controller of which only the reference matters."""

    def __init__(self, reference: Moves) -> None:
        self.reference = reference

    def start(self, state: object) -> None: ...

    def __call__(self, state: object, memory: None) -> Any: ...


def _late(path: Path) -> list[Sample]:
    from allegro_twin.recording.replay import ReplayBackend, replay_samples

    return list(replay_samples(ReplayBackend(load(path))))


def test_a_picture_is_taken_in_the_end_and_the_camera_is_let_go_of(tmp_path: Path, fakes: list[Fake]) -> None:
    performed(Outputs(image=tmp_path / "a.png"))
    (camera,) = fakes
    assert camera.did == ["take", "close"]
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (8, 8)


@pytest.mark.parametrize("kind", ["image", "video"])
def test_a_picture_of_a_recording_is_refused_with_where_to_look_and_one_that_is_optional_is_a_note(
    kind: str, tmp_path: Path
) -> None:
    performed(Outputs(tmp_path / "a.arrow"))
    backend, file = {"kind": "replay", "file": str(tmp_path / "a.arrow")}, tmp_path / "a.file"
    with pytest.raises(ConfigError, match=r"no picture .*a.file: only a simulation .* with `allegro-twin view`"):
        performed(replace(Outputs(), **{kind: file}), backend=backend)  # type: ignore[arg-type]  # One of two paths.
    _, outcome, times = performed(replace(Outputs(optional=True), **{kind: file}), backend=backend)  # type: ignore[arg-type]  # Likewise.
    assert outcome.notes == (
        "no pictures: only a simulation can be rendered; look at a recording with `allegro-twin view`",
    )
    assert (len(times), file.exists()) == (101, False)


def test_a_scene_that_cannot_be_rendered_is_refused_and_where_its_picture_is_optional_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_camera(backend: object, **settings: object) -> None:
        raise ConfigError("cannot render: no library")

    monkeypatch.setattr(camera, "Camera", no_camera)
    with pytest.raises(ConfigError, match=r"no picture .*a.png: cannot render: no library"):
        performed(Outputs(image=tmp_path / "a.png"))
    _, outcome, times = performed(Outputs(image=tmp_path / "a.png", optional=True))
    assert outcome.notes == ("no pictures: cannot render: no library",)
    assert len(times) == 101


@pytest.mark.parametrize(
    ("live", "first", "told"), [("web", "serve", ["Open http://localhost:1"]), ("native", "spawn", [])]
)
def test_a_live_run_is_paced_drawn_and_told_before_it_begins(
    live: str, first: str, told: list[str], fakes: list[Fake], monkeypatch: pytest.MonkeyPatch
) -> None:
    paced: list[float] = []

    def pace(samples: Iterable[Sample]) -> Iterator[Sample]:
        for sample in samples:
            paced.append(sample.state.t)
            yield sample

    monkeypatch.setattr(session, "paced", pace)
    settings, heard = config(), list[str]()

    def tell(line: str) -> None:
        assert paced == []
        heard.append(line)

    perform(assemble(settings), settings, Outputs(live=live), tell=tell)
    (viewer,) = fakes
    assert (viewer.did, heard) == ([first, "close"], told)
    assert len(paced) == len(viewer.drawn) == 101
    assert set(viewer.drawn[0][1]) == {"target"}


def test_a_file_for_rerun_is_drawn_with_every_sample_and_as_fast_as_it_goes(
    tmp_path: Path, fakes: list[Fake], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(session, "paced")
    performed(Outputs(rrd=tmp_path / "a.rrd"))
    (viewer,) = fakes
    assert (viewer.did, len(viewer.drawn)) == (["close"], 101)
    assert (tmp_path / "a.rrd").read_bytes() == b"drawn"


def test_reports_say_which_program_and_engine_judged(tmp_path: Path) -> None:
    report = TrialReport(held=False, reason="fell", phases=(), peak_torque=0.5, lift=0.01, penetration=0.0, at_limit={})
    write_reports(tmp_path / "report.json", {"lemon_left": report})
    content = json.loads((tmp_path / "report.json").read_text())
    assert content["allegro_twin"] == allegro_twin.__version__
    assert content["engine"].startswith("mujoco")
    assert content["trials"]["lemon_left"]["reason"] == "fell"
    assert content["trials"]["lemon_left"]["held"] is False


def test_all_pictures_of_a_folder_become_one_and_a_missing_one_none(tmp_path: Path) -> None:
    for name in ("a", "b"):
        Image.new("RGB", (8, 8), "red").save(tmp_path / f"{name}.png")
    assert picture_all(tmp_path, []) is None
    assert picture_all(tmp_path, ["a", "b", "c"]) is None
    assert not (tmp_path / "overview.png").exists()
    assert picture_all(tmp_path, ["a", "b"]) == tmp_path / "overview.png"
    with Image.open(tmp_path / "overview.png") as picture:
        assert picture.getpixel((360, 120)) == (255, 0, 0)


def test_nothing_is_imported_while_a_hand_is_driven(tmp_path: Path) -> None:
    """An import takes as long as many periods; the first flush of a recording had one."""
    code = f"""
import sys
from pathlib import Path
from allegro_twin.app import assemble
from allegro_twin.app.config import load_config
from allegro_twin.app.session import Outputs, perform
config = load_config("can_virtual").model_copy(update={{"seconds": 0.7}})
seen = []
outputs = Outputs(record=Path({str(tmp_path / "run.arrow")!r}))
perform(assemble(config), config, outputs, lambda t: seen.append(set(sys.modules)))
print(sorted(seen[-1] - seen[0]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_recording_whose_end_the_disk_does_not_take_costs_no_outcome(tmp_path: Path) -> None:
    performed(Outputs(record=tmp_path / "whole.arrow"), seconds=0.1)
    with full_disk((tmp_path / "whole.arrow").stat().st_size - 200):
        _, outcome, times = performed(Outputs(record=tmp_path / "cut.arrow"), seconds=0.1)
    assert outcome.last.t == times[-1] == pytest.approx(0.1, abs=0.004)
    assert outcome.unwritten.startswith(f"cannot go on recording to {tmp_path}/cut.arrow: ")
