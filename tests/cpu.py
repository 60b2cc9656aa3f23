"""A pytest plugin: what each test costs in CPU time, and an end for a test that would compute for ever.

`pytest --cpu 20` prints the twenty dearest, `--cpu-file FILE` writes all of them. CPU time is user and system time of
the process and of the children that it waited for. It does not say how busy the computer is, so it may be limited:
120 s a test (1,800 s for one that is marked `long`), or what `@pytest.mark.cpu_limit(seconds)` says.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Generator
from pathlib import Path
from types import FrameType
from typing import NoReturn

import pytest

LIMIT = 120.0
"""CPU seconds of a test of `make test`; the dearest takes a tenth of it."""
LONG = 1800.0


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("cpu time")
    group.addoption("--cpu", type=int, default=0, metavar="N", help="print the N tests that take most CPU time")
    group.addoption("--cpu-file", type=Path, default=None, metavar="FILE", help="write every test's CPU time to FILE")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "cpu_limit(seconds): CPU time that the test may take, 120 s if not said")
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Account(config), "cpu-account")


def limit_of(item: pytest.Item) -> float:
    """CPU seconds that `item` may take."""
    if mark := item.get_closest_marker("cpu_limit"):
        return float(mark.args[0])
    return LONG if item.get_closest_marker("long") else LIMIT


def _spent() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    begin = _spent()
    item.user_properties.append(("cpu_begin", begin))
    limited = threading.current_thread() is threading.main_thread() and hasattr(signal, "setitimer")
    if not limited:
        return (yield)
    limit = limit_of(item)

    def over(_signal: int, _frame: FrameType | None) -> NoReturn:
        pytest.fail(f"the test took more than {limit:g} s of CPU time: does it wait for ever?")

    before = signal.signal(signal.SIGPROF, over)
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, None, None]:
    try:
        return (yield)
    finally:
        begin = next(value for name, value in item.user_properties if name == "cpu_begin")
        item.user_properties[:] = [(n, v) for n, v in item.user_properties if n != "cpu_begin"]
        item.user_properties.append(("cpu", _spent() - float(str(begin))))


class _Account:
    """Adds up what the tests of all processes took."""

    def __init__(self, config: pytest.Config) -> None:
        self.config, self.seconds = config, dict[str, float]()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        for name, value in report.user_properties:
            if name == "cpu" and report.when == "teardown":
                self.seconds[report.nodeid] = float(str(value))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if not self.seconds:
            return
        dearest = sorted(self.seconds.items(), key=lambda pair: -pair[1])
        if file := self.config.getoption("--cpu-file"):
            file.write_text("".join(f"{seconds:8.2f} {name}\n" for name, seconds in dearest))
        if count := self.config.getoption("--cpu"):
            terminalreporter.section("CPU time")
            for name, seconds in dearest[:count]:
                terminalreporter.write_line(f"{seconds:8.2f} s {name}")
        whole = sum(self.seconds.values())
        terminalreporter.write_line(f"CPU time of {len(dearest)} tests: {whole / 60.0:.1f} min")
