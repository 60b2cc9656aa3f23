"""Fault detection: collects what a mirror estimates into windows and reports a fault once it is certain."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.sim.observer.observer import Estimate
from allegro_twin.spec import HandSpec
from allegro_twin.twin.mirror.contact_detection import EULER, NOTHING, contact_thresholds, held_friction
from allegro_twin.twin.mirror.encoder_drift import DriftDetector
from allegro_twin.twin.mirror.fault_list import CHANGES, HIDES, FaultList
from allegro_twin.twin.mirror.fault_signatures import (
    FINGERS,
    LEAST,
    NOISE,
    fit_signature,
    fit_supply,
    free_noise,
    largest_gains,
    signature_fault,
    still_shows,
)
from allegro_twin.twin.mirror.faults import (
    JUMP,
    MOVING,
    PUSHED,
    ROW,
    STILL,
    Fault,
    FaultName,
    MirrorWindow,
    blocked_fingers,
    direct_faults,
    holds_object,
    still_joints,
)
from allegro_twin.twin.mirror.loose_link import LooseLinkDetector
from allegro_twin.twin.mirror.repeated_reports import RepeatedReports
from allegro_twin.twin.mirror.slip_detection import Slip, SlipDetector
from allegro_twin.types import Array, HandState, Vector, frozen

ROWS = 50
"""Rows of a window: 1.5 s at 3 ms."""
EVERY = 8
"""Rows between two evaluations: 0.24 s."""
WAIT = 40
"""Rows from the first sign to a fault's name. Only these rows count, so that shapes are not mixed with what was before.
A joint that stays still waits for ROWS: it may be stuck."""
FASTEST = 0.003
"""s: the period that JUMP refers to; in a longer period joints move further."""
LONGEST = 72
"""Rows from the first sign after which the likeliest fault is named, however close the next one is."""
FILE = 34
"""Rows from the first sign to the fault `wrong_file`: fingers that close on something rest by then."""
SOONEST = 24
"""Fewest rows for telling shapes apart."""
CLEAR = 20.0
"""The likeliest fault is clear where it is e¹⁰ times likelier than the next: half of `Fault.lead` is the logarithm."""
RARE = 3e5
"""Evaluations in which a free finger reaches its threshold once: 20 hours."""
DEFAULT, PART = 0.02, 0.03
"""N·m, and share of a motor's limit: contact threshold without a free motion."""
SURE = 8.0
"""Standard deviations between reported and predicted positions that noise never reaches."""
UNKNOWN = frozen([np.inf])
ONCE, EXACT = np.ones(1, dtype=int), frozen([0.0])  # Every report arrives, and without noise.
SIGMAS = 6.0
"""Standard deviations of the disturbance that noise alone makes: less is no contact without a free motion."""
REACH = 3
"""Periods within which no push moves a joint by JUMP: 5 N at a fingertip, or a motor's whole torque, 0.7 N·m, over 3
g·m², move it by 7 and 9 mrad in 9 ms. Over more periods the limit grows with the square of their number."""
SHAPED: tuple[FaultName, ...] = (
    "weak",
    "friction",
    "payload",
    "wrong_file",
    "supply",
)  # Found by thresholds from a free motion.
ARISES, LASTS = 0.1, 0.4
"""s after a name within which a touch that it makes begins, and s for which that lasts. Ours: a model takes a name at
once, and a touch that merely comes then is withdrawn from the same name only if it comes within a tenth of a second."""
SLIPS = 1.0
"""s without a sign of a slip after which it is over, and the next one is another."""
SILENT = 0.1
"""s without a report of a joint after which that is said. Ours: single reports are lost."""
FREES = 0.04
"""rad by which a joint moves that is stuck no more: twice what one creeps whose motor is dead."""
BLOCK, FEWEST = 20, 4
"""Evaluations of a block, 4.8 s, and fewest blocks of a free motion that give thresholds of shapes."""
ENOUGH = 22.0  # s of free motion that contain this many at 3 ms, after a mirror has settled and filled a window.


class LinkWeights(NamedTuple):
    """Gravity of a hand's links in one posture."""

    pull: Array
    """Torque on each joint of a kilogram at each link's centre of mass, (links, n), N·m."""
    lean: Array | None
    """Derivative of gravity's torques by the joints, (n, n), N·m/rad; None: not known for this hand."""
    free: NDArray[np.bool_]
    """Joints of fingers without contact, (n,)."""
    down: Vector
    """Gravity in the palm frame, (3,), m/s²."""


