"""What is slow is done in a process of its own, by dex-retargeting, and a webcam's pictures by MediaPipe."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.util import find_spec as installed
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError, HandError, LinkError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import HandKinematics
from allegro_twin.spec import HandSpec, Side
from allegro_twin.surfaces.teleop import webcam as camera
from allegro_twin.surfaces.teleop.retargeting import Retargeting
from allegro_twin.surfaces.teleop.session import open_follower
from allegro_twin.surfaces.teleop.targets import FingertipTargets, target_vectors
from allegro_twin.surfaces.teleop.webcam import Webcam, points_of
from allegro_twin.surfaces.worker_process import WorkerProcess
from tests.surfaces.teleop.conftest import led, sim_config
from tests.surfaces.teleop.synthetic import ROOT, hand, performed, write_csv

PATH = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])


@dataclass(frozen=True)
class Doubling:
    """A job that knows numbers, and dies of words."""

    def open(self) -> Callable[[Any], Any]:
        def work(question: Any) -> Any:
            if isinstance(question, str):
                if question == "die":
                    sys.exit(3)
                raise ConfigError(f"{question!r} is no number")
            return 2 * question

        return work


@dataclass(frozen=True)
class Absent:
    def open(self) -> Callable[[Any], Any]:
        raise ConfigError("it is not installed")


def test_a_question_is_answered_elsewhere_and_may_wait() -> None:
    with WorkerProcess(Doubling()) as work:
        assert work(21) == 42
        work.ask(np.ones(3))
        assert work.ready(10.0)
        np.testing.assert_array_equal(work.answer(), 2.0 * np.ones(3))
        assert not work.ready()


@pytest.mark.slow
def test_what_is_raised_there_is_raised_here() -> None:
    with pytest.raises(ConfigError, match="it is not installed"):
        WorkerProcess(Absent())
    with WorkerProcess(Doubling()) as work, pytest.raises(ConfigError, match="'two' is no number"):
        work("two")


def test_a_process_that_dies_is_told_of_by_name_and_leaves_nothing_behind() -> None:
    with WorkerProcess(Doubling()) as work:
        with pytest.raises(HandError, match="the process of doubling has died"):
            work("die")
        with pytest.raises(HandError, match="the process of doubling has died"):
            work(1)
    assert work._process.poll() is not None
    work.close()


def test_without_its_library_retargeting_says_what_to_install(spec: HandSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    words = r"Python 3.11 or 3.12: pip install 'allegro-twin\[teleop\]'"
    monkeypatch.setitem(sys.modules, "dex_retargeting", None)
    with pytest.raises(ConfigError, match=words):
        Retargeting(spec, target_vectors(spec)).open()

    class Paragraph(MetaPathFinder):
        """As the library answers where PyTorch is missing."""

        def find_spec(self, name: str, path: Any, target: Any = None) -> None:
            if name.startswith("dex_retargeting"):
                raise ImportError("Torch is not installed.\nInstall it.")

    monkeypatch.delitem(sys.modules, "dex_retargeting")
    monkeypatch.setattr(sys, "meta_path", [Paragraph(), *sys.meta_path])
    with pytest.raises(ConfigError, match=words) as refused:
        Retargeting(spec, target_vectors(spec)).open()
    assert "\n" not in str(refused.value)


def test_without_mediapipe_a_webcam_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    with pytest.raises(ConfigError, match=r"pip install 'allegro-twin\[teleop,webcam\]'"):
        Webcam(tmp_path / "hand_landmarker.task", "right").open()


def test_a_model_that_is_none_is_refused_in_one_line(tmp_path: Path) -> None:
    pytest.importorskip("mediapipe", exc_type=ImportError, reason="needs the extra webcam")
    for name in ("none.task", "text.task"):
        (tmp_path / "text.task").write_text("text")
        with pytest.raises(ConfigError, match=f"{name}: MediaPipe does not take it") as refused:
            Webcam(tmp_path / name, "right").open()
        assert "\n" not in str(refused.value)


class Pictures:
    """OpenCV's camera, as far as it is used: three pictures, then none."""

    def __init__(self, number: int) -> None:
        self.left = 3 if number == 0 else 0

    def isOpened(self) -> bool:  # noqa: N802  # OpenCV's name.
        return self.left > 0

    def set(self, what: str, value: int) -> None:
        assert (what, value) == ("buffer", 1)

    def read(self) -> tuple[bool, Any]:
        self.left -= 1
        return self.left >= 0, np.zeros((4, 4, 3), np.uint8)


