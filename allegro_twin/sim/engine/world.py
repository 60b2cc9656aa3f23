"""One physics that one device moves, or several share: it owns the state, and the time as a number of steps."""

from __future__ import annotations

import hashlib
import weakref
from typing import Protocol

import mujoco
import numpy as np


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