class FreeShapes(NamedTuple):
    """Shapes of faults that free motion already shows."""

    noise: Vector
    """Noise of each joint, as from `free_noise`, (n,), N·m."""
    gains: Array
    """The largest gain of each evaluation with this noise, (evaluations, fingers), N²m²."""


class _Period(NamedTuple):
    """One period of a mirror, (n,) each; a row is the mean over ROW of them."""

    disturbance: Vector
    torque: Vector
    velocity: Vector
    side: Vector
    position: Vector
    jump: Vector
    """Reported minus predicted position, rad, where that is a jump; else 0."""
    off: Vector
    """Reported minus predicted position, rad."""
    noise: Vector
    """What `off` does not reach by noise, rad."""


class Thresholds(NamedTuple):
    """Thresholds that free motions of a hand do not reach."""

    contact: Array
    """Thresholds of disturbances, as from `contact_thresholds`, (2, n), N·m: of joints at rest, and moving."""
    gains: Vector
    """Thresholds of the gains of shapes, as `signature_fault` takes them, (fingers,); infinite without a free
    motion."""
    spread: Vector = UNKNOWN
    """Standard deviation of the disturbances that noise alone makes in a mirror for which these thresholds hold, (n,),
    N·m: the thresholds grow with the present one. Infinite where it is not known."""
    held: Vector = NOTHING
    """What friction may hold of a disturbance in joints at rest, (n,), N·m: part of `contact`."""
    noise: Vector = frozen([NOISE])
    """With which `gains` were measured, (n,), N·m."""

    @property
    def unchecked_faults(self) -> tuple[FaultName, ...]:
        """Names of faults that cannot be found, since there was no free motion, or one that was too short."""
        return SHAPED if np.isinf(self.gains).any() else ()

    @staticmethod
    def default(spec: HandSpec) -> Thresholds:
        """Thresholds without a free motion; for a hand that closes its own loop a share of its motors' limits."""
        above = np.full(spec.n_joints, DEFAULT)
        if "torque" not in spec.commands:
            above = np.maximum(above, PART * spec.actuation.torque_limit)
        return Thresholds(np.stack([above, above]), np.full(len(spec.fingers), np.inf), above / SIGMAS)

    @staticmethod
    def from_free_motion(
        disturbance: Array,
        moving: NDArray[np.bool_],
        held: Vector,
        shapes: FreeShapes,
        period: float,
        spec: HandSpec,
        spread: Vector = UNKNOWN,
    ) -> Thresholds:
        """Thresholds from a free motion. `disturbance`: (k, n), N·m; `moving`: which joints moved for a while, (k, n);
        `held`: torque that friction may hold in joints at rest (`StateObserver.held`); `shapes`: from
        `FaultDetector.free_shapes`. A gain is reached once in RARE evaluations, by Gumbel's law over blocks that do not
        overlap. Raises ConfigError for a motion that is too short."""
        noise, gains = shapes
        above, blocks = contact_thresholds(disturbance, moving, held, period, spec), len(gains) // BLOCK
        held = held_friction(disturbance, moving, held, period)
        if blocks < FEWEST:
            return Thresholds(above, np.full(len(spec.fingers), np.inf), spread, held, noise)
        cut = gains[: blocks * BLOCK].reshape(blocks, BLOCK, gains.shape[1]).max(axis=1)
        scale = np.sqrt(6.0) / np.pi * cut.std(axis=0)
        rare = cut.mean(axis=0) + scale * (np.log(RARE / BLOCK) - EULER)
        return Thresholds(above, np.asarray(np.maximum(rare, cut.max(axis=0))), spread, held, noise)


