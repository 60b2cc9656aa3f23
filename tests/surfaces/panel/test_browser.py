"""The panel as its users have it: in a browser, over a socket, with the hand in another process. `pytest -m long`."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

pytest.importorskip("viser", reason="the panel needs viser: pip install 'allegro-twin[panel]'")
sync_api = pytest.importorskip(
    "playwright.sync_api", reason="a browser is driven by playwright: pip install playwright"
)
CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no browser: apt-get install chromium"),
]
_SOFTWARE = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
FIELD = 75.0  # Degrees, viser's field of view from above to below.
LEFT = 3.0  # Pixels, measured: by so much the arrows are drawn beside their place.
COARSE = 0.1
"""Pixels of the picture for each of the page's, each way: no test looks at it."""
PATIENCE = 60_000.0  # ms: a busy computer draws without a GPU.
_SLIDERS = """() => [...document.querySelectorAll('[role=slider]')].map(s => Number(s.getAttribute('aria-valuenow')))"""


class Served(NamedTuple):
    """A panel in a program of its own."""

    url: str
    folder: Path
    process: subprocess.Popen[str]


@contextmanager
def served(folder: Path, *options: str, config: str = "sim_right") -> Iterator[Served]:
    command = [sys.executable, "-m", "allegro_twin", "panel", config, "--port", str(free_port()), *options]
    paths = [str(Path(__file__).parents[3]), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    with (folder / "errors.txt").open("w") as errors:
        process = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=errors, text=True
        )
    assert process.stdout is not None
    try:
        found = re.search(r"http\S+", process.stdout.readline())
        assert found is not None, "the panel did not start"
        yield Served(found[0], folder, process)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            assert process.wait(30.0) == 0
        process.stdout.close()


def free_port() -> int:
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as program:
        chromium = program.chromium.launch(executable_path=CHROMIUM, args=_SOFTWARE)
        yield chromium
        chromium.close()


@pytest.fixture
def panel(tmp_path: Path) -> Iterator[Served]:
    with served(tmp_path) as found:
        yield found


def tab(browser: Any, url: str, joint: str = "index_0") -> Any:
    """A browser's tab of its own, once the hand is in it."""
    page = browser.new_context(viewport={"width": 820, "height": 460}).new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(f"{url}{'&' if '?' in url else '?'}fixedDpr={COARSE}")
    sees(page, joint)
    return page


def sees(page: Any, text: str) -> None:
    page.get_by_text(text).first.wait_for(timeout=PATIENCE)


def press(page: Any, name: str) -> None:
    """By a script: where a CPU draws the pictures, a mouse that is moved waits for them, up to minutes."""
    button = page.get_by_role("button", name=name, exact=True).first
    sync_api.expect(button).to_be_enabled(timeout=PATIENCE)
    button.evaluate("button => button.click()")


def open_tab(page: Any, name: str) -> None:
    page.get_by_role("tab", name=name, exact=True).press("Enter")


def number(page: Any, joint: str) -> float:
    """Where the page says that a joint is, rad."""
    return float(page.locator(f'.joint-row[data-joint="{joint}"] .joint-is').first.inner_text())


def moves(page: Any, joint: str, value: float) -> None:
    """Type a joint's goal into the box of its slider, and wait until the joint is there."""
    box = page.locator("label", has_text=joint).first.locator("xpath=ancestor::*[.//input][1]").locator("input").last
    box.fill(str(value))
    box.press("Enter")
    wait_until(page, joint, value)


def wait_until(page: Any, joint: str, value: float, within: float = 0.05) -> None:
    script = """([joint, value, within]) => {
      const is = document.querySelector(`.joint-row[data-joint="${joint}"] .joint-is`);
      return is && Math.abs(Number(is.textContent) - value) < within; }"""
    page.wait_for_function(script, arg=[joint, value, within], timeout=PATIENCE)


def test_a_slider_moves_its_joint_and_a_stop_leaves_the_hand_limp_until_it_is_released(
    browser: Any, panel: Served
) -> None:
    page = tab(browser, panel.url)
    sees(page, "You drive")
    moves(page, "index_1", 0.9)
    page.locator("#stop").evaluate("button => button.click()")
    sees(page, "STOPPED")
    press(page, "Release the stop")
    sees(page, "the hand is limp until the next request")
    wait_until(page, "index_1", 1.6)  # It hangs.
    page.wait_for_timeout(1000)
    moves(page, "index_1", 0.4)
    page.keyboard.press("Escape")
    sees(page, "STOPPED")


