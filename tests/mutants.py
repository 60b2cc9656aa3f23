"""Mutation testing of a random sample: which small errors in the package would no test see?

`python -m tests.mutants --map` runs the tests once and notes which lines each of them reaches (out/mutants/map): what
fixtures do that several tests share, threads, and programs that tests start. A file of tests that has not changed
since is not run again. `python -m tests.mutants --count 200 --seed 1` then draws mutants at random over the whole
package, runs for each the tests that reach its line in a copy of the repository, and prints those that no test killed
and a table by wing. What has been judged is kept (out/mutants/*.jsonl): a run that is cut off goes on where it was.

Which mutants there are, and what is left alone, stands in `tests/mutation/operators.py`. A line that no test reaches is
a survivor. A mutant on which the tests do not end is killed. A test kills only if it passes without the mutant in the
same way, and one that needs time, twice. Of the tests of a line those of its wing are run for `--budget` seconds,
those that cost and reach little first; then others, then the rest of their files, for half as long each. With 20 s or
more what survives is tried again in a process that imports it anew.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import re
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from tests.mutation.coverage_map import Map, is_current, write_coverage
from tests.mutation.operators import PACKAGE, ROOT, Mutant, found_in, mutants

__all__ = ["Mutant", "found_in", "mutants"]

OUT = ROOT / "out" / "mutants"
LEAST = 3
"""Tests of a line that are run whatever they cost."""
THOROUGH = 20.0
"""Seconds of budget from which on what survives is tried in a process that imports it anew, too: what is computed when
other modules are imported goes through it."""
PATIENCE = 200.0
"""s: for the tests of a file that need time, of which one that waits for ever on a busy computer ends the others."""


def copy_repository(folder: Path) -> Path:
    """A copy of the repository's files to be spoiled; what is compiled in it stays."""
    names = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout.decode()
    wanted = {name for name in names.split("\0") if name and (ROOT / name).is_file()}
    for path in folder.rglob("*") if folder.exists() else ():
        if path.is_file() and "__pycache__" not in path.parts and str(path.relative_to(folder)) not in wanted:
            path.unlink()
    for name in wanted:
        source, target = ROOT / name, folder / name
        if not target.is_file() or target.read_bytes() != source.read_bytes():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)
        os.utime(target, (source.stat().st_atime, source.stat().st_mtime))
    return folder


class ServerProcess:
    """The server of `tests/mutation/server.py` in a folder."""

    def __init__(self, folder: Path, how: str, **more: str) -> None:
        environment = os.environ | {"PYTHONPATH": str(folder), "MUTANTS_LOG": str(OUT / f"{how}.log")} | more
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.mutation.server", how],
            cwd=folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.first = self._read()
        if "error" in self.first:
            raise SystemExit(self.first["error"])

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"the server of tests ended with {self._process.wait()}: see {OUT}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def ask(self, **job: Any) -> dict[str, Any]:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(job) + "\n")
        self._process.stdin.flush()
        return self._read()


