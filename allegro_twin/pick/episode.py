"""Episodes of `ArmPick`: how one begins, what is observed, what an action does, and what it earns."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from allegro_twin.cell.assembly import waiting_pose
from allegro_twin.cell.camera.camera import DepthCamera
from allegro_twin.cell.perception.pipeline import Detection, PerceptionPipeline
from allegro_twin.cell.planning.reachability import GraspPlan, plain_grasps
from allegro_twin.cell.planning.stored_grasps import (
    GraspCandidate,
    standing_object,
    table_object,
    yaw_rotation,
)
from allegro_twin.cell.settings import LabSettings
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.arm import rotate
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.pose import Pose
from allegro_twin.pick.scene import PickScene, SceneState
from allegro_twin.pick.settings import PickOptions, PickSettings
from allegro_twin.sim.contact.contacts import STILL
from allegro_twin.sim.contact.obstacle_clearance import TableObject
from allegro_twin.sim.objects.catalogue import object_catalogue
from allegro_twin.types import Array, Vector

_ROUND = ("sphere", "cylinder")


def known_object(scene: PickScene, yaw: float) -> TableObject:
    """The thing as it stands, turned by `yaw`, rad."""
    return _plain(replace(standing_object(scene.grasp_object, yaw), position=scene.there.position))


def detected_object(scene: PickScene, camera: DepthCamera, pipeline: PerceptionPipeline) -> TableObject | None:
    """The thing as a picture shows it now; None where perception refuses."""
    frame = camera.capture(scene.robot.world.data)
    seen = pipeline.detect(frame.cloud, frame.pose.position, frame.pose.rotation)
    return _plain(table_object(seen.solid)) if isinstance(seen, Detection) else None


class PickState(NamedTuple):
    """State that decides how an episode goes on."""

    object: str
    scene: SceneState
    candidate: GraspCandidate
    body: TableObject
    at: Vector
    yaw: float
    error: float
    first: Vector
    track: tuple[Array, Pose, tuple[Pose, ...]]
    decisions: int
    closed: float


class ObjectTracker:
    """The thing's frame over an episode: x along its longer level extent and z up while it stands, carried along."""

    def __init__(self, scene: PickScene, body: TableObject) -> None:
        settings, there = scene.settings, scene.there
        self._scene, self._fixed = scene, settings.perception
        self.pose = Pose(body.position, yaw_rotation(body.yaw))
        self._own = there.rotation.T @ self.pose.rotation
        self._noise = (settings.camera_shift, settings.camera_turn)
        self._past = deque([self.pose], maxlen=settings.camera_delay + 1)

    def save(self) -> tuple[Array, Pose, tuple[Pose, ...]]:
        """Copy of the state that decides how it goes on."""
        return self._own, self.pose, tuple(self._past)

    def restore(self, state: tuple[Array, Pose, tuple[Pose, ...]]) -> None:
        """Go on from what `save` returned."""
        self._own, self.pose, past = state
        self._past = deque(past, self._past.maxlen)

    def update(self, draws: np.random.Generator) -> None:
        """A decision comes: what is known now."""
        if self._fixed:
            return
        there = self._scene.there
        self._past.append(Pose(there.position, there.rotation @ self._own))
        known, (shift, twist) = self._past[0], self._noise
        self.pose = Pose(
            known.position + shift * draws.uniform(-1.0, 1.0, 3) if shift else known.position,
            rotate(known.rotation, twist * draws.uniform(-1.0, 1.0, 3)) if twist else known.rotation,
        )


def _plain(body: TableObject) -> TableObject:
    """Body with one of its equivalent yaws: zero for a round one, otherwise within a quarter turn."""
    yaw = 0.0 if body.kind in _ROUND else float((body.yaw + np.pi / 2.0) % np.pi - np.pi / 2.0)
    return replace(body, yaw=yaw)


_TRIES = 40
"""Placements that are drawn until the arm reaches a grasp of one."""
_LIFT = 0.15  # m.
_TURNED = np.radians(np.arange(0.0, 360.0, 45.0))
"""In one of these a thing in the table's middle must be within reach, rad, that the hand takes it at all."""
_OTHERS = 28  # Numbers of an observation that are no joints': palm, set-point, thing, time.
_NEAR = 2e-3  # m and rad.


