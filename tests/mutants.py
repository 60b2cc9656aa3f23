"""Which small errors in the package would no test see? A mutation test of a random sample.

`python -m tests.mutants --map` runs the tests once and notes which lines each of them reaches (out/mutants/map.json).
`python -m tests.mutants --count 200 --seed 1` then draws mutants at random over the whole package, runs for each the
tests that reach its line in a copy of the repository, and prints those that no test killed and a table by room.

A mutant changes one thing: a comparison, an operator of arithmetic or logic, a number, a condition, the way out of a
loop, or what is returned. Text, annotations and declarations are left alone. A line that no test reaches is a survivor.
A mutant on which the tests do not end is killed.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import signal
import subprocess
import sys
from collections import defaultdict
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "allegro_twin"
OUT = ROOT / "out" / "mutants"
MAP = OUT / "map.json"
FIRST = 25
"""Tests of a line that are run before the rest of their files."""

_COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift,
    ast.RShift: ast.LShift, ast.BitXor: ast.BitAnd, ast.MatMult: ast.Add,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One change: the file, the line, and the text that stands for a part of that file (offsets in characters)."""

    path: Path
    line: int
    begin: int
    end: int
    text: str
    was: str

    def __str__(self) -> str:
        return f"{self.path.relative_to(ROOT)}:{self.line}  {self.was}  →  {self.text}"

    @property
    def room(self) -> str:
        return self.path.relative_to(PACKAGE).parts[0].removesuffix(".py")

    def applied(self) -> str:
        source = self.path.read_text()
        return source[: self.begin] + self.text + source[self.end :]


class _Finder(ast.NodeVisitor):
    """All mutants of a file."""

    def __init__(self, path: Path) -> None:
        self.path, self.source = path, path.read_text()
        self.found: list[Mutant] = []
        lines = self.source.splitlines(keepends=True)
        self._starts = [0]
        for line in lines:
            self._starts.append(self._starts[-1] + len(line))
        self._lines = [line.encode() for line in lines]
        self.visit(ast.parse(self.source))

    def _at(self, line: int, column: int) -> int:
        """An offset in characters of a place that ast gives in bytes of its line."""
        return self._starts[line - 1] + len(self._lines[line - 1][:column].decode())

    def _replace(self, node: ast.expr | ast.stmt, text: str) -> None:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        begin, end = self._at(node.lineno, node.col_offset), self._at(node.end_lineno, node.end_col_offset)
        self.found.append(Mutant(self.path, node.lineno, begin, end, text, self.source[begin:end]))

    def visit(self, node: ast.AST) -> None:
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list", "type_params", "bases", "keywords_of_class"):
                continue
            for each in value if isinstance(value, list) else [value]:
                if isinstance(each, ast.AST):
                    self._look(each)
                    self.visit(each)

    def _look(self, node: ast.AST) -> None:
        match node:
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARISONS:
                self._replace(node, ast.unparse(ast.Compare(left, [_COMPARISONS[type(op)]()], [right])))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS and not _textual(node):
                self._replace(node, f"({ast.unparse(ast.BinOp(left, _OPERATORS[type(op)](), right))})")
            case ast.BoolOp(op=op, values=values):
                other = ast.And() if isinstance(op, ast.Or) else ast.Or()
                self._replace(node, f"({ast.unparse(ast.BoolOp(other, values))})")
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                self._replace(node, f"bool({ast.unparse(operand)})")
            case ast.UnaryOp(op=ast.USub(), operand=operand) if not isinstance(operand, ast.Constant):
                self._replace(node, f"(+{ast.unparse(operand)})")
            case ast.Constant(value=bool(value)):
                self._replace(node, str(not value))
            case ast.Constant(value=int(value)):
                self._replace(node, str(value + 1))
            case ast.Constant(value=float(value)):
                self._replace(node, repr(value * 2.0 if value else 1.0))
            case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test) if not isinstance(test, ast.Compare):
                self._replace(test, f"(not ({ast.unparse(test)}))")
            case ast.Break():
                self._replace(node, "continue")
            case ast.Continue():
                self._replace(node, "break")
            case ast.Return(value=ast.expr() as value) if not _nothing(value):
                self._replace(value, "None")
            case ast.AugAssign(target=target, op=op, value=value) if type(op) in _OPERATORS and not _textual(value):
                other_op = _OPERATORS[type(op)]()
                self._replace(node, ast.unparse(ast.AugAssign(target, other_op, value)))


def _textual(node: ast.AST) -> bool:
    """Whether text, a path or a union of types is put together."""
    return any(
        isinstance(each, ast.JoinedStr) or (isinstance(each, ast.Constant) and not isinstance(each.value, int | float))
        for each in ast.walk(node)
    )


