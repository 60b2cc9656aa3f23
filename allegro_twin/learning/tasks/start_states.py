"""Start states of in-hand tasks: fingers hold an object above the upturned palm. They are searched for once and
stored.

The search closes postures of the right hand around an object, lets it go, and keeps what holds; for tasks in the
fingertips what fingertips alone hold, once for trainings and once for tests. Fingertips press on an object's sides, or
it lies on them. Postures of the Allegro Hand that press are drawn from ranges of its joints; all others from around
those in which fingertips oppose each other across a ball.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from allegro_twin.control import laws
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import cache_folder, data_root
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.fingerprints import fingerprint
from allegro_twin.grasping.plan.proposals.close_in_geometry import motor_scale
from allegro_twin.grasping.plan.proposals.opposition import OpposingGrasp, opposing_grasps
from allegro_twin.grasping.plan.proposals.poses import closing_directions
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import HAND
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_from_vector
from allegro_twin.learning.environments.randomise import PhysicsRandomiser
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.tasks.base import Flags
from allegro_twin.learning.tasks.scenes import FACING, OBJECT, palm_height, upturned_model
from allegro_twin.learning.tasks.vectors import tilt
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.cpu import CpuBatch
from allegro_twin.sim.batch.link_contacts import LinkContacts
from allegro_twin.sim.batch.shared_model import SharedModelBatch
from allegro_twin.sim.engine.backend import substeps
from allegro_twin.sim.hand_import.adapt import find_mjcf
from allegro_twin.sim.model.physics import Physics as ScenePhysics
from allegro_twin.sim.objects.catalogue import GraspObject
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

log = logging.getLogger(__name__)

FRICTION = 0.5
"""Sliding friction at which the object must be held."""
PERIOD = 0.003  # s, of the control law, and of the physics where a hand bears it.
AT_ONCE = 512  # Simulations.
_CARRIED, _CLOSING, _SEEN, _WATCHED, _PERIODS = 60, 80, 110, 250, 450  # Periods: the object is released, the fingers
# have closed, fallen objects are given up, the rest has come to rest, and the end.
_FALLEN = 0.008  # m
_STILL, _UPRIGHT = 0.001, np.radians(8.0)  # m of motion from then to the end; its tilt.
_GAP, _HIGHEST, _ASIDE = 0.008, 0.090, 0.035  # m: above the palm; highest middle; from the middle of the palm's edge.


class StartCandidates(NamedTuple):
    """Candidates to try, one per row."""

    posture: Array
    """Before the fingers close, (n, joints), rad."""
    target: Array
    """When they have closed, (n, joints), rad."""
    place: Array
    """Position of the object's middle, world, (n, 3), m."""
    yaw: Array
    """Yaw of the object, (n,), rad."""


