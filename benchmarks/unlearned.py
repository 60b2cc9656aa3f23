"""What needs no learning, and the table of it in a page."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.errors import unknown
from allegro_twin.grasping.statistics import wilson
from allegro_twin.learning.policy.interface import Floats, Observation
from allegro_twin.learning.tasks import task_type
from allegro_twin.learning.training.evaluation import Evaluation

SEED = 500_000_000


def levels(tasks: Iterable[str]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Each task at each of its levels: its name, the level's, and the setting that chooses it."""
    for task in tasks:
        residual = "level" in task_type(task).own_settings
        for level in ("easy", "default") if residual else ("—",):
            yield task, level, {"level": level} if residual else {}


class Random:
    """Uniform actions, the same ones at every run."""

    def __init__(self, motors: int) -> None:
        self._generator, self._motors = np.random.default_rng(0), motors

    def __call__(self, observation: Observation) -> Floats:
        seen = observation["observation"] if isinstance(observation, dict) else observation
        return self._generator.uniform(-1.0, 1.0, (*seen.shape[:-1], self._motors)).astype(np.float32)


def shown(found: Evaluation) -> str:
    """A rate of success with its 95 % interval."""
    low, high = wilson(int(found.success.sum()), len(found.success))
    return f"{found.rate:.0%} ({low:.0%}–{high:.0%})".replace("%", " %")


def chosen(words: Iterable[str], known: Sequence[str], mark: str) -> tuple[list[str], list[Path]]:
    """The names among `words`, all that are `known` where there is none, and pages that have this mark. Exits with one
    line for any other word, before anything is computed."""
    words = list(words)
    pages = [Path(word) for word in words if word.endswith(".md")]
    for word in words:
        if word not in known and not word.endswith(".md"):
            raise SystemExit(unknown("row", word, known))
    for page in pages:
        _split(page, mark)
    return [name for name in known if name in words] or list(known), pages


def put(lines: Iterable[str], pages: Iterable[Path], mark: str, key: int = 0) -> None:
    """Print a table as it is made, and then put it between the marks of pages. `key`: the first cells of a row say of
    what it is; rows of a page that are of something else stay, and those of the same are replaced where they stand. 0:
    the whole table is replaced."""
    table = []
    for line in lines:
        print(line, flush=True)
        table.append(line)
    for page in pages:
        before, old, after = _split(page, mark)
        kept = _merged(old.strip().splitlines(), table, key) if key else table
        page.write_text(before + "\n" + "\n".join(kept) + "\n" + after)


def _merged(old: list[str], new: list[str], key: int) -> list[str]:
    """Rows of two tables, by what they are of; head and rule are the newer one's."""
    of = {_named(line, key): line for line in old[2:]} | {_named(line, key): line for line in new[2:]}
    return new[:2] + list(of.values())


def _named(row: str, key: int) -> tuple[str, ...]:
    return tuple(cell.strip() for cell in row.split("|")[1 : key + 1])


def _split(page: Path, mark: str) -> tuple[str, str, str]:
    """The text before a page's table, the table, and the text behind it; the marks are outside. Exits where there is
    no page, or no such mark in it."""
    begin, end = f"<!-- {mark} -->", f"<!-- /{mark} -->"
    try:
        text = page.read_text()
    except OSError as error:
        raise SystemExit(f"{page}: {error.strerror}") from error
    before, first, rest = text.partition(begin)
    table, last, after = rest.partition(end)
    if not (first and last):
        raise SystemExit(f"{page}: has no {begin} and {end}: write both where the table is to be")
    return before + begin, table, end + after
