"""Moving quantities, sent to Rerun in columns: a row a message would take a browser a minute to swallow."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from allegro_twin.errors import ConfigError
from allegro_twin.recording.events import DeviceSample
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample, TorqueCommand, Vector
from allegro_twin.viewing.rerun.layout import MORE
from allegro_twin.viewing.rerun.static import FRAMES, draw_ghost, draw_ghost_object
from allegro_twin.viewing.scenery import Scenery
from allegro_twin.viewing.skeleton import Skeleton

AT_ONCE = 4  # Messages: 0.5 ms of a period of 3 ms, where all 65 of a moment would take 8.
SMOOTHED = 33
"""Samples of the force whose mean is drawn, 0.1 s at 3 ms: one alone is lost in the sensor's noise."""
_ARROW = 0.012  # m for each newton of contact force.
_STATE = ("position", "velocity", "torque", "command")


@dataclass(frozen=True, slots=True, eq=False)
class DrawnRow:
    """One moment of one device."""

    t: float
    joints: Mapping[str, Vector]
    """By quantity, (n,)."""
    look: Mapping[str, Array]

    @staticmethod
    def of(sample: Sample, look: Mapping[str, Array]) -> DrawnRow:
        """Raises ConfigError for a pose that is not one."""
        state, command = sample
        goal = command.torque if isinstance(command, TorqueCommand) else command.position
        for name in ("palm", "object", "target_object", "object_goal"):
            if name in look and look[name].shape != (7,):
                raise ConfigError(f"a pose has a place and a quaternion of four numbers, not {look[name].shape}")
        joints = {"position": state.position, "velocity": state.velocity, "torque": state.torque, "command": goal}
        if "target" in look:
            joints["target"] = look["target"]
        joints |= {name: look[name] for name in MORE if name in look}
        return DrawnRow(state.t, joints, look)


_GHOSTS = {"target_object": "ghosts", "object_goal": "goals"}
"""Where the object is drawn a second time: where it was, and where it shall be."""


class _Message(NamedTuple):
    """One entity's components at several moments."""

    path: str
    rows: Sequence[DrawnRow]
    columns: Any


