"""An episode of an environment as a backend: its object comes, is let go of and pushed, whatever controls the hand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from allegro_twin.backend import limp_of, position_of, torque_of
from allegro_twin.errors import CommandError, ConfigError, HandFault
from allegro_twin.learning.environments.engine import EpisodeEngine
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.policy.interface import Observation
from allegro_twin.learning.tasks.scenes import OBJECT
from allegro_twin.sim.engine.backend import ENGINE
from allegro_twin.sim.model.appearance import scene_appearance
from allegro_twin.sim.model.fingerprint import model_fingerprint
from allegro_twin.sim.model.joints import JointChange
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Command, HandState, Vector, frozen

_ROW = np.zeros(1, np.int64)


class EpisodeBackend:
    """The episode that `HandEnv(task, …).reset(seed=seed)` begins, as a backend; `reset` begins it again.

    The hand reports what the environment measures, noise and delays included. Raises ConfigError.
    """

    live = False
    """Time passes only while this backend reads."""

    def __init__(self, task: str, settings: EnvSettings, seed: int = 0) -> None:
        self.engine, self.seed = EpisodeEngine(task, settings, 1, threads=1), seed
        self.wanted_goal: Vector | None = None
        """A goal in place of the one that a reset draws, for tasks that take one, from the next reset on."""
        self._unknown = frozen(np.full(self.spec.n_actuators, math.nan))
        self._told = frozen(np.zeros(self.spec.n_actuators))
        self._most: NDArray[np.float64] | None = None
        """Force limits of the motors in this episode, for hands that close their own loop, (motors, 2), N·m."""
        self._decimation = self.engine.task.interface.decimation
        self.success, self.over, self.lost = False, False, False
        """State of the episode, as the environment would report it after its last step; whether it has failed."""
        self.reward = 0.0
        """Reward of the last period: that of a step where a step ended with it, without the cost of actions."""
        self.report: dict[str, Any] = {}
        """What was drawn at the last reset, one row each."""
        self.count = 0.0
        """Value of the task's `count_term`, where it has one: rad turned, goals reached."""
        self.shares: dict[str, float] = {}
        """Shares of the episode's time, by name, where the task has such terms."""
        self.terms: dict[str, float] = {}
        """All terms of the last step; empty before the first."""

    @property
    def spec(self) -> HandSpec:
        return self.engine.task.spec

    @property
    def period(self) -> float:
        return self.engine.settings.period

    @property
    def goal(self) -> Vector | None:
        """Goal of the fingertips in this episode, where the task has such goals."""
        goal = self.engine.task.goal() if self.engine.task.interface.goal != "none" else None
        return None if goal is None else frozen(goal[0])

    @property
    def target(self) -> Vector | None:
        """Initial set-points of the joints, rad; None: where they are."""
        targets = self.engine.task.initial_targets(_ROW)
        return None if targets is None else frozen(targets[0])

    def complete_observation(self, observation: Observation) -> Observation:
        """Add to a policy's observation of the hand what no hand reports, as a camera beside it would."""
        parts = observation if isinstance(observation, dict) else {"observation": observation}
        rows = {name: part[None] for name, part in parts.items()}
        completed = self.engine.complete_observation(rows if isinstance(observation, dict) else rows["observation"])
        return {name: part[0] for name, part in completed.items()} if isinstance(completed, dict) else completed[0]

    @property
    def script(self) -> int:
        """Number of the script in this episode."""
        return int(self.engine.task.scripts(_ROW)[0])

    def reset(self) -> HandState:
        self.report = self.engine.reset(_ROW, [seeding.np_random(self.seed)[0]])
        if self.wanted_goal is not None:
            self.engine.task.set_goal(0, self.wanted_goal)
        self._tick, self.reward, self.success, self.over, self.lost = 0, 0.0, False, False, False
        self.count, self.terms, self.shares = 0.0, {}, dict.fromkeys(self.engine.task.share_terms, 0.0)
        self._most = None
        if self.engine.worlds.closes_loop:
            self._most = np.array(self._ranges())
        self.write(limp_of(self.spec))
        return self._state()

    def write(self, command: Command) -> None:
        if self._most is None:
            self._told = frozen(torque_of(command, self.spec))
            return
        wanted, limit = position_of(command, self.spec), self.spec.actuation.torque_limit
        if wanted.duration:
            raise CommandError("an episode of an environment takes positions without a duration: say them on and on")
        share = 1.0 if wanted.effort is None else np.minimum(wanted.effort / limit, 1.0)
        self._ranges()[...] = self._most * np.reshape(share, (-1, 1))
        self._told = wanted.position

    def read(self) -> HandState:
        k = self._tick % self._decimation
        if k == 0:
            self.engine.task.plan_surroundings(np.array([self._tick]))
        self.simulate(k)
        self._tick += 1
        self.reward = 0.0
        if self._tick % self._decimation == 0 and not self.over:
            self._judge()
        return self._state()

    def close(self) -> None:
        self.write(limp_of(self.spec))

    def become(self, change: JointChange, friction: float | None = None) -> None:
        """Go on with another hand, and where `friction` is given with that sliding friction of every contact; not to be
        reset afterwards. Raises ConfigError for a strength of a hand that closes its own loop."""
        if self._most is not None and change.strength != 1.0:
            raise ConfigError(f"{self.spec.name} closes its own loop: no `strength`")
        self.engine.become(change, friction)

    def meta(self) -> dict[str, str]:
        """What a recording should say of the simulation: the engine, and a fingerprint of this episode's model."""
        return {"engine": ENGINE, "model": model_fingerprint(self.engine.worlds.snapshot(0).model)}

    @property
    def command(self) -> Vector:
        """What the hand was told last: torques, N·m, or positions, rad."""
        return self._told

    def simulate(self, k: int) -> None:
        """Let a control period pass, the k-th since the last decision. Other physics of the hand override this."""
        self.engine.step_period(self._told[None], np.array([self._tick]), k)

    def _ranges(self) -> NDArray[np.float64]:
        """Force limits of the motors, a view of the model, (motors, 2), N·m."""
        worlds = self.engine.worlds
        ranges: NDArray[np.float64] = worlds.expand("actuator_forcerange")[0, worlds.motors]
        return ranges

    def _judge(self) -> None:
        """Evaluate the episode as after a step of the environment, without the cost of an action."""
        engine = self.engine
        engine.memory = engine.task.interface.advance(engine.memory)
        engine.count += 1
        outcome, _ = engine.outcome(np.zeros((1, self.spec.n_joints)), engine.observe())
        self.reward, self.success = float(outcome.reward[0]), bool(outcome.success[0])
        self.terms = {name: float(rows[0]) for name, rows in outcome.terms.items()}
        self.count = self.terms.get(engine.task.count_term, 0.0)
        self.shares = {each: self.terms[each] for each in engine.task.share_terms if each in self.terms}
        self.lost = bool(outcome.failed[0])
        self.over = bool(self.lost or engine.count[0] >= engine.limit)

    def _state(self) -> HandState:
        position, velocity = (frozen(x[0]) for x in self.engine.measure(np.array([self._tick])))
        if not np.isfinite(position).all():
            raise HandFault(f"the simulation diverged at {self._tick * self.period:.3f} s")
        t = self._tick * self.period
        torque = self._told if self._most is None else frozen(self.engine.worlds.applied_torque[0])
        return HandState(t, self._tick, position, velocity, torque, self._unknown, frozen(self._gravity()))

    def _gravity(self) -> Array:
        return np.full(3, math.nan)  # The environments' palms report no gravity, and policies need none.