class Episodes:
    """One after the other. Raises ConfigError."""

    def __init__(self, settings: PickSettings) -> None:
        for name in settings.objects:
            if name not in object_catalogue():
                raise ConfigError(unknown("object", name, object_catalogue()))
        self.settings, self.spec = settings, load_spec(settings.hand, settings.side)
        self._model = hand_kinematics(self.spec)
        self._lab = load_settings(LabSettings, data_root() / "conf" / "lab_allegro.yaml")
        self._scenes: dict[str, PickScene] = {}
        self._refused: dict[str, str] = {}
        self._cameras: dict[str, DepthCamera] = {}
        self._pipeline = PerceptionPipeline(self._lab.perception) if settings.perception else None
        self._wait: Vector | None = None
        self.count, self.closed = 0, 0.0
        self.candidate: GraspCandidate
        self.grasp: Grasp
        self.scene = self._of(settings.objects[0])
        self.numbers = 2 * self.scene.robot.spec.n_joints + 3 * self.spec.n_joints + _OTHERS
        """In an observation."""
        self.seconds = settings.period * settings.decimation
        """Between two decisions."""
        self.limit = max(round(settings.seconds / self.seconds), 1)
        """Decisions an episode."""
        if "objects" in settings.model_fields_set:
            for name in settings.objects:
                self._check(name)

    def check(self, options: PickOptions) -> None:
        """Raises ConfigError for an object that the hand does not take. The episode that is going on stays."""
        if options.object is not None:
            self._check(options.object)

    def begin(self, draws: np.random.Generator, options: PickOptions) -> None:
        """The next episode, of what `check` lets pass. Raises ConfigError where the arm reaches no grasp of what is
        asked for, and then there is no episode."""
        name = self._draw(draws) if options.object is None else options.object
        self.scene, self._draws = self._of(name), draws
        if self._pipeline is not None:
            self._eye(self.scene)  # Where nothing can be rendered, no other placement helps.
        why = ""
        for _ in range(_TRIES):
            place = draws.uniform(-self.settings.place, self.settings.place, 2)
            yaw = float(draws.uniform(-np.pi, np.pi))
            off = draws.uniform(-self.settings.off, self.settings.off, 3)
            at = place if options.at is None else np.array(options.at)
            yaw = yaw if options.yaw is None else float(np.radians(options.yaw))
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
            posture = self.scene.path.goal + settings.turn * action[6:]
        self.count += 1
        self.scene.move(settings.step * action[:3], settings.turn * action[3:6], posture)
        for _ in range(settings.decimation):
            self.scene.pass_time()
        self.track.update(self._draws)

    def save(self) -> PickState:
        """State of the episode that is going on."""
        return PickState(
            self.scene.name, self.scene.save(), self.candidate, self.body, self.at, self.yaw, self.error, self._first,
            self.track.save(), self.count, self.closed,
        )  # fmt: skip

    def restore(self, state: PickState, draws: np.random.Generator) -> None:
        """Go on, to the bit, from a state of the same settings; what is drawn comes from `draws`."""
        self.scene, self._draws = self._of(state.object), draws
        self.scene.restore(state.scene)
        self.candidate, self.grasp, self.body = state.candidate, state.candidate.card.grasp, state.body
        self.at, self.yaw, self.error, self._first = state.at, state.yaw, state.error, state.first
        self.track = ObjectTracker(self.scene, self.body)
        self.track.restore(state.track)
        self.count, self.closed = state.decisions, state.closed

    def moved(self) -> tuple[float, float]:
        """How much higher the thing is than it was, and how far along the table, m."""
        way = self.scene.there.position - self._first
        return float(way[2]), float(np.hypot(way[0], way[1]))

    def apart(self) -> float:
        """From the middle of the fingertips to the thing's middle, m."""
        tips = self._model.fingertips(self.scene.hand.position).values()
        middle = np.mean([tip.position for tip in tips], axis=0)
        palm = self.scene.palm
        return float(np.linalg.norm(palm.position + palm.rotation @ middle - self.scene.there.position))

    def close(self) -> None:
        """Let go of everything; idempotent."""
        for camera in self._cameras.values():
            camera.close()
        for scene in self._scenes.values():
            scene.close()

    def _start(self, at: Vector, yaw: float, off: Vector) -> None:
        scene, wait = self.scene, self._waiting()
        scene.rest(at, yaw, wait, self.spec.rest)
        body: TableObject | None = known_object(scene, yaw)
        if self._pipeline is not None:
            eye = self._eye(scene)
            eye.restart(int(self._draws.integers(2**31)))
            body = detected_object(scene, eye, self._pipeline)
        if body is None:
            raise ConfigError("perception refuses the picture")
        why = ""
        for one in plain_grasps(body, scene.robot, wait, _LIFT):
            why = self._table_at_grasp(scene, one, at, yaw) or self._rest_at(scene, one, at, yaw, off)
            if not why:
                break
        if why:
            raise ConfigError(why)
        self.candidate, self.grasp = one.candidate, one.candidate.card.grasp
        scene.begin()
        self.body, self.at, self.yaw = body, at, yaw
        self.error = float(np.linalg.norm(body.position - scene.there.position))
        self.track, self._first = ObjectTracker(scene, body), scene.there.position
        self.count, self.closed = 0, 0.0

    def _rest_at(self, scene: PickScene, one: GraspPlan, at: Vector, yaw: float, off: Vector) -> str:
        """Put the hand `off` by so much, (3,), m, where an approach begins. Returns why nothing can begin there; empty
        where it can."""
        palm = Pose(one.candidate.before.position + off, one.candidate.before.rotation)
        try:
            posture = scene.robot.model.reach(scene.robot.flange_for(palm), one.through[-1], _NEAR)
        except ConfigError as error:
            return str(error)
        scene.rest(at, yaw, posture, one.candidate.card.grasp.preshape)
        if met := scene.obstructions():
            return f"at the beginning {met[0]}"
        return "a joint of the arm would begin at its end" if scene.stuck() else ""

    def _table_at_grasp(self, scene: PickScene, one: GraspPlan, at: Vector, yaw: float) -> str:
        """Which part of hand or arm would be in the table at the grasp; empty where none is."""
        scene.rest(at, yaw, one.there[0], one.candidate.card.grasp.preshape)
        met = [each for each in scene.obstructions() if each.other == STILL]
        return f"at its {one.candidate.card.name} grasp {met[0]}" if met else ""

    def _draw(self, draws: np.random.Generator) -> str:
        """One of the objects that the hand takes. Raises ConfigError where it takes none."""
        left = list(self.settings.objects)
        while left:
            name = left.pop(int(draws.integers(len(left))))
            if not self._refusal(name):
                return name
        raise ConfigError(f"ArmPick has no object that {self.spec.name} takes: name some in objects")

    def _check(self, name: str) -> None:
        """Raises ConfigError for an object that the hand does not take."""
        if why := self._refusal(name):
            raise ConfigError(f"ArmPick has no {name} for {self.spec.name}: {why}; name another object")

    def _refusal(self, name: str) -> str:
        """Why the hand takes no such thing in the table's middle, however it is turned; empty where it does. It draws
        nothing, so it does not matter when it is asked."""
        if name not in self._refused:
            scene, at, why = self._of(name), np.zeros(2), ""
            for yaw in _TURNED:
                scene.rest(at, yaw, self._waiting(), self.spec.rest)
                try:
                    ways = plain_grasps(known_object(scene, yaw), scene.robot, self._waiting(), _LIFT)
                except ConfigError as error:
                    why = why or str(error)
                    continue
                met = [self._table_at_grasp(scene, one, at, yaw) for one in ways]
                why = "" if "" in met else met[0]
                if not why:
                    break
            self._refused[name] = why
        return self._refused[name]

    def _waiting(self) -> Vector:
        if self._wait is None:
            self._wait = waiting_pose(self.scene.robot, self._lab.security)[1]
        return self._wait

    def _of(self, name: str) -> PickScene:
        if name not in self._scenes:
            arm = self.settings.arm or self._lab.arm.model
            self._scenes[name] = PickScene(self.settings, arm, self.spec, self._model, name)
        return self._scenes[name]

    def _eye(self, scene: PickScene) -> DepthCamera:
        if scene.name not in self._cameras:
            self._cameras[scene.name] = DepthCamera(scene.robot.world.model, self._lab.camera)
        return self._cameras[scene.name]


def posture_at(grasp: Grasp, closed: float) -> Vector:
    """The fingers of a grasp that is open at 0, closed at 1, squeezed at 2, (n,), rad."""
    stages = (grasp.preshape, grasp.close, grasp.squeeze)
    first = min(int(closed), 1)
    return np.asarray(stages[first] + (closed - first) * (stages[first + 1] - stages[first]))


def closed_at(grasp: Grasp, posture: Vector) -> float:
    """How far a grasp is closed in a posture, (n,), rad: of `posture_at`, the nearest."""
    stages = (grasp.preshape, grasp.close, grasp.squeeze)
    nearest, found = np.inf, 0.0
    for number, (begin, end) in enumerate(pairwise(stages)):
        way = end - begin
        length = float(way @ way)
        part = float(np.clip((posture - begin) @ way / length, 0.0, 1.0)) if length else 1.0
        off = float(np.linalg.norm(posture - begin - part * way))
        if off <= nearest:
            nearest, found = off, number + part
    return found
