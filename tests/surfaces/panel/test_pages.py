"""Whether there is a page at all: what is missing is said in one line, before anything is served."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import tomllib
from types import SimpleNamespace
from typing import Any

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.surfaces.panel import page_process


def given(monkeypatch: pytest.MonkeyPatch, *versions: str) -> None:
    """Such a viser is installed, or more than one, or none."""
    found: Any = object() if versions else None
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: found)
    papers = [SimpleNamespace(version=version) for version in versions]
    monkeypatch.setattr(importlib.metadata, "distributions", lambda name: papers)


def opened() -> int:
    """The port on which it listened."""
    with page_process.PageServer("127.0.0.1", 0, "hold")._listening as listening:
        return int(listening.getsockname()[1])


def test_without_viser_it_says_which_extra_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    given(monkeypatch)
    with pytest.raises(ConfigError, match=r"^the panel needs viser: pip install --upgrade 'allegro-twin\[panel\]'$"):
        opened()


@pytest.mark.parametrize("version", ["0.2.23", "1.0.9", "1.0rc1"])
def test_a_viser_that_is_too_old_is_named_with_the_way_out(monkeypatch: pytest.MonkeyPatch, version: str) -> None:
    given(monkeypatch, version)
    with pytest.raises(ConfigError, match=rf"needs viser 1.1 or newer, and {version} is installed: pip install"):
        opened()


@pytest.mark.parametrize("versions", [("1.1.0",), ("1.10.2",), ("0.2.23", "1.1.1")])
def test_a_viser_that_is_new_enough_is_let_be(monkeypatch: pytest.MonkeyPatch, versions: tuple[str, ...]) -> None:
    given(monkeypatch, *versions)
    assert opened() > 0


def test_the_oldest_viser_is_that_of_the_extra() -> None:
    path = data_root() / "pyproject.toml"
    if not path.is_file():
        pytest.skip("installed from a wheel")
    (asked,) = tomllib.loads(path.read_text())["project"]["optional-dependencies"]["panel"]
    assert asked.startswith(f"viser>={'.'.join(map(str, page_process._VISER))}")
