"""Posterior of one hand's drive, from the file that `identify` wrote, and draws of it for every simulation.

For each joint, with k' the drawn torque constant, k that of the file and z ~ N(0, C), C the correlations of the joint's
values in the file (1 on the diagonal and 0 beside it where it has none; values of two joints are independent):

    k' = k (1 + z h_k / (1.96 k)),    A' = k' (A / k + z h_A / 1.96),    likewise damping, friction, parasitic torque

h: half of the 95 % interval in the file, which is per k for A and all that a recording tells per torque constant. So a
draw that gives more torque also has more inertia and friction, as the recordings demand.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import array_namespace
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import find_file, read_yaml
from allegro_twin.hands.description.calibration import load_wiring
from allegro_twin.hands.description.specs import hand_side, load_spec
from allegro_twin.learning.environments.random_streams import Draws, jitter
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.shared_model import SharedModelBatch
from allegro_twin.spec import HandSpec, Side
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.types import Array, Vector

log = logging.getLogger(__name__)

NORMAL = 1.96
"""Standard deviations on either side of 95 %."""
SHARE_WIDE = {"strength": 0.25, "armature": 2.0 / 3.0, "damping": 0.3}
WIDE = {
    "frictionloss": 0.01, "encoder_offset": 0.03, "delay": 0.003, "load_friction": 0.03,
    "bias_torque": 0.005, "uneven_damping": 0.02, "cogging_cosine": 0.005, "cogging_sine": 0.005, "stiffness": 0.005,
    "ripple_cosine": 0.03, "ripple_sine": 0.03,
}  # fmt: skip
"""Half-widths about the file's value, uniform, of what is not determined: shares of it, and N·m per N·m of full PWM,
rad, s, 1, per full PWM N·m, N·m·s/rad and N·m/rad, and 1. The wider of today's nominal range (armature 0.001 to 0.005
kg·m²) and the interval beyond which `identify` calls a value not determined."""
CORE = ("strength", "armature", "damping", "frictionloss", "encoder_offset", "delay")
"""Values that are always drawn; the others where the file has them."""
_FILE_NAMES = {"strength": "torque_constant", "encoder_offset": "offset"}
"""Names under `identified`, where they differ."""
_SHARED = ("delay", "warmth")
"""Values of a hand, not of each joint."""
PARASITIC = ("bias_torque", "uneven_damping", "cogging_cosine", "cogging_sine", "stiffness")
_PER_PWM = ("armature", "damping", "frictionloss", *PARASITIC)
RIPPLE = ("ripple_cosine", "ripple_sine")
_SIGNED = ("encoder_offset", *PARASITIC, *RIPPLE)
_LEAST = 0.1
"""Least strength and armature, as a share of the file's: with none a joint cannot be simulated."""
_SIMULATED = ("mass_scale", "tip_mass", "tilt")
"""What is compiled into the models."""
_NOT_SIMULATED = ("stiction", "bristle", "backlash")
"""What takes steps of half a millisecond, which no environment takes. `stribeck_speed` belongs to the first two."""
_ORDER = (*CORE, "load_friction", *PARASITIC[:4], "warmth", *PARASITIC[4:], *RIPPLE)
"""Values in the order of their random numbers: one more does not change the others'."""
_KEYS = ("date", "program", "engine", "recordings", "scale", "friction", "backlash", "units", "per_pwm", "value",
         "interval", "correlation", "not_determined", "residual", "noise", "encoder_offset", "written",
         "kept_back")  # fmt: skip
"""Keys of the block `identified`, in every format that `identify` has written."""
_NAMES = ("torque_constant", "armature", "damping", "frictionloss", "offset", *(each.name for each in fields(Drive)))
_WRITTEN = ("nominal", "determined", "all")
_BEYOND = 10.0
"""Times a value and its nominal range together: no interval of a determined value is so wide."""
_STREAM = 12
"""Stream of the numbers of a reset (random_streams); encoder noise has the next one."""