class EpisodeScene:
    """Scene of an episode: its palm, its object, and the object's goal orientation.

    It begins the episode, since sizes and places are drawn with it; the next reset draws the same.
    """

    def __init__(self, episode: EpisodeBackend) -> None:
        episode.reset()
        self._task = episode.engine.task
        self._scene = self._task.worlds.snapshot(0)
        self._palm = self._scene.model.body(episode.spec.root).id
        self._moves = bool(self._scene.model.body_weldid[self._palm])
        object_names = () if self._task.object_body is None else (OBJECT,)
        self.appearance: Mapping[str, Any] = scene_appearance(self._scene.model, episode.spec, object_names)
        """As the metadata of a recording have it."""

    def poses(self) -> dict[str, Vector]:
        """`palm`, `object` where there is one, and `object_goal`, beside the hand, where its goal is an orientation:
        position, m, and quaternion w x y z, in the world, (7,) each."""
        found = {"palm": self.palm_pose()}
        if self._task.object_body is not None:
            found["object"] = self._task.object_body.pose[0].copy()
        if self._task.goal_is_orientation:
            found["object_goal"] = np.array(self._task.marks(0)[0].pose)
        return found

    def palm_pose(self) -> Vector:
        """(7,)."""
        scene = self._task.worlds.snapshot(0, self._scene) if self._moves else self._scene
        return np.concatenate([scene.data.xpos[self._palm], scene.data.xquat[self._palm]])
