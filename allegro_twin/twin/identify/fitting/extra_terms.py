"""Terms beyond friction and backlash, and which joints have them, by the shape of the torque that is left over.

With the torque τ that moves the links, every joint is one linear regression (`regress`):

    u = [τ, a, v, sgn v, sgn v exp(−(v/v_s)²), |u| sgn v, ∂τ/∂q] x
        + [1 | 1, q − q_m | q − q_m | |v| | cos Nq, sin Nq | û cos Nq, û sin Nq | f exp(−t/τ_w) | ∂τ/∂ω] y

u: fraction of full PWM, û: what x alone explains of it, f: friction and damping, t: since the motors were switched on,
q_m: the middle of the joint's range, about which a spring's torque does not look like a constant one; sgn v: what
`friction_side` says. The terms in y are tried one kind after the other; the kind that lowers Schwarz's criterion most,
over all joints, stays in those where it lowers it by more than EVIDENCE; in all, if it does in half of them. ω, the
lean of the palm in each recording, is one for all joints. A torque that bends with the angle has no term of its own, so
cogging with few periods takes its place: where a low polynomial in the angle lowers the criterion more,
`ExtraTerms.smooth` says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from allegro_twin.kinematics.orientation import rotate_vector
from allegro_twin.sim.open_loop import SPRINGY, DriveParameters, OpenLoopPlayer
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.fitting.parameterisation import COLD, RIPPLE, STRAY
from allegro_twin.twin.identify.fitting.regress import (
    BAND,
    STILL,
    THIN,
    friction_side,
    low_pass,
    shifted_duty,
    smooth_motion,
)
from allegro_twin.twin.identify.motions.motion import RecordedMotion
from allegro_twin.types import Array, Vector

EVIDENCE = 10.0
"""By which Schwarz's criterion must fall: odds of 1 to 150 against the term (Kass and Raftery 1995: very strong)."""
INDEPENDENT = 5.0
"""Rows of which one is a row of its own: what a model leaves over goes on for some time."""
FEWEST = 20.0
"""Rows of its own that a joint needs: one that hardly moved says nothing."""
PERIODS = np.arange(5.0, 121.0, 1.0)
"""Periods of cogging in a turn that are tried: with fewer a joint that moves by a radian shows no more than an
offset."""
_LOOSE = 1e-6  # Of a lean about gravity itself, which nothing shows.
ALIKE = 10.0
"""By which the number of periods that suits all joints together counts more: motors of a hand are of one kind."""
NEARLY = 0.7
"""Share of a ripple's best gain with which the number of periods that suits all joints is a joint's own. Ours."""
LIKELY = 0.02
"""Standard deviation of a term's torque, in full PWM: what looks like weight and friction together is not enormous."""
_LIKELY = {"warmth": 0.5, "ripple": 0.1}  # Likewise, shares.
_STRIBECK = 0.1  # rad/s, of the friction that is taken away first.
_NUDGE = 1e-3  # rad, of finite differences.
_TORQUE = {"bias": ("bias_torque", "stiffness"), "spring": ("stiffness",), "uneven": ("uneven_damping",),
           "cogging": ("cogging_cosine", "cogging_sine"), "ripple": RIPPLE, "warmth": ("cold_friction",)}  # fmt: skip
_SPRING = "bias:spring"  # Both at once: cogging of few periods mimics the two better than either does alone.
EXTRA = tuple(dict.fromkeys(name for names in _TORQUE.values() for name in names))
"""Parameters that only some joints have."""
_COUNTS = {"cogging": "cogging_periods", "ripple": "ripple_periods", "warmth": "warm_up"}
FIXED = tuple(_COUNTS.values())
"""What the regression finds of them and the fit keeps."""
WARM_UPS = (2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 16.0, 22.0, 32.0, 48.0)
"""Time constants that are tried, s."""
_TRIED = {"cogging": tuple(PERIODS.tolist()), "ripple": tuple(PERIODS.tolist()), "warmth": WARM_UPS}


