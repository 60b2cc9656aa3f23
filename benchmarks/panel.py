"""What the panel costs and how quick it is: `python -m benchmarks.panel [rounds]`; the last figures need Chromium.

The loop's own figure is that of `benchmarks.two_processes`: a virtual hand in a program of its own at the other end of
a serial adapter, driven by wishes twenty times a second, in turn with and without the page's process.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.panel import requests
from allegro_twin.surfaces.panel.hand_session import Folders, HandSession, HandSessions
from allegro_twin.surfaces.panel.host import Host
from allegro_twin.surfaces.panel.page_process import PageServer
from allegro_twin.types import Sample, Vector
from benchmarks.two_processes import Figure, _hand

_BROWSER = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
_FRAMES = """() => { window.frames_ = 0; const clear = WebGL2RenderingContext.prototype.clear;
  WebGL2RenderingContext.prototype.clear = function (what) { window.frames_++; return clear.call(this, what); }; }"""
_KEY = 'document.querySelectorAll("[role=slider]")[1]'


class Loop(NamedTuple):
    """What a hand's loop did in a while."""

    used: float
    """Share of the hand's periods of which there was a state, %."""
    worst: float
    """Between two states, ms."""
    share: float
    """Of one core that the loop's own thread took, %: what it costs however busy the computer is."""


def loop(seconds: float, *, panel: bool) -> Loop:
    """Wishes twenty times a second, through the panel or the facade alone."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hand.yaml"
        path.write_text(
            f"backend: {{kind: can, version: v4, interface: slcan, channel: {folder}/hand.tty, imu: 0.1,\n"
            "  options: {sleep_after_open: 0.0}, realtime: false, timeout: 0.5, deadman: 0.5}\n"
            "controller: {kind: pid}\n"
        )
        with _hand(path):
            config, stamps, ticks, worked = load_config(path), list[float](), list[int](), list[float]()

            def keep(sample: Sample) -> None:
                stamps.append(time.perf_counter())
                ticks.append(sample.state.tick)
                worked.append(time.thread_time())

            drive = _through_the_panel if panel else _alone
            drive(config, Path(folder), keep, seconds)
    used, worst = 100.0 * (len(ticks) - 1) / (ticks[-1] - ticks[0]), 1000.0 * float(np.diff(stamps).max())
    # For as many periods as a loop that keeps up has.
    return Loop(used, worst, 100.0 * (worked[-1] - worked[0]) / (len(ticks) - 1) / config.period)


def _alone(config: RunConfig, folder: Path, keep: Any, seconds: float) -> None:
    with Hand.open(config, background=True) as hand:
        hand.direct.prepare()
        hand.listen(keep)
        for goal in _goals(hand.spec.lower, hand.spec.upper, seconds):
            hand.direct.steer(goal)


def _through_the_panel(config: RunConfig, folder: Path, keep: Any, seconds: float) -> None:
    with served(config, folder) as (host, _):
        opened = host._session
        assert isinstance(opened, HandSession)
        opened.hand.listen(keep)
        for goal in _goals(opened.rig.spec.lower, opened.rig.spec.upper, seconds):
            host._take(requests.MoveJoints(tuple(goal.tolist())))


def _goals(lower: Any, upper: Any, seconds: float) -> Iterator[Vector]:
    middle = np.clip(0.3, lower, upper)
    for k in range(round(20 * seconds)):
        goal = middle.copy()
        goal[1] = np.clip(0.5 + 0.3 * np.sin(k / 8.0), lower[1], upper[1])
        yield goal
        time.sleep(0.05)


@contextmanager
def served(config: RunConfig, folder: Path) -> Iterator[tuple[Host, str]]:
    """A panel whose hand is in this process, and its address."""
    host = Host(HandSessions(config, Folders(folder, folder / "taught.yaml")), PageServer("127.0.0.1", 0, "hold"))
    over = threading.Event()
    host.begin()
    address = host._page.address()

    def turn() -> None:
        while not over.is_set():
            host.turn()

    thread = threading.Thread(target=turn)
    thread.start()
    try:
        yield host, address
    finally:
        over.set()
        thread.join()
        host.close()


def browsed(rounds: int) -> Iterator[Figure]:
    """Of a browser on this computer, without a GPU."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as program:
        chromium = program.chromium.launch(executable_path=shutil.which("chromium"), args=_BROWSER)
        with closing(chromium):
            begin = time.perf_counter()
            command = [sys.executable, "-m", "allegro_twin", "panel", "sim_right", "--port", "8199"]
            panel = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
            assert panel.stdout is not None
            panel.stdout.readline()
            served_at = time.perf_counter() - begin
            page = _page(chromium, "http://127.0.0.1:8199/")
            first = time.perf_counter() - begin
            page.context.close()
            panel.terminate()
            panel.wait()
            panel.stdout.close()
            yield "panel: served after the command", served_at, 5.0, "s"
            yield "panel: first picture after the command", first, 5.0, "s"
            with served(load_config("sim_right"), Path(folder)) as (host, address):
                page = _page(chromium, address)
                late = sorted(_latency(host, page) for _ in range(rounds))
                yield f"panel: slider to motion, median of {rounds}", 1000 * float(np.median(late)), 100.0, "ms"
                yield f"panel: slider to motion, worst of {rounds}", 1000 * late[-1], 100.0, "ms"
                yield "panel: pictures a second, 1280 x 800, no GPU (at least)", _rate(host, page), 20.0, ""


