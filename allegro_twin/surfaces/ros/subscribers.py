"""What programs on ROS ask of a hand, checked and passed on to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from uuid import UUID

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.hands.library.library import grasp_names, posture_names
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.build import joint_order, joint_values
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.hand.external_setpoints import Outside
from allegro_twin.surfaces.ros.timing import timing
from allegro_twin.surfaces.ros.topics import TRAJECTORY
from allegro_twin.types import Vector

GRASPS = {"pinch_it": "pinch_index", "pinch_mt": "pinch_middle"}
"""The manufacturer's words that are not names of our library: allegro_node_grasp.cpp of its ROS package."""
OFF = "off"
WORDS = (OFF, "gravcomp", "save", "pdControl")
"""The manufacturer's that are neither a posture nor a grasp."""


class Wishes:
    """Carries out messages, one after the other. What it refuses raises ConfigError before anything moves."""

    def __init__(self, hand: Hand, words: v.RosTypes, clock: Callable[[], int], *, speed: float = 2.0) -> None:
        """`clock`: ns since 1970; `speed`: rad/s, of what is asked for without a time."""
        self._hand, self._words, self._clock, self._speed = hand, words, clock, speed
        self._outside = Outside(hand, speed)
        self._stamps: dict[UUID, int] = {}
        self._saved: Vector | None = None
        self._scale: float | None = None
        self._acts: dict[str, tuple[str, Callable[[Any, UUID], float]]] = {
            "joint_cmd": (v.JOINT_STATE, self._joint_cmd),
            "lib_cmd": (v.STRING, self._lib_cmd),
            "envelop_torque": (v.FLOAT, self._envelop_torque),
            TRAJECTORY: (v.TRAJECTORY, self._trajectory),
            "gravity": (v.VECTOR, self._gravity),
        }

    def stops(self, topic: str, data: bytes) -> bool:
        """Whether a message only asks the hand to go limp, which everybody may."""
        return topic == "lib_cmd" and self._words.decode(data, v.STRING).data == OFF

    def carry_out(self, topic: str, data: bytes, sender: UUID) -> float:
        """Do what a message says. How long its motion takes, s, where it is one that was timed."""
        kind, act = self._acts[topic]
        return act(self._words.decode(data, kind), sender)

    def _joint_cmd(self, message: Any, sender: UUID) -> float:
        stamp, last = v.nanoseconds(message.header.stamp), self._stamps.get(sender, 0)
        if 0 < stamp < last:
            raise ConfigError(f"joint_cmd: its stamp is {(last - stamp) / 1e9:.3f} s before that of the one before it")
        spec = self._hand.spec
        order = joint_order(spec, message.name, "joint_cmd")
        self._outside.track(joint_values(spec, message.position, order, "joint_cmd"))
        self._stamps[sender] = stamp
        return 0.0

    def _lib_cmd(self, message: Any, sender: UUID) -> float:
        word, hand = message.data, self._hand
        grasps, postures = grasp_names(hand.spec.model), posture_names(hand.spec.model)
        if word == OFF:
            hand.set_controller(hand.controllers[0])
        elif word == "gravcomp":
            hand.set_controller("gravity")
        elif word == "save":
            self._saved = hand.state.position
        elif word == "pdControl":
            hand.move_to(hand.state.position if self._saved is None else self._saved, self._speed, wait=False)
        elif word == "envelop":
            hand.grasp("envelop", force=self._scale, wait=False)
        elif GRASPS.get(word, word) in grasps:
            hand.grasp(GRASPS.get(word, word), wait=False)
        elif word in posture_names(
            hand.spec.model
        ):  # A path would be read as well, and who is on the network is not asked in.
            hand.move_to(word, self._speed, wait=False)
        else:
            raise ConfigError(f"lib_cmd: {unknown('word', word, [*WORDS, *GRASPS, *grasps, *postures])}")
        return 0.0

    def _envelop_torque(self, message: Any, sender: UUID) -> float:
        scale = float(message.data)
        if not 0.0 <= scale <= 1.0:
            raise ConfigError(f"envelop_torque must be 0 to 1, not {scale:g}")
        self._scale = scale
        return 0.0

    def _gravity(self, message: Any, sender: UUID) -> float:
        self._hand.gravity = np.array([message.x, message.y, message.z])
        return 0.0

    def _trajectory(self, message: Any, sender: UUID) -> float:
        spec = self._hand.spec
        if not message.points:  # As joint_trajectory_controller takes it: cancel.
            self._hand.stop()
            return 0.0
        times, postures, rates, late = timing(message, spec, self._clock)
        return self._outside.follow(times, postures, rates, late=late)