@dataclass(frozen=True, slots=True, eq=False)
class ExtraTerms:
    """Terms of each joint, and their values in the regression, (n,) each."""

    values: Mapping[str, Vector]
    """By the names of EXTRA and FIXED, as in `DriveParameters`."""
    tilt: Array
    """(recordings, 3), rad; no row where the palm does not lean."""
    joints: Mapping[str, NDArray[np.bool_]]
    """Which joints have a term, (n,), by its name."""
    smooth: NDArray[np.bool_] | None = None
    """Joints of which a low polynomial in the angle explains more than the cogging that was taken, (n,)."""

    @property
    def tilted(self) -> bool:
        return len(self.tilt) > 0

    @property
    def parasitic(self) -> bool:
        """Whether any joint feels parasitic torque."""
        return any(self.joints[name].any() for name in (*STRAY, *RIPPLE) if name in self.joints)

    @property
    def warming(self) -> bool:
        """Whether friction falls while the hand warms up."""
        return "cold_friction" in self.joints and bool(self.joints["cold_friction"].any())

    def __bool__(self) -> bool:
        return self.parasitic or self.warming or self.tilted

    def of_joints(self, name: str, n: int) -> NDArray[np.bool_]:
        """Which joints have a term, (n,)."""
        return self.joints.get(name, np.zeros(n, dtype=bool))

    def begin(self, drive: DriveParameters, recordings: int) -> DriveParameters:
        """A drive with these terms at zero."""
        if not self:
            return drive
        tilt = np.zeros((recordings if self.tilted else 0, 3))
        return replace(drive, **{name: self.values[name] for name in FIXED}, tilt=tilt)

    def add_to(self, drive: DriveParameters) -> DriveParameters:
        """A drive with these terms as the regression has them."""
        if not self:
            return drive
        return replace(drive, **self.values, tilt=self.tilt)


NO_EXTRAS = ExtraTerms({}, np.zeros((0, 3)), {})


class _Joint:
    """The regression of one joint: the columns that are always there are taken out of all others."""

    def __init__(self, u: Vector, base: Array, columns: dict[str, Array], tilt: Array) -> None:
        scale = np.sqrt(np.square(base).sum(axis=0))
        self._Q: Array = np.linalg.qr(base / np.maximum(scale, 1e-12))[0]
        # A ripple of what the motor needs, not of what it was told: that is the other side of the equation.
        needed, angle = (self._Q @ (self._Q.T @ u))[:, None], columns["angle"][:, 1]
        waves = {n: np.stack([np.cos(n * angle), np.sin(n * angle)], axis=1) for n in PERIODS}
        self.columns = columns | {f"ripple:{n:g}": needed * wave for n, wave in waves.items()}
        """The terms that may be taken: (rows, 1), or for every number of cogging periods (rows, 2)."""
        self.u, self.tilt, self.count = self.without(u), self.without(tilt), len(u) / INDEPENDENT
        self._always, self._whole = self._Q, self.u
        self._taken: dict[str, Array] = {}
        self.gains: dict[str, float] = {}
        self.usual: set[str] = set()
        """Terms whose gain counts ALIKE more, for they suit all joints best."""

    @property
    def taken(self) -> list[str]:
        """The terms that are taken out, in order."""
        return list(self._taken)

    def without(self, column: Array) -> Array:
        """What the columns so far do not explain."""
        return np.asarray(column - self._Q @ (self._Q.T @ column))

    def take(self, key: str) -> None:
        """Add a term to what is taken out."""
        more = np.linalg.qr(self.without(self.columns[key]))[0]
        self._Q = np.concatenate([self._Q, more], axis=1)
        self.u, self.tilt = self.without(self.u), self.without(self.tilt)
        gone = {_family(key), "spring"} if key == _SPRING else {_family(key)}
        self._taken[key] = self.columns[key]
        self.columns = {name: each for name, each in self.columns.items() if _family(name) not in gone}
        self.weigh()

    def weigh(self) -> None:
        """By how much Schwarz's criterion falls with each term."""
        self.gains = {key: self._gain(each) for key, each in self.columns.items()}
        for key in self.usual & self.gains.keys():
            self.gains[key] += ALIKE

    def best(self) -> dict[str, tuple[str, float]]:
        """The best term of each family, and its gain."""
        found: dict[str, tuple[str, float]] = {}
        for key, gain in self.gains.items():
            family = _family(key)
            if gain > found.get(family, ("", -np.inf))[1]:
                found[family] = key, gain
        return found

    def settle(self) -> None:
        """Let a spring go that was taken with a constant torque where the terms that came later explain it as well."""
        if _SPRING not in self._taken:
            return
        pair = self._taken[_SPRING]
        others = [each for key, each in self._taken.items() if key != _SPRING]
        Q = np.linalg.qr(np.concatenate([self._always, pair[:, :1], *others], axis=1))[0]
        u, spring = (each - Q @ (Q.T @ each) for each in (self._whole, pair[:, 1:]))
        if _fall(u, spring, self.count) <= EVIDENCE:
            bias = {"bias": pair[:, :1]}
            self._taken = {
                name: column
                for key, each in self._taken.items()
                for name, column in (bias if key == _SPRING else {key: each}).items()
            }

    def value(self, key: str) -> Vector:
        """Coefficients of a taken term, the others that are taken as well; in u."""
        own = np.concatenate(list(self._taken.values()), axis=1)
        own = own - self._always @ (self._always.T @ own)
        likely = np.concatenate(
            [np.full(each.shape[1], _LIKELY.get(_family(name), LIKELY)) for name, each in self._taken.items()]
        )
        hold = INDEPENDENT * float(np.square(self.u).mean()) / np.square(likely)
        found = np.linalg.solve(own.T @ own + np.diag(hold), own.T @ self._whole)
        first = sum(self._taken[name].shape[1] for name in self.taken[: self.taken.index(key)])
        return np.asarray(found[first : first + self._taken[key].shape[1]])

    def is_smooth(self) -> bool:
        """Whether a low polynomial in the angle explains more than the cogging that was taken, and a constant does
        not."""
        taken = [key for key in self.taken if key.startswith("cogging")]
        if not taken:
            return False
        others = [each for key, each in self._taken.items() if key not in taken]
        Q = np.linalg.qr(np.concatenate([self._always, *others], axis=1))[0]
        cogging, cubic = self._taken[taken[0]], self.columns["angle"]
        u, cogging, cubic = (each - Q @ (Q.T @ each) for each in (self._whole, cogging, cubic))
        constant, line, whole = (_fall(u, cubic[:, :many], self.count) for many in (1, 2, 4))
        return max(line, whole) >= max(_fall(u, cogging, self.count), constant + EVIDENCE)

    def _gain(self, columns: Array) -> float:
        return _fall(self.u, self.without(columns), self.count) if self.count >= FEWEST else -np.inf

    def lean(self, part: Vector) -> None:
        """Take out what a lean of the palm explains, (rows,), in u."""
        self._whole = self._whole - (part - self._always @ (self._always.T @ part))
        self.u = self.u - self.without(part)
        self.weigh()


