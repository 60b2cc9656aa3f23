"""Takes the pictures of the docs anew: `python docs/site/pictures.py [NAME…]`, all by default, into docs/images.

`panel` and `marker` need Chromium and playwright, `pip install '.[panel]' playwright`; `cell` needs the extra lab.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

IMAGES = Path(__file__).resolve().parents[1] / "images"
_PROGRAM = [sys.executable, "-m", "allegro_twin"]
_SOFTWARE = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
_PATIENCE = 120_000.0  # ms, for a browser that draws without a GPU.
_HANDS = ("leap", "model_o", "qb_softhand", "sih")


def demo() -> None:
    """`run scenarios/demo --side both`, and the same objects with two other hands."""
    for name, folder, more in (("demo", "demo", ["--side", "both"]), ("model_o_demo", "model_o", []),
                               ("sih_demo", "sih", [])):  # fmt: skip
        out = _ran("run", f"scenarios/{folder}", *more)
        (out / "overview.png").replace(IMAGES / f"{name}.png")


def leap() -> None:
    """`run leap_rubiks_cube`: closed, lifted, turned, held."""
    (_ran("run", "leap_rubiks_cube") / "leap_rubiks_cube_right.png").replace(IMAGES / "leap_cube.png")


def cell() -> None:
    """`lab`: the arm's pictures as states begin, of the Allegro Hand and of four others."""
    folder = _ran("lab", "lab_allegro", "--object", "mug")
    (folder / "grasp.png").replace(IMAGES / "lab_grasp.png")
    found = {name: _ran("lab", f"lab_{name}") for name in _HANDS}
    panes = [np.asarray(Image.open(found[name] / "grasp.png"))[60:380, 140:500] for name in _HANDS]
    _save(np.vstack([np.hstack(panes[:2]), np.hstack(panes[2:])]), "lab_hands")


def panel() -> None:
    """A trial in the panel, at the moment when the cube is held up, as a browser has it."""
    with _browser(["panel", "sim_right"], size=(1280, 850)) as page:
        page.get_by_role("tab", name="Control", exact=True).press("Enter")
        page.wait_for_timeout(500)
        box = page.locator("xpath=//label[text()='Scenario']/ancestor::*[.//input][1]//input").first
        box.fill("rubiks_cube")
        box.press("ArrowDown")
        box.press("Enter")
        page.get_by_role("button", name="Perform it", exact=True).first.evaluate("button => button.click()")
        page.wait_for_function("/Controller: the task's own · [0-2][.]/.test(document.body.textContent)")
        page.get_by_role("tab", name="Joints", exact=True).press("Enter")
        for button, x, y in (("left", -220, 40), ("right", -130, 170)):  # Turn the picture, and move it.
            page.mouse.move(450, 600)
            page.mouse.down(button=button)
            page.mouse.move(450 + x, 600 + y, steps=3)
            page.mouse.up(button=button)
        page.mouse.wheel(0, -150)
        page.wait_for_function("/ · 4[.][2-9] s/.test(document.body.textContent)")  # Lifted; it turns at 6 s.
        _shot(page, "panel", 0.0)


def marker() -> None:
    """The page of a cell, with the marker that leads its palm."""
    with _browser(["lab", "lab_allegro", "--panel"], size=(1300, 800)) as page:
        _shot(page, "lab_marker")


PICTURES: dict[str, Callable[[], None]] = {
    each.__name__: each for each in (demo, leap, cell, panel, marker)
}  # fmt: skip


def _ran(*command: str) -> Path:
    """The folder that a command has written."""
    out = Path(tempfile.mkdtemp()) / "out"
    subprocess.run([*_PROGRAM, *command, "--out", str(out)], check=True, stdout=subprocess.DEVNULL)
    return out


@contextmanager
def _browser(command: list[str], size: tuple[int, int]) -> Iterator[Any]:
    """A page that a command serves, once its picture is there."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as program:
        served = subprocess.Popen([*_PROGRAM, *command, "--port", "8231"], stdout=subprocess.PIPE, text=True)
        assert served.stdout is not None
        try:
            found = next(match for line in served.stdout if (match := re.search(r"http\S+", line)))
            chromium = program.chromium.launch(executable_path="/usr/bin/chromium", args=_SOFTWARE)
            page = chromium.new_context(viewport={"width": size[0], "height": size[1]}).new_page()
            page.set_default_timeout(_PATIENCE)
            page.goto(f"{found[0]}{'&' if '?' in found[0] else '?'}fixedDpr=1.0")
            page.get_by_text("You drive").first.wait_for(timeout=_PATIENCE)
            page.wait_for_timeout(5000)
            yield page
            chromium.close()
        finally:
            served.send_signal(signal.SIGINT)
            served.wait(60.0)


def _shot(page: Any, name: str, after: float = 4000.0) -> None:
    """Save what a page shows some ms later, without messages that go by."""
    page.wait_for_timeout(after)
    page.evaluate("document.querySelectorAll('[role=alert]').forEach(said => said.remove())")
    page.screenshot(path=IMAGES / f"{name}.png", timeout=_PATIENCE)


def _save(picture: Any, name: str) -> None:
    Image.fromarray(picture).save(IMAGES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    for each in sys.argv[1:] or PICTURES:
        PICTURES[each]()
