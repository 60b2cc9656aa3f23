"""Which test reaches which lines: a map with a file for each file of tests, made anew where that file has changed."""

from __future__ import annotations

import ast
import hashlib
import json
import shutil
from base64 import b64decode, b64encode
from collections import Counter, defaultdict
from functools import cache
from pathlib import Path
from typing import Any

from tests.mutation.operators import PACKAGE, ROOT, Mutant


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def map_file(folder: Path, file: str) -> Path:
    """Where the part of the map stands that a file of tests makes."""
    return folder / (file.replace("/", ".") + ".json")


def is_current(folder: Path, file: str) -> bool:
    """Whether the map has a file of tests as it is now."""
    path = map_file(folder, file)
    return path.is_file() and json.loads(path.read_text())["digest"] == digest(ROOT / file)


def write_coverage(data: Path, copy: Path, answers: list[dict[str, Any]], file: str, folder: Path) -> int:
    """Write what the tests of a file reached, from the data of coverage in `data`; how many lines they are."""
    import coverage
    from coverage.numbits import nums_to_numbits

    shared: dict[str, set[str]] = defaultdict(set)
    costs, good = dict[str, list[float]](), list[str]()
    for answer in answers:
        costs |= answer["costs"]
        good += answer["passed"] + answer["failed"]
        for test, fixtures in answer.get("fixtures", {}).items():
            for fixture in fixtures:
                shared[f"@{fixture}"].add(test)
    reached: dict[str, dict[str, set[int]]] = defaultdict(lambda: defaultdict(set))
    for each in sorted(data.rglob("cov*")):
        if each.suffix == ".rc":
            continue
        found = coverage.CoverageData(str(each))
        try:
            found.read()
        except coverage.exceptions.DataError:
            continue  # Of a program that was killed while it wrote.
        for name in found.measured_files():
            place = str(Path(name).relative_to(copy))
            for line, contexts in found.contexts_by_lineno(name).items():
                for context in contexts:
                    for test in shared.get(context, {context.replace("$$", "$")}):
                        reached[place][test].add(line)
    lines = {
        place: {test: b64encode(nums_to_numbits(own)).decode() for test, own in by_test.items() if test in costs}
        for place, by_test in reached.items()
    }
    content = {
        "digest": digest(copy / file),
        "costs": costs,
        "good": good,
        "lines": lines,
    }
    map_file(folder, file).write_text(json.dumps(content))
    shutil.rmtree(data)
    return sum(len(set().union(*by_test.values())) for by_test in reached.values())


class Map:
    """Which test reaches which lines, and what it costs."""

    def __init__(self, folder: Path) -> None:
        self._lines: dict[str, list[tuple[str, bytes]]] = defaultdict(list)
        self.cpu: dict[str, float] = {}
        self.cost: dict[str, float] = {}
        """Seconds of CPU time, and what is waited for counts too."""
        self.good: set[str] = set()
        self.wide: Counter[str] = Counter()
        """How many bytes of eight lines a test reaches: who reaches little looks at it."""
        self.shared: dict[str, float] = {}
        """What the first test of a file made for the others, s, for whichever of them is the first now."""
        for path in sorted(folder.glob("*.json")):
            content = json.loads(path.read_text())
            self.good |= set(content["good"])
            for test, (cpu, wall) in content["costs"].items():
                self.cpu[test], self.cost[test] = cpu, max(cpu, wall) + 0.002
            first, *others = [cpu for cpu, _ in content["costs"].values()] or [0.0]
            self.shared[path.name] = max(first - 3.0 * sorted(others)[len(others) // 2], 0.0) if others else 0.0
            for place, by_test in content["lines"].items():
                found = [(test, b64decode(numbits)) for test, numbits in by_test.items()]
                self._lines[place] += found
                self.wide.update({test: len(numbits) - numbits.count(0) for test, numbits in found})

    def whole(self, test: str) -> float:
        """What a test costs alone, s, by guess."""
        return self.cost.get(test, 10.0) + self.shared[map_file(Path(), test.split("::")[0]).name]

    def at(self, place: str, first: int, last: int) -> set[str]:
        """The tests that reach one of the lines."""
        return {
            test
            for test, numbits in self._lines.get(place, ())
            for line in range(first, last + 1)
            if line // 8 < len(numbits) and numbits[line // 8] & (1 << line % 8) and test in self.good
        }

    def reaching(self, mutant: Mutant) -> set[str]:
        """The tests that reach a mutant: its lines, or those of the functions that use the name that it changes."""
        if mutant.lines is not None:
            return self.at(mutant.name, *mutant.lines)
        names = set(mutant.names)
        while more := {made for name in names for made in made_of().get(name, ())} - names:
            names |= more
        places = [place for name in names for place in uses().get(name, ())]
        return set().union(*(self.at(*place) for place in places))


@cache
def uses() -> dict[str, list[tuple[str, int, int]]]:
    """The functions of the package that mention a name, as a variable or an attribute: file, first and last line."""
    found: dict[str, list[tuple[str, int, int]]] = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                place = (str(path.relative_to(ROOT)), node.body[0].lineno, node.end_lineno or node.body[-1].lineno)
                names = {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}
                names |= {each.attr for each in ast.walk(node) if isinstance(each, ast.Attribute)}
                for name in names:
                    found[name].append(place)
    return found


@cache
def made_of() -> dict[str, set[str]]:
    """What is computed of a name outside of functions: by that name, the names of what is made of it."""
    found: dict[str, set[str]] = defaultdict(set)
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                made = {each.id for target in targets for each in ast.walk(target) if isinstance(each, ast.Name)}
                for each in ast.walk(node.value):
                    if isinstance(each, ast.Name):
                        found[each.id] |= made
    return found