def test_a_posture_and_a_grasp_are_a_button_each(browser: Any, panel: Served) -> None:
    page = tab(browser, panel.url)
    open_tab(page, "Library")
    press(page, "fist")
    open_tab(page, "Joints")
    wait_until(page, "index_1", 1.4, within=0.3)
    open_tab(page, "Library")
    search = page.locator("xpath=//label[text()='Search']/ancestor::*[.//input][1]//input").first
    search.fill("pinch ind")
    search.press("Enter")
    page.wait_for_function("document.querySelectorAll('.library-row img').length === 1", timeout=PATIENCE)
    page.locator(".library-row img").first.evaluate("picture => picture.click()")
    sees(page, "grasp pinch_index")
    search.fill("no such thing")
    sees(page, "none with such a name")


def test_every_joint_of_the_hand_is_seen_once_on_a_screen_of_850_pixels(browser: Any, panel: Served) -> None:
    page = tab(browser, panel.url)
    page.set_viewport_size({"width": 1280, "height": 850})
    page.wait_for_function("document.querySelectorAll('.joint-row').length === 16", timeout=PATIENCE)
    boxes = [row.bounding_box() for row in page.locator(".joint-row").all()]
    assert max(box["y"] + box["height"] for box in boxes) < 850


def test_plots_are_drawn_without_being_asked_for(browser: Any, panel: Served) -> None:
    page = tab(browser, panel.url)
    open_tab(page, "Plots")
    page.wait_for_function("document.querySelectorAll('.uplot').length === 2", timeout=PATIENCE)


def test_a_picture_that_is_paused_says_how_old_it_is(browser: Any, panel: Served) -> None:
    page = tab(browser, panel.url)
    open_tab(page, "Time")
    press(page, "Pause the picture")
    page.wait_for_function("/picture is [1-9][.][0-9] s old/.test(document.body.textContent)", timeout=PATIENCE)
    assert "0.0 s old" not in page.locator("body").inner_text()
    press(page, "Back to now")
    page.wait_for_function("!/picture is/.test(document.body.textContent)", timeout=PATIENCE)


def test_the_second_tab_looks_on_and_may_stop_and_drives_when_the_first_lets_go(browser: Any, panel: Served) -> None:
    first, second = tab(browser, panel.url), tab(browser, panel.url)
    sees(second, "You look on")
    sees(first, "1 more looks on")
    assert second.get_by_role("button", name="Drive", exact=True).is_disabled()
    assert second.get_by_role("button", name="Hold here").is_disabled()
    open_tab(second, "Library")
    press(second, "fist")
    sees(second, "you look on; somebody else drives")
    second.locator("#stop").evaluate("button => button.click()")
    sees(first, "STOPPED")
    press(first, "Release the stop")
    press(first, "Let go")
    sees(second, "Nobody drives")
    press(second, "Drive")
    sees(second, "You drive")
    sees(first, "You look on")


@pytest.mark.parametrize("gone", ["hold", "limp"])
def test_a_closed_tab_leaves_the_hand_as_configured_and_who_comes_back_alone_drives(
    gone: str, browser: Any, tmp_path: Path
) -> None:
    with served(tmp_path, "--gone", gone) as panel:
        page = tab(browser, panel.url)
        moves(page, "index_1", 0.9)
        page.context.close()
        again = tab(browser, panel.url)
        sees(again, "You drive")
        sees(again, "STOPPED" if gone == "limp" else "Controller: pid")
        if gone == "hold":
            assert abs(number(again, "index_1") - 0.9) < 0.05