class FaultDetector:
    """Finds faults in the rows of a mirror. `thresholds`: of free motions; `period`: s; `compensates`: the mirror's
    model takes the sizes of faults that were named."""

    def __init__(self, spec: HandSpec, thresholds: Thresholds, period: float, *, compensates: bool = False) -> None:
        self._spec, self._quiet, self._period, self._above = spec, thresholds.gains, period, thresholds.contact[0]
        self._weight = np.broadcast_to(NOISE / thresholds.noise, spec.n_joints)
        self._free: list[list[dict[str, NDArray[Any]]]] | None = None  # Rows between interruptions, if they are kept.
        self.faults = FaultList(spec, compensates=compensates)
        """Faults that were named."""
        self._periods: list[_Period]
        self._rows: dict[str, NDArray[Any]]  # By field of `MirrorWindow`: the last LONGEST rows twice, so that any of
        # them are one slice.
        self._jump = JUMP * max(period / FASTEST, 1.0)
        self._repeats = RepeatedReports(spec.n_joints)
        self._unheard, self._t, self._slid = np.full(spec.n_joints, np.nan), 0.0, -np.inf
        self.restart()
        self._right = np.zeros(len(spec.fingers), dtype=bool)  # Fingers that the file once described well.

    def keep_rows(self) -> None:
        """Keep all rows from now on, for `free_shapes`."""
        self._free = [[]]

    def free_shapes(self) -> FreeShapes:
        """What the rows since `keep_rows` show, if nothing touched the hand."""
        windows = []
        for part in self._free or []:
            columns = {name: np.array([row[name] for row in part]) for name in (part[0] if part else ())}
            for end in range(-(-ROWS // EVERY) * EVERY, len(part) + 1, EVERY):
                windows.append(MirrorWindow(**{name: each[end - ROWS : end] for name, each in columns.items()}))
        noise = free_noise(windows, self._spec)
        gains = [largest_gains(each._replace(weight=NOISE / noise), self._spec) for each in windows]
        return FreeShapes(noise, np.array(gains).reshape(-1, len(self._spec.fingers)))

    def restart(self) -> None:
        """Start anew after an interruption of unknown length. Named faults stay."""
        if self._free is not None:
            self._free.append([])
        self._periods, self._rows, self._count = [], {}, 0
        self._doubted: dict[int, tuple[Fault, float]] = {}  # By finger: its last name, and when it came.
        self._at, self._went = np.full(self._spec.n_joints, np.nan), np.zeros(self._spec.n_joints)
        fingers = len(self._spec.fingers)
        self._sign, self._since = np.full(fingers, -1), np.zeros(fingers, dtype=int)  # Rows, by finger.
        self._begin = np.zeros(fingers)  # s: the first sign.
        row = ROW * self._period
        self._drift, self._falls, self._slips = (
            DriftDetector(self._spec, row),
            LooseLinkDetector(self._spec),
            SlipDetector(self._spec, row, self._above),
        )
        self.explained = np.zeros(self._spec.n_joints)
        """Torque that named faults make on each joint, (n,), N·m."""

    def hear(self, t: float, heard: NDArray[np.bool_]) -> None:
        """Take in at a time, s, which joints reported, (n,)."""
        if heard.all() and not (self._unheard >= 0.0).any():
            return
        for joint in np.flatnonzero(heard & (self._unheard >= 0.0)):
            self.faults.end("silent", int(joint), t)
        self._unheard = np.where(heard, np.nan, np.fmin(self._unheard, t))
        for joint in np.flatnonzero(t - self._unheard > SILENT):
            begin = float(self._unheard[joint])
            self._name(Fault("silent", int(joint), t - begin), begin, t)

    def add(
        self,
        state: HandState,
        estimate: Estimate,
        torque: Vector,
        off: Vector,
        weights: LinkWeights | None,
        since: NDArray[np.int_] = ONCE,
        expected: Vector = EXACT,
    ) -> None:
        """Add a period: the mirror's estimate, the motors' torques, N·m, and reported minus predicted positions, rad.
        `weights` are needed in the last of ROW periods (`row_due`). `since`: periods from a joint's last report to this
        one, 0 where it was lost, (n,). `expected`: standard deviation of `off`, (n,), rad."""
        v, heard, self._t = estimate.velocity, since > 0, state.t
        went = np.abs(state.position - self._at)
        sped = went - since * self._went
        # A joint that was stopped does not count: it met something.
        most = np.maximum(self._jump * np.maximum(np.square(since / REACH), 1.0), SURE * expected)
        jump = np.where(heard & (sped > most / 2.0) & (np.abs(off) > most), off, 0.0)
        if jump.any() and sum(jump[list(finger.joints)].any() for finger in self._spec.fingers) > 1:
            jump = np.zeros(len(jump))  # Not several encoders at once: the hand met something, or a period was lost.
        self._repeats.add(state.position == self._at, heard, np.abs(v) < MOVING)
        self._at = np.where(heard, state.position, self._at)
        self._went = np.where(heard, went / np.maximum(since, 1), self._went)
        self._periods.append(
            _Period(estimate.disturbance, torque, v, estimate.side, state.position, jump, off, SURE * expected)
        )
        if len(self._periods) < ROW or weights is None:
            return
        periods = _Period(*(np.array(each) for each in zip(*self._periods, strict=True)))
        self._periods.clear()
        mean, jumps = _Period(*(each.mean(axis=0) for each in periods)), periods.jump
        slid = self._slips.add(mean.disturbance, mean.torque, mean.position, weights.down, jumped=bool(jumps.any()))
        self.explained = self.faults.effect(mean.torque, mean.side, weights.pull, weights.lean)
        self._keep({
            "disturbance": mean.disturbance, "torque": mean.torque, "velocity": mean.velocity, "side": mean.side,
            "position": mean.position, "jump": jumps[np.abs(jumps).argmax(axis=0), np.arange(len(v))],
            "pull": weights.pull, "temperature": state.temperature, "holds": self._slips.holds,
            "known": self.explained,
        })  # fmt: skip
        fell = self._falls.add(periods.off, periods.noise.max(axis=0))
        inside = weights.lean is None  # A hand's own loop carries a link that falls.
        if fell is not None and not inside and self._untouched(fell[0], weights.free):
            self._name(Fault("loose", *fell), self._t, self._t)
        self._add_slip(slid)
        self._check_drift(mean, weights)
        if self._count % EVERY == 0 and self._count >= ROWS:
            self._evaluate()

    def _add_slip(self, slid: Slip | None) -> None:
        """Name a slip; one that goes on is the same, and SLIPS without a sign of it end it."""
        if slid is not None:
            self._slid = self._t
            self._since[:], self._sign[:] = self._count, -1  # What fingers held until then made what was seen of them.
            self._name(Fault("slip", *slid), self._t, self._t)
        elif self._t > self._slid + SLIPS:
            for each in self.faults.active:
                if each.name == "slip":
                    self.faults.end("slip", each.joint, self._t)

    def _name(self, found: Fault, begin: float, t: float) -> None:
        """Name a fault, unless it was named or follows from one that was. An encoder that repeats its last value makes
        a posture that is not the finger's: names that its finger got since then are withdrawn."""
        if found.name == "stuck" and self._repeats.lasting(ROWS * ROW)[found.joint]:
            self.faults.end_since(begin, found.joint, t)
        if self.faults.add(found, begin, t) and found.name in (*CHANGES, *HIDES):
            self._forget_all() if found.name == "supply" else self._forget(found.joint)
            if found.name in ("weak", "friction", "payload"):
                self._doubted[self._spec.finger_of(found.joint)] = found, t

    def judge_touches(self, touched: NDArray[np.bool_], t: float) -> None:
        """Withdraw a name that makes a touch. `touched`: fingers that the mirror takes for touched, (fingers,), at a
        time, s, once its model has what was named before. A right name explains what looked like a touch, if anything
        did; from a wrong one on a finger that was not touched is."""
        for finger, (found, named) in list(self._doubted.items()):
            over = not touched[finger] and t > named + ARISES
            if over or (touched[finger] and t <= named):
                del self._doubted[finger]
            elif t > named + ARISES + LASTS:
                del self._doubted[finger]
                self.faults.end(found.name, found.joint, t)
                self._forget(found.joint)

    def _forget(self, joint: int) -> None:
        """Discard the rows of a joint's finger up to now: its model, or what is known of it, has changed."""
        finger = self._spec.finger_of(joint)
        self._since[finger], self._sign[finger] = self._count, -1
        self._drift.forget(self._spec.fingers[finger].joints)

    def _forget_all(self) -> None:
        for finger in self._spec.fingers:
            self._forget(finger.joints[0])

    def _untouched(self, joint: int, free: NDArray[np.bool_]) -> bool:
        """Whether no other finger was in contact or held something in the last ROWS."""
        own = self._spec.fingers[self._spec.finger_of(joint)].joints
        return bool(np.delete(free, list(own)).all()) and not self._last(min(self._count, ROWS)).holds.any()

    def _check_drift(self, mean: _Period, weights: LinkWeights) -> None:
        """Faults that take longer than a window."""
        if weights.lean is None:
            return
        tells, weight = (np.abs(mean.velocity) > MOVING) & weights.free & ~self.faults.hidden, self._weight
        made, lean = weight * np.stack([mean.torque, mean.side]), weight[:, None] * weights.lean
        self._drift.add(weight * mean.disturbance, made, tells, lean, weight * weights.pull)
        if self._count % EVERY == EVERY // 2 and (drifts := self._drift.check()) is not None:
            self._name(Fault("encoder_drift", *drifts), self._t, self._t)

    @property
    def row_due(self) -> bool:
        """Whether the next period ends a row."""
        return len(self._periods) == ROW - 1

    def _keep(self, row: dict[str, NDArray[Any]]) -> None:
        """Keep a row, by field of `MirrorWindow`."""
        for name, each in row.items():
            if name not in self._rows:
                self._rows[name] = np.zeros((2 * LONGEST, *each.shape), each.dtype)
            column = self._rows[name]
            column[self._count % LONGEST] = column[self._count % LONGEST + LONGEST] = each
        self._count += 1
        if self._free is not None:
            kept = {name: np.array(each) for name, each in row.items()}
            kept["disturbance"][self.faults.hidden] = kept["velocity"][self.faults.hidden] = 0.0
            self._free[-1].append(kept)

    def _last(self, count: int) -> MirrorWindow:
        """The last rows. Joints of which nothing can be known neither move nor are pushed in them, nor do fingers move
        in rows from before their model changed."""
        end, hidden = (self._count - 1) % LONGEST + LONGEST + 1, self.faults.hidden
        columns = {name: column[end - count : end] for name, column in self._rows.items()}
        window = MirrorWindow(**columns, weight=self._weight)
        old = np.arange(self._count - count, self._count)[:, None] < self._since
        if not hidden.any() and not old.any():
            return window
        out = np.repeat(old, [len(finger.joints) for finger in self._spec.fingers], axis=1) | hidden
        return window._replace(
            velocity=np.where(out, 0.0, window.velocity), disturbance=np.where(hidden, 0.0, window.disturbance)
        )

    def _evaluate(self) -> None:
        window = self._last(ROWS)
        over = largest_gains(window, self._spec) > self._quiet
        self._right |= ~over & (self._moving_rows(window) > ROWS / 2)
        self._begin = np.where(over & (self._sign < 0), self._t, self._begin)
        self._sign = np.where(over, np.where(self._sign < 0, self._count, self._sign), -1)
        wait = self._name_direct(window)
        self._check_named(window)
        if self._supply() or self._wrong_file():
            return
        for finger in np.flatnonzero(self._sign >= 0):
            if finger not in wait:
                self._name_signature(int(finger))

    def _name_direct(self, window: MirrorWindow) -> set[int]:
        """Name what is visible without shapes. Returns fingers of which the next evaluation tells more."""
        wait = set()
        pushed = np.abs(window.disturbance).max(axis=0)
        works = np.maximum(np.ptp(window.torque, axis=0), pushed) > PUSHED
        frozen = self._repeats.frozen(ROWS * ROW) & np.array([
            works[list(self._spec.fingers[self._spec.finger_of(joint)].joints)].any()
            for joint in range(self._spec.n_joints)
        ])  # fmt: skip
        repeats = [Fault("stuck", int(joint), float(pushed[joint])) for joint in np.flatnonzero(frozen)]
        for found in (*direct_faults(window, self._spec), *repeats):
            finger = self._spec.finger_of(found.joint)
            if _may_be_fall(found, window):
                wait.add(finger)
                continue
            old = self.faults.find("encoder_step", found.joint) if found.name == "encoder_step" else None
            if old is not None:
                self.faults.resize(old, found.amount, self._t)
                self._forget(found.joint)
            else:
                self._name(found, self._begin_of(found), self._t)
            if found.name == "encoder_step":  # Each jump counts once.
                self._rows["jump"][:, found.joint] = 0.0
        return wait

    def _begin_of(self, found: Fault) -> float:
        """When what is visible without shapes began, s: the first row of a jump, or of a rest; now for what is hot."""
        window = self._last(min(self._count, LONGEST))
        if found.name == "encoder_step":
            changed = np.abs(window.jump[:, found.joint]) > JUMP
            first = int(changed.argmax())
        elif found.name == "stuck":
            position = window.position[:, found.joint]
            changed = np.abs(position - position[-1]) > STILL
            first = len(changed) - int(changed[::-1].argmax()) if changed.any() else 0
        else:
            return self._t
        return self._t - (len(changed) - first) * ROW * self._period

    def _check_named(self, window: MirrorWindow) -> None:
        """Correct the sizes of named faults by what remains, and withdraw those of which nothing is left."""
        travel = np.ptp(window.position, axis=0)
        for each in self.faults.active:
            if each.name == "stuck" and travel[each.joint] > FREES and self._rows_since(each.joint) > ROWS:
                self.faults.end("stuck", each.joint, self._t)
                self._forget(each.joint)
        self._check_supply()
        for each in self.faults.shaped:
            rows = min(self._rows_since(each.joint), LONGEST)
            if rows < WAIT:
                continue
            finger = self._spec.finger_of(each.joint)
            rest = fit_signature(self._last(rows), each.name, each.joint, self._spec)
            if rest.convinces(float(self._quiet[finger])):
                self.faults.resize(each, rest.amount, self._t)
                self._forget(each.joint)

    def _rows_since(self, joint: int) -> int:
        """Rows since the model of a joint's finger changed."""
        finger = self._spec.finger_of(joint)
        return int(self._count - self._since[finger])

    def _supply(self) -> bool:
        """Whether the motors of so many fingers seem to lack the same share that the supply may be low; it is named
        once that is certain."""
        odd = self._sign >= 0
        if np.count_nonzero(odd) < FINGERS:
            return False
        waited = int(self._count - self._sign[odd].min())
        window = self._last(min(max(SOONEST, waited), LONGEST))
        fit = fit_supply(window)
        if holds_object(window) or self._closes_on_object(window) or fit.amount < LEAST["weak"]:
            return False
        if not fit.convinces(float(self._quiet.sum())):
            return False
        if waited >= WAIT:
            found = Fault("supply", int(self._spec.fingers[int(odd.argmax())].joints[0]), min(fit.amount, 1.0))
            self._name(found, float(self._begin[odd].min()), self._t)
        return True

    def _check_supply(self) -> None:
        """Correct the share that all motors lack, or withdraw it once they have it again."""
        found, rows = self.faults.supply, int(self._count - self._since.max())
        if found is None or rows < WAIT:
            return
        rest = fit_supply(self._last(min(rows, LONGEST)))
        if rest.convinces(float(self._quiet.sum())):
            self.faults.resize(found, rest.amount, self._t)
            self._forget_all()

    def _wrong_file(self) -> bool:
        """Whether so many fingers are odd that the file may be of another hand; it is named once that is certain."""
        if np.count_nonzero(self._sign >= 0) < FINGERS:
            return False
        waited = int(self._count - self._sign[self._sign >= 0].min())
        window = self._last(min(max(SOONEST, waited), LONGEST))
        found = signature_fault(window, self._quiet, self._spec)
        if found is None or found.name != "wrong_file":
            return False
        # A finger that presses on something has an object between it and others, which pushes them all.
        object_between = window.holds.any() or self._closes_on_object(window)
        if waited >= FILE and np.count_nonzero(~self._right) >= FINGERS and not object_between:
            self._name(found, float(self._begin[self._sign >= 0].min()), self._t)
        return True

    def _closes_on_object(self, window: MirrorWindow) -> bool:
        """Whether several fingers press on something with some of their joints still moving."""
        return bool(np.count_nonzero(blocked_fingers(window, self._spec)) > 1)

    def _name_signature(self, finger: int) -> None:
        """Name the fault of a finger whose shape the rows since its first sign have, and whose posture is known."""
        unknown = self.faults.hidden & self._repeats.lasting(ROWS * ROW)
        if unknown[list(self._spec.fingers[finger].joints)].any():
            return
        waited = int(self._count - self._sign[finger])
        window = self._last(min(max(SOONEST, waited), LONGEST))
        own = np.where(np.arange(len(self._quiet)) == finger, self._quiet, np.inf)
        found = signature_fault(window, own, self._spec)
        if found is None:
            return
        if found.name == "payload" and np.count_nonzero(self._sign >= 0) >= FINGERS:
            return  # So many fingers at once carry nothing: gravity is not where the hand says.
        wait = LONGEST if found.lead < CLEAR else ROWS if still_joints(window)[found.joint] else WAIT
        fit = fit_signature(window, found.name, found.joint, self._spec)
        if waited < wait or not fit.convinces(float(self._quiet[finger])):
            return
        if not still_shows(window, found.name, found.joint, found.amount, self._spec):
            return
        if not self._drift.explains_more(found.name, found.joint, found.gain):
            self._name(found, float(self._begin[finger]), self._t)

    def _moving_rows(self, window: MirrorWindow) -> Vector:
        """Rows in which each finger's second busiest joint moves, (fingers,)."""
        moved = (np.abs(window.velocity) > MOVING).sum(axis=0)
        return np.array([np.sort(moved[list(finger.joints)])[-2:][0] for finger in self._spec.fingers])


def _may_be_fall(seen: Fault, window: MirrorWindow) -> bool:
    """Whether an apparent jump may become the fall of a loose link: the next evaluation tells."""
    return seen.name == "encoder_step" and bool(np.abs(window.jump[-2:, seen.joint]).max() > JUMP)
