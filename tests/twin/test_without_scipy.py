"""Without SciPy every name of the twin that needs it says which package to install."""

from __future__ import annotations

import subprocess
import sys

_CODE = """
import sys
from importlib import import_module
sys.modules["scipy"] = None
from allegro_twin import ConfigError, Hand
def told(ask):
    try:
        ask()
    except ConfigError as error:
        assert str(error) == "a twin needs SciPy: pip install 'allegro-twin[twin]'", error
        return True
    return False
for module in ("allegro_twin.twin", "allegro_twin.twin.rehearsal", "allegro_twin.twin.identify"):
    names = import_module(module)
    print(module, *[name for name in names.__all__ if told(lambda: getattr(names, name))])
with Hand.open("sim_right") as hand:
    print("mirror", told(lambda: hand.mirror))
from allegro_twin.__main__ import main
sys.argv = ["allegro-twin", "rehearse", "can_virtual", "-o", sys.argv[1], "--yes"]
main()
"""


def test_without_scipy_the_twin_is_one_line_and_no_traceback(tmp_path: object) -> None:
    done = subprocess.run([sys.executable, "-c", _CODE, f"{tmp_path}/rh"], capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    assert done.stderr == "allegro-twin: a twin needs SciPy: pip install 'allegro-twin[twin]'\n"
    twin, rehearsal, identify, mirror = done.stdout.splitlines()
    assert {"Mirror", "identify_hand", "mirror_recording"} <= set(twin.split())
    assert rehearsal.split()[1:] == ["Conversation", "HandRehearsal"]
    assert identify.split()[1:] == []
    assert mirror == "mirror True"