def _page(chromium: Any, address: str) -> Any:
    page = chromium.new_context(viewport={"width": 1280, "height": 800}).new_page()
    page.set_default_timeout(60_000)
    page.add_init_script(f"({_FRAMES})()")
    page.goto(address)
    page.get_by_text("Controller").first.wait_for()
    page.wait_for_function("window.frames_ > 1")
    return page


def _latency(host: Host, page: Any) -> float:
    """s from a key on a slider, in the browser, to the first state of the hand in which the joint has moved 1 mrad."""
    assert isinstance(host._session, HandSession)
    hand, moved, at = host._session.hand, threading.Event(), list[float]()
    start = hand.state.position[1]

    def look(sample: Sample) -> None:
        if not at and abs(sample.state.position[1] - start) > 1e-3:
            at.append(time.perf_counter())
            moved.set()

    key = "Home" if start > 0.7 else "End"
    page.evaluate(f"{_KEY}.focus()")
    with hand.listening(look):
        begin = time.perf_counter()
        page.evaluate(f"{_KEY}.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}', bubbles: true}}))")
        if not moved.wait(10.0):
            raise RuntimeError("the slider moved nothing for 10 s")
    time.sleep(2.0)
    return at[0] - begin


def _rate(host: Host, page: Any, seconds: float = 8.0) -> float:
    host._take(requests.MoveToPosture("home"))
    before, begin = page.evaluate("window.frames_"), time.perf_counter()
    for k in range(round(2 * seconds)):
        host._take(requests.MoveToPosture("fist" if k // 4 % 2 else "open"))
        page.wait_for_timeout(500)
    return float(page.evaluate("window.frames_") - before) / (time.perf_counter() - begin)


def figures(rounds: int = 3, seconds: float = 10.0) -> Iterator[Figure]:
    """Medians of interleaved rounds; the bars are for an otherwise idle computer of two cores."""
    if importlib.util.find_spec("viser") is None:
        return
    pairs = [(loop(seconds, panel=False), loop(seconds, panel=True)) for _ in range(rounds)]
    without, beside = (np.median([pair[k] for pair in pairs], axis=0) for k in (0, 1))
    yield "periods used without the panel", float(without[0]), 98.0, "%"
    yield "periods used with it (at least as many)", float(beside[0]), float(without[0]), "%"
    yield "loop's share of a core without the panel", float(without[2]), 30.0, "%"
    yield "loop's share of a core with it", float(beside[2]), 1.1 * float(without[2]), "%"
    yield "worst tick interval without the panel", float(without[1]), 50.0, "ms"
    yield "worst tick interval with it", float(beside[1]), 50.0, "ms"
    if importlib.util.find_spec("playwright") is not None and shutil.which("chromium"):
        yield from browsed(10)


def main() -> None:
    for what, measured, bar, unit in figures(int(sys.argv[1]) if len(sys.argv) > 1 else 3):
        print(f"{what:<64}{measured:>9.2f} {unit:<2}{bar:>8.2f} {unit}", flush=True)


if __name__ == "__main__":
    main()
