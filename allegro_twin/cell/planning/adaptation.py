"""A stored grasp, adapted to a solid that was never measured: seeds from the library, geometry, physics, draws.

The palms of stored grasps keep their distance from the surface of what was seen instead; these and variations of them
close in geometry and are ranked by the share of its limit that the weakest motor has to give (`grasping.plan`). What
the arm reaches with nothing near is closed in physics, and what holds there is tried under draws of what the camera
does not know: place, size, mass, friction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeVar

import numpy as np

from allegro_twin.cell.planning.stored_grasps import (
    MIRROR,
    StoredGrasp,
    body_text,
    extent_mismatch,
    own_parts,
    stored_grasps,
    symmetric_turns,
    yaw_rotation,
)
from allegro_twin.cell.settings import GraspPlanningSettings
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.batch.trials import PERIOD, TrialCase, TrialRunner
from allegro_twin.grasping.plan.candidate import (
    Candidate,
    ObjectSymmetry,
    candidate_grasp,
    candidate_scenario,
    limit_squeeze,
    palm_distance,
)
from allegro_twin.grasping.plan.close_in_simulation import FingerGains, close_candidates
from allegro_twin.grasping.plan.proposals.close_in_geometry import COARSE
from allegro_twin.grasping.plan.proposals.poses import closing_directions
from allegro_twin.grasping.plan.proposals.propose import Proposer
from allegro_twin.grasping.plan.validate import SQUEEZES
from allegro_twin.grasping.scenario import Scenario, ScenarioObject, Wrist, load_protocol
from allegro_twin.grasping.timeline import make_stage, place_object
from allegro_twin.grasping.uncertainty import Perturbation, sample_perturbations
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.grasps import Grasp, build_grasp, entry_from_grasp
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.pose import Pose
from allegro_twin.sim.contact.grasp_scene import GraspScene
from allegro_twin.sim.contact.obstacle_clearance import TableObject
from allegro_twin.sim.objects.catalogue import PlacedObject
from allegro_twin.sim.objects.compound import write_compound
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector

P = TypeVar("P")
_PROTOCOL = "lift"
_CARDS, _OF_PART = 12, 6
"""Stored grasps that are varied, those of the most similar things; of a compound for each of its parts, and for the box
around it."""
_OTHER_KIND = 0.3
"""So much less similar is a thing of another kind, as a logarithm of a ratio of extents."""
_VARIED = 4
"""Variations of a stored grasp in a round; in the next one twice as many."""
_APART, _TURNED = 0.01, 12.0
"""m and degrees: what physics closes differs by that much."""
_LOOKED = 3
"""For each candidate that physics is to close, so many are shown to the arm at most."""
_STRONG = 1.15
"""Share of its limit that a motor may have to give; what needs more does not hold."""
_FIRST, _MORE, _LEFT = 3, 5, 3
"""Draws that everybody gets, and that the best get after them, and how many these are."""
_GOOD, _ENOUGH = 0.85, 0.6
"""Shares of draws held: with the first it is taken at once, with the second when nothing better comes."""
_SIMILAR = 0.03
"""Logarithm of a ratio of extents, up to which a grasp that was found before is taken again."""
_STIRRED, _TURNED_BY, _SCATTER = 0.01, 0.1, 0.002
"""m, the sine of an angle, and m of an edge: what differs by less between two pictures stands where it stood. What is
seen of a rod of 90 mm that nobody touches scatters by 5 mm."""
_GAP = (0.006, 0.011)
"""m, between hand and table: an arm that comes down in a second goes 3 mm too far."""
_FAR, _THIN = 0.4, 0.004
"""m: what is further away is in nobody's way; a box's edge at least."""
_ROUND_TURNS, _HEAVY = 8, 1000.0
"""Turns about the axis of a round object that are tried; density of other objects, kg/m³, which nothing moves in
geometry."""
_LIGHTER = 0.5
"""Share of the density: what cannot be lifted otherwise may be hollow."""
_AIR = 1e-4
"""m, under what is put on the table."""
_LIGHTEST = 0.02
"""kg."""
_FRICTION = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class AdaptedGrasp:
    """A grasp for what was seen, and how often it held in draws of the trial."""

    card: StoredGrasp
    held: int
    tried: int

    @property
    def share(self) -> float:
        """Share of the draws in which it held."""
        return self.held / self.tried


class _Failure(NamedTuple):
    """A search that found nothing."""

    body: TableObject
    beside: int
    """Obstacles."""
    room: float
    error: ConfigError
    mass: float
    """kg."""
    said: str
    anywhere: bool
    """The arm got to all that it looked at, and nothing stood beside: wherever such a thing lies, nothing is found."""


@dataclass(slots=True, eq=False)
class GraspAdapter:
    """Finds grasps for solids on a table, for one hand, and remembers them."""

    spec: HandSpec
    settings: GraspPlanningSettings
    gains: str = "default"
    seed: int = 0
    found: list[AdaptedGrasp] = field(default_factory=list)
    on_progress: Callable[[str], None] = lambda said: None
    """Hears how far a search is, as sentences: one where it begins, one after the draws of each round, and one of the
    grasp that is taken."""
    _failed: list[_Failure] = field(default_factory=list)

    def forget_failures(self) -> None:
        """Where something has changed on the table, what was out of reach may be in it."""
        self._failed.clear()

    def plan(
        self,
        body: TableObject,
        feasible: Callable[[StoredGrasp], P | None],
        others: Sequence[TableObject] = (),
        room: float = 0.0,
        prefer: Callable[[P], bool] = lambda plan: True,
    ) -> P:
        """What `feasible` makes of the best grasp for a body: a plan of the arm's, or None for one that it cannot get
        to. `others`: what stands beside it; with them each grasp counts as it is, without the turns that the body's
        symmetry leaves open. `room`: that is kept to them, m: what failed with one may succeed with another. `prefer`:
        whether a plan is taken before others that are good enough. Where nothing lifts it, it is taken to be lighter.
        Raises ConfigError where nothing is found, with what became of the candidates."""
        for known in [] if others else self.found:
            if known.card.body.kind == body.kind and extent_mismatch(known.card.body, body) < _SIMILAR:
                plan = feasible(known.card)
                if plan is not None and prefer(plan):
                    return plan
        for failure in self._failed:
            if _is_same(failure.body, body) and (failure.beside, failure.room) == (len(others), room):
                raise failure.error
            if failure.anywhere and not others and _alike(failure.body, body):
                raise self._none_for(body, failure.mass, failure.said)
        for density in (self.settings.density, _LIGHTER * self.settings.density):
            with TemporaryDirectory(prefix="compound") as folder:
                search = AdaptationSearch(self, body, others, density, Path(folder))
                self.on_progress(
                    f"adapts stored grasps to the {body_text(body)}, taken to weigh {1e3 * search.mass:.0f} g"
                )
                found = self._searched(search, feasible, prefer)
            if found is not None:
                option, plan = found
                self.on_progress(f"takes one that held in {option.held} of {option.tried} draws")
                if not others:
                    self.found.append(option)
                return plan
            if not search.too_heavy:
                break  # Its weight is not what is in the way.
        error = self._none_for(body, search.mass, search.summary())
        anywhere = search.examined == search.reached and not others
        self._failed.append(_Failure(body, len(others), room, error, search.mass, search.summary(), anywhere))
        raise error

    def _none_for(self, body: TableObject, mass: float, said: str) -> ConfigError:
        return ConfigError(
            f"no grasp of {self.spec.model} is for the {body_text(body)}, of {1e3 * mass:.0f} g if it is as "
            f"dense as most: {said}; move it to where the arm has more room, or put it on another side"
        )

    def _searched(
        self, search: AdaptationSearch, feasible: Callable[[StoredGrasp], P | None], prefer: Callable[[P], bool]
    ) -> tuple[AdaptedGrasp, P] | None:
        """The best that a search finds and the arm gets to, and the arm's plan."""
        found = list[tuple[AdaptedGrasp, P]]()
        rounds = self.settings.rounds
        for number, enough in enumerate([_GOOD] * (rounds - 1) + [_ENOUGH], 1):
            search.round(lambda card: feasible(card) is not None)
            best = self._best_at_once(search, feasible, prefer)
            self.on_progress(f"round {number} of {rounds}: {search.summary()}")
            if best is not None:
                return best
            plans = ((option, feasible(option.card)) for option in search.options if option.share >= enough)
            found = [(option, plan) for option, plan in plans if plan is not None]
            found.sort(key=lambda each: -each[0].share)
            for option, plan in found:
                if prefer(plan):
                    return option, plan
        return found[0] if found else None

    def _best_at_once(
        self, search: AdaptationSearch, feasible: Callable[[StoredGrasp], P | None], prefer: Callable[[P], bool]
    ) -> tuple[AdaptedGrasp, P] | None:
        """Draws for the best of a round, up to the first that holds in all of them: nothing that is left can be
        better."""
        while (option := search.draw_more()) is not None:
            if option.held == option.tried and (plan := feasible(option.card)) is not None and prefer(plan):
                return option, plan
        return None