def test_a_tip_that_is_dragged_moves_its_finger_and_one_out_of_reach_says_so(browser: Any, panel: Served) -> None:
    page = tab(browser, panel.url)
    press(page, "Hold here")
    sees(page, "Controller: pid")
    before = [number(page, f"thumb_{k}") for k in range(4)]
    page.evaluate("document.querySelectorAll('[role=alert]').forEach(said => said.remove())")  # It lies over the tips.
    x, y = on_screen(page, "thumb", 0.008)
    page.mouse.move(x - 5, y - 5)
    page.mouse.move(x, y, steps=4)
    page.wait_for_timeout(500)
    page.mouse.down()
    for step in range(6):
        page.mouse.move(x, y - 4 * step)
        page.wait_for_timeout(150)
    page.wait_for_timeout(1500)
    after = [number(page, f"thumb_{k}") for k in range(4)]
    assert max(abs(a - b) for a, b in zip(after, before, strict=True)) > 0.05
    page.mouse.move(x, y - 300, steps=5)
    sees(page, "out of reach by")
    page.mouse.up()


def on_screen(page: Any, finger: str, above: float) -> tuple[float, float]:
    """Where a place over a fingertip of a hand that is stretched is in the picture, pixels; `above`, m."""
    import numpy as np

    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.surfaces.panel.tip_ik import TipIK
    from allegro_twin.viewing.scenery import scenery

    spec = load_spec()
    point = TipIK(spec).tip(finger, np.clip(0.0, spec.lower, spec.upper)) + np.array([0.0, 0.0, above])
    return pixel_of(page, point, scenery(spec, {}))


def pixel_of(page: Any, point: Any, around: Any) -> tuple[float, float]:
    """Where a place of the world (m) is in the first view of a scenery, pixels."""
    import numpy as np

    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.surfaces.panel.page.scene import eye

    place, target = eye(load_spec(), around)
    ahead = (target - place) / np.linalg.norm(target - place)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up, way = np.cross(right, ahead), point - place
    picture = page.locator("canvas").first.bounding_box()
    scale = picture["height"] / 2 / np.tan(np.radians(FIELD) / 2) / (way @ ahead)
    middle = picture["x"] + picture["width"] / 2, picture["y"] + picture["height"] / 2
    return middle[0] + scale * float(way @ right) - LEFT, middle[1] - scale * float(way @ up)


def test_the_pixels_of_an_object_are_the_object_and_a_mouse_that_drags_them_pulls_it_until_its_button_is_up(
    browser: Any, tmp_path: Path
) -> None:
    from allegro_twin.grasping.trial import make_trial
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.viewing.scenery import scenery

    trial = make_trial("lemon", load_spec(), 0.003)
    place = trial.objects[0].position
    config = tmp_path / "lemon.yaml"
    config.write_text("backend: {kind: sim}\ntask: {scenario: lemon}\ncontroller: {kind: pd}\n")
    with served(tmp_path, config=str(config)) as panel:
        page = tab(browser, panel.url)
        open_tab(page, "Time")
        page.evaluate("document.querySelectorAll('[role=alert]').forEach(said => said.remove())")
        x, y = pixel_of(page, place, scenery(load_spec(), trial.meta()))
        press(page, "Record")
        sees(page, "recording: 1 s")
        page.mouse.move(x - 5, y - 5)
        page.mouse.move(x, y, steps=4)
        page.wait_for_timeout(500)
        page.mouse.down()
        for step in range(6):
            page.mouse.move(x, y - 6 * step)
            page.wait_for_timeout(150)
        sees(page, "The mouse pulls lemon with")
        page.mouse.up()
        page.wait_for_function("!/The mouse pulls/.test(document.body.textContent)", timeout=PATIENCE)
        press(page, "End the recording")
        sees(page, "the recording is whole")
        open_tab(page, "Control")
        sees(page, "Drag an object in the picture to pull it")
    from allegro_twin.recording.reader import load

    columns = load(tmp_path / "out" / "panel_001.arrow").columns
    force = columns["mouse_force"]
    pulled = force[(force != 0.0).any(axis=1)]
    assert len(pulled) > 30
    assert pulled[:, 2].max() > 0.2  # Upwards, as the mouse went.
    assert not force[-1].any()


