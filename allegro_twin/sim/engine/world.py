"""One physics that one device moves, or several share: it owns the state, and the time as a number of steps."""

from __future__ import annotations

import hashlib
import weakref
from typing import NamedTuple, Protocol

import mujoco
import numpy as np

from allegro_twin.types import Array, Vector

_PHYSICS = mujoco.mjtState.mjSTATE_INTEGRATION
_DERIVED = (
    "xpos", "xquat", "xmat", "geom_xpos", "geom_xmat", "site_xpos", "site_xmat", "cam_xpos", "cam_xmat", "light_xpos",
    "light_xdir", "actuator_force", "sensordata",
)  # fmt: skip
"""Quantities that the last step left to read and to draw, of the moment before that step."""


class WorldState(NamedTuple):
    """State that decides how a world goes on, besides its members' own: plain arrays and numbers."""

    physics: Vector
    """MuJoCo's own, of integration."""
    derived: dict[str, Array]
    """By the names of MjData."""
    steps: int


class Member(Protocol):
    """A device in a world."""

    @property
    def substeps(self) -> int:
        """Physics steps in its control period."""
        ...

    @property
    def every_step(self) -> bool:
        """Whether it has something to do at each of them."""
        ...

    def lay(self) -> None:
        """A new session begins: put the device into the state as it is at reset."""
        ...

    def begin_period(self) -> None:
        """A control period of the device begins."""
        ...

    def before_step(self, step: int) -> None:
        """A physics step comes, so many after the reset."""
        ...


class World:
    """A compiled scene and its state. Time passes when a member asks for it, and then for all of them."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.steps = 0
        """Since the reset."""
        self.session = 0
        """Counts the resets."""
        self._joined: list[weakref.ref[Member]] = []

    def join(self, member: Member) -> None:
        """Another device moves in this world, for as long as somebody else holds it: a world that held its devices,
        which hold it, would keep its model's megabytes until Python looks for such circles."""
        self._joined.append(weakref.ref(member))

    @property
    def _members(self) -> list[Member]:
        return [member for joined in self._joined if (member := joined()) is not None]

    def restart(self) -> None:
        """Everything as it was before time began, whoever moves in it."""
        mujoco.mj_resetData(self.model, self.data)
        self.steps, self.session = 0, self.session + 1
        for member in self._members:
            member.lay()

    def save(self) -> WorldState:
        """State of now; a person's pull with the mouse is no part of it."""
        physics = np.empty(mujoco.mj_stateSize(self.model, _PHYSICS))
        mujoco.mj_getState(self.model, self.data, physics, _PHYSICS)
        derived = {name: getattr(self.data, name).copy() for name in _DERIVED}
        return WorldState(physics, derived, self.steps)

    def restore(self, state: WorldState) -> None:
        """Go on, to the bit, from a state of a world of the same model, whether or not it has begun. Its members are
        restored next, each from its own."""
        mujoco.mj_setState(self.model, self.data, state.physics, _PHYSICS)
        for name, values in state.derived.items():
            getattr(self.data, name)[:] = values
        self.steps, self.session = state.steps, self.session + 1

    def advance(self, until: int) -> None:
        """Let steps pass until there are so many. Members hear of each of their periods as it begins."""
        members = self._members
        if len(members) == 1 and not members[0].every_step:
            (member,) = members
            while self.steps < until:
                member.begin_period()
                mujoco.mj_step(self.model, self.data, member.substeps)
                self.steps += member.substeps
            return
        busy = [member for member in members if member.every_step]
        while self.steps < until:
            for member in members:
                if self.steps % member.substeps == 0:
                    member.begin_period()
            for member in busy:
                member.before_step(self.steps)
            mujoco.mj_step(self.model, self.data)
            self.steps += 1

    def hash(self) -> str:
        """Fingerprint of the model as it is stepped."""
        buffer = np.empty(mujoco.mj_sizeModel(self.model), np.uint8)
        mujoco.mj_saveModel(self.model, None, buffer)
        return hashlib.sha256(buffer.tobytes()).hexdigest()[:16]

    def warned(self) -> str:
        """What the engine has warned of."""
        data = self.data
        found = [mujoco.mjtWarning(i).name for i in range(len(data.warning)) if data.warning[i].number]
        return ", ".join(found) or "no warning from the engine"
