"""Pictures are those of MuJoCo's own renderer, however many scenes share a context."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection

import mujoco
import numpy as np
import pytest

from allegro_twin.app import assemble, scenario_config
from allegro_twin.errors import ConfigError
from allegro_twin.sim import renderer
from allegro_twin.viewing.camera import Camera
from allegro_twin.viewing.gl_context import OffscreenRenderer


def test_pictures_are_to_the_bit_and_depths_to_a_float_those_of_mujocos_renderer() -> None:
    rigs = [assemble(scenario_config(name, "right")) for name in ("lemon", "mug")]
    screens = []
    for rig in rigs:
        assert rig.sim is not None
        rig.backend.reset()
        try:
            Camera(rig.sim, width=96, height=64).close()
        except ConfigError as error:
            pytest.skip(str(error))
        screens.append((rig.sim, OffscreenRenderer(rig.sim.model, 64, 96)))
    eye = mujoco.MjvCamera()
    eye.distance, eye.elevation = 0.6, -20.0
    for shown, screen in screens:  # Both are open, and take turns.
        eye.lookat = shown.data.body("palm_link").xpos
        with mujoco.Renderer(shown.model, 64, 96) as renderer:
            renderer.update_scene(shown.data, eye)
            np.testing.assert_array_equal(screen.draw(shown.data, eye), renderer.render())
            renderer.enable_depth_rendering()
            np.testing.assert_allclose(screen.draw_depth(shown.data, eye), renderer.render(), rtol=1e-4)
            renderer.disable_depth_rendering()
            np.testing.assert_array_equal(screen.draw(shown.data, eye), renderer.render())
    for _, screen in screens:
        screen.close()
        screen.close()


BALL = "<mujoco><worldbody><light pos='0 0 2'/><geom size='.1'/></worldbody></mujoco>"


@pytest.fixture
def scene() -> Iterator[tuple[OffscreenRenderer, mujoco.MjData]]:
    """A ball, rendered once."""
    model = mujoco.MjModel.from_xml_string(BALL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    try:
        screen = OffscreenRenderer(model, 16, 16)
    except (ImportError, AttributeError, RuntimeError, OSError, mujoco.FatalError) as error:
        pytest.skip(str(error))
    screen.draw(data, mujoco.MjvCamera())
    yield screen, data
    screen.close()


def _told(answer: Connection, ways: list[Callable[[], object]]) -> None:
    for way in ways:
        try:
            way()
            answer.send("")
        except ConfigError as error:
            answer.send(str(error))


def test_a_fork_of_a_process_that_has_rendered_says_that_it_cannot_instead_of_waiting_for_ever(
    scene: tuple[OffscreenRenderer, mujoco.MjData],
) -> None:
    screen, data = scene
    ways = [
        lambda: screen.draw(data, mujoco.MjvCamera()),
        lambda: OffscreenRenderer(mujoco.MjModel.from_xml_string(BALL), 16, 16).draw(data, mujoco.MjvCamera()),
        screen.close,
    ]
    here, there = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=_told, args=(there, ways), daemon=True)
    child.start()
    try:
        for said in ('context="spawn"', 'context="spawn"', ""):
            assert here.poll(60.0), "the fork waits for ever"
            answer = here.recv()
            assert said in answer
            assert bool(said) == bool(answer)
    finally:
        child.kill()
        child.join()
    assert screen.draw(data, mujoco.MjvCamera()).any()


def test_another_thread_is_told_which_one_renders_a_scene_and_renders_its_own(
    scene: tuple[OffscreenRenderer, mujoco.MjData],
) -> None:
    screen, data = scene
    picture = screen.draw(data, mujoco.MjvCamera())
    with ThreadPoolExecutor(1, thread_name_prefix="other") as pool:
        refused = pool.submit(screen.draw, data, mujoco.MjvCamera()).exception()
        assert isinstance(refused, ConfigError)
        assert "'MainThread' first cannot be in 'other_0'" in str(refused)
        own = pool.submit(OffscreenRenderer, screen._model, 16, 16).result()
        np.testing.assert_array_equal(pool.submit(own.draw, data, mujoco.MjvCamera()).result(), picture)
        own.close()  # From this thread: what is drawn here stays.
        np.testing.assert_array_equal(screen.draw(data, mujoco.MjvCamera()), picture)
        pool.submit(OffscreenRenderer, screen._model, 16, 16).result().close()


@pytest.mark.parametrize(
    ("there", "chosen"),
    [
        ({"libEGL.so.1", "libOpenGL.so.0"}, "egl"),
        ({"libEGL.so.1", "libGL.so.1"}, "egl"),
        ({"libEGL.so.1"}, "disable"),  # PyOpenGL would break MuJoCo's import.
        ({"libGL.so.1", "libOpenGL.so.0"}, "disable"),
        (set(), "disable"),
    ],
)
def test_without_a_screen_egl_is_chosen_where_all_of_its_libraries_are(
    there: set[str], chosen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def load(name: str) -> None:
        if name not in there:
            raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr("ctypes.CDLL", load)
    assert renderer.chosen() == chosen


@pytest.mark.parametrize(
    ("value", "there", "says"),
    [
        ("garbage", (), "no value of MUJOCO_GL named 'garbage'.*egl.*unset it"),
        ("osmesa", ("libEGL.so.1",), "MUJOCO_GL=osmesa: its library is not there.*unset MUJOCO_GL"),
        ("EGL", ("libEGL.so.1",), "MUJOCO_GL=EGL: EGL's libraries are not there.*unset MUJOCO_GL"),
    ],
)
def test_a_value_of_mujoco_gl_that_would_break_the_import_is_refused_with_the_rendering_hint(
    value: str, there: tuple[str, ...], says: str
) -> None:
    with pytest.raises(ConfigError, match=says):
        renderer.check_value(value, lambda library: library in there)


@pytest.mark.parametrize("value", ["off", "glfw", "Disabled", "egl", "osmesa"])
def test_values_of_mujoco_gl_that_mujoco_takes_here_are_taken(value: str) -> None:
    renderer.check_value(value, lambda library: True)


def test_where_nothing_renders_the_rendering_hint_is_of_what_the_user_has_set() -> None:
    assert renderer.rendering_hint({"MUJOCO_GL": "off"}) == "MUJOCO_GL=off switches pictures off: unset it"
    assert "MUJOCO_GL=glfw does not render here: unset it" in renderer.rendering_hint({"MUJOCO_GL": "glfw"})
    assert "libegl1" in renderer.rendering_hint({})
    assert "libegl1" in renderer.rendering_hint({"MUJOCO_GL": "egl"})


def test_a_command_with_a_wrong_mujoco_gl_ends_in_one_line() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "allegro_twin", "posture", "home"],
        env=os.environ | {"MUJOCO_GL": "garbage"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "MUJOCO_GL named 'garbage'" in done.stderr
