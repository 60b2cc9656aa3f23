"""`python -m benchmarks.leaderboard`: one table of everything that was tried at each task, learned and not.

It writes docs/results/leaderboard.md from what stands elsewhere: `results` in the pages of the shipped policies
(conf/policies/*.md), and the tables of baselines and of model predictive control in docs/results/environments.md. The
environment of a policy is what its card says. A figure that cannot be is refused, with its file and line. A test keeps
the page current.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.grasping.statistics import wilson
from allegro_twin.hands.library.entries import HAND
from allegro_twin.learning.policy.card import ARM_PICK, PolicyCard, policy_task, read_card
from allegro_twin.learning.tasks import NO_BATCH, TASKS
from allegro_twin.pick.card import PickCard, read_pick_card

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "leaderboard.md"
RESULTS = PAGE.with_name("environments.md")
HEAD = """# Leaderboard

*Results: every task with everything that was tried at it. Made by `python -m benchmarks.leaderboard` from the pages of
the [policies](policies.md) and the tables of [baselines and model predictive control](environments.md); do not edit.*

Rows of one environment compare only where episodes, seeds and physics are the same; the last two columns say which they
were. Intervals are Wilson's, 95 %. "Nothing" is a zero action: the script, where the task has one. A best constant was
chosen on the episodes that it is judged in, which flatters it. `mpc` knows the true state and plans with the true
physics. Policies and `mpc` decide 16.7 times a second in `Rotate` and `Reorient`, policies that add to a script, and
what stands beside them, 12.8 times; all else is at 26. An empty cell was not measured.

| task | environment | who | sees | episodes | success | counted | of | seeds from, physics |
|---|---|---|---|---|---|---|---|---|
"""
_KEYWORDS = ("level", "palm", "grip", "goals", "position_noise", "hand", "control", "perception")
"""Keywords of an environment that say what is asked."""
_BASELINES = "500,000,000, 3 ms"
_MPC = "0, 3 ms"
_RESULTS = ("who", "episodes", "success", "counted, mean", "of", "seeds from, physics")
"""Columns of a policy's page."""
_WHOLE = r"(?:[0-9]{1,3}(?:,[0-9]{3})+|[0-9]+)"
_NUMBER = r"[0-9]+(?:\.[0-9]+)?"
_RATE = re.compile(rf"({_NUMBER}) %(?: \(({_NUMBER}) %–({_NUMBER}) %\))?")
_COUNTED = re.compile(rf"{_NUMBER}(?: ± {_NUMBER})? (?:rad|goals)\b.*")
_WHERE = re.compile(rf"{_WHOLE}, ({_NUMBER}) ms")
_CONSTANT = re.compile(rf"\+{_NUMBER} rad on .+")


class Row(NamedTuple):
    """One line of the page."""

    task: str
    environment: str
    who: str
    sees: str
    episodes: str
    success: str
    counted: str
    of: str
    where: str

    def line(self) -> str:
        return "| " + " | ".join(self) + " |"


def page() -> str:
    """The whole page."""
    found = [*baselines(), *planned(), *policies()]
    order = [*TASKS, NO_BATCH]
    found.sort(key=lambda row: (order.index(row.task.strip("`")), row.environment))  # Stable: nothing comes first.
    return HEAD + "\n".join(row.line() for row in found) + "\n"


def policies(folder: Path | None = None) -> Iterator[Row]:
    """What the pages of the policies in a folder say, else of those that ship. Raises ConfigError for a policy without
    a page, a page without a policy, a network that is there twice, and what a page cannot say."""
    folder = folder or data_root() / "conf" / "policies"
    networks: dict[bytes, str] = {}
    for stem in sorted({path.stem for kind in ("*.md", "*.onnx") for path in folder.glob(kind)}):
        path, network = folder / f"{stem}.md", folder / f"{stem}.onnx"
        for missing, other in ((path, network), (network, path)):
            if not missing.is_file():
                raise ConfigError(f"{_named(other)} has no {missing.name} beside it: add it, or remove {other.name}")
        twin = networks.setdefault(network.read_bytes(), network.name)
        if twin != network.name:
            raise ConfigError(f"{_named(network)} is the network of {twin}, byte for byte: keep one of them")
        card = _card(network)
        for who, episodes, success, counted, of, where in results(path):
            mine = who.strip("`") == path.stem
            yield Row(
                f"`{card.task.removeprefix('AllegroTwin/').removesuffix('-v0')}`",
                environment(card),
                f"[{who}](../../conf/policies/{path.name})" if mine else who,
                seen(card) if mine else "",
                episodes,
                success,
                counted,
                of,
                where,
            )


