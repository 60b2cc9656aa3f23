"""Link contacts: the links of the hands that touch an object, and their shares of the force."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.shared_model import SharedModelBatch
from allegro_twin.types import Array

GROUPS = ("tips", "middle", "palm")
"""Groups of links: the last of each finger; those that carry these; the palm and everything between."""
_TOUCH = 1e-9  # N. A contact without force touches nothing.


class LinkContacts:
    """Contact forces of `n` hands on one object at every physics step, summed since the reset of each simulation.

    Scenes have the sensors of `Stage.sensed`. `within`: whether every physics step of a period counts, or its last one.
    """

    def __init__(self, worlds: SharedModelBatch, *, within: bool = True) -> None:
        xp, self._worlds = worlds.xp, worlds
        self.links = worlds.watch_contacts(within)
        group = _groups(worlds, self.links)
        self._member: Array = xp.asarray((group[:, None] == np.arange(len(GROUPS))).astype(np.float64))
        """Whether a link (row) belongs to a group (column)."""
        self.sums: Array = xp.zeros((worlds.n, len(self.links)))
        """Sums of contact force per link over physics steps, (n, links), N."""
        self._touched: Any = xp.zeros((worlds.n, len(self.links)), bool)
        """Since `begin_decision`; `_now`: in the last period."""
        self._now: Any = xp.zeros((worlds.n, len(self.links)), bool)
        self._new: Any = xp.zeros(worlds.n, bool)
        """Simulations that have not moved since their reset: their sensors have the forces of the episode before."""
        self._waiting: list[Array] = []
        """Forces of periods that are not counted yet: those of a decision are counted at once, which is faster."""
        self._xp = xp

    def begin(self, rows: Rows) -> None:
        self.count()
        self.sums[rows], self._touched[rows], self._now[rows] = 0.0, False, False
        self._new[rows] = True

    def begin_decision(self) -> None:
        self.count()
        self._touched[...] = False
        self._new[...] = False

    def add_period(self) -> None:
        """Count the period that has just been simulated, with each of its physics steps."""
        assert self._worlds.contact_steps is not None
        self._waiting.append(self._xp.copy(self._worlds.contact_steps))

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """What an episode changes, by name, live; complete, since what waits is counted."""
        self.count()
        return {"sums": self.sums, "touched": self._touched, "now": self._now, "new": self._new}

    def count(self) -> None:
        """Count the periods that wait."""
        if not self._waiting:
            return
        force = self._xp.concatenate(self._waiting)
        last = len(self._waiting[-1])
        self._waiting.clear()
        square = (force * force).sum(axis=-1)
        square = self._xp.where(self._xp.isfinite(square) & ~self._new[:, None], square, 0.0)
        for each in self._xp.sqrt(square):  # In the same order for any number of simulations.
            self.sums += each
        touching = square > _TOUCH**2
        self._now[...] = touching[-last:].any(axis=0)
        self._touched |= touching.any(axis=0)

    def in_contact(self) -> NDArray[np.bool_]:
        """Whether any link touched the object in a period since `begin_decision`, (n,): a gait lets go for moments."""
        self.count()
        found: NDArray[np.bool_] = self._touched.any(axis=-1)
        return found

    def in_contact_now(self) -> NDArray[np.bool_]:
        """Whether any link touched the object in the last period, (n,)."""
        self.count()
        found: NDArray[np.bool_] = self._now.any(axis=-1)
        return found

    def touching(self, group: str) -> NDArray[np.int64]:
        """Number of a group's links that touched the object in a period since `begin_decision`, (n,)."""
        self.count()
        column = self._member[:, GROUPS.index(group)] > 0
        found: NDArray[np.int64] = (self._touched & column).sum(axis=-1)
        return found

    def shares(self) -> dict[str, Array]:
        """Share of each group in the sum of contact forces since the reset, (n,); 0 where nothing touched."""
        self.count()
        total = self.sums.sum(axis=-1)
        safe = self._xp.where(total > 0, total, 1.0)
        return {name: (self.sums * self._member[:, k]).sum(axis=-1) / safe for k, name in enumerate(GROUPS)}


class AssumedContacts(LinkContacts):
    """Contacts of hands into which poses are only written: no contact is known, so every object is taken to be
    touched."""

    def in_contact(self) -> NDArray[np.bool_]:
        return super().in_contact() | True


def _groups(worlds: SharedModelBatch, links: tuple[str, ...]) -> NDArray[np.int64]:
    """Number of each link's group: a tip moves no other of the links, and a middle link moves only tips."""
    model: Any = worlds.model
    ids = [int(model.body(name).id) for name in links]
    moved = [[k for k, other in enumerate(ids) if other != own and own in _ancestors(model, other)] for own in ids]
    tips = {k for k, carried in enumerate(moved) if not carried}
    return np.array([0 if k in tips else 1 if set(moved[k]) <= tips and len(moved[k]) == 1 else 2
                     for k in range(len(ids))])  # fmt: skip


def _ancestors(model: Any, body: int) -> set[int]:
    found = set()
    while body:
        body = int(model.body_parentid[body])
        found.add(body)
    return found
