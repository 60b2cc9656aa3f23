"""A pytest plugin: which tests may be skipped, and what would run them.

A skipped test says nothing, so each reason is on a list with its remedy, and the end of a run prints how many tests
were left out for want of what. A reason that is not on the list fails the run. `--whole NAME` (rl, panel, …) runs a
tier for which everything of that name is installed: what it leaves out fails too. So does, where CI is set, whatever
`.ci/run` installs.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Generator
from dataclasses import dataclass

import pytest


@dataclass(frozen=True)
class Reason:
    """Why a test may be left out: words of the skip, the tier that has it, and what installs it."""

    pattern: str
    tier: str
    remedy: str


_LEARNING = r"torch|stable_baselines3|rsl_rl|\bonnx\b|tensorboard|extra rl|extras? rsl|needs the extra rl|trains: extra"
REASONS = (
    Reason(r"mujoco_warp|MuJoCo Warp|there is an NVIDIA GPU", "gpu", "a GPU, pip install 'allegro-twin[warp]'"),
    Reason(r"extra teleop|extra webcam|mediapipe|dex_retargeting", "teleop", "pip install '.[teleop,webcam]'"),
    Reason(r"\bray\b|Ray is not", "ray", "pip install 'allegro-twin[ray]'"),
    Reason(r"LEROBOT_PYTHON", "lerobot", "LEROBOT_PYTHON=… (CONTRIBUTING.md)"),
    Reason(r"needs Debian's|ROS 1|rospy", "ros", "apt-get install what the reason names"),
    Reason(r"panel needs viser|viser|playwright|no browser", "panel", "make test-panel"),
    Reason(r"only Minari", "minari", "pip install minari"),
    Reason(_LEARNING, "rl", "make test-rl"),
    Reason(r"no python\d", "python", "another Python beside this one"),
    Reason(r"the site is not built|extra docs", "docs", "make docs"),
    Reason(r"no screen|xvfb|there is a screen", "screen", "apt-get install xvfb"),
    Reason(r"OpenGL|EGL|GL_|GLContext|no context|libEGL|render", "ci", "apt-get install libegl1 libgl1-mesa-dri"),
    Reason(r"user-mode-linux|iproute2", "ci", "apt-get install user-mode-linux iproute2"),
    Reason(r"trimesh|collada", "ci", "pip install 'allegro-twin[meshes]'"),
    Reason(r"extra franka", "franka", "pip install 'allegro-twin[franka]'"),
    Reason(r"extra realsense", "realsense", "pip install 'allegro-twin[realsense]', apt-get install libusb-1.0-0"),
    Reason(r"HAND_MODELS", "models", "tests/hands/get_models FOLDER; HAND_MODELS=FOLDER"),
)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.getgroup("skips").addoption(
        "--whole",
        action="append",
        default=[],
        metavar="NAME",
        help="a tier that has no skips: rl, panel, …",
    )


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Account(config.getoption("--whole"), bool(os.environ.get("CI"))), "skip-account")


def known(words: str) -> Reason | None:
    """The entry of the list that a skip's words fall under, or None."""
    return next((reason for reason in REASONS if re.search(reason.pattern, words)), None)


class Account:
    """Counts the skips of all processes, by reason."""

    def __init__(self, whole: list[str], ci: bool) -> None:
        self.forbidden = {*whole, *(["ci"] if ci else [])}
        self.allowed, self.refused = Counter[tuple[str, str]](), Counter[str]()
        self.modules = set[str]()

    def add(self, where: str, words: str) -> None:
        """One test that was left out at `where` (file:line) for the reason `words`."""
        reason = known(words)
        if reason is None or reason.tier in self.forbidden:
            self.refused[f"{where}: {words}"] += 1
        else:
            self.allowed[(reason.tier, reason.remedy)] += 1

    def _report(self, report: pytest.TestReport | pytest.CollectReport) -> None:
        if report.skipped and not hasattr(report, "wasxfail"):
            place = report.longrepr if isinstance(report.longrepr, tuple) else (report.nodeid, "", str(report.longrepr))
            self.add(f"{os.path.relpath(str(place[0]))}:{place[1]}", str(place[2]).removeprefix("Skipped: "))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._report(report)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.nodeid not in self.modules:  # Every process collects every module.
            self._report(report)
        self.modules.add(report.nodeid)

    @pytest.hookimpl(wrapper=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> Generator[None, object, object]:
        result = yield
        if self.refused and session.exitstatus == 0:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
        return result

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        for (tier, remedy), count in sorted(self.allowed.items()):
            terminalreporter.write_line(f"skipped {count:3d} of {tier}: {remedy}")
        for words, count in self.refused.items():
            terminalreporter.write_line(f"SKIPPED WITHOUT LEAVE ({count}): {words}", red=True)