def results(path: Path) -> list[list[str]]:
    """Rows of a policy's page. Raises ConfigError for one that cannot be."""
    seen_rows: dict[tuple[str, ...], str] = {}
    rows = []
    for line, cells in _lines(path, "results", _RESULTS):
        who, episodes, success, counted, of, where = cells
        name = who.strip("`")
        if name != path.stem and name not in ("nothing", "random", "script") and not _CONSTANT.fullmatch(who):
            raise ConfigError(f'{line}: who "{who}": write `{path.stem}`, whose page this is, nothing, random, or a '
                              "constant as +0.10 rad on the proximal joints")  # fmt: skip
        if not episodes:
            raise ConfigError(f"{line}: episodes is empty: say in words which these were")
        if not success and not counted:
            raise ConfigError(f'{line}: "{who}" has neither success nor a count: write one, or leave the row out')
        _check_rate(line, success, of)
        if counted and (not _COUNTED.fullmatch(counted) or max(_shares(counted)) > 100.0):
            raise ConfigError(f'{line}: counted "{counted}": write a number and rad or goals, as 5.60 ± 0.10 goals; a '
                              "share is at most 100 %")  # fmt: skip
        physics = _WHERE.fullmatch(where)
        if physics is None or float(physics[1]) == 0.0:
            raise ConfigError(f'{line}: seeds from, physics "{where}": write the first seed and the physics step, as '
                              "3,000,000,000, 1 ms")  # fmt: skip
        first = seen_rows.setdefault((name, episodes, of, where), line)
        if first != line:
            raise ConfigError(f'{line}: "{who}" in these episodes is in {first} already: leave one of the two')
        rows.append(cells)
    if not any(row[0].strip("`") == path.stem for row in rows):
        raise ConfigError(f"{_named(path)} has no row of `{path.stem}` in its results: add what it was measured to do")
    return rows


def baselines() -> Iterator[Row]:
    """What needs no learning: three rows for each of that table."""
    for line, (task, level, nothing, random, constant, of) in _lines(RESULTS, "baselines"):
        where = f'`level="{level}"`' if level == "easy" else "default"
        best, _, offset = constant.partition(" at ")
        for who, success in (("nothing", nothing), ("random", random), (f"best constant, {offset}", best)):
            if success != "—":
                _check_rate(line, success, of)
                yield Row(task, where, who, "", "the task's", success, "", of, _BASELINES)


def planned() -> Iterator[Row]:
    """Model predictive control."""
    for mark, who in (("mpc", "mpc"), ("mpc before", "mpc without costs")):
        for case, of, kept, seconds, counted, *_ in table(RESULTS, mark):
            case, _, hand = case.partition(", ")
            task, _, what = case.partition(" ")
            keys = [*(['`goals="yaw"`'] if what == "yaw" else []), *([f'`hand="{hand}"`'] if hand else [])]
            where = ", ".join(keys) or "default"
            which = what if task == "Rotate" else "cube"
            yield Row(f"`{task}`", where, who, "all", f"{which}, sizes of tests, at most 15 s", "",
                      f"{counted} in {seconds} s; {kept} kept", of, _MPC)  # fmt: skip


def _card(network: Path) -> PolicyCard | PickCard:
    return read_pick_card(network) if policy_task(network) == ARM_PICK else read_card(network)


def environment(card: PolicyCard | PickCard) -> str:
    """What a policy's environment asks otherwise than the task's default."""
    own = (card.environment or {}) | ({"hand": card.hand} if isinstance(card, PolicyCard) and card.hand != HAND else {})
    return ", ".join(f"`{key}={own[key]!r}`".replace("'", '"') for key in _KEYWORDS if key in own) or "default"


def seen(card: PolicyCard | PickCard) -> str:
    """What a policy sees."""
    if isinstance(card, PickCard):
        return "arm, hand and object"
    frames = "" if card.history == 1 else f", {card.history} decisions"
    return ("the hand and the object" if card.privileged else "the hand") + frames


def table(path: Path, mark: str) -> Iterator[list[str]]:
    """Cells of the rows between a page's marks. Raises ConfigError without these marks, and for a row with other cells
    than the head of the table."""
    for _, cells in _lines(path, mark):
        yield cells