def _family(key: str) -> str:
    """Family of a term: `cogging` for `cogging:7`."""
    return key.partition(":")[0]


def _fall(u: Vector, columns: Array, count: float) -> float:
    """By how much columns lower Schwarz's criterion of what is left over, of so many rows of their own."""
    left = u - columns @ np.linalg.lstsq(columns, u)[0]
    before, after = float(u @ u), float(left @ left)
    return float(count * np.log(before / max(after, 1e-30)) - columns.shape[1] * np.log(count))


def screen_terms(motions: Sequence[RecordedMotion], player: OpenLoopPlayer, start: DriveParameters) -> ExtraTerms:
    """The terms that the motions ask for. `start`: a drive from `regress`, for its delay, constants and masses."""
    joints = _regressions(motions, player, start)
    n, tilt = len(joints), np.zeros((0, 3))
    while True:
        _agree(joints)
        # A family as a whole: a lean, one for all joints, would otherwise come after what mimics it in single ones.
        best = [each.best() for each in joints]
        families = {family: [each.get(family, ("", 0.0)) for each in best] for family in _TORQUE}
        totals = {family: sum(gain for _, gain in each if gain > EVIDENCE) for family, each in families.items()}
        family = max(totals, key=lambda name: totals[name])
        if not len(tilt):
            lean, gained = _lean(joints, start.torque_constant, len(motions))
            if gained > max(EVIDENCE, totals[family]):
                tilt = lean.reshape(-1, 3)
                for each, k in zip(joints, start.torque_constant, strict=True):
                    each.lean(each.tilt @ lean / k)
                continue
        if totals[family] <= 0.0:
            break
        for each, (key, gain) in zip(joints, families[family], strict=True):
            if gain > EVIDENCE:
                each.take(key)
    for each in joints:
        each.settle()
    rows = {name: np.zeros(n) for name in (*EXTRA, *FIXED)}
    has = {name: np.zeros(n, dtype=bool) for name in EXTRA}
    for number, (each, k) in enumerate(zip(joints, start.torque_constant, strict=True)):
        for key in each.taken:
            family, _, count = key.partition(":")
            for name, value in zip(_TORQUE[family], each.value(key), strict=False):  # A bias may be one alone.
                # What is a torque resists in the equation of u.
                rows[name][number] = value if name in COLD else -value if name in RIPPLE else -k * value
                has[name][number] = True
            if count and family in _COUNTS:
                rows[_COUNTS[family]][number] = float(count)
    # A spring's torque is none in the middle of a range, in the regression.
    rows["bias_torque"] = rows["bias_torque"] + rows["stiffness"] * _middle(player.spec)
    has["bias_torque"] |= has["stiffness"]
    for mask in has.values():
        mask |= mask.sum() >= n / 2.0
    for name, of in (
        ("cogging_periods", "cogging_sine"),
        ("ripple_periods", "ripple_sine"),
        ("warm_up", "cold_friction"),
    ):
        counts = rows[name]
        if counts.any():
            usual = float(np.median(counts[counts > 0.0]))
            rows[name] = np.where(has[of] & (counts == 0.0), usual, counts)
    return ExtraTerms(rows, tilt, has, np.array([each.is_smooth() for each in joints]))


