"""The ROS topics of a hand: states, frames and diagnostics out, set-points and the manufacturer's words in."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any
from uuid import UUID

import numpy as np

from allegro_twin.errors import ConfigError, HandError, unknown
from allegro_twin.hands.library.library import grasp_names, posture_names
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.recording.events import DeviceSample, SessionEvent
from allegro_twin.recording.messages import build
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.build import joint_order, joint_values
from allegro_twin.recording.messages.frames import LinkFrames, urdf_text
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.hand.external_setpoints import ExternalSetpoints
from allegro_twin.surfaces.ros.bridge import QUIET, Maker, Publication, SessionTopics
from allegro_twin.surfaces.ros.joint_trajectory import TRAJECTORY, joint_path
from allegro_twin.surfaces.ros.node_api import QosProfile, RosTopic
from allegro_twin.types import Sample, Vector

NAMESPACE = "/allegroHand_0"
"""As the manufacturer's launch file names the first hand: allegro_hand.launch, `NUM`."""
WRENCH = "wrench/{finger}"
PUBLISHED = (
    RosTopic(
        "joint_states", v.JOINT_STATE, QosProfile(), "positions, rad; speeds, rad/s; effort: applied torques, N·m"
    ),
    RosTopic("/tf", v.TF, QosProfile(100), "every moving link on its parent"),
    RosTopic("/tf_static", v.TF, QosProfile(1, latched=True), "fingertips on their links"),
    RosTopic("robot_description", v.STRING, QosProfile(1, latched=True), "the hand's URDF"),
    RosTopic(WRENCH, v.WRENCH, QosProfile(), "what pushes on a fingertip, N, in its own frame"),
    RosTopic(
        "/diagnostics", v.DIAGNOSTICS, QosProfile(), "once a second: what drives, missed periods, the hottest motor"
    ),
    RosTopic("/rosout", v.LOG, QosProfile(1000, latched=True), "every command that was refused, and why"),
)
SUBSCRIBED = (
    RosTopic("joint_cmd", v.JOINT_STATE, QosProfile(), "positions to be at, rad"),
    RosTopic("lib_cmd", v.STRING, QosProfile(), "a word of the manufacturer's, or a posture or grasp of the library"),
    RosTopic("envelop_torque", v.FLOAT, QosProfile(), "the scale of the next `envelop`, 0 to 1"),
    RosTopic(TRAJECTORY, v.TRAJECTORY, QosProfile(), "postures, rad, and when, s"),
    RosTopic("gravity", v.VECTOR, QosProfile(), "what is compensated, palm frame, m/s²"),
)
GRASPS = {"pinch_it": "pinch_index", "pinch_mt": "pinch_middle"}
"""The manufacturer's words that are not names of our library: allegro_node_grasp.cpp of its ROS package."""
OFF = "off"
WORDS = (OFF, "gravcomp", "save", "pdControl")
"""The manufacturer's that are neither a posture nor a grasp."""


