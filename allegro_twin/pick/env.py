"""Arm, hand and a thing on the table as a Gymnasium environment: take it, lift it by 0.1 m and hold it for a second."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from allegro_twin.errors import CommandError, ConfigError, HandFault
from allegro_twin.files.schema import first_difference, parse_settings
from allegro_twin.kinematics.arm import rotation_between
from allegro_twin.learning.environments.spaces import with_episode_length
from allegro_twin.pick.card import trained_keywords
from allegro_twin.pick.episode import Episodes, PickState
from allegro_twin.pick.settings import PickOptions, PickSettings
from allegro_twin.types import Array, Vector
from allegro_twin.viewing.camera import Camera
from allegro_twin.viewing.views import View, check_edges

Floats = NDArray[np.float32]
BOUND = 5.0
"""Bound of every number in an observation."""
_HIGH = 0.1
"""Height by which a picked object is lifted, m."""
_LONG = 1.0
"""Time for which a picked object is lifted, s."""
_LOST = 0.2
"""m. A thing that was shoved so far, or fell as far below the table, is lost."""
_VIEW = View(azimuth=125.0, elevation=-25.0, distance=1.35)


class ArmPickState(NamedTuple):
    """A saved state of the environment."""

    keywords: dict[str, Any]
    """Its settings."""
    episode: PickState
    over: bool
    high: float
    generator: Mapping[str, Any]
    """State of the random numbers."""
    seed: int
    """As Gymnasium reports it; -1: unknown."""


class ArmPick(gymnasium.Env[Floats, Floats], EzPickle):
    """The keywords are those of `PickSettings`, and `policy`, a path or a name, which stands for the environments in
    which it was trained. Raises ConfigError. A pickle holds how it was made."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 26}  # noqa: RUF012  # As Gymnasium has it.

    def __init__(self, *, render_mode: str | None = None, width: int = 480, height: int = 480, **kwargs: Any) -> None:
        EzPickle.__init__(self, render_mode=render_mode, width=width, height=height, **kwargs)
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f"render_mode {render_mode!r}: ArmPick has rgb_array")
        check_edges(width, height)
        if "autoreset_mode" in kwargs:
            raise ConfigError("ArmPick is one environment: gymnasium.make_vec takes its autoreset_mode in "
                              "vector_kwargs: {'autoreset_mode': gymnasium.vector.AutoresetMode.…}")  # fmt: skip
        if (policy := kwargs.pop("policy", None)) is not None:
            kwargs = trained_keywords(policy, kwargs)
        self.settings = parse_settings(PickSettings, kwargs, "environment")
        self.render_mode, self._size = render_mode, (width, height)
        self.episodes = Episodes(self.settings)
        self._camera: Camera | None = None
        joints = 1 if self.settings.control == "grasp" else self.episodes.spec.n_joints
        self.action_space = spaces.Box(-1.0, 1.0, (6 + joints,), np.float32)
        self.observation_space = spaces.Box(-BOUND, BOUND, (self.episodes.numbers,), np.float32)
        self._begun, self._over, self._high = False, True, 0.0
        self._spec: EnvSpec | None = None

    @property
    def numbers(self) -> tuple[int, int]:
        """Sizes of an observation and of an action."""
        return self.episodes.numbers, int(np.prod(self.action_space.shape or ()))

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's, with the length of an episode."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = with_episode_length(spec, self.episodes.limit)

    def save_state(self) -> ArmPickState:
        """All that decides how the episode goes on, random numbers included: plain arrays and numbers, which pickle.
        Raises CommandError where none has begun."""
        if not self._begun:
            raise CommandError("no episode has begun: reset before save_state")
        keywords, draws = self.settings.model_dump(mode="json"), self.np_random.bit_generator.state
        return ArmPickState(keywords, self.episodes.save(), self._over, self._high, draws, self.np_random_seed)

    def restore_state(self, state: ArmPickState) -> Floats:
        """Go on from a `save_state` of an environment with the same keywords, to the bit. Returns the observation that
        it had. Raises ConfigError for another, and then nothing has changed."""
        if not isinstance(state, ArmPickState):
            raise ConfigError(f"restore_state takes what ArmPick's save_state has returned, not {type(state).__name__}")
        if difference := first_difference(state.keywords, self.settings.model_dump(mode="json")):
            raise ConfigError(f"the state is of environments with {difference}: make them with the same keywords")
        self._close_camera()
        self.np_random.bit_generator.state, self._np_random_seed = state.generator, state.seed
        self.episodes.restore(state.episode, self.np_random)
        self._begun, self._over, self._high = True, state.over, state.high
        return self._seen()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        asked = parse_settings(PickOptions, options or {}, "options")
        now = self.episodes
        now.check(asked)
        super().reset(seed=seed)
        self._begun, self._over = False, True  # A search that finds no beginning leaves the scene where it looked last.
        self._close_camera()
        now.begin(self.np_random, asked)
        self._begun, self._over, self._high = True, False, 0.0
        info = {"object": now.scene.name, "at": now.at.tolist(), "yaw": float(np.degrees(now.yaw)), "error": now.error}
        return self._seen(), info

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        if self._over:
            raise CommandError("no episode is going on: it is over, or none has begun; reset before the next step")
        now, taken = self.episodes, _placed(action, self.action_space.shape)
        stopped = ""
        try:
            now.step(taken)
        except HandFault as error:
            stopped = str(error)
        terms = self._terms(taken)
        rise, away = now.moved()
        self._high = self._high + now.seconds if rise >= _HIGH else 0.0
        success = self._high >= _LONG - 1e-9
        lost = rise < -_LOST or (away > _LOST and rise < _HIGH)
        if now.scene.stuck() and not stopped:
            stopped = "a joint of the arm is at its end"
        over = now.count >= now.limit
        self._over = over or lost or bool(stopped)
        info: dict[str, Any] = {"is_success": success, "rise": rise} | terms
        if stopped:
            info["stopped"] = stopped
        reward = float(sum(terms.values()))
        return self._seen(), reward, lost or bool(stopped), over, info

    def render(self) -> NDArray[np.uint8] | None:
        if self.render_mode is None:
            return None
        if self._camera is None:
            width, height = self._size
            self._camera = Camera(self.episodes.scene.robot.hand_sim, width=width, height=height, view=_VIEW)
        return self._camera.take()

    def close(self) -> None:
        self._close_camera()
        self.episodes.close()

    def _close_camera(self) -> None:
        """The next picture is of the scene of then."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _terms(self, action: Vector) -> dict[str, float]:
        """What the reward is made of."""
        now = self.episodes
        one, both = now.scene.touched()
        return {
            "reach": 0.1 * float(np.exp(-now.apart() / 0.1)),
            "contact": 0.05 * one + 0.15 * both,
            "lift": float(np.clip(now.moved()[0] / _HIGH, 0.0, 1.0)) * (0.5 if both else 0.1),
            "effort": -0.01 * float(np.mean(action**2)),
        }

    def _seen(self) -> Floats:
        now, scene = self.episodes, self.episodes.scene
        arm, hand, palm, spec = scene.arm, scene.hand, scene.palm, self.episodes.spec
        object_pose, mine = now.track.pose, scene.robot.spec
        parts: list[Array] = [
            _part(arm.position, mine.lower, mine.upper), arm.velocity / 2.0,
            _part(hand.position, spec.lower, spec.upper), hand.velocity / 5.0, (scene.path.goal - hand.position) / 0.3,
            palm.position / 0.5, palm.quaternion, (scene.aim.position - palm.position) / 0.06,
            rotation_between(palm.rotation, scene.aim.rotation) / 0.3,
            object_pose.position / 0.5, palm.rotation.T @ (object_pose.position - palm.position) / 0.2,
            object_pose.quaternion,
            np.array(now.body.extents) / 0.2, np.array([now.closed - 1.0, now.count / now.limit]),
        ]  # fmt: skip
        return np.clip(np.concatenate(parts), -BOUND, BOUND).astype(np.float32)


def _part(position: Vector, lower: Vector, upper: Vector) -> Vector:
    """Position between limits as a number from -1 to 1."""
    return np.asarray((2.0 * position - lower - upper) / (upper - lower))


def _placed(action: Floats, shape: tuple[int, ...] | None) -> Vector:
    given = np.asarray(action, dtype=np.float64)
    if given.shape != shape:
        raise CommandError(f"ArmPick takes an action of shape {shape}, not {given.shape}")
    if not np.isfinite(given).all():
        raise CommandError(f"action {given.tolist()} is not finite")
    return np.asarray(np.clip(given, -1.0, 1.0))