class AdaptationSearch:
    """Rounds of variations of stored grasps on one solid, or on the parts of a compound, and what has become of them.
    `folder`: where a compound's files are put."""

    def __init__(
        self, adapter: GraspAdapter, body: TableObject, others: Sequence[TableObject], density: float,
        folder: Path = Path(),
    ) -> None:  # fmt: skip
        self._own, self._settings, self._draws = adapter.spec, adapter.settings, adapter.seed
        self._spec = load_spec(self._own.model, "right")  # A left hand takes the mirror image: the solid is its own.
        self._body, self._random = body, np.random.default_rng(adapter.seed)
        hull = replace(body, kind="box", parts=()) if body.parts else body
        targets = [*own_parts(body), replace(hull, yaw=0.0, position=np.zeros(3))]
        cards = [card for card in stored_grasps(self._spec.model) if card.grasp.grip is None]
        most = _OF_PART if body.parts else _CARDS
        self._targets = targets
        self._cards = [sorted(cards, key=lambda card: _unlike(card.body, target))[:most] for target in targets]
        self._templates = {card.name: replace(card.grasp, name=card.name) for some in self._cards for card in some}
        self._folder, self._density = folder, density
        self._scenario = detected_scenario(body, self._spec, density, folder)
        self._protocol = load_protocol(_PROTOCOL)
        self._bench = GraspScene(self._spec, make_stage(self._scenario, self._protocol, "right", Path()))
        self._gains = load_gains(adapter.gains, self._spec)
        self._runner = TrialRunner(self._spec, adapter.gains, self._protocol.period or PERIOD)
        reckoned = None if self._spec.followers else self._gains
        templates = list(self._templates.values())
        around = _beside(self._scenario, body, others)
        free = GraspScene(self._spec, make_stage(around, self._protocol, "right", Path())) if others else self._bench
        # Of what stands alone the arm looks at all turns; beside others, or as a part, each is another grasp.
        every = bool(others) or bool(body.parts)
        self._turns = [_symmetric_turns(target, self._random) if every else (0.0,) for target in targets]
        self._proposer = Proposer(free, templates, _FRICTION, (0.0,), self._random, COARSE, None, reckoned, _GAP)
        self._round, self._shown, self.options = 0, list[Candidate](), list[AdaptedGrasp]()
        self._standing = list[tuple[int, Candidate, Grasp]]()
        self.mass = self._bench.mass
        self.grown = self.examined = self.reached = self.lifted = self.weak = 0
        """Candidates that closed in geometry; those of them that the arm looked at, that it gets to, and that held
        through a lift; and those for which a motor is too weak."""

    @property
    def too_heavy(self) -> bool:
        """Whether it may be its weight for which nothing lifts it: something could be closed on it, and it may weigh
        less. What nothing closes on, and what the arm does not get to, is not taken however light it is."""
        lightest = _LIGHTEST * max(len(self._body.parts), 1)
        return not self.lifted and bool(self.reached or self.weak) and self.mass > lightest

    def summary(self) -> str:
        """What became of the candidates, for a person."""
        best = max(self.options, key=lambda each: each.share, default=None)
        held = "none holds" if best is None else f"the best holds in {best.held} of {best.tried} draws"
        return (
            f"{self.grown} adapted grasps close on it, the arm gets to {self.reached} of the {self.examined} best, "
            f"{self.lifted} lift it, and {held}"
        )

    def round(self, reaches: Callable[[StoredGrasp], bool]) -> None:
        """Some more variations; `draw_more` draws for the best that hold. `reaches`: whether the arm gets to one."""
        self._standing = []
        seeds = [
            self._seed(card, target, turn)
            for target, cards, turns in zip(self._targets, self._cards, self._turns, strict=True)
            for card in cards
            for turn in turns
        ]
        wider, count = 0.5 * 2**self._round, sum(len(cards) for cards in self._cards)
        grown = self._proposer.near(seeds, _VARIED * (1 + self._round) * count, min(wider, 2.0))
        if not self._round:
            grown += self._proposer.grow(seeds)
        self._round += 1
        self.grown += len(grown)
        chosen = list(self._reached(sorted(grown, key=lambda c: -c.score), reaches))
        if not chosen:
            return
        performer = FingerGains(self._gains, hand_kinematics(self._spec).gravity_torque)
        outcomes = close_candidates(self._bench, chosen, performer, _FRICTION, self._random, self._proposer.preload)
        lifted = [each.candidate for each in outcomes if each.passed or each.where == "turn"]
        self.lifted += len(lifted)
        self._standing = self._drawn(lifted)

    def _seed(self, card: StoredGrasp, target: TableObject, turn: float) -> Candidate:
        """A stored grasp beside what was seen, or a part of it, the target: as far from its surface as it was from that
        of its own thing, and turned with it by an angle, rad, by which it is as it was."""
        grasp, own, new = card.grasp, np.array(card.body.extents) / 2.0, np.array(target.extents) / 2.0
        at = card.palm.position
        at = at + np.sign(at) * (new - own) * np.minimum(np.abs(at) / own, 1.0)
        turned, closing = yaw_rotation(target.yaw + turn), closing_directions(grasp, self._spec)
        middle = target.position + self._bench.placed.position
        return Candidate(
            turned @ at + middle, turned @ card.palm.rotation, turned @ card.retreat,
            grasp.preshape, closing, grasp.preshape, grasp.preshape, grasp.preshape, card.name,
        )  # fmt: skip

    def _reached(self, candidates: Sequence[Candidate], reaches: Callable[[StoredGrasp], bool]) -> Iterator[Candidate]:
        """The best, apart from each other and from all before, that the arm gets to."""
        found = looked = 0
        for candidate in candidates:
            if found == self._settings.closed or looked == _LOOKED * self._settings.closed:
                return
            weak = not self._spec.followers and candidate.score < -_STRONG
            self.weak += weak
            if weak or any(self._same_palm(candidate, other) for other in self._shown):
                continue
            self._shown.append(candidate)
            looked += 1
            self.examined += 1
            if reaches(self._card(candidate, candidate_grasp(candidate, self._template(candidate), self._spec))):
                found += 1
                self.reached += 1
                yield candidate

    def _same_palm(self, one: Candidate, other: Candidate) -> bool:
        far, turned = palm_distance(one, other, ObjectSymmetry(np.array(self._bench.placed.position)))
        return far < _APART and turned < np.radians(_TURNED)

    def _drawn(self, candidates: Sequence[Candidate]) -> list[tuple[int, Candidate, Grasp]]:
        """The best in a few draws for all, those that held most last: how many held, candidate, and grasp."""
        grasps = [self._squeezed(candidate) for candidate in candidates]
        held = self._held(candidates, grasps, 0, _FIRST)
        best = sorted(range(len(held)), key=lambda k: (-held[k], -candidates[k].score))[:_LEFT]
        return [(held[k], candidates[k], grasps[k]) for k in reversed(best) if held[k] > 0]

    def draw_more(self) -> AdaptedGrasp | None:
        """More draws for the next best of the round; it comes to the options. None where none is left."""
        if not self._standing:
            return None
        held, candidate, grasp = self._standing.pop()
        held += self._held([candidate], [grasp], _FIRST, _MORE)[0]
        card = replace(self._card(candidate, grasp), rest=self._rest(candidate))
        self.options.append(AdaptedGrasp(card, held, _FIRST + _MORE))
        return self.options[-1]

    def _held(self, candidates: Sequence[Candidate], grasps: Sequence[Grasp], first: int, count: int) -> list[int]:
        draws = sample_perturbations(self._settings.uncertainty, count, self._draws, first, stream="search")
        drawn = [self._drawn_body(draw, first + number) for number, draw in enumerate(draws)]
        cases = [
            TrialCase(candidate_scenario(candidate, self._bench, scenario), grasp, draw, self._protocol)
            for candidate, grasp in zip(candidates, grasps, strict=True)
            for scenario, draw in drawn
        ]
        verdicts = self._runner.verdicts(cases, stop_early=True)
        return [sum(next(verdicts).held for _ in range(count)) for _ in candidates]

    def _drawn_body(self, draw: Perturbation, number: int) -> tuple[Scenario, Perturbation]:
        """The scenario of a draw, and what is left to be drawn: a compound's file has its size and mass. Its middle is
        where that of the scenario without a draw is, so that the palm is where it would be."""
        if not self._body.parts:
            return self._scenario, draw
        folder = self._folder / str(number)
        folder.mkdir(exist_ok=True)
        one = compound_object(self._body, "seen", self._density, folder, draw.size, draw.mass)
        return self._scenario.model_copy(update={"objects": (one,)}), replace(draw, size=1.0, mass=1.0)

    def _squeezed(self, candidate: Candidate) -> Grasp:
        """With the firmer squeeze of a search: what a camera has seen may be heavier than it looks."""
        squeeze = SQUEEZES[-1]
        grasp = candidate_grasp(candidate, self._template(candidate), self._spec, squeeze.factor)
        return limit_squeeze(grasp, candidate.rest, self._gains, self._spec, squeeze.share)

    def _rest(self, candidate: Candidate) -> Vector | None:
        return candidate.rest if self._own.side == self._spec.side else None

    def _template(self, candidate: Candidate) -> Grasp:
        return self._templates[candidate.template]

    def _card(self, candidate: Candidate, grasp: Grasp) -> StoredGrasp:
        """The candidate as a grasp of what was seen, in the frame of its middle."""
        at, rotation, retreat = candidate.position - self._bench.placed.position, candidate.rotation, candidate.retreat
        name = f"adapted {candidate.template}"
        grasp = replace(grasp, name=name)
        if self._own.side == "left":
            grasp = build_grasp(name, entry_from_grasp(grasp, self._spec), self._own, name)
            at, rotation, retreat = MIRROR @ at, MIRROR @ rotation @ MIRROR, MIRROR @ retreat
        return StoredGrasp(name, self._body, grasp, Pose(at, rotation), retreat)