def _middle(spec: HandSpec) -> Vector:
    return np.asarray((spec.lower + spec.upper) / 2.0)


def _agree(joints: Sequence[_Joint]) -> None:
    """Prefer the number of cogging periods, and the warm-up time, that suits all joints best."""
    total = {f"{family}:{count:g}": 0.0 for family, counts in _TRIED.items() for count in counts}
    for each in joints:
        for key, gain in each.gains.items():
            if key in total:
                total[key] += max(gain - ALIKE * (key in each.usual), 0.0)
        for key in each.taken:
            if key in total:
                total[key] += EVIDENCE
    usual = {max((key for key in total if key.startswith(name)), key=lambda key: total[key]) for name in _TRIED}
    for each in joints:
        for key in each.gains:
            each.gains[key] += ALIKE * ((key in usual) - (key in each.usual))
        each.usual = usual
        _share_ripple(each)


def _share_ripple(joint: _Joint) -> None:
    """Let a joint's ripple come again as often as suits all joints, where that explains nearly as much as its own best
    number: what a ripple is a share of is known too roughly to tell neighbouring numbers apart by one joint."""
    own = {key: gain for key, gain in joint.gains.items() if key.startswith("ripple")}
    usual = next((key for key in own if key in joint.usual), None)
    if usual is not None and own[usual] >= NEARLY * max(own.values()) > 0.0:
        joint.gains |= dict.fromkeys(own.keys() - {usual}, -np.inf)


def _lean(joints: Sequence[_Joint], constant: Vector, recordings: int) -> tuple[Vector, float]:
    """The lean that explains most of what is left over in all joints, (3 recordings,), rad, and its gain."""
    rows, right = [], []
    known = [(each, k) for each, k in zip(joints, constant, strict=True) if each.count > FEWEST]
    if not known:
        return np.zeros(3 * recordings), -np.inf
    for each, k in known:
        sure = 1.0 / max(float(np.sqrt(np.square(each.u).mean())), 1e-12)
        rows.append(each.tilt / k * sure)
        right.append(each.u * sure)
    A, b = np.concatenate(rows), np.concatenate(right)
    found = np.linalg.lstsq(A.T @ A + _LOOSE * np.trace(A.T @ A) * np.eye(A.shape[1]), A.T @ b)[0]
    gain = 0.0
    for each, k in known:
        left = each.u - each.tilt @ found / k
        gain += each.count * float(np.log((each.u @ each.u) / max(float(left @ left), 1e-30)))
    return found, gain - 2.0 * recordings * float(np.log(sum(each.count for each, _ in known)))