def _nothing(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def found_in(path: Path) -> list[Mutant]:
    """Every mutant of a file, in the order of places."""
    return sorted(_Finder(path).found, key=lambda one: (one.begin, one.end))


def mutants() -> list[Mutant]:
    """Every mutant of the package, in the order of files and places."""
    return [mutant for path in sorted(PACKAGE.rglob("*.py")) for mutant in found_in(path)]


class Contexts:
    """A pytest plugin: coverage by test, its fixtures included."""

    def __init__(self) -> None:
        import coverage

        self.coverage = coverage.Coverage(data_file=str(OUT / "coverage"), source=[str(PACKAGE)], config_file=False)

    def pytest_sessionstart(self) -> None:
        self.coverage.erase()
        self.coverage.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self.coverage.switch_context(item.nodeid)
        try:
            return (yield)
        finally:
            self.coverage.switch_context("")

    def pytest_sessionfinish(self) -> None:
        self.coverage.stop()
        self.coverage.save()


def make_map(words: list[str]) -> int:
    """Run the tests that `words` choose, in this process, and write which test reaches which lines."""
    import coverage

    OUT.mkdir(parents=True, exist_ok=True)
    costs = OUT / "cpu.txt"
    status = pytest.main(["--cpu-file", str(costs), *words], plugins=[Contexts()])
    data = coverage.CoverageData(str(OUT / "coverage"))
    data.read()
    dear = {name: float(cost) for cost, name in (line.split(maxsplit=1) for line in costs.read_text().splitlines())}
    found: dict[str, dict[str, list[str]]] = json.loads(MAP.read_text())["lines"] if MAP.is_file() else {}
    for name in data.measured_files():
        lines = found.setdefault(str(Path(name).relative_to(ROOT)), {})
        for line, tests in data.contexts_by_lineno(name).items():
            lines[str(line)] = sorted({*lines.get(str(line), []), *(test for test in tests if test)})
    known = json.loads(MAP.read_text())["cpu"] if MAP.is_file() else {}
    MAP.write_text(json.dumps({"lines": found, "cpu": known | dear}))
    print(f"{MAP.relative_to(ROOT)}: {len(found)} files; pytest ended with {int(status)}")
    return int(status)


def copied(folder: Path) -> Path:
    """A copy of the repository's files to be spoiled."""
    if folder.exists():
        shutil.rmtree(folder)
    names = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout.decode()
    for name in filter(None, names.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def failed(folder: Path, tests: list[str], seconds: float) -> bool:
    """Whether one of the tests fails, or they do not end within so many seconds of CPU time."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "", "-o", "addopts=", *tests]
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    # A busy computer gives less than a core; what sleeps for ever takes no CPU time at all.
    process = subprocess.Popen(
        ["prlimit", f"--cpu={round(seconds)}", *command],
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        status = process.wait(timeout=4.0 * seconds)
    except subprocess.TimeoutExpired:
        status = -1
    finally:
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        process.wait()
    return status not in (0, 5)


def judged(mutant: Mutant, folder: Path, lines: dict[str, Any], cpu: dict[str, float]) -> str:
    """'killed', 'survived' or 'not reached'."""
    name = str(mutant.path.relative_to(ROOT))
    last = mutant.line + mutant.was.count("\n")
    reached = {test for line in range(mutant.line, last + 1) for test in lines.get(name, {}).get(str(line), [])}
    tests = sorted(reached, key=lambda test: cpu.get(test, 1.0))
    if not tests and not _at_import(mutant):
        return "not reached"
    target = folder / name
    original = target.read_text()
    target.write_text(mutant.applied())
    try:
        for chosen in _rounds(mutant, tests, cpu):
            spent = sum(cpu.get(test, 1.0) for test in chosen)
            if chosen and failed(folder, chosen, 60.0 + 5.0 * spent):
                return "killed"
    finally:
        target.write_text(original)
    return "survived"


def _rounds(mutant: Mutant, tests: list[str], cpu: dict[str, float]) -> Iterator[list[str]]:
    """The cheapest tests of a line first, then the whole files that they are in: a fixture's test may be another.

    What is computed when a module is imported is reached by no test; those of its room, then."""
    yield tests[:FIRST]
    files = list(dict.fromkeys(test.split("::")[0] for test in tests))[:6]
    room = ROOT / "tests" / mutant.room
    if _at_import(mutant) and room.is_dir():
        files += [str(path.relative_to(ROOT)) for path in sorted(room.rglob("test_*.py"))]
    wanted = [test for test in cpu if test.split("::")[0] in files and test not in tests[:FIRST]]
    yield sorted(wanted, key=lambda test: cpu[test])[:800]


def _at_import(mutant: Mutant) -> bool:
    """Whether the line stands outside every function."""
    tree = ast.parse(mutant.path.read_text())
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
    return not any(
        isinstance(node, kinds) and node.lineno <= mutant.line <= (node.end_lineno or 0) for node in ast.walk(tree)
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--map", action="store_true", help="note what the tests reach; takes pytest's words")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--room", default="", help="only of this room")
    parser.add_argument("--at", default="", help="only of a place: path:line")
    parser.add_argument("--bar", type=float, default=0.0, help="exit status 1 below this share")
    options, words = parser.parse_known_args()
    if options.map:
        return make_map(words)
    known = json.loads(MAP.read_text())
    pool = [one for one in mutants() if options.room in ("", one.room)]
    if options.at:
        chosen = [one for one in pool if str(one).split()[0] == options.at]
    else:
        chosen = random.Random(options.seed).sample(pool, min(options.count, len(pool)))
    folder = copied(OUT / "copy")
    counts: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for number, mutant in enumerate(chosen, 1):
        verdict = judged(mutant, folder, known["lines"], known["cpu"])
        counts[mutant.room][verdict] += 1
        print(f"{number:4d} {verdict:11s} {' '.join(str(mutant).split())}", flush=True)
    killed = sum(each["killed"] for each in counts.values())
    print(f"\n| room | mutants | killed |\n|---|---|---|  ({len(pool)} possible, seed {options.seed})")
    for room, each in sorted(counts.items()):
        print(f"| {room} | {sum(each.values())} | {each['killed']} |")
    print(f"| all | {len(chosen)} | {killed} ({killed / max(1, len(chosen)):.0%}) |")
    return int(killed < options.bar * len(chosen))


if __name__ == "__main__":
    sys.exit(main())
