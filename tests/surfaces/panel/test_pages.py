"""Whether there is a page at all: what is missing is said in one line, before anything is served."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import threading
import tomllib
import urllib.error
import urllib.request
from types import SimpleNamespace
from typing import Any

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.surfaces.panel import page_process
from allegro_twin.surfaces.panel.requests import StopMotion
from allegro_twin.surfaces.panel.stream import Notice
from tests.patience import wait_for


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


@pytest.mark.parametrize(
    ("host", "here"),
    [("localhost", True), ("127.0.0.1", True), ("127.3.2.1", True), ("::1", True), ("0.0.0.0", False),
     ("10.0.0.2", False), ("example.org", False), ("", False)],
)  # fmt: skip
def test_only_this_computer_reaches_a_loopback_address(host: str, here: bool) -> None:
    assert page_process.is_loopback(host) is here


def test_a_page_for_this_computer_needs_no_token_and_answers_to_its_own_names_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given(monkeypatch, "9.9")
    made = page_process.PageServer("127.0.0.1", 0, "hold")
    with made._listening as listening:
        port = listening.getsockname()[1]
        assert made._url == f"http://127.0.0.1:{port}/"
        assert made._setup == page_process.PageSetup(None, ("localhost", "127.0.0.1", "::1", "127.0.0.1"))


def test_a_page_for_others_has_a_token_that_nobody_guesses_and_any_name(monkeypatch: pytest.MonkeyPatch) -> None:
    given(monkeypatch, "9.9")
    found = []
    for _ in range(2):
        made = page_process.PageServer("0.0.0.0", 0, "limp")
        with made._listening as listening:
            token = made._setup.token
            assert token is not None
            assert len(token) == 32  # 24 bytes.
            assert made._url == f"http://0.0.0.0:{listening.getsockname()[1]}/?token={token}"
            assert made._setup == page_process.PageSetup(token, ())
            found.append(token)
    assert found[0] != found[1]
    given_one = page_process.PageServer("0.0.0.0", 0, "limp", "a-token-of-my-own")
    with given_one._listening:
        assert given_one._url.endswith("?token=a-token-of-my-own")


def test_an_address_of_numbers_and_colons_stands_in_brackets(monkeypatch: pytest.MonkeyPatch) -> None:
    given(monkeypatch, "9.9")
    try:
        made = page_process.PageServer("::1", 0, "hold")
    except ConfigError:
        pytest.skip("no context: this computer has no IPv6, as one without libEGL has no pictures")
    with made._listening as listening:
        assert made._url == f"http://[::1]:{listening.getsockname()[1]}/"


def test_a_port_that_is_taken_and_an_address_of_another_computer_are_refused_with_the_way_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given(monkeypatch, "9.9")
    with page_process.PageServer("127.0.0.1", 0, "hold")._listening as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=rf"port {port} is taken by another program; choose another with --port"):
            page_process.PageServer("127.0.0.1", port, "hold")
    for host in ("192.0.2.1", "no such host"):
        with pytest.raises(ConfigError, match=rf"--host {host}: no address of this computer"):
            page_process.PageServer(host, 0, "hold")


def test_a_page_that_dies_is_opened_again_three_times_and_then_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    given(monkeypatch, "9.9")
    made = page_process.PageServer("127.0.0.1", 0, "hold")
    asked: list[tuple[Any, ...]] = []
    monkeypatch.setattr(page_process, "PageProcess", lambda *given: asked.append(given))
    with made._listening as listening:
        for _ in range(4):
            made.open()
        assert asked == [(listening, made._setup, made._url)] * 4
        with pytest.raises(ConfigError, match="the panel's page has ended 4 times"):
            made.open()


@pytest.mark.slow
def test_a_page_is_served_by_a_process_of_its_own_and_its_stop_comes_back_as_a_request() -> None:
    pytest.importorskip("viser", reason="needs viser: extra panel")
    made = page_process.PageServer("127.0.0.1", 0, "hold")
    page = made.open()
    requests = page.requests()
    said: list[Any] = []
    listener = threading.Thread(target=lambda: said.extend(requests))
    listener.start()
    try:
        url = page.address()
        assert url == made._url
        assert page.alive
        with urllib.request.urlopen(url) as answer:
            text = answer.read().decode()
        assert "STOP" in text
        assert "<title>" in text
        page.tell(Notice("hello"))
        urllib.request.urlopen(urllib.request.Request(f"{url}stop", method="POST")).close()
        wait_for(lambda: said == [StopMotion()], "a stop")
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"{url}etc/passwd")
    finally:
        page.close()
        listener.join()
        made._listening.close()
    assert page._process.returncode is not None
    assert not page.alive
    page.tell(Notice("nobody hears this"))
    with pytest.raises(ConfigError, match="the panel's page did not start"):
        page.address()