class ValueSpread(NamedTuple):
    """Centre and half-width of one value, (joints,), or (1,) of the whole hand; per torque constant where a recording
    tells it so."""

    centre: Vector
    half: Vector
    """Half of the 95 % interval where it is determined, else the half-width of a uniform range."""
    identifiable: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class DrivePosterior:
    """Identified drive of one hand, with its uncertainty."""

    spec: HandSpec
    """The hand of the file; of its drive only what is compiled into models."""
    torque_constant: Vector
    """As the file has it and hosts believe, (joints,), N·m at full PWM."""
    spreads: Mapping[str, ValueSpread]
    noise: Vector
    """Standard deviation of reported positions, (joints,), rad, beside quantisation."""
    quantisation: Vector
    """(joints,), rad; 0: none."""
    cogging_periods: Vector
    ripple_periods: Vector
    cold_friction: Vector
    """Share by which friction and damping are larger when cold, (joints,)."""
    correlated: tuple[str, ...] = ()
    """Values that are drawn together."""
    mixing: Array | None = None
    """Lower triangular, (joints, m, m): turns independent normal numbers into theirs."""


def load_posterior(twin: str, model: str, side: Side) -> DrivePosterior:
    """The posterior of the hand in a file, by path or by its name in conf/hands. Logs one line on what the environments
    do not represent. Raises ConfigError for the file of another model or side, and for one that `identify` has not
    written."""
    path = find_file(twin, "hand", "conf/hands")
    table = read_yaml(path)
    spec = _own_spec(path, table, model, side)
    basis = table.get("identified")
    if not isinstance(basis, Mapping):
        raise ConfigError(f"randomise.twin: {path} has no `identified` block, so no widths to draw from: write it with "
                          f"allegro-twin identify RECORDINGS --hand {path}")  # fmt: skip
    _check_block(path, basis, spec)
    drive = spec.drive or Drive.from_values({}, spec.n_joints)
    missing = [name for name in _NOT_SIMULATED if (getattr(drive, name) > (name == "stiction")).any()]
    if missing:
        _warn_once(path, ", ".join(f"drive.{name}" for name in missing))
    simulated = {name: value for name, value in drive.plain().items() if name in _SIMULATED}
    fixed = Drive.from_values(simulated, spec.n_joints)
    plain = Drive.from_values({}, spec.n_joints)
    same = all(np.array_equal(getattr(fixed, name), getattr(plain, name)) for name in _SIMULATED)
    spreads = dict(_spreads(path, basis, spec, drive))
    correlated, mixing = _mixing(path, basis, spec, spreads)
    noise = _row(path, "noise", basis.get("noise", 0.0), spec.n_joints)
    noise = np.sqrt(np.maximum(noise**2 - drive.quantisation**2 / 12.0, drive.encoder_noise**2))
    return DrivePosterior(
        spec=replace(spec, drive=None if same else fixed),
        torque_constant=np.array(load_wiring(model, str(path)).calibration.torque_constant),
        spreads=spreads,
        noise=noise,
        quantisation=drive.quantisation,
        cogging_periods=drive.cogging_periods,
        ripple_periods=drive.ripple_periods,
        cold_friction=np.where(drive.warm_up > 0.0, drive.cold_friction, 0.0),
        correlated=correlated,
        mixing=mixing,
    )


@cache
def _warn_once(path: Path, keys: str) -> None:
    log.warning("randomise.twin: environments do not represent %s of %s: friction is Coulomb's, links have no play",
                keys, path)  # fmt: skip


