"""A virtual hand's port is a link to a pseudo-terminal: whose link it may replace, and which one it removes."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from allegro_twin.errors import LinkError

if sys.platform == "win32":
    pytest.skip("Windows has no pseudo-terminals", allow_module_level=True)

SERVES = """
import sys, time
from pathlib import Path
from allegro_twin.drivers.{module} import {name}
kept = {name}(Path(sys.argv[1]))
print("there", flush=True)
time.sleep(60.0)
"""


@pytest.mark.parametrize(("module", "name"), [("base.terminal", "Terminal"), ("can.virtual.slcan", "SlcanDevice")])
def test_the_port_of_a_hand_is_not_taken_away_from_the_program_that_serves_it(
    tmp_path: Path, module: str, name: str
) -> None:
    path, code = tmp_path / "hand.tty", SERVES.format(module=module, name=name)
    make = getattr(importlib.import_module(f"allegro_twin.drivers.{module}"), name)
    first = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True)
    try:
        assert first.stdout is not None
        assert first.stdout.readline() == "there\n"
        served = path.readlink()
        with pytest.raises(LinkError, match=rf"hand\.tty is served by another program \(pid {first.pid}\): end it, or"):
            make(path)
        assert path.readlink() == served
    finally:
        first.kill()
        first.communicate()
    again = make(path)  # What was killed has left its link.
    assert path.is_symlink()
    path.unlink()
    path.symlink_to("/dev/pts/of-another")
    (again.close if name == "Terminal" else again.shutdown)()
    assert path.is_symlink()


@pytest.mark.parametrize(("module", "name"), [("base.terminal", "Terminal"), ("can.virtual.slcan", "SlcanDevice")])
def test_a_link_of_yours_is_not_replaced_by_a_terminal(tmp_path: Path, module: str, name: str) -> None:
    (tmp_path / "mine").write_text("precious")
    (path := tmp_path / "hand.tty").symlink_to("mine")
    make = getattr(importlib.import_module(f"allegro_twin.drivers.{module}"), name)
    with pytest.raises(LinkError, match=r"hand\.tty is a link of yours to mine: remove it, or give another place"):
        make(path)
    assert path.read_text() == "precious"
