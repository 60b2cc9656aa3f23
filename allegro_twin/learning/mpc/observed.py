"""An episode as it can be known from outside: joints as measured and an object's pose as observed, in a model of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import (
    quaternion_conjugate,
    quaternion_from_vector,
    quaternion_product,
    vector_from_quaternion,
)
from allegro_twin.learning.environments.engine import EpisodeEngine
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.settings import EnvSettings, env_keywords
from allegro_twin.learning.environments.snapshot import EpisodeState
from allegro_twin.learning.mpc.settings import PoseCamera
from allegro_twin.learning.tasks.in_hand import InHandTask
from allegro_twin.sim.batch.link_contacts import AssumedContacts
from allegro_twin.types import Array, HandState

PoseSource = Callable[[], Array]
"""The object's present pose, position and quaternion w x y z in the scene's world, (7,), m."""


class PoseTracker:
    """Follows an object by pictures: its pose now, and its velocity. Call it once in every control period."""

    def __init__(self, source: PoseSource, settings: PoseCamera) -> None:
        self._source, self.settings = source, settings
        self.begin()

    def begin(self) -> None:
        """A new episode."""
        self._rng = np.random.default_rng(self.settings.seed)
        self._pictures: deque[tuple[float, Array]] = deque()
        self._due = -np.inf

    def look(self, t: float) -> None:
        """Take a picture where one is due; `t`: the hand's time, s."""
        chosen = self.settings
        if t < self._due - 1e-9:
            return
        self._due = t + chosen.period
        pose = np.array(self._source())
        pose[:3] += chosen.noise * self._rng.standard_normal(3)
        pose[3:] = quaternion_product(pose[3:], quaternion_from_vector(chosen.turn * self._rng.standard_normal(3)))
        self._pictures.append((t, pose))
        oldest = t - chosen.delay - chosen.window - chosen.period
        while len(self._pictures) > 1 and self._pictures[1][0] <= oldest:
            self._pictures.popleft()

    def now(self, t: float) -> tuple[Array, Array]:
        """Pose (7,), and velocity (6,), m/s in the world and rad/s in the object's axes, at the hand's time `t`, from
        the pictures that have arrived by then."""
        seen = [each for each in self._pictures if each[0] <= t - self.settings.delay + 1e-9] or [self._pictures[0]]
        last, pose = seen[-1]
        recent = [each for each in seen if each[0] >= last - self.settings.window - 1e-9]
        times = np.array([when - last for when, _ in recent])
        back = quaternion_conjugate(pose[3:])
        steps = np.array([
            np.concatenate([each[:3] - pose[:3], vector_from_quaternion(quaternion_product(back, each[3:]))])
            for _, each in recent
        ])  # fmt: skip
        if len(recent) < 2:
            return pose.copy(), np.zeros(6)
        design = np.stack([np.ones_like(times), times], axis=-1)
        (offset, velocity), *_ = np.linalg.lstsq(design, steps, rcond=None)
        moved = offset + velocity * (t - last)
        turned = quaternion_product(pose[3:], quaternion_from_vector(moved[3:]))
        return np.concatenate([pose[:3] + moved[:3], turned]), velocity


class ObservedEpisode:
    """A model of an episode that is brought to what is measured at every decision.

    It knows the hand, the object and the task (the episode of the environment with this seed); joints and the object's
    motion come from outside. `poses`: the object's pose, for tasks with an object. Raises ConfigError.
    """

    def __init__(
        self,
        task: str,
        environment: EnvSettings,
        seed: int = 0,
        poses: PoseTracker | None = None,
    ) -> None:
        self.environment = environment.model_copy(update={"history": 1, "device": "cpu", "state": False})
        self._env, self.seed, self.poses = HandEnv(task, **env_keywords(self.environment)), seed, poses
        self.goal: Array | None = None
        """A goal in place of the task's, as long as there is one; it may be set at any time."""
        own = self.engine.task
        if own.interface.scripts is not None:
            raise ConfigError(f"{own.name} has a script and brings its object by itself: a model cannot follow it from "
                              "outside; use allegro-twin mpc, or a task without a script")  # fmt: skip
        if own.object_body is not None and poses is None:
            raise ConfigError(f"{own.name} has an object, and this hand comes with no pose of one: use a simulated or "
                              "virtual hand, or Reach")  # fmt: skip

        if isinstance(own, InHandTask):
            own.contacts = AssumedContacts(own.worlds)

    @property
    def engine(self) -> EpisodeEngine:
        return self._env.engine

    def begin(self, state: HandState) -> None:
        """The episode begins with this state."""
        self._env.reset(seed=self.seed)
        if self.poses is not None:
            self.poses.begin()
            self.poses.look(state.t)
        self._write(state)

    def look(self, t: float) -> None:
        """To be called in every control period, at the hand's time `t`, s."""
        if self.poses is not None:
            self.poses.look(t)

    def follow(self, state: HandState, action: Array) -> None:
        """A decision has passed with this action, (joints,), and the hand is now in this state."""
        engine = self.engine
        interface, taken = engine.task.interface, engine.clip_actions(np.asarray(action)[None])
        engine.task.plan_surroundings(engine.memory.tick)
        engine.memory = interface.advance(interface.act(taken, engine.memory))
        engine.count += 1
        self._write(state)
        engine.outcome(taken, engine.observe())

    def save(self) -> EpisodeState:
        """The present state, to plan from."""
        return self._env.save_state()

    def _write(self, state: HandState) -> None:
        task, row = self.engine.task, np.zeros(1, np.int64)
        task.worlds.place(row, state.position[None])
        velocity = task.worlds.velocity
        if velocity.base is not None:  # A hand whose motors turn joints of their own: a view of the simulation.
            velocity[...] = np.nan_to_num(state.velocity)
        if self.goal is not None and (known := task.goal()) is not None:
            known[0] = self.goal
        if task.object_body is not None and self.poses is not None:
            pose, motion = self.poses.now(state.t)
            body = task.object_body
            body.pose[0], body.velocity[0], body.spin[0] = pose, motion[:3], motion[3:]
