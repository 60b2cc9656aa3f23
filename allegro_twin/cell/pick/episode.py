"""Episodes of `ArmPick`: what is drawn, how it begins, and what a decision does."""

from __future__ import annotations

import numpy as np

from allegro_twin.cell.assembly import waiting
from allegro_twin.cell.camera.camera import Camera
from allegro_twin.cell.motion.grasp_selection import Body, Way
from allegro_twin.cell.perception.pipeline import Pipeline
from allegro_twin.cell.pick.observation import Track, pictured, told
from allegro_twin.cell.pick.scene import Stand
from allegro_twin.cell.pick.settings import PickOptions, PickSettings
from allegro_twin.cell.reachability import best_of
from allegro_twin.cell.settings import LabSettings
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import Library
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.pose import Pose
from allegro_twin.sim.objects.catalogue import catalogue
from allegro_twin.types import Vector

_TRIES = 40
"""Placements that are drawn until the arm reaches a grasp of one."""
_LIFT = 0.15  # m.
_OTHERS = 28  # Numbers of an observation that are no joints': palm, set-point, thing, time.
_NEAR = 2e-3  # m and rad.


class Episodes:
    """One after the other. Raises ConfigError."""

    def __init__(self, settings: PickSettings) -> None:
        for name in settings.objects:
            if name not in catalogue():
                raise ConfigError(unknown("object", name, catalogue()))
        self.settings, self.spec = settings, load_spec(settings.hand, settings.side)
        self._model, self._library = hand_kinematics(self.spec), Library()
        self._lab = load_settings(LabSettings, data_root() / "conf" / "lab_allegro.yaml")
        self._stands: dict[str, Stand] = {}
        self._cameras: dict[str, Camera] = {}
        self._pipeline = Pipeline(self._lab.perception) if settings.perception else None
        self._wait: Vector | None = None
        self.count, self.closed = 0, 0.0
        self.stand = self._of(settings.objects[0])
        self.numbers = 2 * self.stand.cell.spec.n_joints + 3 * self.spec.n_joints + _OTHERS
        """In an observation."""
        self.seconds = settings.period * settings.decimation
        """Between two decisions."""
        self.limit = max(round(settings.seconds / self.seconds), 1)
        """Decisions an episode."""

    def begin(self, draws: np.random.Generator, asked: PickOptions) -> None:
        """The next episode. Raises ConfigError where the arm reaches no grasp of what is asked for."""
        name = asked.object or self.settings.objects[int(draws.integers(len(self.settings.objects)))]
        self.stand, self._draws = self._of(name), draws
        why = ""
        for _ in range(_TRIES):
            place = draws.uniform(-self.settings.place, self.settings.place, 2)
            yaw = float(draws.uniform(-np.pi, np.pi))
            off = draws.uniform(-self.settings.off, self.settings.off, 3)
            at = place if asked.at is None else np.array(asked.at)
            yaw = yaw if asked.yaw is None else float(np.radians(asked.yaw))
            try:
                self._start(at, yaw, off)
            except ConfigError as error:
                why = str(error)
                continue
            return
        raise ConfigError(f"ArmPick found no placement of {name} that the arm reaches: {why}")

    def step(self, action: Vector) -> None:
        """What a decision does, in [-1, 1]. Raises HandFault where a guard stops arm or hand."""
        settings, grasp = self.settings, self.grasp
        if settings.control == "grasp":
            self.closed = float(np.clip(self.closed + settings.close * action[6], 0.0, 2.0))
            posture = posture_at(grasp, self.closed)
        else:
            posture = self.stand.path.goal + settings.turn * action[6:]
        self.count += 1
        self.stand.move(settings.step * action[:3], settings.turn * action[3:6], posture)
        for _ in range(settings.decimation):
            self.stand.pass_time()
        self.track.look(self._draws)

    def moved(self) -> tuple[float, float]:
        """How much higher the thing is than it was, and how far along the table, m."""
        way = self.stand.there.position - self._first
        return float(way[2]), float(np.hypot(way[0], way[1]))

    def apart(self) -> float:
        """From the middle of the fingertips to the thing's middle, m."""
        tips = self._model.fingertips(self.stand.hand.position).values()
        middle = np.mean([tip.position for tip in tips], axis=0)
        palm = self.stand.palm
        return float(np.linalg.norm(palm.position + palm.rotation @ middle - self.stand.there.position))

    def close(self) -> None:
        """Let go of everything; idempotent."""
        for camera in self._cameras.values():
            camera.close()
        for stand in self._stands.values():
            stand.close()

    def _start(self, at: Vector, yaw: float, off: Vector) -> None:
        stand, wait = self.stand, self._waiting()
        stand.rest(at, yaw, wait, self.spec.rest)
        body: Body | None = told(stand, yaw)
        if self._pipeline is not None:
            eye = self._eye(stand)
            eye.restart(int(self._draws.integers(2**31)))
            body = pictured(stand, eye, self._pipeline)
        if body is None:
            raise ConfigError("perception refuses the picture")
        reached = best_of(body, stand.cell, wait, _LIFT)
        self.way: Way = reached.way
        self.grasp: Grasp = self._library.grasp(self.way.card.grasp, self.spec)
        palm = Pose(self.way.before.position + off, self.way.before.rotation)
        posture = stand.cell.model.reach(stand.cell.flange_for(palm), reached.through[-1], _NEAR)
        stand.rest(at, yaw, posture, self.grasp.preshape)
        stand.begin()
        self.body, self.at, self.yaw = body, at, yaw
        self.error = float(np.linalg.norm(body.position - stand.there.position))
        self.track, self._first = Track(stand, body), stand.there.position
        self.count, self.closed = 0, 0.0

    def _waiting(self) -> Vector:
        if self._wait is None:
            self._wait = waiting(self.stand.cell, self._lab.security)[1]
        return self._wait

    def _of(self, name: str) -> Stand:
        if name not in self._stands:
            arm = self.settings.arm or self._lab.arm.model
            self._stands[name] = Stand(self.settings, arm, self.spec, self._model, name)
        return self._stands[name]

    def _eye(self, stand: Stand) -> Camera:
        if stand.name not in self._cameras:
            self._cameras[stand.name] = Camera(stand.cell.world.model, self._lab.camera)
        return self._cameras[stand.name]


def posture_at(grasp: Grasp, closed: float) -> Vector:
    """The fingers of a grasp that is open at 0, closed at 1, squeezed at 2, (n,), rad."""
    stages = (grasp.preshape, grasp.close, grasp.squeeze)
    first = min(int(closed), 1)
    return np.asarray(stages[first] + (closed - first) * (stages[first + 1] - stages[first]))