def _own_spec(path: Path, table: Mapping[str, Any], model: str, side: Side) -> HandSpec:
    nominal = load_spec(model, side)
    if "torque" not in nominal.commands:
        raise ConfigError(f"randomise.twin: {path} is of a hand that takes torques, as `identify` knows them, and the "
                          f"environment's hand is {model}: leave out randomise.twin")  # fmt: skip
    if strange := [key for key in ("driven", "mjcf", "commands") if key in table]:
        raise ConfigError(f"randomise.twin: {path} is not the file of one {model} hand: it has `{strange[0]}`; give "
                          "the one that `identify` has written")  # fmt: skip
    its = hand_side(str(path))
    if its is not None and its != side:
        raise ConfigError(f"randomise.twin: {path} is of a {its} hand, and the environment's is {side}: side={its!r}")
    try:
        return load_spec(model, side, str(path))
    except ConfigError as error:
        raise ConfigError(f"randomise.twin: no {model} hand: {error}") from error


def _spreads(path: Path, basis: Mapping[str, Any], spec: HandSpec, drive: Drive) -> Iterator[tuple[str, ValueSpread]]:
    constant = np.array(load_wiring(spec.model, str(path)).calibration.torque_constant)
    intervals, missing = (_mapping(path, basis, name) for name in ("interval", "not_determined"))
    written = basis.get("written")
    nominal = [isinstance(written, Mapping) and written.get(joint) == "nominal" for joint in spec.joint_labels]
    centres = {"strength": drive.strength, "delay": np.array([drive.delay]), "encoder_offset": drive.encoder_offset}
    centres |= {name: getattr(spec.actuation, name) for name in ("armature", "damping", "frictionloss")}
    centres |= {name: getattr(drive, name) for name in WIDE if name not in centres}
    for name, value in centres.items():
        key = _FILE_NAMES.get(name, name)
        if name not in CORE and key not in intervals and not value.any():
            continue
        centre = value / (constant * drive.strength) if name in _PER_PWM else value
        wide = np.array(WIDE[name] if name in WIDE else SHARE_WIDE[name] * centre)
        if key not in intervals:
            # A drive beyond the core that someone wrote into the file by hand is what it says.
            sure = np.full(len(centre), name not in CORE)
            yield name, ValueSpread(centre, np.where(sure, 0.0, wide), sure)
            continue
        half = _row(path, f"interval.{key}", intervals[key], len(centre))
        half = half / constant * drive.strength if name == "strength" else half
        joints = _mapping(path, missing, key, "not_determined.")
        sure = np.array([label not in joints for label in spec.joint_labels[: len(centre)]])
        if name not in _SHARED:
            sure &= ~np.array(nominal)  # Its interval is about the value that was found, and nominal is what it has.
        if (sure & (half > _BEYOND * (np.abs(centre) + wide))).any():
            raise ConfigError(
                f"randomise.twin: {path}: identified.interval.{key} has half-widths of up to "
                f"{np.max(intervals[key]):g}, more than {_BEYOND:g} times the value and its nominal "
                "range: correct it, or name it in not_determined"
            )
        yield name, ValueSpread(centre, np.where(sure, half, wide), sure)


def _mixing(
    path: Path, basis: Mapping[str, Any], spec: HandSpec, spreads: Mapping[str, ValueSpread]
) -> tuple[tuple[str, ...], Array | None]:
    """Values that the file has correlations of, and the Cholesky factor of these for every joint, (joints, m, m); what
    is not determined is drawn apart. No values where the file has none."""
    table = _mapping(path, basis, "correlation")
    told = table.get("of", [])
    names = tuple(name for name in _ORDER if _FILE_NAMES.get(name, name) in told and name not in _SHARED)
    names = tuple(name for name in names if name in spreads)
    if not names:
        return (), None
    at, m = [told.index(_FILE_NAMES.get(name, name)) for name in names], len(names)
    found = np.empty((spec.n_joints, m, m))
    for joint, label in enumerate(spec.joint_labels):
        given, whole = table.get(label), np.zeros((len(told), len(told)))
        below = np.tril_indices(len(told), -1)
        numbers = given if isinstance(given, list) else []
        if len(numbers) != len(below[0]) or not all(_is_number(v) and abs(v) <= 1.0 for v in numbers):
            raise ConfigError(
                f"randomise.twin: {path}: identified.correlation.{label} needs {len(below[0])} numbers from -1 to 1, "
                f"what is below the diagonal for {len(told)} values, not {given!r}"
            )
        whole[below] = numbers
        sure = np.array([spreads[name].identifiable[joint] for name in names])
        own = np.where(np.outer(sure, sure), (whole + whole.T)[np.ix_(at, at)], 0.0)
        found[joint] = _factor(own + np.eye(m))
    return names, found


