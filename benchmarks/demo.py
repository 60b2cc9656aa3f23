"""CPU time of the demo: physics, control, what is seen, and pictures. `python -m benchmarks.demo [OBJECT ...]`."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Any

from allegro_twin.app import assemble, scenario_config
from allegro_twin.app.session import Outputs, perform
from allegro_twin.files.assets import data_root
from benchmarks.figures import show

Figure = tuple[str, float, float, str]


def figures(names: list[str] | None = None) -> Iterator[Figure]:
    """Every trial of the demo with the right hand in this process: without outputs, with a recording, with pictures."""
    scenarios = names or sorted(path.stem for path in (data_root() / "scenarios" / "demo").glob("*.yaml"))
    steps = _Clock(import_module("mujoco"), "mj_step")
    seconds = {"plain": 0.0, "recorded": 0.0, "pictured": 0.0}
    physics = 0.0
    with tempfile.TemporaryDirectory() as folder:
        record, image = Path(folder) / "a.arrow", Path(folder) / "a.png"
        _performed(scenarios[0], Outputs(record, image))  # What is loaded once.
        for name in scenarios:
            for kind, outputs in (
                ("plain", Outputs()),
                ("recorded", Outputs(record)),
                ("pictured", Outputs(image=image)),
            ):
                steps.spent = 0.0
                seconds[kind] += _performed(name, outputs)
                physics += steps.spent if kind == "plain" else 0.0
    plain = seconds["plain"]
    yield f"CPU s a trial, mean of {len(scenarios)}", plain / len(scenarios), float("nan"), "s"
    yield "share of it that is mj_step", physics / plain, 0.88, ""
    yield "a recording costs more", 100.0 * (seconds["recorded"] / plain - 1.0), float("nan"), "%"
    yield "pictures cost more", 100.0 * (seconds["pictured"] / plain - 1.0), 12.0, "%"


class _Clock:
    """Adds up the CPU time in a function of a module."""

    def __init__(self, module: Any, name: str) -> None:
        self.spent, inner = 0.0, getattr(module, name)
        setattr(module, name, self._timed(inner))

    def _timed(self, inner: Callable[..., None]) -> Callable[..., None]:
        @wraps(inner)
        def timed(*given: Any) -> None:
            begin = time.process_time()
            inner(*given)
            self.spent += time.process_time() - begin

        return timed


def _performed(name: str, outputs: Outputs) -> float:
    """CPU s of one trial."""
    config = scenario_config(name, "right")
    begin = time.process_time()
    perform(assemble(config), config, outputs)
    return time.process_time() - begin


if __name__ == "__main__":
    show(figures(sys.argv[1:] or None))
