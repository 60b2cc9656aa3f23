"""A hand's samples as the messages of the bridge."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.recording.messages import build
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.frames import LinkFrames, urdf_text
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.ros.topics import WRENCH
from allegro_twin.types import Sample, Vector

Report = tuple[str, v.Message]
"""A topic and what is published there."""


class Reports:
    """Makes them. The model is its own: that of the hand works in another thread."""

    def __init__(self, hand: Hand, words: v.RosTypes) -> None:
        self._hand, self._words, self._spec = hand, words, hand.spec
        self._frames, self._model = LinkFrames(hand.spec), hand_kinematics(hand.spec)
        self._missed, self._tick = 0, -1

    def at_first(self, stamp: int) -> Iterator[Report]:
        """What is said once, for whoever comes later too."""
        yield "robot_description", self._words.make(v.STRING, data=urdf_text(self._spec))
        yield "/tf_static", self._frames.static_transforms(self._words, stamp)

    def of(self, stamp: int, sample: Sample) -> Iterator[Report]:
        """What is said of every sample that is published; `stamp`: ns since 1970."""
        words, state = self._words, sample.state
        yield "joint_states", build.joint_states(words, stamp, [(self._spec, state)])
        yield "/tf", self._frames.transforms_at(words, stamp, state.position)
        for finger, force in self._pushed(sample).items():
            yield (
                WRENCH.format(finger=finger),
                build.wrench(words, stamp, self._spec.finger(finger).tip, np.append(force, np.zeros(3))),
            )

    def seen(self, sample: Sample) -> None:
        """Count a sample, whether it is published or not."""
        tick = sample.state.tick
        if self._tick >= 0:
            self._missed += max(tick - self._tick - 1, 0)
        self._tick = tick

    def health(self, stamp: int, sample: Sample, error: str = "") -> Report:
        """The once-a-second status; `error`: what ended the hand."""
        stalled, hottest = self._hand.stalled, _hottest(sample.state.temperature)
        level = build.ERROR if error else build.WARN if stalled is not None else build.OK
        text = error or str(stalled or f"driven by {self._hand.controller}")
        values = {
            "controller": self._hand.controller,
            "time": f"{sample.state.t:.3f} s",
            "missed periods": str(self._missed),
            "clipped set-points": str(self._hand.clipped),
            "hottest motor": hottest,
        }
        return "/diagnostics", build.diagnostics(self._words, stamp, self._name, level, text, values)

    def refused(self, stamp: int, topic: str, why: str) -> Report:
        """A wish that was not carried out."""
        message = self._words.make(
            v.LOG, stamp=self._words.time(stamp), level=30, name=self._name, msg=why, file="", function=topic, line=0
        )
        return "/rosout", message

    @property
    def _name(self) -> str:
        return self._spec.name + (f" {self._spec.serial}" if self._spec.serial else "")

    def _pushed(self, sample: Sample) -> dict[str, Vector]:
        """What pushes on each fingertip, (3,), N, in the tip's frame, by the joint torques of a hand at rest:
        τ = g(q) - Jᵀ f, so f = -(Jᵀ)⁺ (τ - g). NaN where gravity is not known."""
        state, spec, given = sample.state, self._spec, self._hand.gravity
        load = state.torque - self._model.gravity_torque(state.position, given)
        _, jacobians = self._model.fingertip_jacobians(state.position, [finger.name for finger in spec.fingers])
        tips, found = self._model.fingertips(state.position), {}
        for finger, jacobian in zip(spec.fingers, jacobians, strict=True):
            mine = list(finger.joints)
            unknown = not np.isfinite(load[mine]).all()
            force = np.full(3, np.nan) if unknown else -np.linalg.lstsq(jacobian[:, mine].T, load[mine], rcond=None)[0]
            found[finger.name] = tips[finger.name].rotation.T @ force
        return found


def _hottest(temperature: Vector) -> str:
    return "not reported" if np.isnan(temperature).all() else f"{np.nanmax(temperature):.0f} °C"
