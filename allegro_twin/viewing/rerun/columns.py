"""What moves, sent to Rerun in columns: a row a message would take a browser a minute to swallow."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

import numpy as np
import rerun as rr

from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample, TorqueCommand, Vector
from allegro_twin.viewing.rerun.layout import MORE
from allegro_twin.viewing.rerun.scene import Scenery
from allegro_twin.viewing.rerun.static import draw_ghost, draw_ghost_object
from allegro_twin.viewing.skeleton import Skeleton

AT_ONCE = 4  # Messages: 0.5 ms of a period of 3 ms, where all 65 of a moment would take 8.
_ARROW = 0.012  # m for each newton of contact force.
_STATE = ("position", "velocity", "torque", "command")


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One moment."""

    t: float
    joints: Mapping[str, Vector]
    """By quantity, (n,)."""
    look: Mapping[str, Array]

    @staticmethod
    def of(sample: Sample, look: Mapping[str, Array]) -> Row:
        """Raises ConfigError for a pose that is not one."""
        state, command = sample
        goal = command.torque if isinstance(command, TorqueCommand) else command.position
        for name in ("palm", "object", "target_object"):
            if name in look and look[name].shape != (7,):
                raise ConfigError(f"a pose has a place and a quaternion of four numbers, not {look[name].shape}")
        joints = {"position": state.position, "velocity": state.velocity, "torque": state.torque, "command": goal}
        if "target" in look:
            joints["target"] = look["target"]
        joints |= {name: look[name] for name in MORE if name in look}
        return Row(state.t, joints, look)


class Rows:
    """Collects moments and sends them together."""

    def __init__(self, stream: rr.RecordingStream, spec: HandSpec, scene: Scenery) -> None:
        self._stream, self._spec, self._skeleton = stream, spec, Skeleton(scene.bodies, spec)
        self._object, self._ghosts = next(iter(scene.objects), None), False
        self._scene = scene
        self._wanted: Vector | None = None
        self._rows: list[Row] = []
        self._sending: Iterator[None] = iter(())

    @property
    def begin(self) -> float:
        """Of what was collected, s."""
        return self._rows[0].t

    def add(self, row: Row) -> None:
        self._rows.append(row)

    def send(self) -> None:
        """Send what has been collected."""
        self.start()
        for _ in self._sending:
            pass

    def start(self) -> None:
        """Begin to send what has been collected, and end what was begun before."""
        for _ in self._sending:
            pass
        rows, self._rows = self._rows, []
        self._sending = self._messages(rows) if rows else iter(())

    def advance(self) -> None:
        """Send some more of what was begun."""
        for _ in islice(self._sending, AT_ONCE):
            pass

    def _messages(self, rows: list[Row]) -> Iterator[None]:
        for name in (*_STATE, "target", *self._scene.more):
            having = [row for row in rows if name in row.joints]
            yield from self._series(name, having, np.array([row.joints[name] for row in having]))
        yield from self._hand("world/palm", rows, np.array([row.joints["position"] for row in rows]))
        yield from self._ghost([row for row in rows if "target" in row.joints])
        yield from self._limits(rows)
        yield from self._beside(rows)

    def _series(self, name: str, rows: list[Row], values: Array) -> Iterator[None]:
        for finger in self._spec.fingers if rows else ():
            column = values[:, list(finger.joints)]
            data = rr.Scalars.columns(scalars=column.reshape(-1)).partition([column.shape[1]] * len(rows))
            self._stream.send_columns(f"joints/{name}/{finger.name}", indexes=_times(rows), columns=data)
            yield

    def _hand(self, root: str, rows: list[Row], position: Array) -> Iterator[None]:
        for body, (place, rotation) in zip(self._skeleton.bodies, self._skeleton.places(position), strict=True):
            if body.parent >= 0:
                moved = rr.Transform3D.columns(translation=place, mat3x3=rotation.reshape(-1, 9))  # Row by row.
                self._stream.send_columns(f"{root}/{body.name}", indexes=_times(rows), columns=moved)
                yield

    def _ghost(self, rows: list[Row]) -> Iterator[None]:
        """The hand that is wanted; it is sent again only when something else is, for what was sent stays."""
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
            yield from self._hand("world/palm/target", [rows[k] for k in np.flatnonzero(new)], wanted[new])

    def _limits(self, rows: list[Row]) -> Iterator[None]:
        """Lines need two points: the first and the last moment."""
        ends = [rows[0], rows[-1]] if len(rows) > 1 else rows
        for finger in self._spec.fingers:
            values = np.unique(self._spec.actuation.torque_limit[list(finger.joints)])
            lines = np.tile(np.concatenate([values, -values]), len(ends))
            data = rr.Scalars.columns(scalars=lines).partition([2 * len(values)] * len(ends))
            self._stream.send_columns(f"joints/torque_limit/{finger.name}", indexes=_times(ends), columns=data)
            yield

    def _beside(self, rows: list[Row]) -> Iterator[None]:
        paths = {"palm": "world/palm"}
        if self._object is not None:
            paths |= {"object": f"world/objects/{self._object}", "target_object": f"world/ghosts/{self._object}"}
        for name, path in paths.items():
            having = [row for row in rows if name in row.look]
            if not having:
                continue
            if name == "target_object" and not self._ghosts:
                self._ghosts = True
                draw_ghost_object(self._stream, self._scene)
            poses = np.array([row.look[name] for row in having])
            moved = rr.Transform3D.columns(translation=poses[:, :3], quaternion=poses[:, [4, 5, 6, 3]])
            self._stream.send_columns(path, indexes=_times(having), columns=moved)
            yield
        for name, path in (("contact_force", "contact/force"), ("link", "mirror/link")):
            having = [row for row in rows if name in row.look]
            if having:
                values = np.array([row.look[name] for row in having])
                data = rr.Scalars.columns(scalars=values.reshape(-1)).partition([values.shape[1]] * len(having))
                self._stream.send_columns(path, indexes=_times(having), columns=data)
                yield
        having = [row for row in rows if "contact_vector" in row.look]
        if having:
            self._arrows(having)
            yield

    def _arrows(self, rows: list[Row]) -> None:
        """From where each part of the hand presses on the object, the way it pushes."""
        points = np.array([row.look["contact_point"] for row in rows]).reshape(len(rows), -1, 3)
        vectors = _ARROW * np.array([row.look["contact_vector"] for row in rows]).reshape(points.shape)
        # An arrow is drawn towards its contact, so that the object does not hide it.
        origins = np.nan_to_num(points) - np.nan_to_num(vectors)
        drawn = rr.Arrows3D.columns(
            vectors=np.nan_to_num(vectors).reshape(-1, 3), origins=origins.reshape(-1, 3)
        ).partition([points.shape[1]] * len(rows))
        self._stream.send_columns("world/contact", indexes=_times(rows), columns=drawn)


def _times(rows: list[Row]) -> list[rr.TimeColumn]:
    return [rr.TimeColumn("time", duration=[row.t for row in rows])]
