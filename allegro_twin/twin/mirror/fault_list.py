"""The list of named faults: what is new beside it, what follows from it, and what it explains.

A fault that was named goes on disturbing its finger. So a mirror takes its size into its model (`model_change`), and
what remains is judged as before: a touch, or the next fault. A size is known to `faults.KNOWN` of
itself, so as much of its effect is neither.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from allegro_twin.sim.observer.observer import ModelChange
from allegro_twin.spec import HandSpec
from allegro_twin.twin.mirror.fault_signatures import overcomes
from allegro_twin.twin.mirror.faults import JUMP, Fault, FaultName, FaultReport
from allegro_twin.types import Array, Vector

SHAPED: tuple[FaultName, ...] = ("weak", "friction", "payload")
"""Faults with a shape and a size."""
WHOLE: tuple[FaultName, ...] = ("wrong_file", "slip", "supply")
"""Faults that are the hand's and no joint's: each is there once."""
CHANGES: tuple[FaultName, ...] = (*SHAPED, "encoder_step", "supply")
"""Faults whose size changes the model."""
HIDES: tuple[FaultName, ...] = ("stuck", "loose", "silent")
"""Faults of a joint of which nothing else can be known: what it shows is no touch."""
FOLLOWS: tuple[FaultName, ...] = (*SHAPED, "stuck", "loose", "encoder_drift")
"""Names that may follow from a fault that hides the same joint."""
FADED = 0.2
"""Share of a fault's size below which its name is withdrawn."""
WEAKEST = 0.1
"""Least share of a motor's torque in the model: none would leave nothing to compare."""


class FaultList:
    """Faults in the order in which they were named. `compensates`: the mirror's model takes their sizes."""

    def __init__(self, spec: HandSpec, *, compensates: bool) -> None:
        self._spec, self._compensates = spec, compensates
        self.reports: list[FaultReport] = []
        self.changes = 0
        """Counts changes of the list."""

    @property
    def active(self) -> tuple[Fault, ...]:
        """Faults that hold now."""
        return tuple(report.fault for report in self.reports if report.ended == np.inf)

    def fingers(self, joint: int) -> list[int]:
        """All joints of a joint's finger."""
        return list(self._spec.fingers[self._spec.finger_of(joint)].joints)

    def add(self, found: Fault, begin: float, t: float) -> bool:
        """Add a fault at a time, s, unless it is there, or follows from one that is. Returns whether it is new."""
        if any(self._covers(each, found) for each in self.active):
            return False
        self.reports.append(FaultReport(found, begin, t))
        self.changes += 1
        return True

    def _covers(self, old: Fault, new: Fault) -> bool:
        same_joint, same_finger = old.joint == new.joint, new.joint in self.fingers(old.joint)
        if old.name == new.name and (same_joint or old.name in WHOLE):
            return True
        if old.name == "wrong_file" or (old.name == new.name == "encoder_drift" and same_finger):
            return new.name in FOLLOWS
        if old.name in SHAPED and new.name in SHAPED and same_finger and not self._compensates:
            return True
        if old.name == "supply" and new.name in FOLLOWS and not self._compensates:
            return True
        return old.name in HIDES and same_joint and new.name in FOLLOWS

    def resize(self, old: Fault, more: float, t: float) -> None:
        """Add to the size of a fault. What fades is withdrawn, and friction that no motor overcomes: its evidence was
        something else's."""
        share = old.name in ("weak", "supply")
        size = 1.0 - (1.0 - old.amount) * (1.0 - more) if share else old.amount + more
        faded = abs(size) < JUMP if old.name == "encoder_step" else size < FADED * old.amount
        if faded or (old.name == "friction" and not overcomes(old.joint, size, self._spec)):
            self.end(old.name, old.joint, t)
        else:
            most = 1.0 if share else np.inf
            self._replace(old, old._replace(amount=float(min(size, most))), np.inf)

    def end(self, name: FaultName, joint: int, t: float) -> None:
        """End a fault that holds, if there is one."""
        for each in self.active:
            if (each.name, each.joint) == (name, joint):
                self._replace(each, each, t)

    def end_since(self, since: float, joint: int, t: float) -> None:
        """End faults with a shape of a joint's finger that were named after a time, s."""
        for each in [report for report in self.reports if report.ended == np.inf and report.named > since]:
            if each.fault.name in SHAPED and each.fault.joint in self.fingers(joint):
                self._replace(each.fault, each.fault, t)

    def _replace(self, old: Fault, new: Fault, ended: float) -> None:
        where = next(k for k, each in enumerate(self.reports) if each.fault is old and each.ended == np.inf)
        self.reports[where] = self.reports[where]._replace(fault=new, ended=ended)
        self.changes += 1

    def find(self, name: FaultName, joint: int) -> Fault | None:
        """The fault of this name and joint that holds, or None."""
        return next((each for each in self.active if (each.name, each.joint) == (name, joint)), None)

    @property
    def hidden(self) -> NDArray[np.bool_]:
        """Joints of which nothing else can be known, (n,)."""
        found = np.zeros(self._spec.n_joints, dtype=bool)
        found[[each.joint for each in self.active if each.name in HIDES]] = True
        return found

    @property
    def shaped(self) -> tuple[Fault, ...]:
        """Faults with a shape, which the model has; none where it takes none."""
        return tuple(each for each in self.active if each.name in SHAPED) if self._compensates else ()

    @property
    def supply(self) -> Fault | None:
        """What all motors lack and the model has; None where it takes nothing."""
        return next((each for each in self.active if each.name == "supply" and self._compensates), None)

    def model_change(self) -> ModelChange:
        """What the faults that hold change of the mirror's model."""
        n = self._spec.n_joints
        strength, friction, payload, offset = np.ones(n), np.zeros(n), np.zeros(n), np.zeros(n)
        for name, joint, amount, *_ in self.active:
            match name:
                case "weak":
                    strength[joint] *= max(1.0 - amount, WEAKEST)
                case "supply":
                    strength *= max(1.0 - amount, WEAKEST)
                case "friction":
                    friction[joint] = amount
                case "payload":
                    payload[joint] = amount
                case "encoder_step":
                    offset[joint] = amount
        return ModelChange(strength, friction, payload, offset)

    def effect(self, torque: Vector, side: Vector, pull: Array, lean: Array | None) -> Vector:
        """Torque that the faults that hold make on each joint now, (n,), N·m. Arguments as in a row of `MirrorWindow`;
        `lean`: derivative of gravity's torques by the joints, (n, n), N·m/rad."""
        found = np.zeros(self._spec.n_joints)
        for joints, push in self._effects(torque, side, pull, lean):
            found[joints] += push
        return found

    def _effects(
        self, torque: Vector, side: Vector, pull: Array, lean: Array | None
    ) -> Iterator[tuple[list[int], Vector | float]]:
        for name, joint, amount, *_ in self.active:
            own = self.fingers(joint)
            if name in ("weak", "supply"):
                left = max(1.0 - amount, WEAKEST) if self._compensates else 1.0
                weak = [joint] if name == "weak" else list(range(self._spec.n_joints))
                yield weak, -amount * torque[weak] / left
            elif name == "friction":
                yield [joint], -amount * side[joint]
            elif name == "payload":
                yield own, amount * pull[joint, own]
            elif name == "encoder_step" and lean is not None:
                yield own, -amount * lean[own, joint]