def _factor(correlation: Array) -> Array:
    """Cholesky factor of a matrix whose numbers were rounded, made positive definite where rounding left it not so."""
    values, vectors = np.linalg.eigh(correlation)
    near = (vectors * np.maximum(values, 1e-6)) @ vectors.T
    deviation = np.sqrt(np.diagonal(near))
    factor: Array = np.linalg.cholesky(near / np.outer(deviation, deviation))
    return factor


def _check_block(path: Path, basis: Mapping[str, Any], spec: HandSpec) -> None:
    """Raises ConfigError for keys, values, joints and words in `identified` that mean nothing: what is mistyped would
    widen or narrow the draws without a word."""
    missing, labels = _mapping(path, basis, "not_determined"), spec.joint_labels
    correlation = _mapping(path, basis, "correlation")
    written = basis.get("written")  # Once a sentence, and one where no part was kept back.
    by_joint = written if isinstance(written, Mapping) else {}
    told = correlation.get("of", [])
    if not isinstance(told, list):
        raise ConfigError(f"randomise.twin: {path}: identified.correlation.of must be a list of values, not {told!r}")
    for where, kind, given, known in (
        ("", "key", basis, _KEYS), (".interval", "value", _mapping(path, basis, "interval"), _NAMES),
        (".not_determined", "value", missing, _NAMES), (".correlation.of", "value", told, _NAMES),
        (".correlation", "joint", correlation.keys() - {"of"}, labels), (".written", "joint", by_joint, labels),
        (".written", "word", by_joint.values(), _WRITTEN),
        *((f".not_determined.{name}", "joint", _mapping(path, missing, name, "not_determined."), labels)
          for name in missing),
    ):  # fmt: skip
        for each in given:
            if each not in known:
                raise ConfigError(f"randomise.twin: {path}: identified{where}: {unknown(kind, str(each), known)}")


def _mapping(path: Path, table: Mapping[str, Any], name: str, within: str = "") -> Mapping[str, Any]:
    found = table.get(name) or {}
    if not isinstance(found, Mapping):
        raise ConfigError(f"randomise.twin: {path}: identified.{within}{name} must hold keys and values")
    return found


def _row(path: Path, name: str, given: object, n: int) -> Vector:
    row = given if isinstance(given, list) else [given] * n
    if len(row) != n or not all(_is_number(v) and v >= 0.0 for v in row):
        raise ConfigError(f"randomise.twin: {path}: identified.{name} needs {n} numbers from 0, one for each that this "
                          f"hand has, not {given!r}")  # fmt: skip
    return np.array(row, np.float64)


def _is_number(given: object) -> TypeGuard[float]:
    return isinstance(given, int | float) and not isinstance(given, bool) and math.isfinite(given)