def detected_scenario(body: TableObject, spec: HandSpec, density: float, folder: Path = Path()) -> Scenario:
    """A trial with a solid or a compound as it was seen, its longer level extent along x, in the middle of the table,
    and its mass by a density, kg/m³. The palm and the grasp are those of whoever tries it. `folder`: where a
    compound's file is put."""
    if body.parts:
        scenario_object = compound_object(body, "seen", density, folder)
    else:
        scenario_object = detected_object(body.kind, body.extents, "seen", density)
    wrist = Wrist(position=(0.0, 0.0, 0.1), facing=(0.0, 0.0, -1.0), fingers=(1.0, 0.0, 0.0), retreat=(0.0, 0.0, 0.1))
    return Scenario(
        objects=(scenario_object,), friction=_FRICTION, grasp="adapted",
        hand=spec.model_reference, side="right", wrist=wrist, protocol=_PROTOCOL,
    )  # fmt: skip


def detected_object(
    body_kind: str, extents: tuple[float, float, float], name: str, density: float, yaw: float = 0.0
) -> ScenarioObject:
    """A solid as it was seen, `yaw` from the world's x to its longer level extent, rad, in the middle of the table,
    with its mass by a density, kg/m³."""
    (x, y, z), kind, lying = extents, body_kind.removeprefix("lying "), body_kind.startswith("lying ")
    up, own = "z", 0.0
    match kind:
        case "sphere":
            size: tuple[float, ...] = ((x + y + z) / 3.0,)
        case "box":
            size = (x, y, z)
        case _:  # Of revolution, about the level extent that is unlike the height where it lies.
            along_x = not lying or abs(x - z) >= abs(y - z)
            length, round_ = (x, y) if along_x else (y, x)
            length, round_ = (length, (round_ + z) / 2.0) if lying else (z, (x + y) / 2.0)
            size = (round_, length)
            up = {"cylinder": "zy", "ellipsoid": "xz"}[kind][lying]  # A cylinder's own axis is z, an ellipsoid's x.
            own = 0.0 if along_x else 90.0
    fill = {"box": 1.0, "cylinder": np.pi / 4.0}.get(kind, np.pi / 6.0)
    mass = max(density * fill * x * y * z, _LIGHTEST)
    return ScenarioObject(name=name, shape=kind, size=size, mass=mass, up=up, yaw=own + np.degrees(yaw))  # type: ignore[arg-type]