def test_a_camera_that_is_not_there_and_one_that_is_pulled_out_are_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    logging = SimpleNamespace(setLogLevel=lambda level: None, LOG_LEVEL_ERROR=2)
    cv2 = SimpleNamespace(
        utils=SimpleNamespace(logging=logging), VideoCapture=Pictures, CAP_PROP_BUFFERSIZE="buffer",
        COLOR_BGR2RGB=4, cvtColor=lambda picture, code: picture,
    )  # fmt: skip
    times: list[int] = []

    def detect(image: Any, milliseconds: int) -> Any:
        times.append(milliseconds)
        return SimpleNamespace(handedness=[], hand_world_landmarks=[])

    monkeypatch.setitem(sys.modules, "cv2", cv2)
    monkeypatch.setattr(
        camera, "_landmarker", lambda model: (SimpleNamespace(detect_for_video=detect), lambda pixels: pixels)
    )
    with pytest.raises(LinkError, match="camera 1 cannot be opened: is it plugged in"):
        Webcam(tmp_path, "right", 1).open()
    look = Webcam(tmp_path, "right").open()
    assert all(np.isnan(look(None)).all() for _ in range(3))
    assert (np.diff(times) > 0).all()  # As its tracker demands.
    with pytest.raises(LinkError, match="camera 0 gives no more pictures"):
        look(None)


@pytest.mark.parametrize("side", ["right", "left"])
def test_of_the_hands_in_a_picture_the_one_that_was_asked_for_is_taken(side: Side) -> None:
    """As MediaPipe gives them: landmarks with x, y, z, and words for whose they are."""
    shown = {"right": hand(0.1), "left": hand(0.9)}
    found = SimpleNamespace(
        handedness=[[SimpleNamespace(category_name=name.title())] for name in shown],
        hand_world_landmarks=[[SimpleNamespace(x=x, y=y, z=z) for x, y, z in points] for points in shown.values()],
    )
    np.testing.assert_array_equal(points_of(found, side), shown[side])
    empty = SimpleNamespace(handedness=[], hand_world_landmarks=[])
    assert np.isnan(points_of(empty, side)).all()


def test_dex_retargeting_brings_fingertips_to_where_they_should_be(side: Side) -> None:
    pytest.importorskip("dex_retargeting", exc_type=ImportError, reason="needs the extra teleop")
    spec = load_spec(side=side)
    retarget, model = Retargeting(spec, target_vectors(spec)).open(), HandKinematics(spec)
    posture = 0.5 * (np.maximum(spec.lower, 0.0) + spec.upper) * np.where(spec.upper > 0.6, 1.0, 0.0)
    posture = np.clip(posture, spec.lower, spec.upper)
    tips = [model.fingertips(posture)[name].position for name in target_vectors(spec).tips]
    thumb = model.fingertips(posture)["thumb"].position
    targets = np.array([tip - (0.0 if k < 4 else thumb) for k, tip in enumerate(tips)])
    for _ in range(60):
        found = retarget(targets)
    for finger in spec.fingers:
        apart = model.fingertips(found)[finger.name].position - model.fingertips(posture)[finger.name].position
        assert np.linalg.norm(apart) < 0.004
    assert ((found >= spec.lower - 2e-3) & (found <= spec.upper + 2e-3)).all()  # Its own tolerance is 1e-3 rad.


def test_a_track_leads_a_hand_through_dex_retargeting(side: Side) -> None:
    """Seen from the palm the tips follow a hand's that is smaller; a pinch is a pinch."""
    pytest.importorskip("dex_retargeting", exc_type=ImportError, reason="needs the extra teleop")
    spec = load_spec(side=side)
    times, frames = performed()
    with (
        WorkerProcess(Retargeting(spec, FingertipTargets(spec, "right").vectors)) as retarget,
        led(sim_config(side), retarget=retarget) as it,
    ):
        stills = times < 1.0
        it.play(times[stills], frames[stills])
        tips, targets = it.hand.fingertips(), it.targets(frames[0])
        for finger, target in zip(spec.fingers, targets, strict=False):
            # Its knuckles stand as a person's do in no finger but the middle one.
            assert np.linalg.norm(tips[finger.name].position - target) < 0.02
        moving = (times >= 1.0) & (times < 4.9)
        it.play(times[moving], frames[moving])
        tips = it.hand.fingertips()
        assert np.linalg.norm(tips["thumb"].position - tips["index"].position) < 0.03
        assert it.follower.tally.followed == int((times < 4.9).sum())


def test_a_tracker_of_ones_own_leads_a_hand_frame_by_frame() -> None:
    pytest.importorskip("dex_retargeting", exc_type=ImportError, reason="needs the extra teleop")
    said: list[str] = []
    with open_follower(sim_config(), "right", said.append, background=False) as (opened, follower):
        for _ in range(60):
            follower.see(opened.state.t, hand(0.1))
            opened.wait(1.0 / 30.0)
        assert opened.fingertips()["middle"].position[2] > 0.12
    assert len(said) == 1


@pytest.mark.slow
def test_the_command_line_follows_a_file_or_says_what_it_lacks(tmp_path: Path) -> None:
    times, frames = performed(rate=10.0)
    write_csv(tmp_path / "short.csv", times[:6], frames[:6])
    command = [sys.executable, "-m", "allegro_twin", "teleop", "sim_right", "--from", "short.csv"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": PATH})
    if installed("dex_retargeting") and installed("torch"):
        assert done.returncode == 0, done.stderr
        assert "6 frames followed; left out: 0 without a hand, 0 that jumped, 0 overtaken" in done.stdout
        assert "a hand is seen, and followed" in done.stderr
    else:
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert "pip install 'allegro-twin[teleop]'" in done.stderr