def test_angles_that_are_typed_turn_the_goal_of_an_episode_until_the_task_has_its_own_again(
    browser: Any, tmp_path: Path
) -> None:
    config = tmp_path / "reorient.yaml"
    config.write_text(
        "backend: {kind: sim}\n"
        "task: {episode: {task: Reorient, environment: {decimation: 20, timestep: 0.003}}}\n"
        "controller: {kind: mpc, time: real}\n"
    )
    with served(tmp_path, config=str(config)) as panel:
        page = tab(browser, panel.url)
        sees(page, "from the goal of the task")
        box = page.locator("xpath=//*[text()='Goal (°)']/ancestor::*[.//input][1]//input").nth(2)
        box.fill("25")
        box.press("Enter")
        sees(page, "from the goal set by hand")
        press(page, "Perform the task")
        sees(page, "plans a second")
        sees(page, "from the goal set by hand")
        press(page, "Goals of the task")
        sees(page, "from the goal of the task")


def test_a_wrong_token_is_refused_and_the_right_one_opens_the_page(browser: Any, tmp_path: Path) -> None:
    (tmp_path / "token").write_text("a-token-of-some-length\n")
    with served(tmp_path, "--host", "0.0.0.0", "--token-file", "token") as panel:
        plain = panel.url.split("?")[0].replace("0.0.0.0", "127.0.0.1")
        page = browser.new_context().new_page()
        assert page.goto(plain).status == 403
        assert page.goto(plain + "?token=wrong").status == 403
        assert "needs its token" in page.content()
        right = tab(browser, plain + "?token=a-token-of-some-length")
        sees(right, "You drive")
        assert "token" not in right.url


def test_the_page_that_died_is_served_again_and_the_hand_has_not_moved(browser: Any, panel: Served) -> None:
    page = tab(browser, panel.url)
    moves(page, "index_1", 0.9)
    listed = subprocess.run(["ps", "-eo", "pid,ppid,args"], capture_output=True, text=True, check=True).stdout
    mine = [row.split() for row in listed.splitlines() if "allegro_twin.surfaces.panel.page" in row]
    child = next(int(row[0]) for row in mine if int(row[1]) == panel.process.pid)
    os.kill(child, signal.SIGKILL)
    page.context.close()
    again = tab(browser, panel.url)
    sees(again, "You drive")
    assert abs(number(again, "index_1") - 0.9) < 0.05


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_a_page_whose_program_is_gone_says_so_and_its_stop_is_grey(
    end: signal.Signals, browser: Any, panel: Served
) -> None:
    page = tab(browser, panel.url)
    sees(page, "You drive")
    lost, stop = page.locator("#lost"), page.locator("#stop")
    red = stop.evaluate("button => getComputedStyle(button).backgroundColor")
    assert not lost.is_visible()
    panel.process.send_signal(end)
    panel.process.wait(30.0)
    sees(page, "Connection to the program lost: STOP of this page does nothing")
    assert stop.evaluate("button => getComputedStyle(button).backgroundColor") != red
    assert "Traceback" not in (panel.folder / "errors.txt").read_text()


def test_what_was_recorded_is_a_recording(browser: Any, panel: Served) -> None:
    page = tab(browser, panel.url)
    open_tab(page, "Time")
    press(page, "Record")
    sees(page, "recording: 1 s")
    press(page, "End the recording")
    sees(page, "the recording is whole")
    from allegro_twin.recording.reader import load

    recording = load(panel.folder / "out" / "panel_001.arrow")
    assert recording.complete
    assert len(recording) > 150  # Half a second of them is shown as 1 s.


@pytest.mark.parametrize(
    ("hand", "joint", "motors", "closed"), [("model_o", "thumb", 4, 2.6), ("qb_softhand", "closure", 1, 0.95)]
)
def test_a_hand_on_tendons_has_a_slider_for_each_motor_and_grasps_of_its_own(
    hand: str, joint: str, motors: int, closed: float, browser: Any, tmp_path: Path
) -> None:
    with served(tmp_path, config=f"sim_{hand}") as panel:
        page = tab(browser, panel.url, joint)
        sees(page, "You drive")
        assert len(page.evaluate(_SLIDERS)) == motors
        open_tab(page, "Library")
        sees(page, "none for this hand")
        press(page, "lemon" if hand == "model_o" else "mug")
        open_tab(page, "Joints")
        wait_until(page, joint, closed, within=0.2 * closed)
        open_tab(page, "Control")
        sees(page, "Scenario")
        assert not page.get_by_text("Gains").is_visible()
        assert not page.get_by_text("As the hand reports").is_visible()
