"""A hand's state as messages, and joints by name back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.recording.messages.vocabulary import DIAGNOSTICS, JOINT_STATE, WRENCH, Message, Vocabulary
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, Vector

OK, WARN, ERROR = 0, 1, 2
"""Levels of diagnostic_msgs/DiagnosticStatus."""


def joint_state(words: Vocabulary, stamp: int, spec: HandSpec, state: HandState) -> Message:
    """Positions (rad), speeds (rad/s) and, as effort, the torques that were applied (N·m)."""
    return words.make(
        JOINT_STATE,
        header=words.header(stamp),
        name=list(spec.joints),
        position=np.array(state.position),
        velocity=np.array(state.velocity),
        effort=np.array(state.torque),
    )


def wrench(words: Vocabulary, stamp: int, frame: str, force: Vector) -> Message:
    """A force without a torque, (3,), N, in a frame."""
    x, y, z = (float(value) for value in force)
    return words.make(
        WRENCH,
        header=words.header(stamp, frame),
        wrench=words.make(
            "geometry_msgs/msg/Wrench",
            force=words.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
            torque=words.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0),
        ),
    )


def diagnostics(
    words: Vocabulary, stamp: int, name: str, level: int, message: str, values: Mapping[str, str]
) -> Message:
    """One status with its values."""
    pairs = [words.make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
    status = words.make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level, name=name, message=message, hardware_id=name, values=pairs,
    )  # fmt: skip
    return words.make(DIAGNOSTICS, header=words.header(stamp), status=[status])


def in_order(spec: HandSpec, names: Sequence[str], what: str) -> list[int]:
    """For each joint of the hand its place among `names`; no names at all: the hand's own order. Raises ConfigError
    for a joint that is unknown, missing or named twice."""
    if not names:
        return list(range(spec.n_joints))
    places: dict[int, int] = {}
    for place, name in enumerate(names):
        try:
            joint = spec.joint(_ours(spec, name))
        except ConfigError:
            raise ConfigError(f"{what}: {unknown('joint', name, spec.joints)}") from None
        if joint in places:
            raise ConfigError(f"{what} names the joint {name} twice")
        places[joint] = place
    if missing := [spec.joints[joint] for joint in range(spec.n_joints) if joint not in places]:
        raise ConfigError(f"{what} lacks {', '.join(missing)}: it needs all {spec.n_joints} joints of {spec.name}")
    return [places[joint] for joint in range(spec.n_joints)]


def row(spec: HandSpec, values: Sequence[float], order: Sequence[int], what: str) -> Vector:
    """Numbers of a message in the hand's order, (n,), read-only. Raises ConfigError for a wrong length, or a number
    that is not finite."""
    if len(values) != len(order):
        raise ConfigError(f"{what} has {len(values)} numbers for {len(order)} joints")
    return spec.vector(np.asarray(values, dtype=np.float64)[list(order)], what)


def _ours(spec: HandSpec, name: str) -> str:
    """The hand's own name of a joint: ROS 2 has no dots in names, so packages write `joint_3_0` for `joint_3.0`."""
    return next((joint for joint in spec.joints if joint.replace(".", "_") == name), name)