class Judge:
    """Says of mutants whether a test sees them."""

    def __init__(self, budget: float) -> None:
        self.folder, self.budget = copy_repository(OUT / "copy"), budget
        self.hot = ServerProcess(self.folder, "hot")
        self.marks: dict[str, list[str]] = self.hot.first["tests"]
        self._cold: ServerProcess | None = None
        self.map = Map(OUT / "map")
        self._green: dict[tuple[str, str], bool] = {}
        self._count = 0

    @property
    def cold(self) -> ServerProcess:
        if self._cold is None:
            more = {"MUTANTS_MODULES": json.dumps(self.hot.first["strangers"])} | self.hot.first["environment"]
            self._cold = ServerProcess(self.folder, "cold", **more)
        return self._cold

    def ordered(self, tests: set[str]) -> list[str]:
        """What costs little and reaches little first: it looks closely."""
        return sorted(
            (test for test in tests if test in self.marks and "long" not in self.marks[test]),
            key=lambda test: (self.map.whole(test) * math.sqrt(1.0 + self.map.wide[test]), test),
        )

    def affordable(self, tests: list[str], budget: float) -> list[str]:
        chosen, spent, files = list[str](), 0.0, set[str]()
        for test in tests:
            file = test.split("::")[0]
            spent += self.map.cost.get(test, 10.0) if file in files else self.map.whole(test)
            files.add(file)
            if len(chosen) >= LEAST and spent > budget:
                break
            chosen.append(test)
        return chosen

    def rounds(self, mutant: Mutant) -> Iterator[tuple[str, list[str]]]:
        """How and which tests are run, one lot after the other until one fails."""
        how = "cold" if mutant.imported else "hot"
        reaching = self.map.reaching(mutant)
        mine = {test for test in reaching if test.startswith((f"tests/{mutant.wing}/", f"tests/test_{mutant.wing}"))}
        home = self.affordable(self.ordered(mine), self.budget)
        yield how, home
        first = [*home, *self.affordable(self.ordered(reaching - mine), self.budget / 2.0)]
        yield how, first[len(home) :]
        if mutant.imported:
            files = files_with(mutant.names)
            named = {test for test in self.map.good if test.split("::")[0] in files} - set(first)
            said = self.affordable(self.ordered(named), self.budget / 2.0)
            yield how, said
            first = [*first, *said]
        near = {file for file, _ in Counter(test.split("::")[0] for test in first).most_common(8)}
        if mutant.imported:
            near |= {test.split("::")[0] for test in self.map.good if test.startswith(f"tests/{mutant.wing}")}
        others = {test for test in self.map.good if test.split("::")[0] in near} - set(first)
        if reaching or mutant.imported:
            yield how, self.affordable(self.ordered(others), self.budget / 2.0)
        if first and not mutant.imported and self.budget >= THOROUGH:
            yield "cold", self.affordable(self.ordered(reaching), self.budget / 4.0)[:60]

    def verdict(self, mutant: Mutant) -> dict[str, Any]:
        """'killed', 'survived' or 'not reached', by which test, and what that took."""
        target = self.folder / mutant.name
        before, after = mutant.path.read_text(), mutant.applied()
        tried, seconds = 0, 0.0
        self.put(target, after)
        try:
            for how, tests in self.rounds(mutant):
                tests = [test for test in tests if self._green.get((how, test), True)]
                if not tests:
                    continue
                tried += len(tests)
                found = self.tried(how, tests, target, before, after)
                seconds += found["seconds"]
                while found["killer"] and not self.confirmed(how, found["killer"], target, before, after):
                    tests = [test for test in tests if test != found["killer"]]
                    found = self.tried(how, tests, target, before, after) if tests else {"killer": "", "seconds": 0.0}
                    seconds += found["seconds"]
                if found["killer"]:
                    return {"verdict": "killed", "by": found["killer"], "how": how, "tests": tried, "seconds": seconds}
        finally:
            self.put(target, before)
            shutil.copystat(mutant.path, target)
        return {"verdict": "survived" if tried else "not reached", "tests": tried, "seconds": seconds}

    def put(self, target: Path, text: str) -> None:
        """Write a file of the copy so that nobody takes what was compiled of another text for its own."""
        target.write_text(text)
        self._count += 1
        os.utime(target, (2_000_000_000 + self._count, 2_000_000_000 + self._count))
        for each in target.parent.glob(f"__pycache__/{target.stem}.*.pyc"):
            each.unlink()

    def tried(self, how: str, tests: list[str], target: Path, before: str, after: str) -> dict[str, Any]:
        """Run tests on a mutant: which one failed first, and the seconds."""
        spent = sum(self.map.whole(test) for test in tests)
        more = {"file": str(target), "before": before, "after": after} if how == "hot" and before != after else {}
        server = self.hot if how == "hot" else self.cold
        found = server.ask(tests=tests, cpu=60.0 + 5.0 * spent, wall=240.0 + 10.0 * spent, **more)
        if "refused" in found:
            return self.tried("cold", tests, target, before, after)
        killer = found["failed"][0] if found["failed"] else ""
        if not killer and not found.get("collected", True):
            killer = "it cannot be imported"
        if not killer and (found["status"] != "ended" or found.get("error")):
            killer = found.get("error", "") or found["status"]
        return {"killer": killer, "seconds": found["seconds"]}

    def confirmed(self, how: str, killer: str, target: Path, before: str, after: str) -> bool:
        """Whether what failed passes without the mutant; and fails again with it, where it needs time."""
        if killer not in self.marks:  # It cannot be imported, or it ended the tests.
            return True
        if (how, killer) not in self._green:
            self.put(target, before)
            self._green[how, killer] = not self.tried(how, [killer], target, before, before)["killer"]
            self.put(target, after)
        if not self._green[how, killer]:
            return False
        return "realtime" not in self.marks[killer] or bool(self.tried(how, [killer], target, before, after)["killer"])


def files_with(names: tuple[str, ...]) -> set[str]:
    """The files of tests that have one of some names in their text, or in that of a file that is kept beside them."""
    found = set()
    for path, words in words_of_tests().items():
        if not words.isdisjoint(names):
            beside = [path] if path.suffix == ".py" else path.parent.parent.glob("test_*.py")
            found |= {
                str(each.relative_to(ROOT)) for each in beside if each == path or "assert_snapshot" in each.read_text()
            }
    return found


@cache
def words_of_tests() -> dict[Path, set[str]]:
    files = [path for path in (ROOT / "tests").rglob("*") if path.suffix in (".py", ".txt") and path.is_file()]
    return {path: set(re.findall(r"\w+", path.read_text())) for path in files}