def _lines(path: Path, mark: str, columns: tuple[str, ...] | None = None) -> Iterator[tuple[str, list[str]]]:
    """File and line of each row, and its cells, as above; of a table with these `columns`, where they are said."""
    begin, end, lines = f"<!-- {mark} -->", f"<!-- /{mark} -->", path.read_text().splitlines()
    if [line for line in lines if line in (begin, end)] != [begin, end]:
        raise ConfigError(f"{_named(path)} has no table between one line {begin} and one line {end}: write both")
    first = lines.index(begin) + 1
    rows = [(f"{_named(path)}:{k + 1}", lines[k]) for k in range(first, lines.index(end)) if lines[k].strip()]
    cells = [(line, [cell.strip() for cell in _inner(text).split("|")]) for line, text in rows]
    head = list(columns) if columns else cells[0][1] if cells else []
    if len(cells) < 3 or cells[0][1] != head:
        where = cells[0][0] if cells else f"{_named(path)}:{first}"
        raise ConfigError(f"{where}: after {begin} come the head | {' | '.join(head)} |, a line of dashes, and rows")
    for line, row in cells[1:]:
        if len(row) != len(head):
            raise ConfigError(f"{line}: {len(row)} cells, | {' | '.join(row)} |, where the head of the table has "
                              f"{len(head)}: {', '.join(head)}; leave a cell empty that was not measured")  # fmt: skip
    yield from cells[2:]


def _inner(row: str) -> str:
    """A row without its outer bars; an empty cell at either end stays."""
    return row.strip().removeprefix("|").removesuffix("|")


def _check_rate(line: str, success: str, of: str) -> None:
    """Raises ConfigError for a rate that so many episodes do not give, and for an interval that is not Wilson's."""
    if not re.fullmatch(_WHOLE, of) or (episodes := int(of.replace(",", ""))) == 0:
        raise ConfigError(f'{line}: of "{of}": write how many episodes these were, 1 or more, as 1,000')
    if not success:
        return
    found = _RATE.fullmatch(success)
    if found is None or max(_shares(success)) > 100.0:
        raise ConfigError(f'{line}: success "{success}": write a share of 0 to 100 %, alone or with its interval, as '
                          "60.6 % (57.5 %–63.6 %)")  # fmt: skip
    rate, low, high = found.groups()
    middle, slack = float(rate) / 100.0 * episodes, _half_digit(rate) / 100.0 * episodes
    counts = range(max(0, math.ceil(middle - slack)), min(episodes, math.floor(middle + slack)) + 1)
    if not counts:
        near = dict.fromkeys(f"{100.0 * k / episodes:.{_decimals(rate)}f} %" for k in _beside(middle))
        raise ConfigError(f"{line}: success \"{success}\": no count of {of} episodes is {rate} %; near are "
                          f"{' and '.join(near)}: correct the share, or of")  # fmt: skip
    intervals = [wilson(k, episodes) for k in counts]
    if low is not None and not any(_is_shown(at.low, low) and _is_shown(at.high, high) for at in intervals):
        told = f"{100.0 * intervals[0].low:.{_decimals(low)}f} %–{100.0 * intervals[0].high:.{_decimals(high)}f} %"
        raise ConfigError(f'{line}: success "{success}": {rate} % of {of} episodes has the Wilson interval ({told}): '
                          "write it, or correct the share, or of")  # fmt: skip


def _beside(number: float) -> tuple[int, int]:
    """The whole numbers on either side."""
    return math.floor(number), math.ceil(number)


def _shares(text: str) -> list[float]:
    """Every share that a cell names, %."""
    return [float(number) for number in re.findall(rf"({_NUMBER}) %", text)] or [0.0]


def _decimals(number: str) -> int:
    return len(number.partition(".")[2])


def _half_digit(number: str) -> float:
    """Half of a number's last digit, and what rounding to it may lose."""
    return 0.5 * 10.0 ** -_decimals(number) + 1e-9


def _is_shown(bound: float, shown: str) -> bool:
    """Whether a share is what stands there, %, to the digit."""
    return abs(100.0 * bound - float(shown)) <= _half_digit(shown)


def _named(path: Path) -> str:
    """A file from the repository's root on, where it lies in it."""
    root = PAGE.parents[2]
    return str(path.relative_to(root) if path.is_relative_to(root) else path)


if __name__ == "__main__":
    try:
        PAGE.write_text(page())
    except ConfigError as error:
        sys.exit(f"error: {error}")
    print(PAGE)