@dataclass(frozen=True, slots=True)
class StartStateSearch:
    """Ranges of the candidates, rad: fingers opposite the thumb, in any posture that leaves room for the object between
    them. Its repr is part of the name of the stored file."""

    finger: tuple[tuple[float, float], ...] = ((0.0, 0.0), (0.75, 1.55), (0.0, 1.0), (0.0, 0.8))
    """From the palm outward."""
    thumb: tuple[tuple[float, float], ...] = ((0.7, 1.39), (0.4, 1.16), (0.0, 1.3), (-0.1, 1.0))
    spread: float = 0.15
    """Range of a finger's spread about the others, rad."""
    squeeze: tuple[float, float] = (0.05, 0.30)
    press: tuple[float, float] = (0.0, 0.25)
    """Beyond the posture: of the fingers' base joints, and of the thumb's two."""
    below: tuple[float, float] = (-0.035, 0.005)
    """m, of the object's middle from the lowest tips."""
    apart: tuple[float, float] = (0.02, 0.1)
    """m, from the thumb to the fingers."""
    tips: int = field(default=0, repr=False)
    """Fingertips, at least, that must hold the object, and no other link may touch it; 0: whatever holds."""

    def tries(self, spec: HandSpec, sizes: Array, rng: np.random.Generator) -> StartCandidates:
        """Draw candidates for objects of these sizes, (n, 3), m, upright."""
        n, height, tips = len(sizes), sizes[:, 2], hand_kinematics(spec).batch_fingertips()
        posture, squeeze, place = (np.zeros((n, k)) for k in (16, 16, 3))
        missing = np.arange(n)
        while len(missing):
            posture[missing], squeeze[missing] = self._postures(len(missing), rng)
            posture = np.clip(posture, spec.lower + 0.01, spec.upper - 0.01)
            world = tips(posture[missing])[..., ::-1]  # The palm's x is up, its z along the world's x.
            fingers, thumb = world[:, :3].mean(axis=1), world[:, 3]
            place[missing] = (fingers + thumb) / 2
            low = np.minimum(fingers[:, 2], thumb[:, 2])
            place[missing, 2] = low + rng.uniform(*self.below, len(missing))
            apart = fingers[:, 0] - thumb[:, 0]
            good = (apart > self.apart[0]) & (apart < self.apart[1])
            good &= self.inside(spec, place[missing], height[missing])
            missing = missing[~good]
        target = np.clip(posture + squeeze, spec.lower, spec.upper)
        return StartCandidates(posture, target, place, rng.uniform(-np.pi / 4, np.pi / 4, n))

    def of(self, spec: HandSpec) -> Search:
        """The search for a hand: these ranges are of ours."""
        return self if spec.model == HAND else OpposedSearch(tips=self.tips).of(spec)

    def accepts(self, spec: HandSpec, position: Array, place: Array, height: Array) -> Flags:
        """Whether an object that has come to rest may stay there: as `inside`; joints (n, joints), rad."""
        return self.inside(spec, place, height)

    def inside(self, spec: HandSpec, place: Array, height: Array) -> Flags:
        """Where an object may be, with its middle at `place` (n, 3), m: above the palm, and neither high nor aside."""
        low = palm_height(spec) + height / 2 + _GAP
        found: Flags = (place[:, 2] > low) & (place[:, 2] < _HIGHEST) & (np.abs(place[:, :2]).max(axis=-1) < _ASIDE)
        return found

    def _postures(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        finger = np.array([rng.uniform(*wide, n) for wide in self.finger]).T
        fingers = finger[:, None] + rng.uniform(-self.spread, self.spread, (n, 3, 4))
        thumb = np.array([rng.uniform(*wide, n) for wide in self.thumb]).T
        squeeze = np.zeros((n, 4, 4))
        squeeze[:, :3, 1] = rng.uniform(*self.squeeze, (n, 1))
        squeeze[:, 3, 1:3] = rng.uniform(*self.press, (n, 2))
        return np.concatenate([fingers.reshape(n, 12), thumb], axis=1), squeeze.reshape(n, 16)


@dataclass(frozen=True, slots=True)
class OpposedSearch:
    """Candidates for a hand of which nothing more is known than where its fingertips are: around postures in which they
    oppose each other across a ball as wide as the object. Its repr is part of the name of the stored file."""

    wider: tuple[float, float] = (1.0, 1.3)
    """Diameter of the ball, in widths of the object."""
    joints: float = 0.12
    """rad, standard deviation."""
    opened: tuple[float, float] = (0.0, 0.2)
    """rad, by which what closes begins before the ball."""
    squeeze: tuple[float, float] = (0.15, 0.6)
    """rad, by which it is told to go on from there."""
    place: float = 0.008
    """m, standard deviation of the object's middle from the ball's."""
    tips: int = field(default=0, repr=False)
    """As above."""

    def tries(self, spec: HandSpec, sizes: Array, rng: np.random.Generator) -> StartCandidates:
        """Draw candidates for objects of these sizes, (n, 3), m, upright."""
        n, known = len(sizes), _most_fingers(spec)
        ball = sizes[:, :2].mean(axis=1) * rng.uniform(*self.wider, n)
        chosen = [min(known, key=lambda grasp: abs(grasp.diameter - wide)) for wide in ball.tolist()]
        scale, edge = motor_scale(spec), 0.01 * motor_scale(spec)
        closing = np.array([closing_directions(grasp, spec) for grasp in chosen]) * scale
        posture = np.array([grasp.close for grasp in chosen]) + self.joints * scale * rng.normal(size=closing.shape)
        posture = posture - closing * rng.uniform(*self.opened, (n, 1))
        posture = np.clip(posture, spec.lower + edge, spec.upper - edge)
        target = np.clip(posture + closing * rng.uniform(*self.squeeze, (n, 1)), spec.lower, spec.upper)
        middle = np.array([grasp.centre for grasp in chosen]) @ matrix_from_quaternion(np.array(FACING)).T
        place = middle + self.place * rng.normal(size=(n, 3))
        return StartCandidates(posture, target, place, rng.uniform(-np.pi / 4, np.pi / 4, n))

    def of(self, spec: HandSpec) -> Search:
        """As above: no more tips than the hand has."""
        return replace(self, tips=min(self.tips, len(spec.fingers)))

    def accepts(self, spec: HandSpec, position: Array, place: Array, height: Array) -> Flags:
        """As above."""
        return self.inside(spec, place, height)

    def inside(self, spec: HandSpec, place: Array, height: Array) -> Flags:
        """Where an object may be, with its middle at `place` (n, 3), m: above the palm."""
        found: Flags = place[:, 2] > palm_height(spec) + height / 2 + _GAP
        return found


@dataclass(frozen=True, slots=True)
class CradleSearch(OpposedSearch):
    """Candidates of any hand with the object's middle above the fingertips: it lies on them. Its repr is part of the
    name of the stored file."""

    wider: tuple[float, float] = (0.6, 1.0)
    opened: tuple[float, float] = (0.0, 0.1)
    squeeze: tuple[float, float] = (0.0, 0.25)
    raised: tuple[float, float] = (0.25, 0.8)
    """Height of the object's middle over the ball's, in half sizes of the object."""
    above: float = 0.008
    """m, at least, of the object's middle over the mean of the fingertips, once it has come to rest."""

    def tries(self, spec: HandSpec, sizes: Array, rng: np.random.Generator) -> StartCandidates:
        found = OpposedSearch.tries(self, spec, sizes, rng)
        place = found.place.copy()
        place[:, 2] += sizes.mean(axis=1) / 2 * rng.uniform(*self.raised, len(sizes))
        return found._replace(place=place)

    def accepts(self, spec: HandSpec, position: Array, place: Array, height: Array) -> Flags:
        """As above, with its middle `above` the fingertips."""
        tips = hand_kinematics(spec).batch_fingertips()(position) @ matrix_from_quaternion(np.array(FACING)).T
        found: Flags = place[:, 2] - tips[..., 2].mean(axis=1) > self.above
        return found & self.inside(spec, place, height)


Search: TypeAlias = StartStateSearch | OpposedSearch


class StartSet(NamedTuple):
    """A set of states of one object."""

    seed: int
    most: int
    """States."""
    sizes: tuple[tuple[float, float], ...]
    """Ranges of the factor on the object's size."""


def try_candidates(
    spec: HandSpec, grasp_object: GraspObject, search: Search, wanted: StartSet, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """Try one batch. Returns what was held: joint positions and targets (m, joints), rad, pose (m, 7), m, and factor on
    the size (m,)."""
    (worlds, steps), rows = _over_the_palm(spec, grasp_object, AT_ONCE), np.arange(AT_ONCE)
    body = worlds.free_body(OBJECT)
    physics = PhysicsRandomiser(worlds, body)
    size = physics.sizes(worlds.variant, _draw_sizes(wanted.sizes, rng))
    sizes = 2.0 * size[:, None] * grasp_object.half_extents()
    physics.apply(rows, {"size": size})
    posture, target, place, yaw = search.tries(spec, sizes, rng)
    turned = quaternion_from_vector(yaw[:, None] * (0.0, 0.0, 1.0))
    worlds.place(rows, posture)
    watched, going, contacts, command = place, rows, LinkContacts(worlds), _fingers(spec, worlds)
    for k in range(_PERIODS):
        if k < _CARRIED:
            body.pose[:, :3], body.pose[:, 3:] = place, turned
            body.velocity[...] = body.spin[...] = 0.0
        if k == _SEEN:
            going = _unmoved(body.pose[:, :3], place, _FALLEN)
        if k == _WATCHED:
            watched = np.array(body.pose[:, :3])
        setpoint = posture + (target - posture) * min(k / _CLOSING, 1.0)
        command(setpoint)
        worlds.step(None if k < _SEEN else going, steps)
        if k >= _WATCHED:
            contacts.add_period()
    still = np.intersect1d(going, _unmoved(body.pose[:, :3], watched, _STILL))
    good = search.accepts(spec, worlds.position[still], body.pose[still, :3], sizes[still, 2])
    good &= tilt(body.pose[still, 3:]) < _UPRIGHT
    if search.tips:
        good &= (contacts.touching("tips") >= search.tips)[still]
        good &= ((contacts.touching("middle") + contacts.touching("palm")) == 0)[still]
    kept = still[good]
    return worlds.position[kept], target[kept], body.pose[kept], size[kept]


def _over_the_palm(spec: HandSpec, grasp_object: GraspObject, n: int) -> tuple[CpuBatch, int]:
    """`n` simulations of an object over the upturned palm, and their steps of physics in a control period."""
    settings = EnvSettings(timestep=spec.longest_step(PERIOD))
    worlds = CpuBatch(spec, upturned_model(spec, grasp_object, (0.0, 0.0, 0.2), settings, FRICTION), n, 0)
    worlds.choose(np.arange(n), np.zeros(n, np.int64))
    return worlds, substeps(PERIOD, settings.timestep)


def _fingers(spec: HandSpec, worlds: SharedModelBatch) -> Callable[[Array], None]:
    """Tells all fingers where to be, (n, joints), rad, in the period that comes."""
    if worlds.closes_loop:
        return worlds.command
    gains = load_gains("default", spec)

    def command(setpoint: Array) -> None:
        worlds.control[...] = laws.pd(setpoint - worlds.position, -worlds.velocity, gains.kp, gains.kd)

    return command


def survives_noise(spec: HandSpec, grasp_object: GraspObject, states: StartStates, rng: np.random.Generator) -> Flags:
    """Whether fingertips still hold, and nothing else does, after `SHAKES` draws of an episode's own noise on each
    state, (m,)."""
    many = np.tile(np.arange(len(states.size)), SHAKES)
    rows = np.arange(len(many))
    worlds, steps = _over_the_palm(spec, grasp_object, len(many))
    body = worlds.free_body(OBJECT)
    physics = PhysicsRandomiser(worlds, body)
    physics.apply(rows, {"size": physics.sizes(worlds.variant, states.size[many])})
    place = states.pose[many, :3] + rng.uniform(-NOISE_PLACE, NOISE_PLACE, (len(many), 3))
    shaken = states.position[many] + rng.uniform(-NOISE_JOINT, NOISE_JOINT, (len(many), spec.n_joints))
    worlds.place(rows, np.clip(shaken, spec.lower, spec.upper))
    body.pose[:, :3], body.pose[:, 3:], contacts = place, states.pose[many, 3:], LinkContacts(worlds)
    command = _fingers(spec, worlds)
    for _ in range(_WATCHED):
        command(states.target[many])
        worlds.step(None, steps)
        contacts.add_period()
    kept = np.linalg.norm(body.pose[:, :3] - place, axis=-1) < _FALLEN
    kept &= contacts.touching("palm") == 0
    found: Flags = kept.reshape(SHAKES, -1).all(axis=0)
    return found


def _draw_sizes(ranges: tuple[tuple[float, float], ...], rng: np.random.Generator) -> Array:
    """Evenly from all ranges, (AT_ONCE,)."""
    if len(ranges) == 1:
        whole: Array = rng.uniform(*ranges[0], AT_ONCE)
        return whole
    low, high = np.array(ranges)[rng.choice(len(ranges), AT_ONCE, p=_widths(ranges))].T
    found: Array = rng.uniform(low, high)
    return found


def _widths(ranges: tuple[tuple[float, float], ...]) -> Array:
    wide = np.array([high - low for low, high in ranges])
    shares: Array = wide / wide.sum()
    return shares


def _unmoved(place: Array, other: Array, most: float) -> Rows:
    """Rows that are at most `most` from where they were."""
    return np.flatnonzero(np.linalg.norm(place - other, axis=-1) < most)


@lru_cache(maxsize=8)
def _most_fingers(spec: HandSpec) -> list[OpposingGrasp]:
    """The hand's opposing grasps with as many fingers as it has them with."""
    found = opposing_grasps(spec)
    most = max(len(grasp.fingers) for grasp in found)
    return [grasp for grasp in found if len(grasp.fingers) == most]


VERSION = 2
"""Version of the search, counted up when it would find other states."""
ANYHOW = StartStateSearch()
"""Whatever holds, proximal links and palm's edge included: for tasks that allow the palm."""
FINGERTIPS = StartStateSearch(below=(-0.02, 0.01), tips=3)
"""Three fingertips or four, the thumb's among them, and nothing else."""
CRADLE = CradleSearch(tips=3)
"""Search for states with the object on three fingertips or more."""
ALL = StartSet(20260101, 1024, ((0.9, 1.1),))
"""Start states of `ANYHOW`."""
TRAIN = StartSet(20260101, 512, ((0.9, 1.1),))
"""Start states of `FINGERTIPS`, for trainings."""
TEST = StartSet(20260102, 256, ((0.85, 0.9), (1.1, 1.15)))
"""For tests: no state of a training, and of sizes that no training has."""
NOISE_JOINT, NOISE_PLACE, SHAKES = 0.02, 0.001, 4
"""rad and m: half-widths of an episode's noise on its start; draws of it that a state of `FINGERTIPS` survives."""
MOST, HOPELESS = 200, 4
"""Batches, after which a search that finds too little ends, and one that has found nothing."""
OPPOSED_MOST = 16
"""Most batches of the first search for a hand of which little is known: some minutes."""
TOLD, FIRST_TOLD = 8, (2, 4)
"""Batches from one line on a search's progress to the next, some 16 s of two cores; and after which there are such
lines in the beginning."""


@dataclass(frozen=True, slots=True, eq=False)
class StartStates:
    """Start states of one side, one per row, in order of size."""

    position: Array
    """Joint positions, (m, n), rad."""
    target: Array
    """Set-points of the position control that holds the object, (m, n), rad."""
    pose: Array
    """Pose of the object, world, (m, 7), m."""
    size: Array
    """Factor on the object's size, (m,)."""

    def of(self, rows: Any) -> StartStates:
        """Those of some rows."""
        return StartStates(self.position[rows], self.target[rows], self.pose[rows], self.size[rows])


class _Found:
    """States that a search has found up to now, in order. With a `file` it is there after every batch, and who searches
    again for the same goes on from it, to the same states."""

    def __init__(self, seed: int, file: Path | None) -> None:
        self.rng, self.file, self.batches = np.random.default_rng(seed), file, 0
        self.columns: tuple[Array, ...] = ()
        """Joint positions, targets, poses and sizes, as in `StartStates`."""
        if file is not None and file.is_file():
            with np.load(file) as kept:
                self.columns, self.batches = tuple(kept[f"column_{k}"] for k in range(4)), int(kept["batches"])
                self.rng.bit_generator.state = json.loads(str(kept["random"]))

    def __len__(self) -> int:
        return len(self.columns[0]) if self.columns else 0

    def add(self, part: tuple[Array, ...]) -> None:
        """Add a batch. Raises RecordingError where the file cannot be written."""
        old = self.columns or tuple(column[:0] for column in part)
        self.columns = tuple(np.concatenate(pair) for pair in zip(old, part, strict=True))
        self.batches += 1
        if self.file is None:
            return
        arrays: dict[str, Any] = {f"column_{k}": column for k, column in enumerate(self.columns)}
        random = json.dumps(self.rng.bit_generator.state)
        with atomic_file(self.file) as temporary, temporary.open("wb") as file:
            np.savez(file, batches=self.batches, random=random, **arrays)

    def line(self, count: int) -> str:
        """How far the search is that wants so many."""
        return f"{min(len(self), count)} of {count} start states, after {self.batches * AT_ONCE:,} tries,"


def load_start_states(
    grasp_object: GraspObject, side: str, search: Search = ANYHOW, wanted: StartSet = ALL, model: str = HAND
) -> StartStates:
    """Load start states from the package, or from the cache of this machine; the first use searches for some minutes,
    says so, and goes on where it was interrupted. `model`: of hand, by name or card. Raises ConfigError without a
    cache, and for a hand whose fingertips hold nothing."""
    spec = load_spec(model)
    kind = search.of(spec)
    name = file_name(grasp_object, kind, wanted, spec)
    path = data_root() / "conf" / "starts" / name
    if not path.is_file():
        path = cache_folder("starts", f"how fingertips hold a {grasp_object.name}") / name
        if not path.is_file():
            log.warning(
                "%s: searching for %d start states, in which the fingers of %s hold it; that takes some minutes, "
                "happens once, and is kept in %s", grasp_object.name, wanted.most, spec.model, path.parent
            )  # fmt: skip
            write_start_states(grasp_object, path, kind, wanted, spec, path.with_name(f"{path.stem}.unfinished.npz"))
    found = _read(path)
    return found if side == spec.side else _mirror(found, spec)


def write_start_states(
    grasp_object: GraspObject,
    path: Path,
    search: Search = ANYHOW,
    wanted: StartSet = ALL,
    spec: HandSpec | None = None,
    unfinished: Path | None = None,
) -> None:
    """Search for the start states of a right hand, ours where none is given, and write them. `unfinished`: as in
    `search_start_states`. Raises RecordingError."""
    try:
        found = search_start_states(grasp_object, search, wanted, spec, unfinished)
    except ConfigError:  # It has ended, with nothing.
        _remove(unfinished)
        raise
    arrays = {"position": found.position, "target": found.target, "pose": found.pose, "size": found.size}
    short = {name: array.astype(np.float32) for name, array in arrays.items()}
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **short)  # type: ignore[arg-type]  # Taken for its options.
    _remove(unfinished)


def _remove(file: Path | None) -> None:
    if file is not None:
        file.unlink(missing_ok=True)


def search_start_states(
    grasp_object: GraspObject,
    search: Search,
    wanted: StartSet = ALL,
    spec: HandSpec | None = None,
    unfinished: Path | None = None,
) -> StartStates:
    """Search for as many states as are wanted, or as a long search finds; those in the fingertips that noise shakes
    loose are left out. `unfinished`: a file that has what was found before an interruption, and from which the search
    goes on; whoever has stored the result removes it. Raises ConfigError where it finds none."""
    count, spec = wanted.most, spec or load_spec(side="right")
    most, held = MOST if spec.model == HAND else OPPOSED_MOST, _Found(wanted.seed, unfinished)
    if held.batches:
        log.warning("%s: %s are there from an interrupted search, which goes on", grasp_object.name, held.line(count))
    try:
        while len(held) < count and held.batches < (most if len(held) else HOPELESS):
            held.add(try_candidates(spec, grasp_object, search, wanted, held.rng))
            if (held.batches in FIRST_TOLD or held.batches % TOLD == 0) and len(held) < count:
                log.warning("%s: %s are found", grasp_object.name, held.line(count))
    except KeyboardInterrupt:
        kept = unfinished is not None and held.batches > 0
        then = "they are kept, and the next search goes on from them" if kept else "nothing is kept"
        log.warning("%s: interrupted: %s are found; %s", grasp_object.name, held.line(count), then)
        raise
    none = ConfigError(
        f"no grasp of the fingertips of {spec.model} was found that holds {grasp_object.name} above the palm: it may "
        "be too large, too small or too heavy"
    )
    if not len(held):
        raise none
    columns = [column[:count] for column in held.columns]
    order = np.argsort(columns[3], kind="stable")
    found = StartStates(*(column[order] for column in columns))
    if not search.tips:
        return found
    firm = survives_noise(spec, grasp_object, found, np.random.default_rng((wanted.seed, 1)))
    if not firm.any():
        raise none
    return found.of(firm)


def file_name(
    grasp_object: GraspObject, search: Search = ANYHOW, wanted: StartSet = ALL, spec: HandSpec | None = None
) -> str:
    """File name; it depends on the search, the object and the hand, ours where none is given."""
    spec = spec or load_spec(side="right")
    # Without a unit the key is that of the states that ship.
    scale = 1.0 if grasp_object.scale is None else ("said", grasp_object.scale)
    own = (grasp_object.shape, grasp_object.size, grasp_object.mass, grasp_object.file, scale)
    sizes = wanted.sizes[0] if len(wanted.sizes) == 1 else wanted.sizes
    whole = (
        VERSION,
        own,
        repr(search).replace("StartStateSearch", "Search", 1),
        wanted.most,
        wanted.seed,
        sizes,
        FRICTION,
        _hand_fingerprint(spec),
        repr(ScenePhysics()),
    ) + ((search.tips,) if search.tips else ())
    return f"{fingerprint(*whole)}.npz"


def _hand_fingerprint(spec: HandSpec) -> str:
    """Fingerprint of the searching hand: shapes and masses, limits and motors."""
    own = data_root() / "models" / "mjcf" / f"{spec.name}.xml"
    motors, mjcf = spec.actuation, own if spec.foreign is None else find_mjcf(spec)
    driven: tuple[Any, ...] = (motors.torque_limit, motors.damping, motors.armature, motors.frictionloss)
    if spec.model != HAND:
        driven += (spec.model, motors.stiffness)
    return fingerprint(mjcf, spec.lower, spec.upper, driven)


def _mirror(right: StartStates, spec: HandSpec) -> StartStates:
    """Mirror the states, for the left hand."""
    pose = right.pose * (1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0)
    return StartStates(spec.mirror_posture(right.position), spec.mirror_posture(right.target), pose, right.size)


def _read(path: Path) -> StartStates:
    with np.load(path) as kept:
        return StartStates(*(kept[name].astype(np.float64) for name in ("position", "target", "pose", "size")))
