"""Logs of a training, chosen by a recipe's `log`: the learning curve as CSV, TensorBoard, and Weights & Biases."""

from __future__ import annotations

import csv
import math
import os
import uuid
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file, write_error

COLUMNS = ("steps", "seconds", "episodes", "return", "length", "success", "evaluated")
"""The first columns of a curve. Actions in all; s of training; episodes that ended since the last row; their mean
return, length and success rate; and the success rate without noise on the actions, once per round. Empty: no value.
Further columns have the names that TensorBoard shows."""
NO_TERMS = ("is_success", "final_obs")
"""What the info of a step has besides the terms of its task."""
NAMES = {
    "return": "rollout/ep_rew_mean",
    "length": "rollout/ep_len_mean",
    "success": "rollout/success_rate",
    "evaluated": "evaluation/success_rate",
}
"""Names in TensorBoard of the curve's first columns."""
_RUN_ID = "wandb_id"
"""File with the id of a folder's run, so that a continued training continues its run."""


class LoggedRecipe(Protocol):
    """Recipe of a training that is logged."""

    @property
    def log(self) -> tuple[str, ...]:
        """Names of the logs."""
        ...

    def model_dump(self, *, mode: str) -> dict[str, Any]:
        """All its values."""
        ...


class TrainingLog:
    """Writes rows of values to all logs of a recipe. Raises ConfigError where Weights & Biases refuses to begin."""

    def __init__(self, recipe: LoggedRecipe, folder: Path, steps: int) -> None:
        """`steps`: actions so far. What a killed training wrote beyond these is replaced, or hidden."""
        self._seconds, self._steps = 0.0, steps
        self._curve = LearningCurve(folder / "curve.csv", steps) if "csv" in recipe.log else None
        self._board: Any = None
        if "tensorboard" in recipe.log:
            writer = import_module("torch.utils.tensorboard").SummaryWriter
            self._board = writer(str(folder / "tensorboard"), purge_step=steps + 1)
        self._run = _begin_run(recipe, folder) if "wandb" in recipe.log else None

    def __enter__(self) -> TrainingLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._board is not None:
            self._board.close()
        if self._run is not None:
            self._run.finish()

    def add_update(
        self,
        steps: int,
        seconds: float,
        episodes: tuple[int, float, float, float],
        values: Mapping[str, float],
    ) -> None:
        """Add a row after an update. `episodes`: number that ended since the last row, their mean return, length and
        success rate. `values`: losses and more, by their names in TensorBoard."""
        number, *means = episodes
        found = dict(zip(("return", "length", "success"), means, strict=True)) if number else {}
        since = seconds - self._seconds
        rate = {"time/fps": (steps - self._steps) / since} if self._seconds and since > 0.0 else {}
        self._seconds, self._steps = seconds, steps
        self._add({"steps": steps, "seconds": seconds, "episodes": number, **found, **values, **rate})

    def add_evaluation(self, steps: int, seconds: float, rate: float) -> None:
        """Add a row with a success rate that was evaluated without noise on the actions."""
        self._add({"steps": steps, "seconds": seconds, "evaluated": rate})

    def _add(self, row: Mapping[str, float | int]) -> None:
        known = {name: value for name, value in row.items() if not math.isnan(value)}
        if self._curve is not None:
            self._curve.add(known)
        steps = int(row["steps"])
        shown = {NAMES.get(name, name): float(value) for name, value in known.items()
                 if name in NAMES or name not in COLUMNS}  # fmt: skip
        if self._board is not None:
            for name, value in shown.items():
                self._board.add_scalar(name, value, steps)
        if self._run is not None:
            self._run.log(shown, step=steps)


class LearningCurve:
    """A learning curve as a CSV file. It continues after the rows up to `steps`: what a killed training wrote beyond
    its checkpoint is written again."""

    def __init__(self, path: Path, steps: int) -> None:
        self._path, self._columns = path, list(COLUMNS)
        self._write([row for row in self._read() if int(row["steps"]) <= steps] if steps else [])

    def add(self, values: Mapping[str, float | int]) -> None:
        """Add a row; a name that is new becomes a column."""
        if new := [name for name in values if name not in self._columns]:
            rows = self._read()
            self._columns += new
            self._write(rows)
        row = {name: value if isinstance(value, int) else f"{value:.6g}" for name, value in values.items()}
        try:
            with self._path.open("a", newline="") as file:
                csv.DictWriter(file, self._columns, lineterminator="\n").writerow(row)
        except OSError as error:
            raise write_error(self._path, error) from error

    def _read(self) -> list[dict[str, str]]:
        if not self._path.is_file():
            return []
        with self._path.open(newline="") as file:
            reader = csv.DictReader(file)
            rows = [row for row in reader if None not in row.values()]  # The last row may be cut.
            self._columns = [*COLUMNS, *(name for name in reader.fieldnames or () if name not in COLUMNS)]
        return rows

    def _write(self, rows: list[dict[str, str]]) -> None:
        with atomic_file(self._path) as temporary, temporary.open("w", newline="") as file:
            writer = csv.DictWriter(file, self._columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def check_logs(recipe: LoggedRecipe, extra: str) -> None:
    """Raise ConfigError where a package of a log is missing; `extra` brings TensorBoard."""
    for name, brings in (("tensorboard", extra), ("wandb", "wandb")):
        if name in recipe.log:
            try:
                import_module(name)
            except ImportError as error:
                raise ConfigError(
                    f"training needs {name}: pip install 'allegro-twin[{brings}]', or leave {name} out of log"
                ) from error


def _begin_run(recipe: LoggedRecipe, folder: Path) -> Any:
    """A run of Weights & Biases; its own environment variables (WANDB_MODE=offline, WANDB_PROJECT) apply."""
    wandb = import_module("wandb")
    path = folder / _RUN_ID
    if not path.is_file():
        with atomic_file(path) as temporary:
            temporary.write_text(uuid.uuid4().hex)
    try:
        return wandb.init(
            project=os.environ.get("WANDB_PROJECT", "allegro_twin"),
            dir=str(folder),
            id=path.read_text().strip(),
            name=folder.name,
            resume="allow",
            config=recipe.model_dump(mode="json"),
        )
    except wandb.Error as error:
        raise ConfigError(
            f"log wandb: {str(error).splitlines()[0]} (WANDB_MODE=offline keeps the run in {folder / 'wandb'})"
        ) from error