def _regressions(motions: Sequence[RecordedMotion], player: OpenLoopPlayer, start: DriveParameters) -> list[_Joint]:
    """The rows of every joint, filtered as in `regress`."""
    parts = [_Sensitivity(motion, player, start) for motion in motions]
    delay = float(start.delay[0])
    late = [low_pass(shifted_duty(m.duty, delay / m.period), m.period, BAND) for m in motions]
    found = []
    for joint in range(player.spec.n_joints):
        u, base, tilt = list[Array](), list[Array](), list[Array]()
        columns = list[dict[str, Array]]()
        for number, (motion, part, duty) in enumerate(zip(motions, parts, late, strict=True)):
            v = part.smooth.velocity[:, joint]
            kept = np.flatnonzero((np.abs(v) > STILL) & (motion.good[:, joint] > 0))[::THIN]
            made = low_pass(part.base(joint, motion.duty), motion.period, BAND)[kept]
            leans = np.zeros((len(kept), 3 * len(motions)))
            leans[:, 3 * number : 3 * number + 3] = low_pass(part.by_lean[:, :, joint].T, motion.period, BAND)[kept]
            terms = {key: low_pass(each, motion.period, BAND)[kept] for key, each in part.terms(joint).items()}
            u.append(duty[kept, joint])
            base.append(made)
            tilt.append(leans)
            columns.append(terms)
        each = {key: np.concatenate([part[key] for part in columns]) for key in columns[0]}
        found.append(_Joint(np.concatenate(u), np.concatenate(base), each, np.concatenate(tilt)))
        found[-1].weigh()
    return found


class _Sensitivity:
    """The torque that the links of a motion take, and its derivatives."""

    def __init__(self, motion: RecordedMotion, player: OpenLoopPlayer, start: DriveParameters) -> None:
        self.smooth = smooth_motion(motion)
        self._middle = _middle(player.spec)
        springy = np.where(start.bristle > SPRINGY, start.bristle, 0.0)
        self._side = friction_side(self.smooth.velocity, springy, motion.period)
        self._time = np.arange(len(motion.position)) * motion.period
        self._friction = start.frictionloss / start.torque_constant
        self._damping = start.damping / start.torque_constant
        player.links_only(start.mass_scale, motion.weight)
        self.torque = self._links(player, motion.gravity)
        down = motion.gravity
        axes = rotate_vector(np.tile(down, (3, 1)), _NUDGE * np.eye(3))
        self.by_lean = np.array([(self._links(player, each) - self.torque) / _NUDGE for each in axes])
        self.by_place = np.zeros_like(self.torque)
        longest = max(len(finger.joints) for finger in player.spec.fingers)
        for place in range(longest):
            own = [finger.joints[place] for finger in player.spec.fingers if place < len(finger.joints)]
            off = np.zeros(player.spec.n_joints)
            off[own] = _NUDGE
            self.by_place[:, own] = ((self._links(player, down, off) - self.torque) / _NUDGE)[:, own]

    def base(self, joint: int, duty: Array) -> Array:
        """The columns that are always there, (k, 7)."""
        v, side = self.smooth.velocity[:, joint], self._side[:, joint]
        slow, load = side * np.exp(-np.square(v / _STRIBECK)), side * np.abs(duty[:, joint])
        columns = (
            self.torque[:, joint],
            self.smooth.acceleration[:, joint],
            v,
            side,
            slow,
            load,
            self.by_place[:, joint],
        )
        return np.stack(columns, axis=1)

    def terms(self, joint: int) -> dict[str, Array]:
        """The columns that may be there, but for the ripple's, which `_Joint` makes."""
        q, v = self.smooth.position[:, joint], self.smooth.velocity[:, joint]
        found = {"bias": np.ones((len(q), 1)), "uneven": -np.abs(v)[:, None]}
        found["spring"] = (self._middle[joint] - q)[:, None]
        found[_SPRING] = np.concatenate([found["bias"], found["spring"]], axis=1)
        waves = {f"cogging:{count:g}": np.stack([np.cos(count * q), np.sin(count * q)], axis=1) for count in PERIODS}
        rubs = self._friction[joint] * self._side[:, joint] + self._damping[joint] * v
        cold = {f"warmth:{time:g}": (rubs * np.exp(-self._time / time))[:, None] for time in WARM_UPS}
        # Never taken: `_Joint.is_smooth` compares it with cogging.
        return found | waves | cold | {"angle": np.stack([np.ones_like(q), q, q**2, q**3], axis=1)}

    def _links(self, player: OpenLoopPlayer, down: Vector, off: Vector | float = 0.0) -> Array:
        motion = zip(*self.smooth, strict=True)
        return np.array([player.link_torque(q + off, v, a, down) for q, v, a in motion])
