"""`Hand`, the facade for people at a prompt: everything the hand can do, on any backend."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.build import Rig, assemble
from allegro_twin.config import PositionSettings, RunConfig, load_config
from allegro_twin.control.controllers import PD, PID, Gains, Gravity, GravityCompensation, Torque
from allegro_twin.control.handover import Relay
from allegro_twin.control.trajectory import Hold, Moves, Profile, Reference, Waypoint
from allegro_twin.driver import Driver
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.kinematics.model import HandModel, Pose
from allegro_twin.library.gains import load_gains
from allegro_twin.library.postures import load_posture
from allegro_twin.loop import paced, run
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, Sample, Vector, frozen

Kind: TypeAlias = Literal["torque", "gravity", "pd", "pid"]
KINDS: tuple[Kind, ...] = ("torque", "gravity", "pd", "pid")
Posture: TypeAlias = str | ArrayLike
"""A name in the library, or joint positions, shape (n,), rad."""


class Hand:
    """A hand to work with.

    It opens limp. In a simulation and a replay time passes only in calls that wait, so a script repeats itself bit for
    bit; with `background=True` it passes on its own in real time. Every way out of `with` leaves the hand limp.
    """

    def __init__(self, rig: Rig, gains: Gains, *, background: bool = False) -> None:
        self._rig, self._gains = rig, gains
        self._model = HandModel(rig.spec)
        self._gravity = Gravity(self._model.gravity_torque)
        self._kind: Kind = "torque"
        self._reference: Reference | None = None
        self._relay = Relay(Torque(np.zeros(rig.spec.n_joints)), rig.spec.actuation.torque_limit)
        self._driver = Driver(self._samples(background), background=background)

    @classmethod
    def open(cls, config: str | Path | RunConfig, *, background: bool = False) -> Self:
        """Open the hand that a config describes; its `controller` block names the gains. Raises HandError."""
        settings = config if isinstance(config, RunConfig) else load_config(config)
        rig = assemble(settings)
        controller = settings.controller
        name = controller.gains if isinstance(controller, PositionSettings) else "default"
        return cls(rig, load_gains(name, rig.spec), background=background)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the hand limp and let go of it. Idempotent."""
        self._driver.close()
        self._rig.backend.close()

    @property
    def spec(self) -> HandSpec:
        return self._rig.spec

    @property
    def state(self) -> HandState:
        """The newest state."""
        return self._driver.latest.state

    @property
    def controllers(self) -> tuple[Kind, ...]:
        """What `set_controller` takes."""
        return KINDS

    @property
    def controller(self) -> Kind:
        """What drives the hand now."""
        return self._kind

    def set_controller(self, kind: Kind, *, torque: ArrayLike = 0.0) -> None:
        """Change the controller while the hand runs, without a jump of torque. `pd` and `pid` stay where the hand is;
        `torque` (N·m, one value or n) is for the torque controller. Raises ConfigError."""
        if kind not in KINDS:
            raise ConfigError(unknown("controller", kind, KINDS))
        if kind == "torque":
            self._switch(kind, Torque(self.spec.vector(torque, "torque")), None)
        elif kind == "gravity":
            self._switch(kind, GravityCompensation(self._checked_gravity()), None)
        else:
            self._follow(kind, Hold(self.state.position))

    @property
    def errors(self) -> Vector:
        """Where the joints should be less where they are, (n,), rad; NaN where the controller wants no position."""
        sample = self._driver.latest
        target = self._target(sample.state)
        return frozen(np.full(self.spec.n_joints, np.nan) if target is None else target - sample.state.position)

    @property
    def gravity(self) -> Vector:
        """The gravity that controllers compensate, palm frame, (3,), m/s²."""
        return self.state.gravity if self._gravity.vector is None else self._gravity.vector

    @gravity.setter
    def gravity(self, vector: ArrayLike | None) -> None:
        """Set it where the hand reports none or is wrong about it; None: what the hand reports."""
        if vector is not None:
            vector = frozen(vector)
            if vector.shape != (3,) or not np.isfinite(vector).all():
                raise ConfigError(f"gravity needs three finite numbers in the palm frame, m/s²; not {vector}")
        self._gravity = Gravity(self._model.gravity_torque, vector)
        if self._kind != "torque":
            self._relay.amend(lambda controller: replace(controller, gravity=self._gravity))

    def move_to(
        self, posture: Posture, speed: float = 1.0, *, profile: Profile = "minimum_jerk", wait: bool = True
    ) -> None:
        """Go to a posture: the joint that travels furthest peaks at `speed` (rad/s), all arrive together. From torque
        or gravity compensation the hand changes to PID. Raises ConfigError before anything moves."""
        goal = self._posture(posture)
        moves = Moves([Waypoint(goal, speed=speed, profile=profile)])
        moves.begin(self.state.position)  # A wrong speed is an error here, not in the loop.
        self._follow(self._kind if self._kind in ("pd", "pid") else "pid", moves)
        if wait:
            self.wait()

    def fingertips(self) -> dict[str, Pose]:
        """Position (m) and rotation of every fingertip in the palm frame."""
        return self._model.fingertips(self.state.position)

    def wait(self, seconds: float | None = None) -> HandState:
        """Let time pass: so many seconds of the hand's clock, or until the motion is over and the joints have settled
        (0.02 rad, or half a second at most)."""
        if seconds is not None:
            end = self.state.t + seconds
            return self._driver.wait(lambda sample: sample.state.t >= end - 1e-9).state
        over = self._motion_end()
        return self._driver.wait(lambda sample: self._arrived(sample, over)).state

    def stop(self) -> None:
        """Stay here: PID at the present position."""
        self._follow("pid", Hold(self.state.position))

    def _samples(self, background: bool) -> Iterator[Sample]:
        samples = run(self._rig.backend, self._relay)
        return paced(samples) if background and self._rig.sim is not None else samples
