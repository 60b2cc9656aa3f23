"""Checks of Python, of the required packages and of the extras."""

from __future__ import annotations

import platform
import re
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec

from allegro_twin.surfaces.cli.machine.finding import Diagnosis

_REQUIREMENT = re.compile(r"([A-Za-z0-9_.-]+)(?:\[[^]]*\])?\s*([^;]*)(?:;\s*(.*))?")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)['\"]")
_BEFORE = re.compile(r"python_version\s*<\s*['\"]3\.(\d+)['\"]")
_BOUND = re.compile(r"(>=|<)\s*([0-9.]+)")
Version = Callable[[str], str]


def python() -> Iterator[Diagnosis]:
    """The Python version."""
    found = f"Python {platform.python_version()}, {platform.system()} {platform.release()}, {platform.machine()}"
    fine = sys.version_info >= (3, 11)
    yield Diagnosis("Python", "works" if fine else "broken", found, "" if fine else "install Python 3.11 or newer")


def packages(
    given: list[str] | None = None, its: Version = version, minor: int = sys.version_info[1]
) -> Iterator[Diagnosis]:
    """The required packages, and each extra. `given`: requirements as in the metadata; `minor`: minor version of
    Python 3."""
    given = requires("allegro-twin") or [] if given is None else given
    core, extras = parse_requirements(given)
    wrong = list(_wrong(core, its))
    yield Diagnosis(
        "packages", "broken" if wrong else "works", "; ".join(wrong) or f"{len(core)} needed, all there",
        "pip install --upgrade allegro-twin" if wrong else "",
    )  # fmt: skip
    for extra, needed in extras.items():
        wrong = list(_wrong(needed, its))
        says = "; ".join(wrong) or ", ".join(f"{name} {its(name)}" for name in needed)
        mend = f"pip install 'allegro-twin[{extra}]'" if wrong else ""
        end = _ends(given, extra)
        if wrong and end <= minor:  # pip would silently install nothing.
            says, mend = f"{says}; not for Python 3.{end} and later", f"use Python 3.{end - 1}, and {mend}"
        yield Diagnosis(f"extra {extra}", "absent" if wrong else "works", says, mend)


def rospy(found: bool | None = None) -> Iterator[Diagnosis]:
    """rospy, the library of ROS 1; no extra installs it. `found`: whether it is installed."""
    there = find_spec("rospy") is not None if found is None else found
    yield Diagnosis("rospy", "works" if there else "absent", "ROS 1 works" if there else "no `allegro-twin ros1`",
                  "" if there else "apt-get install python3-rospy; docs/how-to/use_ros.md")  # fmt: skip


def _ends(given: list[str], extra: str) -> int:
    """First minor version of Python 3 that an extra excludes; 999 if it excludes none."""
    markers = [line.partition(";")[2] for line in given]
    mine = [marker for marker in markers if (name := _EXTRA.search(marker)) and name[1] == extra]
    return min((int(found[1]) for marker in mine if (found := _BEFORE.search(marker))), default=999)


def parse_requirements(given: list[str]) -> tuple[dict[str, str], dict[str, dict[str, str]]]:
    """Requirements by name with their bounds: the required ones, and those of each extra but `dev`."""
    core: dict[str, str] = {}
    extras: dict[str, dict[str, str]] = {}
    for line in given:
        match = _REQUIREMENT.match(line)
        assert match is not None
        name, bounds, marker = match.groups()
        extra = _EXTRA.search(marker or "")
        if extra is None:
            core[name] = bounds
        elif extra[1] != "dev":
            extras.setdefault(extra[1], {})[name] = bounds
    return core, dict(sorted(extras.items()))


def _wrong(needed: dict[str, str], its: Version) -> Iterator[str]:
    for name, bounds in needed.items():
        try:
            found = its(name)
        except PackageNotFoundError:
            yield f"{name} is not installed"
            continue
        for sign, bound in _BOUND.findall(bounds):
            if (_number(found) < _number(bound)) == (sign == ">="):
                yield f"{name} is {found}; {bounds.strip()} is needed"


def _number(text: str) -> tuple[int, ...]:
    """The numbers of a release, without suffixes."""
    return tuple(int(part) for part in re.findall(r"\d+", re.split(r"[a-z+]", text)[0]))