class RowBuffer:
    """Collects moments of the hand, and of the arm that carries it, and sends them together."""

    def __init__(self, stream: rr.RecordingStream, spec: HandSpec, scene: Scenery, arm: HandSpec | None = None) -> None:
        self._stream, self._spec, self._skeleton = stream, spec, Skeleton(scene.bodies, spec)
        self._objects, self._ghosts = list(scene.objects), set[str]()
        self._scene = scene
        self._arm = Skeleton(scene.arm.bodies, arm) if arm is not None and scene.arm is not None else None
        self._wanted: Vector | None = None
        self._rows: dict[str, list[DrawnRow]] = {"hand": [], "arm": []}
        self._forces: deque[Array] = deque(maxlen=SMOOTHED)
        self._sending: Iterator[_Message] = iter(())

    @property
    def begin(self) -> float:
        """Time of the first collected moment, s."""
        return min(rows[0].t for rows in self._rows.values() if rows)

    def smooth(self, event: DeviceSample) -> None:
        """Take every sample's force on the flange, (6,), N and N·m, into the mean, whether it is drawn or not."""
        if "force" in event.extras:
            self._forces.append(event.extras["force"])

    def add(self, event: DeviceSample) -> None:
        """Collect a moment. Raises ConfigError."""
        look = dict(event.extras)
        if self._forces and event.device == "arm":
            look["force"] = np.mean(self._forces, axis=0)
        self._rows[event.device].append(DrawnRow.of(event.sample, look))

    def send(self) -> None:
        """Send what has been collected."""
        self.start()
        self._send(self._sending)

    def start(self) -> None:
        """Begin to send what has been collected, and end what was begun before."""
        self._send(self._sending)
        rows, self._rows = self._rows, {"hand": [], "arm": []}
        self._sending = self._messages(rows["hand"], rows["arm"])

    def advance(self) -> None:
        """Send some more of what was begun."""
        self._send(islice(self._sending, AT_ONCE))

    def _send(self, messages: Iterator[_Message]) -> None:
        for path, rows, columns in messages:
            times = rr.TimeColumn("time", duration=[row.t for row in rows])
            self._stream.send_columns(path, indexes=[times], columns=columns)

    def _messages(self, hand: list[DrawnRow], arm: list[DrawnRow]) -> Iterator[_Message]:
        if hand:
            yield from self._hand_messages(hand)
        if arm and self._arm is not None:
            yield from self._links("world/arm", self._arm, arm, np.array([row.joints["position"] for row in arm]))
            for name in ("flange", *FRAMES):
                yield _poses(f"world/{name}", arm, np.array([row.look[name] for row in arm]))
            yield _scalars("arm/torque", arm, np.array([row.joints["torque"] for row in arm]))
            force = np.array([row.look["force"] for row in arm])
            yield _scalars("cell/force", arm, force[:, :3])
            yield _scalars("cell/moment", arm, force[:, 3:])

    def _hand_messages(self, rows: list[DrawnRow]) -> Iterator[_Message]:
        for name in (*_STATE, "target", *self._scene.more):
            having = [row for row in rows if name in row.joints]
            values = np.array([row.joints[name] for row in having])
            for finger in self._spec.fingers if having else ():
                yield _scalars(f"joints/{name}/{finger.name}", having, values[:, list(finger.joints)])
        yield from self._links("world/palm", self._skeleton, rows, np.array([row.joints["position"] for row in rows]))
        yield from self._ghost([row for row in rows if "target" in row.joints])
        yield from self._limits(rows)
        yield from self._surroundings(rows)

    def _links(self, root: str, skeleton: Skeleton, rows: list[DrawnRow], position: Array) -> Iterator[_Message]:
        for body, (place, rotation) in zip(skeleton.bodies, skeleton.places(position), strict=True):
            if body.parent >= 0:
                moved = rr.Transform3D.columns(translation=place, mat3x3=rotation.reshape(-1, 9))  # Row by row.
                yield _Message(f"{root}/{body.name}", rows, moved)

    def _ghost(self, rows: list[DrawnRow]) -> Iterator[_Message]:
        """The hand at its target; it is sent again only when the target changes, for what was sent stays."""
        if not rows:
            return
        wanted = np.array([row.joints["target"] for row in rows])
        if self._wanted is None:
            draw_ghost(self._stream, self._scene)
        before = np.concatenate([wanted[:1] if self._wanted is None else self._wanted[None], wanted[:-1]])
        new = (wanted != before).any(axis=1)
        new[0] |= self._wanted is None
        self._wanted = wanted[-1]
        if new.any():
            changed = [rows[k] for k in np.flatnonzero(new)]
            yield from self._links("world/palm/target", self._skeleton, changed, wanted[new])

    def _limits(self, rows: list[DrawnRow]) -> Iterator[_Message]:
        """Lines need two points: the first and the last moment."""
        ends = [rows[0], rows[-1]] if len(rows) > 1 else rows
        for finger in self._spec.fingers:
            values = np.unique(self._spec.actuation.torque_limit[list(finger.joints)])
            lines = np.tile(np.concatenate([values, -values]), (len(ends), 1))
            yield _scalars(f"joints/torque_limit/{finger.name}", ends, lines)

    def _surroundings(self, rows: list[DrawnRow]) -> Iterator[_Message]:
        paths = {"palm": "world/palm"}
        if self._objects:
            first = self._objects[0]
            paths |= {"object": f"world/objects/{first}"} | {name: f"world/{_GHOSTS[name]}/{first}" for name in _GHOSTS}
        for name, path in paths.items():
            having = [row for row in rows if name in row.look]
            if not having:
                continue
            if name in _GHOSTS and name not in self._ghosts:
                self._ghosts.add(name)
                draw_ghost_object(self._stream, self._scene, f"world/{_GHOSTS[name]}")
            yield _poses(path, having, np.array([row.look[name] for row in having]))
        if having := [row for row in rows if "others" in row.look]:
            others = np.array([row.look["others"] for row in having]).reshape(len(having), -1, 7)
            for number, name in enumerate(self._objects[1:]):
                yield _poses(f"world/objects/{name}", having, others[:, number])
        for name, path in (("contact_force", "contact/force"), ("link", "mirror/link")):
            if having := [row for row in rows if name in row.look]:
                yield _scalars(path, having, np.array([row.look[name] for row in having]))
        if having := [row for row in rows if "contact_vector" in row.look]:
            yield _arrows(having)


def _poses(path: str, rows: Sequence[DrawnRow], poses: Array) -> _Message:
    """Positions, m, and quaternions w x y z, (k, 7)."""
    moved = rr.Transform3D.columns(translation=poses[:, :3], quaternion=poses[:, [4, 5, 6, 3]])
    return _Message(path, rows, moved)


def _scalars(path: str, rows: Sequence[DrawnRow], values: Array) -> _Message:
    """Series, (k, series)."""
    data = rr.Scalars.columns(scalars=values.reshape(-1)).partition([values.shape[1]] * len(rows))
    return _Message(path, rows, data)


def _arrows(rows: Sequence[DrawnRow]) -> _Message:
    """From where each part of the hand presses on the object, the way it pushes."""
    points = np.array([row.look["contact_point"] for row in rows]).reshape(len(rows), -1, 3)
    vectors = _ARROW * np.array([row.look["contact_vector"] for row in rows]).reshape(points.shape)
    # An arrow is drawn towards its contact, so that the object does not hide it.
    origins = np.nan_to_num(points) - np.nan_to_num(vectors)
    drawn = rr.Arrows3D.columns(vectors=np.nan_to_num(vectors).reshape(-1, 3), origins=origins.reshape(-1, 3))
    return _Message("world/contact", rows, drawn.partition([points.shape[1]] * len(rows)))