def compound_object(
    body: TableObject, name: str, density: float, folder: Path, size: float = 1.0, mass: float = 1.0
) -> ScenarioObject:
    """A compound as it was seen, its longer level extent along x, in the middle of the table, in a file in a folder.
    `size` and `mass`: factors; a larger one grows upwards from the table, and its middle is said to be where that of
    the seen one is."""
    parts = list[PlacedObject]()
    for number, part in enumerate(own_parts(body)):
        one = detected_object(part.kind, part.extents, f"part_{number}", density, part.yaw)
        placed = place_object(one)
        assert one.mass is not None
        assert one.size is not None
        grasp_object = replace(placed.grasp_object, size=tuple(size * edge for edge in one.size), mass=mass * one.mass)
        x, y, z = (size * part.position + [0.0, 0.0, (size - 1.0) * body.extents[2] / 2.0]).tolist()
        parts.append(PlacedObject(grasp_object, (x, y, z), placed.quaternion))
    path = folder / "compound.xml"
    write_compound(parts, path)
    return ScenarioObject(name=name, shape="mjcf", file=path, at=(0.0, 0.0, body.extents[2] / 2.0 + _AIR))


def _beside(scenario: Scenario, body: TableObject, others: Sequence[TableObject]) -> Scenario:
    """The scenario with others beside the body, as they stand when the body lies along x."""
    back, objects = yaw_rotation(-body.yaw), list(scenario.objects)
    for number, other in enumerate(solid for one in others for solid in one.solids):
        away = other.position - body.position
        if float(np.hypot(*away[:2])) > _FAR:
            continue
        x, y = (back @ away)[:2].tolist()
        a, b, c = (max(extent, _THIN) for extent in other.extents)
        one = detected_object(other.kind, (a, b, c), f"other_{number}", _HEAVY, other.yaw - body.yaw)
        objects.append(one.model_copy(update={"at": (x, y, max(float(other.position[2]), c / 2.0))}))
    return scenario.model_copy(update={"objects": tuple(objects)})


def _symmetric_turns(body: TableObject, random: np.random.Generator) -> tuple[float, ...]:
    """Angles, rad, by which it may be turned and is as it was: all, or some of those of what is round."""
    turns = symmetric_turns(body)
    return tuple(random.permutation(turns)[:_ROUND_TURNS].tolist())


def _is_same(one: TableObject, other: TableObject) -> bool:
    """Whether it still stands there."""
    near = float(np.linalg.norm(one.position - other.position)) < _STIRRED
    turned = abs(np.sin(one.yaw - other.yaw)) < _TURNED_BY or one.kind in ("sphere", "cylinder")
    return near and turned and _alike(one, other)


def _alike(one: TableObject, other: TableObject) -> bool:
    """Whether it is of the same kind and size, within what pictures of it scatter by."""
    edges = float(np.abs(np.subtract(one.extents, other.extents)).max()) < _SCATTER and not (one.parts or other.parts)
    return one.kind == other.kind and (edges or extent_mismatch(one, other) < _SIMILAR)


def _unlike(one: TableObject, other: TableObject) -> float:
    return extent_mismatch(one, other) + (0.0 if one.kind == other.kind else _OTHER_KIND)