def make_map(words: list[str], anew: bool) -> int:
    """Run the tests of the files that `words` begin, all by default, and write which of them reaches which lines."""
    folder = OUT / "map"
    folder.mkdir(parents=True, exist_ok=True)
    copy = copy_repository(OUT / "copy")
    server = ServerProcess(copy, "hot")
    files: dict[str, list[str]] = defaultdict(list)
    for test, marks in server.first["tests"].items():
        if "long" not in marks:
            files[test.split("::")[0]].append(test)
    bad = 0
    for number, (file, tests) in enumerate(sorted(files.items()), 1):
        if (words and not file.startswith(tuple(words))) or (not anew and is_current(folder, file)):
            continue
        timed = [test for test in tests if "realtime" in server.first["tests"][test]]
        data = OUT / "coverage"
        shutil.rmtree(data, ignore_errors=True)
        answers = list[dict[str, Any]]()
        for lot, wall in (([test for test in tests if test not in timed], 3600.0), (timed, PATIENCE)):
            if lot:
                place = data / str(len(answers))
                place.mkdir(parents=True)
                answers.append(server.ask(tests=lot, cpu=3600.0, wall=wall, map=str(place)))
        lines = write_coverage(data, copy, answers, file, folder)
        failed = [test for each in answers for test in each["failed"]]
        failed += [each.get("error", each["status"]) for each in answers if each["status"] != "ended"]
        bad += len(failed)
        seconds = sum(each["seconds"] for each in answers)
        said = f"{len(tests)} tests, {lines} lines, {seconds:.0f} s"
        print(f"{number:4d} of {len(files)}  {file}: {said}", *failed, flush=True)
    return int(bad > 0)


def wilson(killed: int, count: int) -> tuple[float, float]:
    """The interval of 95 % of a share, after Wilson."""
    z = 1.959964
    middle = (killed + z * z / 2.0) / (count + z * z)
    half = z / (count + z * z) * math.sqrt(killed * (count - killed) / count + z * z / 4.0)
    return middle - half, middle + half


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--map", action="store_true", help="note what the tests reach; takes the files' beginnings")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--wing", default="", help="only of this wing")
    parser.add_argument("--at", default="", help="only of a place: path or path:line")
    parser.add_argument("--budget", type=float, default=40.0, help="seconds of tests for each mutant")
    parser.add_argument("--anew", action="store_true", help="forget what is known")
    parser.add_argument("--again", action="store_true", help="judge what survived again: there are new tests")
    parser.add_argument("--bar", type=float, default=0.0, help="exit status 1 below this share")
    options, words = parser.parse_known_args()
    if options.map:
        return make_map(words, options.anew)
    pool = [one for one in mutants() if options.wing in ("", one.wing)]
    if options.at:
        chosen = [one for one in pool if options.at in (one.name, f"{one.name}:{one.line}")]
        kept = OUT / "at.jsonl"
        kept.unlink(missing_ok=True)
    else:
        chosen = random.Random(options.seed).sample(pool, min(options.count, len(pool)))
        kept = OUT / f"seed-{options.seed}{options.wing and '-'}{options.wing}.jsonl"
    if options.anew:
        kept.unlink(missing_ok=True)
    done = judged(kept)
    judge: Judge | None = None
    for number, mutant in enumerate(chosen, 1):
        row = done.get(mutant.key)
        if row is None or (options.again and row["verdict"] != "killed"):
            judge = judge or Judge(options.budget)
            row = done[mutant.key] = {"mutant": str(mutant), "key": mutant.key} | judge.verdict(mutant)
            with kept.open("a") as file:
                file.write(json.dumps(row) + "\n")
            text = " ".join(str(mutant).split())
            print(f"{number:4d} {row['verdict']:11s} {row['seconds']:5.1f} s {text}  {row.get('by', '')}", flush=True)
    killed = table([(mutant, done[mutant.key]["verdict"]) for mutant in chosen], len(pool), options.seed)
    return int(killed < options.bar * len(chosen))


def judged(path: Path) -> dict[str, dict[str, Any]]:
    """What is known of mutants, the last word on each."""
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
    return {row["key"]: row for row in rows}


def table(verdicts: list[tuple[Mutant, str]], possible: int, seed: int) -> int:
    """Print what survived and how many were killed in each wing; how many in all."""
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for mutant, verdict in verdicts:
        counts[mutant.wing if (PACKAGE / mutant.wing).is_dir() else "(modules)"][verdict] += 1
        if verdict != "killed":
            print(f"{verdict:11s} {' '.join(str(mutant).split())}")
    killed = sum(each["killed"] for each in counts.values())
    print(f"\n| wing | mutants | killed |\n|---|---|---|  ({possible} possible, seed {seed})")
    for wing, each in sorted(counts.items()):
        print(f"| {wing} | {sum(each.values())} | {each['killed']} |")
    low, high = wilson(killed, len(verdicts)) if verdicts else (0.0, 1.0)
    print(f"| all | {len(verdicts)} | {killed} ({killed / max(1, len(verdicts)):.1%}, {low:.0%} to {high:.0%}) |")
    return killed


if __name__ == "__main__":
    sys.exit(main())
