"""A process that has imported everything and collected every test, and lets children of its own run some of them.

`python -m tests.mutation.server hot` in a copy of the repository reads one job a line from its standard input and
answers each with a line: a forked child puts the mutant into the functions that are already there (it exchanges their
code) and runs the tests that the job names, until one fails. `cold` imports only what is not of this project, so that a
child imports the mutant as it stands on the disk: for what is computed when a module is imported.

A job may ask for a map instead: which test reaches which lines, programs that tests start included.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterator
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest

HERE = Path(__file__).resolve().parents[2]
_OURS = ("pytest", "_pytest", "pluggy", "xdist", "execnet", "hypothesis", "_hypothesis", "coverage", "tests",
              "allegro_twin", "__main__", "__mp_main__", "conftest", "iniconfig", "sitecustomize")  # fmt: skip
_CHILD_SUBREAPER = 36
"""prctl: what a descendant leaves behind is this process's."""
_NOTHING: dict[str, Any] = {"failed": [], "passed": [], "costs": {}}
_OPTIONS = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "", "-o", "addopts="]


def code_objects(code: CodeType) -> Iterator[CodeType]:
    """A code object and all that are defined in it, in the order of places."""
    yield code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from code_objects(each)


def exchange_code(path: str, before: str, after: str) -> int:
    """Give the functions of a file the code that its new text has; how many have it now."""
    olds, news = (list(code_objects(compile(text, path, "exec", dont_inherit=True))) for text in (before, after))
    if len(olds) != len(news):
        raise ValueError("the mutant has other functions")
    new_of = {old: new for old, new in zip(olds, news, strict=True) if old != new}
    count = 0
    for each in gc.get_objects():
        if (
            type(each) is FunctionType and each.__code__.co_filename == path and each.__code__ in new_of
        ):  # A proxy may raise.
            each.__code__ = new_of[each.__code__]
            count += 1
    return count


class Reporter:
    """What the tests of a child came to, written down as soon as it is known."""

    def __init__(self, path: Path) -> None:
        self.path, self.failed = path, list[str]()
        self.passed, self.bad = list[str](), list[str]()
        self.costs: dict[str, tuple[float, float]] = {}
        self._wall: dict[str, float] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        name = report.nodeid
        self._wall[name] = self._wall.get(name, 0.0) + report.duration
        if report.failed:
            self.failed.append(name)
            self.write()
        elif report.skipped:
            self.bad.append(name)
        if report.when == "teardown":
            self.passed.append(name)
            cpu = next((float(str(value)) for key, value in report.user_properties if key == "cpu"), 0.0)
            self.costs[name] = (cpu, self._wall[name])

    def write(self, **more: Any) -> None:
        good = [name for name in self.passed if name not in {*self.failed, *self.bad}]
        self.path.write_text(json.dumps({"failed": self.failed, "passed": good, "costs": self.costs} | more))


