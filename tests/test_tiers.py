"""What the tests' own plugins promise: a test that waits for ever fails, and none is left out without a reason."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests import mutants
from tests.mutation.server import exchange_code
from tests.patience import comes_true, exit_code, wait_for
from tests.skips import REASONS, Account, known

ROOT = Path(__file__).resolve().parents[1]


def run(folder: Path, code: str, *words: str) -> subprocess.CompletedProcess[str]:
    (folder / "test_it.py").write_text(f"import pytest\n{code}")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.cpu", "-p", "tests.skips", "--rootdir", str(folder),
               "-c", "/dev/null", str(folder), *words]  # fmt: skip
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


def test_a_test_that_computes_for_ever_fails_and_the_others_go_on(tmp_path: Path) -> None:
    code = "@pytest.mark.cpu_limit(0.3)\ndef test_ever():\n    while True: pass\ndef test_other(): pass\n"
    done = run(tmp_path, code, "--cpu", "2", "--cpu-file", str(tmp_path / "cpu.txt"))
    assert done.returncode == 1, done.stdout
    assert "the test took more than 0.3 s of CPU time: does it wait for ever?" in done.stdout
    assert "1 failed, 1 passed" in done.stdout
    seconds, name = (tmp_path / "cpu.txt").read_text().splitlines()[0].split()
    assert float(seconds) >= 0.25
    assert name.endswith("test_ever")


def test_a_skip_that_is_not_on_the_list_fails_the_run_and_one_that_is_says_what_installs_it(tmp_path: Path) -> None:
    done = run(tmp_path, "def test_it(): pytest.skip('no mood')\n")
    assert done.returncode == 1, done.stdout
    assert "SKIPPED WITHOUT LEAVE (1)" in done.stdout
    assert "no mood" in done.stdout
    code = "def test_it(): pytest.skip('needs the extra rl')\n"
    done = run(tmp_path, code)
    assert done.returncode == 0, done.stdout
    assert "skipped   1 of rl: make test-rl" in done.stdout
    assert run(tmp_path, code, "--whole", "rl").returncode == 1


def test_in_ci_what_it_installs_is_not_left_out() -> None:
    words = "no OpenGL here: EGL"
    for ci, refused in ((False, 0), (True, 1)):
        account = Account([], ci)
        account.add("tests/look.py:3", words)
        assert len(account.refused) == refused
    assert known("could not import 'torch': No module named 'torch'") is not None
    assert known("it is Monday") is None
    assert all(reason.remedy for reason in REASONS)


def test_no_folder_of_tests_is_passed_over(pytestconfig: pytest.Config) -> None:
    for folder in {path.parent for path in (ROOT / "tests").rglob("test_*.py")}:
        assert not pytestconfig.hook.pytest_ignore_collect(collection_path=folder, config=pytestconfig), folder


def test_patience_ends_with_what_was_waited_for() -> None:
    count = iter(range(5))
    assert comes_true(lambda: next(count) == 3)
    assert not comes_true(lambda: False, 0.05)
    with pytest.raises(AssertionError, match="the moon did not come about"):
        wait_for(lambda: False, "the moon", 0.05)
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]) as process:
        with pytest.raises(AssertionError, match="did not end"):
            exit_code(process, 0.05)
        assert process.returncode == -9


def test_a_mutant_is_one_change_that_still_parses(tmp_path: Path) -> None:
    path = tmp_path / "a.py"
    path.write_text(
        'def f(x: int = 3) -> int:\n    """Text 1."""\n    if x < 2.5 and not x:\n        return "é" + str(x)\n'
        "    return x * -x\n"
    )
    found = {(one.line, one.was, one.text) for one in mutants.found_in(path)}
    assert (3, "x < 2.5", "x <= 2.5") in found
    assert (3, "2.5", "5.0") in found
    assert (3, "not x", "bool(x)") in found
    assert (3, "x < 2.5 and not x", "(x < 2.5 or not x)") in found
    assert (5, "x * -x", "(x / -x)") in found
    assert (1, "3", "4") in found
    assert not [one for one in found if one[0] == 2]  # Text is left alone.
    for one in mutants.found_in(path):
        compile(one.applied(), "a.py", "exec")
        assert one.applied() != path.read_text()


IDLE = """
import time
from typing import TYPE_CHECKING, Protocol
if TYPE_CHECKING:
    A = 1
class Seen(Protocol):
    def f(self, x: int = 3) -> int: ...
class Thing:
    def __repr__(self) -> str:
        return "a" if 1 < 2 else "b"
def f(a, b, wait):
    pairs = list(zip(a, b, strict=True))
    path.mkdir(parents=True, exist_ok=True)
    lock.acquire(timeout=3.0)
    time.sleep(0.5)
    data = socket.recv(4096)
    text = f"{round(wait, 3)}"
if __name__ == "__main__":
    f(1, 2, 3)
"""


def test_what_says_nothing_of_the_package_is_no_mutant_and_its_neighbours_are(tmp_path: Path) -> None:
    path = tmp_path / "idle.py"
    path.write_text(IDLE)
    assert mutants.found_in(path) == []
    path.write_text(
        "x = round(wait, 3)\nlock.acquire(timeout=2.0 * wait)\nf(zip(a[1:], b, strict=True), frozen=frost)\n"
    )
    assert {(one.line, one.was) for one in mutants.found_in(path)} == {
        (1, "3"), (2, "2.0 * wait"), (2, "2.0"), (3, "1"),
    }  # fmt: skip


def test_a_mutant_knows_what_uses_it(tmp_path: Path) -> None:
    path = tmp_path / "uses.py"
    path.write_text("NEAR = 3\nclass Thing:\n    wide: int = 4\ndef f(x=5):\n    y = 6\n    return None\n")
    near, wide, default, inside = mutants.found_in(path)
    assert (near.imported, near.names, near.lines) == (True, ("NEAR",), None)
    assert (wide.imported, wide.names) == (True, ("wide",))
    assert (default.imported, default.lines) == (True, (5, 6))
    assert (inside.imported, inside.lines) == (False, (5, 5))


def test_functions_that_are_there_already_take_the_code_of_a_mutant(tmp_path: Path) -> None:
    before = "def f(x):\n    def g(y):\n        return x + y\n    return g\ndef h():\n    return 1\n"
    path = tmp_path / "module.py"
    made: dict[str, Any] = {}
    exec(compile(before, str(path), "exec", dont_inherit=True), made)
    inner = made["f"](1)
    assert exchange_code(str(path), before, before.replace("x + y", "x - y")) == 2
    assert (inner(3), made["f"](1)(3), made["h"]()) == (-2, -2, 1)
    with pytest.raises(ValueError, match="other functions"):
        exchange_code(str(path), before, "def f():\n    return 1\n")


def test_a_share_of_mutants_has_an_interval() -> None:
    low, high = mutants.wilson(30, 53)
    assert (low, high) == pytest.approx((0.433, 0.691), abs=1e-3)
    assert mutants.wilson(10, 10)[1] == pytest.approx(1.0)
