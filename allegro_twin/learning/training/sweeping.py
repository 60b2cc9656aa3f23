"""Sweeps of recipes: one training for every combination of values, side by side on this computer."""

from __future__ import annotations

import csv
import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import read_yaml
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.schema import parse_settings
from allegro_twin.learning.training import check_packages, train
from allegro_twin.learning.training.report import SELECTION, check_seeds, compare_policy, write_report
from allegro_twin.learning.training.settings import Recipe
from allegro_twin.sweep import Local, Sweep, run

TABLE = "sweep.csv"
"""In a sweep's folder: a row for each training."""
EVALUATION = "evaluation.json"
"""Beside a trained policy."""


class Variant(NamedTuple):
    """One training of a sweep."""

    name: str
    """Name of its folder."""
    values: dict[str, Any]
    """By the keys of the sweep's file."""
    recipe: Recipe


def read_variants(path: Path, recipe: Recipe) -> list[Variant]:
    """All combinations of the values in a file, of which the last key changes fastest. A key is one of the recipe's, of
    a part with a dot: `environment.step`. Raises ConfigError with the nearest key."""
    content = read_yaml(path)
    for key, values in content.items():
        if not isinstance(values, list) or not values:
            raise ConfigError(f"{path}: {key}: a sweep needs a list of values, not {values!r}")
    if not content:
        raise ConfigError(f"{path}: a sweep has keys of a recipe, each with a list of values; this file has none")
    plain = recipe.model_dump(mode="json", exclude_unset=True)
    found = []
    for places in itertools.product(*(range(len(values)) for values in content.values())):
        values = {key: content[key][place] for key, place in zip(content, places, strict=True)}
        name = ",".join(f"{key}={_short(values[key], place)}" for key, place in zip(content, places, strict=True))
        found.append(Variant(name, values, parse_settings(Recipe, _changed(plain, values), f"{path}: {name}")))
    if len({each.name for each in found}) < len(found):
        raise ConfigError(f"{path}: a key has the same value twice")
    return found


def train_variants(
    variants: Sequence[Variant],
    folder: Path,
    episodes: int,
    jobs: int = 1,
    advance: Callable[[int, int], None] = lambda done, of: None,
) -> list[dict[str, Any]]:
    """Train all in folders of their own, `jobs` at once, and judge each in `episodes` episodes. Trainings that were
    interrupted continue. Returns a row for each, which `sweep.csv` has, too: its values, the `steps` that were trained
    (`steps, trained` where steps are among the values), and success by set of objects, or the `error` with which it
    ended. Raises ConfigError without the extra."""
    for each in variants:
        check_packages(each.recipe)
    items = [
        {
            "folder": str((folder / each.name).resolve()),
            "recipe": each.recipe.model_dump(mode="json", exclude_unset=True),
        }
        for each in variants
    ]
    sweep = Sweep("allegro_twin.learning.training.sweeping:train_items", items, {"episodes": episodes}, unit=1)
    done = run(sweep, None, Local(0 if jobs == 1 else jobs), advance).to_pylist()
    rows = [
        each.values
        | {
            f"{name}, trained" if name in each.values else name: value
            for name, value in row.items()
            if name != "key" and (value is not None or name != "error")
        }
        for each, row in zip(variants, done, strict=True)
    ]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with atomic_file(folder / TABLE) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return rows


def train_items(shared: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The function of the sweep."""
    return [_train(Path(item["folder"]), item["recipe"], int(shared["episodes"])) for item in items]


def _train(folder: Path, content: dict[str, Any], episodes: int) -> dict[str, Any]:
    recipe = parse_settings(Recipe, content, str(folder))
    report = folder / EVALUATION

    def advance(steps: int, mean: float, rate: float) -> None:
        report.unlink(missing_ok=True)  # Of an earlier policy.

    check_seeds(recipe, episodes, str(folder))
    trained = train(recipe, folder, advance, source=str(folder))
    judged = json.loads(report.read_text()) if report.is_file() else {}
    if not judged or any(each["policy"]["episodes"] != episodes for each in judged.values()):
        write_report(compare_policy(trained.policy, recipe, episodes, SELECTION), report)
        judged = json.loads(report.read_text())
    rates = {f"success, {name}": float(each["policy"]["rate"]) for name, each in judged.items()}
    return {"steps": trained.progress.steps, **rates}


def _changed(plain: dict[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """A recipe with other values."""
    found = json.loads(json.dumps(plain))
    for key, value in values.items():
        *parts, last = key.split(".")
        place = found
        for part in parts:
            place = place.setdefault(part, {})
            if not isinstance(place, dict):
                raise ConfigError(f"sweep: {key}: {part} has no parts, it is {place!r}")
        place[last] = value
    return found  # type: ignore[no-any-return]


def _short(value: Any, place: int) -> str:
    """A value as a part of a folder's name; its number in the list where it is no plain word or number."""
    text = str(value)
    return text if isinstance(value, int | float | str) and "/" not in text and len(text) <= 24 else str(place)