class Chosen:
    """Of what is collected the tests of a job, in its order: not every name of a test can be a word of a command."""

    def __init__(self, tests: list[str]) -> None:
        self.place = {name: number for number, name in enumerate(tests)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted(
            (item for item in items if item.nodeid in self.place), key=lambda item: self.place[item.nodeid]
        )


class Contexts:
    """Coverage by test in a child; what a fixture does that several tests share is under its own name."""

    def __init__(self, folder: Path) -> None:
        import coverage

        settings = folder / "coverage.rc"
        settings.write_text(
            f"[run]\ndata_file={folder}/cov\nparallel=true\nsource={HERE}/allegro_twin\ncontext=${{MUTANTS_TEST-}}\n"
            "sigterm=true\ndisable_warnings=no-data-collected,module-not-measured\npatch=\n    _exit\n    fork\n"
        )
        os.environ["COVERAGE_PROCESS_START"] = str(settings)
        self.coverage = coverage.Coverage(
            data_file=str(folder / "cov"), data_suffix="main", source=[f"{HERE}/allegro_twin"], config_file=False
        )
        self.coverage.set_option("run:patch", ["fork"])
        self.coverage.set_option("run:disable_warnings", ["no-data-collected", "module-not-measured"])
        self.now = [""]
        begin = subprocess.Popen.__init__

        def begun(process: Any, command: Any, *given: Any, **more: Any) -> None:
            """A program that is to load nothing of this package does not load coverage either: `-S`."""
            listed = isinstance(command, list) and command[0] == sys.executable
            begin(process, [word for word in command if word != "-S"] if listed else command, *given, **more)

        subprocess.Popen.__init__ = begun  # type: ignore[method-assign,assignment]

    @contextlib.contextmanager
    def context(self, name: str) -> Generator[None, None, None]:
        self.now.append(name)
        self._switch()
        try:
            yield
        finally:
            self.now.pop()
            self._switch()

    def _switch(self) -> None:
        os.environ["MUTANTS_TEST"] = self.now[-1].replace("$", "$$")
        self.coverage.switch_context(self.now[-1])

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        with self.context(item.nodeid):
            return (yield)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Generator[None, object, object]:
        if fixturedef.scope == "function":
            return (yield)
        with self.context(f"@{fixturedef.argname}"):
            return (yield)


class Server:
    """Takes jobs and has children do them."""

    def __init__(self) -> None:
        self.jobs, self.answers = os.fdopen(os.dup(0), "r"), os.fdopen(os.dup(1), "w")
        log = os.open(os.environ.get("MUTANTS_LOG", os.devnull), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        null = os.open(os.devnull, os.O_RDONLY)
        os.dup2(null, 0)
        os.dup2(log, 1)
        os.dup2(log, 2)
        self.session: pytest.Session | None = None
        ctypes.CDLL(None).prctl(_CHILD_SUBREAPER, 1, 0, 0, 0)

    def answer(self, content: object) -> None:
        self.answers.write(json.dumps(content) + "\n")
        self.answers.flush()

    def serve(self, first: dict[str, Any]) -> None:
        if getattr(sys.modules.get("mujoco.egl"), "EGL_DISPLAY", None):
            self.answer({"error": "a test draws while it is collected: no child would have the threads that draw"})
            return
        self.answer(first)
        for line in self.jobs:
            self.answer(self.child(json.loads(line)))

    def child(self, job: dict[str, Any]) -> dict[str, Any]:
        folder = Path(tempfile.mkdtemp(prefix="mutant-"))
        begin, spent = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
        process = os.fork()
        if not process:
            code = 3
            try:
                os.setsid()
                resource.setrlimit(resource.RLIMIT_CPU, (int(job["cpu"]) + 1, int(job["cpu"]) + 3))
                os.environ["TMPDIR"] = str(folder)
                tempfile.tempdir = str(folder)
                self.work(job, folder)
                code = 0
            except BaseException as error:  # noqa: BLE001  # A mutant may raise anything; the judge reads it.
                (folder / "error").write_text(f"{type(error).__name__}: {error}")
            finally:
                os._exit(code)
        state = self.waited(process, begin + job["wall"])
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process, signal.SIGKILL)
        if state is None:
            os.waitpid(process, 0)
        self.orphans()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        result = folder / "result.json"
        found = json.loads(result.read_text()) if result.is_file() else dict(_NOTHING)
        if (folder / "error").is_file():
            found["error"] = (folder / "error").read_text()
        found["status"] = "late" if state is None else "ended" if state == 0 else f"status {state}"
        found["seconds"] = time.monotonic() - begin
        found["cpu"] = after.ru_utime + after.ru_stime - spent.ru_utime - spent.ru_stime
        if "map" in job:
            for each in folder.glob("cov*"):
                shutil.move(each, Path(job["map"]) / each.name)
        shutil.rmtree(folder, ignore_errors=True)
        return found

    @staticmethod
    def waited(process: int, end: float) -> int | None:
        """The exit status of a child, or None where it has not ended by `end`."""
        pause = 0.001
        while time.monotonic() < end:
            ended, status = os.waitpid(process, os.WNOHANG)
            if ended:
                return os.waitstatus_to_exitcode(status)
            time.sleep(pause)
            pause = min(pause * 1.5, 0.05)
        return None

    @staticmethod
    def orphans() -> None:
        """End what a child has started and left behind: it is this process's since the child has ended."""
        for _ in range(20):
            left = [int(word) for word in Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()]
            for each in left:
                with contextlib.suppress(OSError):
                    os.kill(each, signal.SIGKILL)
                    os.waitpid(each, 0)
            if not left:
                return

    def work(self, job: dict[str, Any], folder: Path) -> None:
        raise NotImplementedError


class Hot(Server):
    """Everything is imported and every test collected."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        gc.unfreeze()
        self.session = session
        self.items = {item.nodeid: item for item in session.items}
        strangers = [
            name
            for name, module in list(sys.modules.items())
            if name.split(".")[0] not in _OURS
            and not name.startswith(("pytest", "_pytest", "_hypothesis"))
            and not str(getattr(module, "__file__", None) or "").startswith(str(HERE))
        ]
        tests = {
            item.nodeid: [mark.name for mark in item.iter_markers() if mark.name in ("slow", "long", "realtime")]
            for item in session.items
        }
        gc.collect()
        chosen = {name: os.environ[name] for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM") if name in os.environ}
        self.serve({"tests": tests, "strangers": strangers, "environment": chosen})
        return True

    def work(self, job: dict[str, Any], folder: Path) -> None:
        assert self.session is not None
        session, config = self.session, self.session.config
        if "file" in job:
            try:
                exchange_code(job["file"], job["before"], job["after"])
            except (ValueError, SyntaxError) as error:  # Of a closure with fewer variables, say.
                (folder / "result.json").write_text(json.dumps(_NOTHING | {"refused": str(error)}))
                return
        gc.freeze()
        session.items = [self.items[name] for name in job["tests"] if name in self.items]
        factory = config._tmp_path_factory  # type: ignore[attr-defined]
        factory._given_basetemp, factory._basetemp = folder / "tmp", None
        reporter = Reporter(folder / "result.json")
        config.pluginmanager.register(reporter, "mutant-reporter")
        measured = None
        if "map" in job:
            measured = Contexts(folder)
            config.pluginmanager.register(measured, "mutant-contexts")
            measured.coverage.start()
        else:
            config.option.maxfail = 1
        config.pluginmanager.unregister(self)
        with contextlib.suppress(session.Failed, session.Interrupted):
            config.hook.pytest_runtestloop(session=session)
        if measured is not None:
            measured.coverage.stop()
            measured.coverage.save()
            shared = {item.nodeid: list(getattr(item, "fixturenames", ())) for item in session.items}
            reporter.write(fixtures=shared)
        else:
            reporter.write()


class Cold(Server):
    """Nothing of this project is imported; what it stands on is."""

    def work(self, job: dict[str, Any], folder: Path) -> None:
        reporter = Reporter(folder / "result.json")
        files = dict.fromkeys(name.split("::")[0] for name in job["tests"])
        words = [*_OPTIONS, "-x", f"--basetemp={folder / 'tmp'}", *files]
        status = pytest.main(words, plugins=[reporter, Chosen(job["tests"])])
        # A mutant that cannot be imported fails while tests are collected.
        reporter.write(collected=int(status) not in (2, 3, 4))


def main(how: str) -> None:
    sys.path.insert(0, str(HERE))
    if how == "cold":
        server: Server = Cold()
        for name in json.loads(os.environ["MUTANTS_MODULES"]):
            with contextlib.suppress(BaseException):
                importlib.import_module(name)
        ours = [name for name in sys.modules if name.split(".")[0] == "allegro_twin"]
        server.serve({"error": f"{ours[0]} is imported by something else"} if ours else {})
    else:
        hot = Hot()
        status = pytest.main([*_OPTIONS, "tests"], plugins=[hot])
        hot.answer({"error": f"pytest ended with {int(status)}"})


if __name__ == "__main__":
    main(sys.argv[1])
