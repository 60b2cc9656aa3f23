"""`python -m benchmarks.leaderboard`: one table of everything that was tried at each task, learned and not.

It writes docs/results/leaderboard.md from what stands elsewhere: `results` in the pages of the shipped policies
(conf/policies/*.md), and the tables of baselines and of model predictive control in docs/results/environments.md. The
environment of a policy is what its card says. A test keeps the page current.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from allegro_twin.files.assets import data_root
from allegro_twin.hands.library.entries import HAND
from allegro_twin.learning.policy.card import PolicyCard, read_card
from allegro_twin.learning.tasks import TASKS

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
_KEYWORDS = ("level", "palm", "goals", "position_noise", "hand")
"""Keywords of an environment that say what is asked."""
_BASELINES = "500,000,000, 3 ms"
_MPC = "0, 3 ms"


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
    order = [*TASKS]
    found.sort(key=lambda row: (order.index(row.task.strip("`")), row.environment))  # Stable: nothing comes first.
    return HEAD + "\n".join(row.line() for row in found) + "\n"


def policies() -> Iterator[Row]:
    """What the pages of the shipped policies say."""
    for path in sorted((data_root() / "conf" / "policies").glob("*.md")):
        card = read_card(path.with_suffix(".onnx"))
        for who, episodes, success, counted, of, where in table(path, "results"):
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


def baselines() -> Iterator[Row]:
    """What needs no learning: three rows for each of that table."""
    for task, level, nothing, random, constant, of in table(RESULTS, "baselines"):
        where = f'`level="{level}"`' if level == "easy" else "default"
        best, _, offset = constant.partition(" at ")
        for who, success in (("nothing", nothing), ("random", random), (f"best constant, {offset}", best)):
            if success != "—":
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


def environment(card: PolicyCard) -> str:
    """What a policy's environment asks otherwise than the task's default."""
    own = (card.environment or {}) | ({} if card.hand == HAND else {"hand": card.hand})
    return ", ".join(f"`{key}={own[key]!r}`".replace("'", '"') for key in _KEYWORDS if key in own) or "default"


def seen(card: PolicyCard) -> str:
    """What a policy sees."""
    frames = "" if card.history == 1 else f", {card.history} decisions"
    return ("the hand and the object" if card.privileged else "the hand") + frames


def table(path: Path, mark: str) -> Iterator[list[str]]:
    """Cells of the rows between a page's marks. Raises ValueError without these marks."""
    text = path.read_text()
    begin, end = f"<!-- {mark} -->\n", f"<!-- /{mark} -->"
    if begin not in text:
        raise ValueError(f"{path.name} has no table between {begin.strip()} and {end}")
    lines = text.split(begin)[1].split(end)[0].strip().splitlines()
    for line in lines[2:]:
        yield [cell.strip() for cell in line.strip().strip("|").split("|")]


if __name__ == "__main__":
    PAGE.write_text(page())
    print(PAGE)
