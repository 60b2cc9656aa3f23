"""What happens in a cell as the messages of its topics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from allegro_twin.cell.assembly import Room
from allegro_twin.cell.camera.intrinsics import Intrinsics
from allegro_twin.recording.events import DeviceSample
from allegro_twin.recording.messages import build
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.frames import LinkFrames
from allegro_twin.surfaces.ros import cell_topics as topics
from allegro_twin.surfaces.ros.publishers import Report
from allegro_twin.types import Array

CAMERA, TARGET = "camera_depth_optical_frame", "target_frame"
"""Frames: realsense-ros's, and where the flange is to be."""
_INFO, _WARN = 20, 30  # rcl_interfaces/Log.


class CellReports:
    """Makes them."""

    def __init__(self, room: Room, words: v.RosTypes) -> None:
        self._words, self._arm, self._hand = words, LinkFrames(room.cell.spec), LinkFrames(room.hand.spec)
        self._specs, self._foot, self._name = (
            (room.cell.spec, room.hand.spec),
            room.cell.base.position,
            room.hand.spec.name,
        )

    @property
    def base(self) -> str:
        """The frame of the arm's foot."""
        return self._arm.root

    @property
    def foot(self) -> Array:
        """Where it stands in the world, (3,), m."""
        return self._foot

    def at_first(self, stamp: int) -> Iterator[Report]:
        """What is said once, for whoever comes later too."""
        words = self._words
        still = self._hand.static_transforms(words, stamp)
        base = np.array([*self._foot, 1.0, 0.0, 0.0, 0.0])
        still.transforms.append(build.transform(words, stamp, build.WORLD, self._arm.root, base))
        yield "/tf_static", still

    def of(self, stamp: int, arm: DeviceSample, hand: DeviceSample) -> Iterator[Report]:
        """What is said of a moment; `stamp`: ns since 1970."""
        words, beside = self._words, arm.extras
        states = (arm.sample.state, hand.sample.state)
        yield topics.STATES, build.joint_states(words, stamp, list(zip(self._specs, states, strict=True)))
        yield topics.POSE, build.pose(words, stamp, build.WORLD, beside["tool"])
        yield topics.WRENCH, build.wrench(words, stamp, build.WORLD, beside["force"])
        links = self._arm.transforms_at(words, stamp, states[0].position)
        links.transforms.extend(self._hand.transforms_at(words, stamp, states[1].position).transforms)
        for frame, name in ((self._hand.root, "tool"), (TARGET, "goal")):
            links.transforms.append(build.transform(words, stamp, build.WORLD, frame, beside[name]))
        yield "/tf", links

    def picture(self, stamp: int, row: Mapping[str, Any]) -> Iterator[Report]:
        """What is said of a picture."""
        words, depth = self._words, row["depth"]
        fx, fy, cx, cy = row["lens"]
        metres = np.where(depth == 0, np.nan, depth / 1000.0).astype(np.float32)
        points = Intrinsics(depth.shape[1], depth.shape[0], fx, fy, cx, cy).cloud(metres)
        yield topics.POINTS, build.cloud(words, stamp, CAMERA, points)
        place = build.transform(words, stamp, build.WORLD, CAMERA, row["camera"])
        yield "/tf", words.make(v.TF, transforms=[place])

    def said(self, stamp: int, topic: str, text: str, *, bad: bool) -> Report:
        """A line of the log."""
        level = _WARN if bad else _INFO
        words = self._words
        message = words.make(
            v.LOG, stamp=words.time(stamp), level=level, name=self._name, msg=text, file="", function=topic, line=0
        )
        return "/rosout", message
