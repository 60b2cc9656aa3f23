"""Every command that Ctrl-C ends says what is lost and what is there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from allegro_twin.cell import assembly
from allegro_twin.cell.journal import observers
from allegro_twin.learning import training
from allegro_twin.learning.mpc import episodes
from allegro_twin.learning.training import report, sweeping
from allegro_twin.surfaces.cli.cell import calibrate, lab
from allegro_twin.surfaces.cli.grasps import improve
from allegro_twin.surfaces.cli.twin import branch_run, identification
from allegro_twin.surfaces.hand import Hand
from allegro_twin.twin.identify import joint_ends
from tests.surfaces.cli.conftest import Run


def stop(*_: Any, **__: Any) -> Any:
    raise KeyboardInterrupt


def film_then_stop(*_: Any, shown: Callable[[Any], None], **__: Any) -> None:
    shown(np.zeros((32, 32, 3), np.uint8))
    raise KeyboardInterrupt


@contextmanager
def filmed(cell: Any, film: Path, stage: Any) -> Iterator[Any]:
    try:
        yield stage
    finally:
        film.write_bytes(b"film")


@pytest.mark.parametrize(
    ("arguments", "where", "said"),
    [
        ("teach mine --into IT.yaml", (Hand, "wait"), "IT.yaml not written"),
        ("calibrate limits", (joint_ends, "find_limits"), "no limits are found"),
        ("calibrate limits --by-hand 9 --into IT.yaml", (joint_ends, "find_limits"), "IT.yaml not written"),
        ("identify a.arrow", (identification, "identify_drive"), "nothing is identified"),
        ("identify a.arrow --hand IT.yaml --report IT.html", (identification, "identify_drive"),
         "IT.yaml, IT.html not written"),
        ("branch a.arrow --at 1", (branch_run, "run_branch"), "nothing is compared"),
        ("branch a.arrow --at 1 --record IT.arrow", (branch_run, "run_branch"), "IT.arrow not written"),
        ("lab-calibrate lab_allegro", (calibrate, "_simulated"), "no mount is found"),
        ("lab-calibrate lab_allegro --out IT", (calibrate, "_simulated"), "IT/mount.yaml not written"),
        ("improve lemon --out IT", (improve, "_load_start"),
         "0 of 3 rounds had ended; nothing is compared or written"),
    ],
)  # fmt: skip
def test_an_interruption_says_what_is_not_written(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch, arguments: str, where: tuple[Any, str], said: str
) -> None:
    monkeypatch.setattr(*where, stop)
    code, _, errors = command(*arguments.replace("IT", str(tmp_path / "it")).split())
    line = " ".join(errors.split())
    assert (code, line) == (130, f"interrupted: {said.replace('IT', str(tmp_path / 'it'))}")


@pytest.mark.parametrize(
    ("checkpoints", "there", "said"),
    [
        ((0,), False, "nothing is kept before the first checkpoint, at 256 actions: the same command begins anew"),
        (
            (0, 256, 512),
            False,
            "the checkpoint at 512 of 768 actions is kept in IT, and the same command continues from it",
        ),
        ((), True, "the checkpoints in IT are as they were, and the same command continues"),
    ],
)  # fmt: skip
def test_an_interrupted_training_says_what_is_kept_and_how_it_goes_on(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch, checkpoints: tuple[int, ...], there: bool, said: str
) -> None:
    def train(recipe: Any, folder: Path, advance: Any, kept: Callable[[int], None], source: str) -> None:
        for steps in checkpoints:
            kept(steps)
        raise KeyboardInterrupt

    recipe, folder = tmp_path / "small.yaml", tmp_path / "it"
    recipe.write_text("{task: Reach, envs: 8, rollout: 16, batch: 64, round: 256, steps: 768}")
    if there:
        (folder / "checkpoints").mkdir(parents=True)
        (folder / "checkpoints" / "00001.zip").touch()
    monkeypatch.setattr(training, "train", train)
    code, _, errors = command("train", recipe, "--out", folder)
    assert (code, " ".join(errors.split())) == (130, f"interrupted: {said.replace('IT', str(folder))}")


def test_a_training_that_is_interrupted_in_its_evaluation_says_that_the_policy_is_there(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = SimpleNamespace(policy=tmp_path / "it" / "policy.onnx", progress=SimpleNamespace(steps=768, seconds=6.0))
    monkeypatch.setattr(training, "train", lambda *_: done)
    monkeypatch.setattr(report, "compare_policy", stop)
    code, _, errors = command("train", "reach", "--out", tmp_path / "it")
    said = f"the policy in {tmp_path / 'it'} is complete, its evaluation is not: the same command makes that"
    assert (code, " ".join(errors.split())) == (130, f"interrupted: {said}")


def test_an_interrupted_sweep_of_trainings_says_how_many_had_ended(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(variants: Any, folder: Path, episodes: int, jobs: int, advance: Callable[[int, int], None]) -> None:
        advance(1, len(variants))
        raise KeyboardInterrupt

    monkeypatch.setattr(sweeping, "train_variants", interrupted)
    rates = tmp_path / "rates.yaml"
    rates.write_text("learning_rate: [1.0e-3, 5.0e-4]\n")
    code, _, errors = command("train", "reach", "--sweep", rates, "--out", tmp_path / "it")
    said = ("interrupted: 1 of 2 trainings had ended; the others keep their last checkpoints in "
            f"{tmp_path / 'it'}, and the same command continues")  # fmt: skip
    assert (code, " ".join(errors.split())) == (130, said)


def test_a_film_that_an_interruption_ends_is_named(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = tmp_path / "it.mp4"
    monkeypatch.setattr(episodes, "run_episodes", film_then_stop)
    code, _, errors = command("mpc", "Rotate", "--film", film)
    said = f"interrupted: 0 of 4 episodes have ended; what came until then is in {film}"
    assert (code, " ".join(errors.split())) == (130, said)
    monkeypatch.setattr(assembly, "make_cell", lambda *_, **__: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(observers, "Observers", lambda *_: SimpleNamespace(hand=None))
    monkeypatch.setattr(observers, "film_stage", filmed)
    monkeypatch.setattr(lab, "_performed", stop)
    code, _, errors = command("lab", "lab_allegro", "--film", film)
    assert (code, " ".join(errors.split())) == (130, f"interrupted: what came until then is in {film}")