class HandTopics(SessionTopics):
    """Makes messages of a hand's samples and carries out commands, one after the other. What it refuses raises
    ConfigError before anything moves. The model is its own: that of the hand works in another thread."""

    occupied = f"another program drives the hand, or has switched it off; this one is obeyed after {QUIET:g} s of quiet"

    def __init__(
        self,
        hand: Hand,
        types: v.RosTypes,
        *,
        rate: float = 100.0,
        speed: float = 2.0,
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        """`rate`: Hz, of what is published; `speed`: rad/s, of motions without a time; `clock`: ns since 1970. Raises
        ConfigError for a rate that is not positive."""
        spec = hand.spec
        super().__init__(types, spec.name + (f" {spec.serial}" if spec.serial else ""), rate)
        self._hand, self._spec, self._clock, self._speed = hand, spec, clock, speed
        self._frames, self._model = LinkFrames(spec), hand_kinematics(spec)
        self._outside = ExternalSetpoints(hand, speed)
        self.published, self.subscribed = tuple(self._named()), SUBSCRIBED
        self._missed, self._tick, self._reported = 0, -1, 0
        self._latest: Sample | None = None
        self._stamps: dict[UUID, int] = {}
        self._saved: Vector | None = None
        self._scale: float | None = None
        self._actions: dict[str, tuple[str, Callable[[Any, UUID], float]]] = {
            "joint_cmd": (v.JOINT_STATE, self._joint_cmd),
            "lib_cmd": (v.STRING, self._lib_cmd),
            "envelop_torque": (v.FLOAT, self._envelop_torque),
            TRAJECTORY: (v.TRAJECTORY, self._trajectory),
            "gravity": (v.VECTOR, self._gravity),
        }

    def _named(self) -> Iterator[RosTopic]:
        for topic in PUBLISHED:
            for finger in self._spec.fingers if topic.name == WRENCH else self._spec.fingers[:1]:
                yield topic._replace(name=topic.name.format(finger=finger.name))

    def attached(self, observer: Callable[[SessionEvent], None]) -> AbstractContextManager[None]:
        return self._hand.listening(lambda sample: observer(DeviceSample("hand", sample, {})))

    def check(self) -> None:
        _ = self._hand.state  # Raises what ended the loop.

    def first(self, stamp: int) -> Iterator[Publication]:
        yield "robot_description", self._types.make(v.STRING, data=urdf_text(self._spec))
        yield "/tf_static", self._frames.static_transforms(self._types, stamp)

    def messages(self, event: SessionEvent) -> Maker | None:
        assert isinstance(event, DeviceSample)
        sample = self._latest = event.sample
        tick = sample.state.tick
        if self._tick >= 0:
            self._missed += max(tick - self._tick - 1, 0)
        self._tick = tick
        return (lambda stamp: self._sample(stamp, sample)) if self._is_due(sample.state.t) else None

    def last(self, stamp: int, error: HandError) -> Iterator[Publication]:
        if self._latest is not None:
            yield self.health(stamp, self._latest, str(error))

    def _sample(self, stamp: int, sample: Sample) -> Iterator[Publication]:
        types, state = self._types, sample.state
        yield "joint_states", build.joint_states(types, stamp, [(self._spec, state)])
        yield "/tf", self._frames.transforms_at(types, stamp, state.position)
        for finger, force in self._fingertip_forces(sample).items():
            tip, wrench = self._spec.finger(finger).tip, np.append(force, np.zeros(3))
            yield WRENCH.format(finger=finger), build.wrench(types, stamp, tip, wrench)
        if stamp - self._reported >= 10**9:
            self._reported = stamp
            yield self.health(stamp, sample)

    def health(self, stamp: int, sample: Sample, error: str = "") -> Publication:
        """The once-a-second status; `error`: what ended the hand."""
        hand, temperature = self._hand, sample.state.temperature
        stalled = hand.stalled
        level = build.ERROR if error else build.WARN if stalled is not None else build.OK
        text = error or str(stalled or f"driven by {hand.controller}")
        values = {
            "controller": hand.controller,
            "time": f"{sample.state.t:.3f} s",
            "missed periods": str(self._missed),
            "clipped set-points": str(hand.clipped),
            "hottest motor": "not reported" if np.isnan(temperature).all() else f"{np.nanmax(temperature):.0f} °C",
        }
        return "/diagnostics", build.diagnostics(self._types, stamp, self._name, level, text, values)

    def _fingertip_forces(self, sample: Sample) -> dict[str, Vector]:
        """The force on each fingertip, (3,), N, in the tip's frame, by the joint torques of a hand at rest:
        τ = g(q) - Jᵀ f, so f = -(Jᵀ)⁺ (τ - g). NaN where gravity is not known."""
        state, spec = sample.state, self._spec
        load = state.torque - self._model.gravity_torque(state.position, self._hand.gravity)
        _, jacobians = self._model.fingertip_jacobians(state.position, [finger.name for finger in spec.fingers])
        tips, found = self._model.fingertips(state.position), {}
        for finger, jacobian in zip(spec.fingers, jacobians, strict=True):
            joints = list(finger.joints)
            known = bool(np.isfinite(load[joints]).all())
            force = (
                -np.linalg.lstsq(jacobian[:, joints].T, load[joints], rcond=None)[0] if known else np.full(3, np.nan)
            )
            found[finger.name] = tips[finger.name].rotation.T @ force
        return found

    def is_stop(self, topic: str, data: bytes) -> bool:
        return topic == "lib_cmd" and self._types.decode(data, v.STRING).data == OFF

    def execute(self, topic: str, data: bytes, sender: UUID) -> float:
        kind, action = self._actions[topic]
        return action(self._types.decode(data, kind), sender)

    def _joint_cmd(self, message: Any, sender: UUID) -> float:
        stamp, last = v.nanoseconds(message.header.stamp), self._stamps.get(sender, 0)
        if 0 < stamp < last:
            raise ConfigError(f"joint_cmd: its stamp is {(last - stamp) / 1e9:.3f} s before that of the one before it")
        order = joint_order(self._spec, message.name, "joint_cmd")
        self._outside.track(joint_values(self._spec, message.position, order, "joint_cmd"))
        self._stamps[sender] = stamp
        return 0.0

    def _lib_cmd(self, message: Any, sender: UUID) -> float:
        word, hand = message.data, self._hand
        grasps, postures = grasp_names(hand.spec.model), posture_names(hand.spec)
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
        elif word in postures:  # A path would be read as well, and the network does not choose files.
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
        if not message.points:  # As joint_trajectory_controller takes it: cancel.
            self._hand.stop()
            return 0.0
        times, postures, rates, late = joint_path(message, self._spec, self._clock)
        return self._outside.follow(times, postures, rates, late=late)
