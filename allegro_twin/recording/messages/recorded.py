"""The topics of a recording in a bag: what every viewer of ROS knows, and every column as it was, for the way back."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.recording.messages import vocabulary as v
from allegro_twin.recording.messages.build import WORLD, transform
from allegro_twin.recording.messages.frames import Frames, description
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

NAMESPACE = "/allegroHand_0"
"""As the manufacturer's launch file names the first hand: allegro_hand.launch, `NUM`."""
META = f"{NAMESPACE}/recording"
"""A latched String: the recording's metadata, JSON."""
COLUMN = f"{META}/"
"""Before the name of each column: a Float64MultiArray a row."""
STATES = f"{NAMESPACE}/joint_states"
ARRAY = "std_msgs/msg/Float64MultiArray"
POSES = {"palm": "", "object": "object"}
"""Columns that are a pose in the world, and the frame that has it; empty: the hand's own root."""


class Topic(NamedTuple):
    """One that a bag has."""

    name: str
    kind: str
    latched: bool = False


class Row(NamedTuple):
    """A message of one, and when, ns since the recording began."""

    topic: str
    at: int
    message: v.Message


def topics_of(columns: Mapping[str, Array]) -> list[Topic]:
    """What a bag of these columns has."""
    return [
        Topic(META, v.STRING, latched=True),
        Topic(f"{NAMESPACE}/robot_description", v.STRING, latched=True),
        Topic("/tf_static", v.TF, latched=True),
        Topic("/tf", v.TF),
        Topic(STATES, v.JOINT_STATE),
        *(Topic(COLUMN + name, ARRAY) for name in columns),
    ]


def rows(words: v.Vocabulary, spec: HandSpec, meta: Mapping[str, Any], columns: Mapping[str, Array]) -> Iterator[Row]:
    """Every message of a recording, oldest first. What was commanded is there for the eye, under a name that no driver
    listens to: a bag that is played must not move a hand."""
    frames = Frames(spec)
    yield Row(META, 0, words.make(v.STRING, data=json.dumps(dict(meta))))
    yield Row(f"{NAMESPACE}/robot_description", 0, words.make(v.STRING, data=description(spec)))
    yield Row("/tf_static", 0, frames.still(words, 0))
    layout = words.make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    placed = {name: frame or frames.root for name, frame in POSES.items() if name in columns}
    for row, t in enumerate(columns["t"].tolist()):
        at = max(round((t - float(columns["t"][0])) * 1e9), 0)
        moving = frames.at(words, at, columns["position"][row])
        for name, frame in placed.items():
            moving.transforms.append(transform(words, at, WORLD, frame, columns[name][row]))
        yield Row("/tf", at, moving)
        state = words.make(
            v.JOINT_STATE,
            header=words.header(at),
            name=list(spec.joints),
            position=columns["position"][row],
            velocity=columns["velocity"][row],
            effort=columns["torque"][row],
        )
        yield Row(STATES, at, state)
        for name, values in columns.items():
            numbers = np.atleast_1d(values[row]).astype(np.float64)
            yield Row(COLUMN + name, at, words.make(ARRAY, layout=layout, data=numbers))