class RandomDrive:
    """Drives of `n` hands, drawn from a posterior: what is in their models, and what happens in every period."""

    def __init__(self, posterior: DrivePosterior, worlds: SharedModelBatch, period: float) -> None:
        self._posterior, self._worlds, self._period = posterior, worlds, period
        xp = self._xp = worlds.xp
        n, joints = worlds.position.shape
        self._known = {
            name: ValueSpread(*(xp.asarray(part) for part in spread)) for name, spread in posterior.spreads.items()
        }
        self._constant, self._limit = (
            xp.asarray(row) for row in (posterior.torque_constant, posterior.spec.actuation.torque_limit)
        )
        self._cold = xp.asarray(posterior.cold_friction) if posterior.cold_friction.any() else None
        self._dofs = xp.asarray(worlds.dofs)
        self._motors = xp.asarray(np.arange(worlds.model.nu)[worlds.motors])
        self._own, self._key = xp.arange(n), xp.zeros(n, np.uint64)
        self._offset, self._late = xp.zeros((n, joints)), xp.zeros((n, 1))
        late = posterior.spreads["delay"]
        self._longest = float((late.centre + np.where(late.identifiable, 5.0 / NORMAL, 1.0) * late.half)[0])
        """s; five standard deviations."""
        self._past = xp.zeros((math.ceil(self._longest / period) + 2, n, joints))
        self._strength, self._dry = xp.ones((n, joints)), xp.zeros((n, joints))
        self._load = xp.zeros((n, joints)) if "load_friction" in self._known else None
        self._strays = {name: xp.zeros((n, joints)) for name in PARASITIC if name in self._known}
        self._ripples = {name: xp.zeros((n, joints)) for name in RIPPLE if name in self._known}
        self._periods, self._often = (xp.asarray(row) for row in (posterior.cogging_periods, posterior.ripple_periods))
        self._applied = worlds.joint_force if self._strays else None
        self._mixing = None if posterior.mixing is None else xp.asarray(posterior.mixing)
        self._noise = xp.asarray(math.sqrt(3.0) * posterior.noise) if posterior.noise.any() else None
        self._step = xp.asarray(posterior.quantisation) if posterior.quantisation.any() else None

    def begin(self, rows: Rows, draws: Draws) -> dict[str, Array]:
        """Draw new drives for some hands, and write what belongs there into their models. Returns what was drawn,
        (m, joints), or (m,) of a whole hand."""
        drawn, worlds, xp = self._draw(draws), self._worlds, self._xp
        self._key[rows] = draws.last_keys()
        strength, warm = drawn["strength"], 1.0
        if self._cold is not None:
            warm = 1.0 + self._cold * drawn["warmth"][:, None]
        at, limit = (rows[:, None], self._dofs), self._limit * strength
        worlds.expand("dof_armature")[at] = drawn["armature"]
        worlds.expand("dof_damping")[at] = drawn["damping"] * warm
        worlds.expand("dof_frictionloss")[at] = drawn["frictionloss"] * warm
        worlds.expand("actuator_gainprm")[rows[:, None], self._motors, 0] = strength
        worlds.expand("actuator_forcerange")[rows[:, None], self._motors] = xp.stack([-limit, limit], axis=-1)
        worlds.derive(rows)
        self._offset[rows], self._strength[rows] = drawn["encoder_offset"], strength
        self._dry[rows], self._late[rows] = drawn["frictionloss"] * warm, drawn["delay"][:, None] / self._period
        self._past[:, rows] = 0.0
        if self._load is not None:
            self._load[rows] = drawn["load_friction"]
        for name, own in (self._strays | self._ripples).items():
            own[rows] = drawn[name]
        return drawn

    def rub(self, dry: float) -> None:
        """Set the dry friction of all joints, N·m, until the next episode."""
        self._dry[...] = dry

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """What an episode changes, by name. What is in the models, and the torques on the joints, is theirs."""
        load = {} if self._load is None else {"load_friction": self._load}
        own = {"key": self._key, "offset": self._offset, "delay": self._late, "past": self._past,
               "strength": self._strength, "dry_friction": self._dry}  # fmt: skip
        return own | load | self._strays | self._ripples

    def report(self, position: Array, tick: NDArray[np.int64]) -> Array:
        """Joint positions as the encoders tell them, (n, joints), rad."""
        found = position + self._offset
        if self._noise is not None:  # Uniform, as wide as the standard deviation asks for.
            found = found + self._noise * jitter(self._key, tick, _STREAM + 1, position.shape[1])
        if (step := self._step) is not None:
            some = self._xp.where(step > 0, step, 1.0)
            found = self._xp.where(step > 0, step * self._xp.rint(found / some), found)
        return found  # type: ignore[no-any-return]  # Its functions have no types.

    def act(self, command: Array, tick: NDArray[np.int64]) -> Array:
        """Torques that motors are told in this period, (n, joints), N·m, of what was commanded in it and before.

        A delay of n + f periods lets the command before last act for f of a period: (1 - f) u[t - n] + f u[t - n - 1],
        which has the same impulse. Friction by load, parasitic torque and ripple are those at the beginning of the
        period.
        """
        xp, past, own = self._xp, self._past, self._own
        past[tick % len(past), own] = xp.clip(command, -self._limit, self._limit)
        whole = xp.floor(self._late)
        n, part = xp.asarray(whole[:, 0], np.int64), self._late - whole
        found: Array = (1.0 - part) * past[(tick - n) % len(past), own] + part * past[(tick - n - 1) % len(past), own]
        if self._ripples:
            angle = self._often * self._worlds.position
            waves = {"ripple_cosine": xp.cos(angle), "ripple_sine": xp.sin(angle)}
            found = found * (1.0 + sum(own * waves[name] for name, own in self._ripples.items()))
        if self._load is not None:
            loss = self._dry + self._load * xp.abs(found * self._strength)
            self._worlds.expand("dof_frictionloss")[:, self._dofs] = loss
        if self._applied is not None:
            self._applied[:, self._dofs] = self._stray_torque(self._worlds.position, self._worlds.velocity)
        return found

    def _stray_torque(self, position: Array, velocity: Array) -> Array:
        """As `sim/drivetrain/parasitic_torque.py` has it, (n, joints), N·m."""
        xp, angle, found = self._xp, self._periods * position, 0.0 * position
        of = {"bias_torque": 1.0, "stiffness": -position, "uneven_damping": -xp.abs(velocity),
              "cogging_cosine": xp.cos(angle), "cogging_sine": xp.sin(angle)}  # fmt: skip
        for name, own in self._strays.items():
            found = found + own * of[name]
        return found

    def _draw(self, draws: Draws) -> dict[str, Array]:
        key, xp = draws.last_keys(), self._xp
        found: dict[str, Array] = {}
        numbers, normal = {}, {}
        for name, spread in self._known.items():
            size = len(spread.centre)
            both = jitter(key, xp.zeros(len(draws), np.int64) + _ORDER.index(name), _STREAM, 2 * size)
            numbers[name], normal[name] = both[:, :size], _normal(both[:, :size], both[:, size:])
        normal |= self._mixed(normal)
        for name, spread in self._known.items():
            value = spread.centre + spread.half * xp.where(spread.identifiable, normal[name] / NORMAL, numbers[name])
            least = _LEAST * spread.centre if name in ("strength", "armature") else 0.0 * spread.centre
            value = value if name in _SIGNED else xp.maximum(value, least)
            if name in _PER_PWM:
                value = value * self._constant * found["strength"]
            found[name] = value
        found["delay"] = xp.minimum(found["delay"][:, 0], self._longest)
        if self._cold is not None:
            even = jitter(key, xp.zeros(len(draws), np.int64) + _ORDER.index("warmth"), _STREAM, 1)
            found["warmth"] = (1.0 + even[:, 0]) / 2.0
        return found

    def _mixed(self, normal: Mapping[str, Array]) -> dict[str, Array]:
        """Independent normal numbers, (m, joints) each, as the joints' values hang together."""
        names, factor = self._posterior.correlated, self._mixing
        return {} if factor is None else {
            name: sum(factor[:, i, k] * normal[other] for k, other in enumerate(names[: i + 1]))
            for i, name in enumerate(names)
        }  # fmt: skip


def _normal(first: Array, second: Array) -> Array:
    """Normal numbers of two arrays of uniform ones in [-1, 1) (Box and Muller 1958)."""
    xp = array_namespace(first)
    some = xp.maximum((1.0 - first) / 2.0, 1e-12)  # In single precision 1 occurs.
    found: Array = xp.sqrt(-2.0 * xp.log(some)) * xp.cos(math.pi * second)
    return found
