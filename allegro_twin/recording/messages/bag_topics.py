"""Topics of a recording in a bag: those that ROS viewers know, and every column unchanged for the way back."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.build import WORLD, transform
from allegro_twin.recording.messages.frames import LinkFrames, urdf_text
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

NAMESPACE = "/allegroHand_0"
"""Namespace of the first hand in the manufacturer's launch file: allegro_hand.launch, `NUM`."""
META = f"{NAMESPACE}/recording"
"""A latched String: the recording's metadata, JSON."""
COLUMN = f"{META}/"
"""Prefix of the column topics: one Float64MultiArray per row."""
STATES = f"{NAMESPACE}/joint_states"
ARRAY = "std_msgs/msg/Float64MultiArray"
POSES = {"palm": "", "object": "object"}
"""Columns that are a pose in the world, and their frame; empty: the hand's own root."""


class BagTopic(NamedTuple):
    """A topic of a bag."""

    name: str
    kind: str
    latched: bool = False


class BagMessage(NamedTuple):
    """A message of a topic, with its time, ns since the recording began."""

    topic: str
    at: int
    message: v.Message


def bag_topics(columns: Mapping[str, Array]) -> list[BagTopic]:
    """The topics of a bag with these columns."""
    return [
        BagTopic(META, v.STRING, latched=True),
        BagTopic(f"{NAMESPACE}/robot_description", v.STRING, latched=True),
        BagTopic("/tf_static", v.TF, latched=True),
        BagTopic("/tf", v.TF),
        BagTopic(STATES, v.JOINT_STATE),
        *(BagTopic(COLUMN + name, ARRAY) for name in columns),
    ]


def bag_messages(
    types: v.RosTypes, spec: HandSpec, meta: Mapping[str, Any], columns: Mapping[str, Array]
) -> Iterator[BagMessage]:
    """Yield all messages of a recording, oldest first. Commands have a name that no driver listens to: a bag that is
    played must not move a hand."""
    frames = LinkFrames(spec)
    yield BagMessage(META, 0, types.make(v.STRING, data=json.dumps(dict(meta))))
    yield BagMessage(f"{NAMESPACE}/robot_description", 0, types.make(v.STRING, data=urdf_text(spec)))
    yield BagMessage("/tf_static", 0, frames.static_transforms(types, 0))
    layout = types.make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    placed = {name: frame or frames.root for name, frame in POSES.items() if name in columns}
    for row, t in enumerate(columns["t"].tolist()):
        at = max(round((t - float(columns["t"][0])) * 1e9), 0)
        moving = frames.transforms_at(types, at, columns["position"][row])
        for name, frame in placed.items():
            moving.transforms.append(transform(types, at, WORLD, frame, columns[name][row]))
        yield BagMessage("/tf", at, moving)
        state = types.make(
            v.JOINT_STATE,
            header=types.header(at),
            name=list(spec.joints),
            position=columns["position"][row],
            velocity=columns["velocity"][row],
            effort=columns["torque"][row],
        )
        yield BagMessage(STATES, at, state)
        for name, values in columns.items():
            numbers = np.atleast_1d(values[row]).astype(np.float64)
            yield BagMessage(COLUMN + name, at, types.make(ARRAY, layout=layout, data=numbers))
