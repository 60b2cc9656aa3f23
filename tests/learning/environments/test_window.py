"""A window, where there is a screen."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.viewing.batch import has_screen

CODE = """
import gymnasium, numpy as np, allegro_twin.gym
env = gymnasium.make("AllegroTwin/Reach-v0", render_mode="human")
env.reset(seed=0)
env.step(np.zeros(16, np.float32))
window = env.unwrapped._pictures._window
assert window.is_running()
assert env.render() is None
env.close()
assert not window.is_running()
print("shown")
"""


@pytest.mark.slow
def test_a_window_shows_the_steps_and_is_closed_with_the_environment() -> None:
    screen = [] if has_screen() else ["xvfb-run", "--auto-servernum"]
    if screen and not shutil.which(screen[0]):
        pytest.skip("no screen, and no xvfb-run to make one")
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    done = subprocess.run([*screen, sys.executable, "-c", CODE], capture_output=True, text=True,
                          env=environment)  # fmt: skip
    assert done.stdout.strip() == "shown", done.stderr[-2000:]


@pytest.mark.skipif(has_screen(), reason="there is a screen")
def test_without_a_screen_a_window_is_refused_with_the_modes_that_there_are() -> None:
    with pytest.raises(ConfigError, match="render_mode 'human' is none of rgb_array, depth_array"):
        HandEnv("Reach", render_mode="human")
