"""The episode that a session's hand is in: what the page sees of it, its clock, and a person's goals."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from allegro_twin.app import Rig
from allegro_twin.control.controllers import PD, PositionControl
from allegro_twin.control.trajectory import Hold, Path
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import gravity_from_quaternion
from allegro_twin.learning.environments.episode import EpisodeBackend, EpisodeScene
from allegro_twin.learning.tasks.scenes import OBJECT
from allegro_twin.surfaces.panel.stream import goals_reached
from allegro_twin.types import Array, PositionCommand, Sample, TorqueCommand, Vector

HOLD = "hold"
"""The controller that keeps the set-points of the fingers, by this name."""
_UNIT = 1e-3  # That the norm of a quaternion may differ from 1.


class EpisodeStart:
    """The set-points with which an episode begins; where it has none, where the joints are."""

    def __init__(self, episode: EpisodeBackend) -> None:
        self._episode = episode

    def begin(self, position: Vector) -> Path:
        target = self._episode.target
        return Hold(position if target is None else target).begin(position)


class EpisodeWatch:
    """Watches the episode of a rig. `see`, `look` and `over` belong to the thread that turns the loop.

    The episode's time stands until somebody has its task performed. A person's goal takes the place of the task's: the
    planner plans for it, and the episode judges and counts it. When it is reached, the task goes on with goals of its
    own.
    """

    def __init__(self, rig: Rig, episode: EpisodeBackend) -> None:
        self._episode, self._engine, self._task = episode, episode.engine, episode.engine.task
        self._planner = rig.planner
        self._asked: deque[Vector | None] = deque(maxlen=1)
        self._performed, self._mine, self._reached, self._mine_reached = False, False, 0, 0
        self._sample: Sample | None = None
        self._scene = EpisodeScene(episode)
        self.gravity: Vector = gravity_from_quaternion(self._scene.palm_pose()[3:])
        """In the palm's frame, (3,), m/s²: the episode's palm reports none."""
        self.appearance: Mapping[str, Any] = self._scene.appearance
        """As the metadata of a recording have it."""

    @property
    def name(self) -> str:
        """Name of the task."""
        return self._task.name

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of its objects in the scene."""
        return () if self._task.object_body is None else (OBJECT,)

    @property
    def turns(self) -> bool:
        """Whether its goal is an orientation of the object."""
        return self._task.goal_is_orientation

    @property
    def plans(self) -> bool:
        """Whether the config's controller plans."""
        return self._planner is not None

    def first(self) -> PD | PositionControl:
        """Holds the set-points with which the episode begins, as its task does without an action."""
        return self._holding(EpisodeStart(self._episode))

    def hold(self) -> PD | PositionControl:
        """Keeps pressing as the hand does now: an object in the fingertips stays there."""
        assert self._sample is not None
        state, command = self._sample
        if isinstance(command, PositionCommand):
            return self._holding(Hold(state.position if command.limp else command.position))
        assert isinstance(command, TorqueCommand)
        return self._holding(Hold(state.position + command.torque / self._task.interface.gains.kp))

    def perform(self) -> None:
        """The episode's time passes from now on."""
        self._performed = True

    def turn(self, quaternion: Sequence[float] | None) -> None:
        """Take a person's goal, a unit quaternion w x y z in the world, (4,); None: the task's own goals again. The
        newest counts, from the next period on. Raises ConfigError."""
        if not self.turns:
            raise ConfigError(f"{self.name} has no orientation as its goal: task.episode.task Reorient has one")
        if quaternion is None:
            self._asked.append(None)
            return
        given = np.array(quaternion, dtype=float)
        size = float(np.linalg.norm(given)) if given.shape == (4,) else np.nan
        if not abs(size - 1.0) <= _UNIT:
            said = ", ".join(f"{value:g}" for value in quaternion)
            raise ConfigError(f"a goal is a unit quaternion w, x, y, z, four finite numbers of norm 1; not ({said})")
        self._asked.append(given / size)

    def see(self, sample: Sample) -> None:
        """A period has begun: count what was reached, and pass new goals on to the task and the planner."""
        self._sample = sample
        if not self._performed:
            self._engine.count[:] = 0
        if not self.turns:
            return
        reached = int(self._episode.count)
        if reached > self._reached:
            self._mine_reached += self._mine
            self._mine = False
        self._reached = reached
        if self._asked:
            asked = self._asked.popleft()
            if asked is not None or self._mine:
                self._task.set_goal(0, asked)
            self._mine = asked is not None
        goal = self._task.goal()
        if self._planner is not None and goal is not None:
            self._planner.episode.goal = goal[0].copy()

    def look(self) -> Mapping[str, Array]:
        """As `StreamFrame.look`."""
        seconds, plans = self._seconds, 0 if self._planner is None else self._planner.plans
        limit = self._engine.limit * self._task.interface.seconds
        row = (seconds, limit, self._reached, self._mine_reached, self._mine, plans / max(seconds, 1.0))
        return {**self._scene.poses(), "episode": np.array(row)}

    def ended(self) -> str:
        """How the episode ended, in a sentence; empty while it goes on."""
        if not self._episode.over:
            return ""
        if self._performed and self._engine.count[0] >= self._engine.limit:
            how = f"the {self._seconds:.0f} s of {self.name} are over"
        else:
            when = f"after {self._seconds:.1f} s" if self._performed else "before the task was performed"
            how = f"the object of {self.name} is lost {when}"
        return how + (f"; {goals_reached(self._reached, self._mine_reached)}" if self.turns else "")

    def close(self) -> None:
        """End the planning."""
        if self._planner is not None:
            self._planner.close()

    @property
    def _seconds(self) -> float:
        return float(self._engine.count[0]) * self._task.interface.seconds

    def _holding(self, reference: EpisodeStart | Hold) -> PD | PositionControl:
        interface = self._task.interface
        return PositionControl(reference) if interface.takes_positions else PD(reference, interface.gains)
