"""The marker of a cell as its users have it: in a browser, with the cell in another process. `pytest -m long`."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="the panel needs viser: pip install 'allegro-twin[panel]'")
pytest.importorskip("playwright.sync_api", reason="a browser is driven by playwright: pip install playwright")

from allegro_twin.surfaces.panel.page.scene import AT, EYE
from allegro_twin.types import Vector
from tests.surfaces.panel.test_browser import COARSE, FIELD, LEFT, PATIENCE, browser, free_port, press, sees  # noqa: F401

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(shutil.which("chromium") is None, reason="there is no browser: apt-get install chromium"),
]


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:  # noqa: F811  # The fixture of that name.
    port = free_port()
    command = [sys.executable, "-m", "allegro_twin", "lab", "conf/lab_allegro.yaml", "--panel", "--port", str(port)]
    paths = [str(Path(__file__).parents[3]), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        assert f":{port}/" in process.stdout.readline()
        found = browser.new_context(viewport={"width": 1640, "height": 920}).new_page()
        found.set_default_timeout(PATIENCE)
        found.goto(f"http://127.0.0.1:{port}/?fixedDpr={COARSE}")
        sees(found, "You drive: drag the marker")
        sees(found, "Palm at")
        yield found
        found.context.close()
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(30.0) == 0
        process.stdout.close()


def palm(page: Any) -> Vector:
    """Where the page says that it is, (3,), m."""
    text = page.get_by_text("Palm at").first.inner_text()
    found = re.search(r"Palm at (\S+), (\S+), (\S+) m", text)
    assert found is not None, text
    return np.array([float(part) for part in found.groups()])


def number_box(page: Any, axis: int) -> Any:
    return page.locator("xpath=//*[text()='Palm to (m)']/ancestor::*[.//input][1]//input").nth(axis)


def typed(page: Any, axis: int, value: float) -> None:
    box = number_box(page, axis)
    box.fill(str(value))
    box.press("Enter")


def comes(page: Any, axis: int, value: float) -> None:
    for _ in range(200):
        if abs(palm(page)[axis] - value) < 0.01:
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"the palm is at {palm(page)}, and {value} was wished")


def on_screen(page: Any, point: Vector) -> tuple[float, float]:
    """Where a place of the world is in the picture, pixels."""
    ahead = (np.array(AT) - EYE) / np.linalg.norm(np.array(AT) - EYE)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up, way = np.cross(right, ahead), point - np.array(EYE)
    picture = page.locator("canvas").first.bounding_box()
    scale = picture["height"] / 2 / np.tan(np.radians(FIELD) / 2) / (way @ ahead)
    middle = picture["x"] + picture["width"] / 2, picture["y"] + picture["height"] / 2
    return middle[0] + scale * float(way @ right) - LEFT, middle[1] - scale * float(way @ up)


def test_numbers_move_the_palm_and_a_place_in_the_table_is_refused_and_nothing_moves(page: Any) -> None:
    typed(page, 1, 0.15)
    comes(page, 1, 0.15)
    typed(page, 2, 0.05)
    sees(page, "the table, at")
    page.wait_for_timeout(1000)
    np.testing.assert_allclose(palm(page), [-0.22, 0.15, 0.4], atol=0.01)


def test_the_marker_that_is_dragged_leads_the_palm(page: Any) -> None:
    page.evaluate("document.querySelectorAll('[role=alert]').forEach(said => said.remove())")
    before = palm(page)
    along = np.array([0.0, 0.0, -0.15])  # The palm's own z points down where it waits: its blue arrow.
    x, y = on_screen(page, before + along)
    page.mouse.move(x - 3, y)
    page.mouse.move(x, y, steps=4)
    page.wait_for_timeout(500)
    page.mouse.down()
    for step in range(8):
        page.mouse.move(x, y - 5 * step)
        page.wait_for_timeout(150)
    page.wait_for_timeout(2500)
    page.mouse.up()
    moved = palm(page) - before
    assert moved[2] > 0.03, moved
    assert np.abs(moved[:2]).max() < 0.03, moved


def test_a_stop_keeps_the_arm_until_it_is_released(page: Any) -> None:
    page.locator("#stop").evaluate("button => button.click()")
    sees(page, "STOPPED: arm and fingers stay")
    assert number_box(page, 1).is_disabled()
    press(page, "Release the stop")
    sees(page, "Palm at")
    typed(page, 1, -0.1)
    comes(page, 1, -0.1)
