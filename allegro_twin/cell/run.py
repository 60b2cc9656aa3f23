"""One run of the cell: see, take, lift, check; and what is told of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TypeVar

import numpy as np

from allegro_twin.backend import HandBackend, recover
from allegro_twin.cell.actions.cell_actions import WATCHED, CellActions
from allegro_twin.cell.arm.impedance import Stiffness, stuck
from allegro_twin.cell.arm.target import Smoothing
from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.checks.grasp_check import GraspCheck
from allegro_twin.cell.ground_truth import ObjectPlaces, object_places, objects_in_hand
from allegro_twin.cell.motion.arm_motion import ArmGuide, GuidedImpedance
from allegro_twin.cell.motion.finger_paths import SteeredReference, finger_controller
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.planning.release import check_tray
from allegro_twin.cell.settings import LabSettings
from allegro_twin.cell.states import (
    CellOutcome,
    MachineState,
    Observation,
    StateName,
    StateRules,
    ended,
    endless_run,
    initial_state,
    next_state,
    put_away,
    watch_outcome,
)
from allegro_twin.controller import Controller
from allegro_twin.errors import ArmReflex, HandError, HandFault, LinkError
from allegro_twin.loop import interleave, resume, run
from allegro_twin.types import Array, HandState, Sample

M = TypeVar("M")
SampleStage = Callable[[Iterable[Sample]], Iterator[Sample]]
_LIFTED = 0.05  # m. Something that is higher than before by more is in the air.
_STIRRED = 0.005  # m. Another object that has moved less stands where it stood.
_UNSEEN = "it is out of the picture, too small, or lower than `perception.object.above`"
_SLACK = (0.01, 0.1)  # m and rad: how far friction may keep the hand from its target, as of `Impedance`.


@dataclass(frozen=True, slots=True)
class LabReport:
    """Report of a run of the cell."""

    end: CellOutcome
    events: tuple[tuple[float, StateName], ...]
    """When each state began, s."""
    tries: int
    solid: Solid | None
    """What was seen, at the last look that led to something."""
    grasp: str | None
    """By the name of the scenario that it comes from."""
    checked: GraspCheck | None
    """Check of what was seen, at the last try; None where that did not come to it."""
    error: float
    """How far the solid's middle is from the thing's, m; NaN where nothing was found. Only a simulation knows."""
    lifted: float
    """How much higher the thing's middle of mass is than it was when the hand went for it, m; 0 where it never did; NaN
    where it is off the table, for there is no floor beside it. Only a simulation knows."""
    object_name: str = ""
    """Its name: of those in the scene the one that is nearest to what was seen last. Only a simulation knows."""
    moved: tuple[tuple[str, float], ...] = ()
    """Other objects on the table that are not where they were, and how far, m. Only a simulation knows."""
    released: int = 0
    """Objects that were put into the tray, as the run itself counts them: what it took at once is one."""
    in_tray: tuple[str, ...] = ()
    """Those that are in it. Only a simulation knows."""
    on_table: tuple[str, ...] = ()
    """With a tray: those that are anywhere else above the table. Only a simulation knows."""
    off_table: tuple[str, ...] = ()
    """Those that have fallen off the table. Only a simulation knows."""
    believed: CellOutcome | None = None
    """How the cell itself takes it to have ended, where a simulation knows better, as `end` says."""
    in_hand: tuple[str, ...] = ()
    """Those that the hand carries. Only a simulation knows."""

    @property
    def is_lifted(self) -> bool:
        """Whether the thing is in the air at the end."""
        return self.lifted > _LIFTED


def perform(
    cell: Cell,
    *,
    arm: SampleStage = iter,
    hand: SampleStage = iter,
    on_state: Callable[[MachineState], None] = lambda now: None,
    on_prepare: Callable[[CellActions], None] = lambda work: None,
    on_planning: Callable[[str], None] = lambda said: None,
) -> LabReport:
    """From the security pose to an end. `arm` and `hand` are stages around their samples, `on_state` hears of states,
    `on_prepare` of the run's memory before anything moves, `on_planning` how far a search for a grasp is, in sentences,
    while simulated time stands still.

    Whatever falls silent or stops ends it in a named fault: the other one goes on and holds, the arm where it is. Every
    state has its longest time, and so has the run, by the periods of arm and hand. Raises ConfigError for a tray out of
    reach.
    """
    if cell.settings.tray is not None:
        check_tray(cell.settings.tray, cell)
    work, now = CellActions(cell), initial_state(0.0)
    seen = _Story(cell, work)
    work.on_planning = on_planning
    on_prepare(work)
    law = arm_controller(cell, work.guide)
    grip = finger_controller(SteeredReference(work.fingers), cell.settings.hand.gains, cell.hand.spec, cell.model)
    failed: list[str] = []
    arms = arm(_noted("arm", run_through_reflexes(cell.arm, law, work.on_reflex), failed))
    hands = hand(_noted("hand", run(cell.hand, grip), failed))
    rules, clock = state_rules(cell.settings), _Clock(cell.settings)
    last: Sample | None = None
    passed = [0.0, 0.0]  # Of the arm's and the hand's periods, s: counted, for a clock may stand still.
    try:
        for turn, sample in interleave((arms, cell.arm.period), (hands, cell.hand.period)):
            passed[turn] += (cell.arm, cell.hand)[turn].period
            if passed[turn] > rules.longest:
                now = endless_run(now, sample.state.t, rules, ("arm", "hand")[turn])
                seen.enter(now, on_state)
                if last is not None:
                    work.motion.stand_still(last.state)
                break
            if turn == 1:
                work.hand.update(sample.state)
                continue
            state, last = sample.state, sample
            if state.tick == 0:
                seen.enter(now, on_state)
                work.enter(now, state)
            work.collect_force(now, state)
            if now.state == "Done":
                held = now.end is not None and now.end.kind == "held"
                known = work.recheck(now, state) if held else Observation(state.t)
                after = watch_outcome(now, known, rules)
                if after is not now:
                    now = after
                    seen.enter(now, on_state)
                    work.enter(now, state)
                elif state.t >= now.since + WATCHED and (known.held or not held):
                    break
                continue
            if not clock.due(state.t):
                continue
            after = next_state(now, work.observe(now, state), rules)
            if after is not now:
                now = after
                seen.enter(now, on_state)
                work.enter(now, state)
    except (HandFault, LinkError) as error:
        now = ended(now, 0.0 if last is None else last.state.t, CellOutcome("fault", _who(error, failed), str(error)))
        seen.enter(now, on_state)
        _hold(cell, work, last, (arms, hands))
    assert now.end is not None
    return seen.report(now)


def state_rules(settings: LabSettings) -> StateRules:
    """What the state machine goes by."""
    most = settings.timeouts
    return StateRules(
        {"ToSecurityPose": most.security, "Look": most.look, "ToTargetPose": most.target, "Approach": most.approach,
         "ClosingHand": most.close, "ToLiftedPose": most.lift, "Validate": most.check,
         "Retreat": most.retreat, "ToReleasePose": most.release, "PutBack": most.release,
         "OpeningHand": most.open},
        settings.decide.retries,
        0 if settings.tray is None else settings.tray.objects,
    )  # fmt: skip


class _Clock:
    """Schedule of the state machine's decisions."""

    def __init__(self, settings: LabSettings) -> None:
        self._every = 1.0 / settings.decide.rate if settings.decide.by == "clock" else 0.0
        self._count = 0

    def due(self, t: float) -> bool:
        if self._every == 0.0:
            return True
        if t < self._count * self._every - 1e-9:
            return False
        self._count = int(t / self._every + 1e-9) + 1
        return True


class _Story:
    """Data that is kept for the report."""

    def __init__(self, cell: Cell, work: CellActions) -> None:
        self._cell, self._work = cell, work
        self._events: list[tuple[float, StateName]] = []
        self._first: dict[str, Array] = {}
        self._in_tray: tuple[str, ...] = ()  # Before anything moved.
        self._taken: dict[str, Array] = {}
        self._heights: dict[str, float] = {}

    def enter(self, now: MachineState, on_state: Callable[[MachineState], None]) -> None:
        if not self._first:
            self._first, self._in_tray = self._places(), object_places(self._cell).in_tray
        if now.state == "ToTargetPose":
            self._taken, self._heights = self._places(), self._middles()
        self._events.append((now.since, now.state))
        on_state(now)

    def report(self, now: MachineState) -> LabReport:
        assert now.end is not None
        work, first, last = self._work, self._first, self._places()
        error, chosen = float("nan"), self._cell.settings.objects[0].name
        target = work.target
        if target.solid is not None:
            stood = self._taken or first
            errors = {name: float(np.linalg.norm(target.solid.position - at)) for name, at in stood.items()}
            chosen = min(errors, key=errors.__getitem__)
            error = errors[chosen]
        ways = {name: float(np.linalg.norm(last[name] - first[name])) for name in last if name != chosen}
        name = None if target.candidate is None else target.candidate.card.name
        places, heights = object_places(self._cell), self._middles()
        off = places.off_table
        moved = tuple((name, way) for name, way in ways.items() if way > _STIRRED and name not in off)
        risen = {name: float("nan") if name in off else heights[name] - at for name, at in self._heights.items()}
        end = other_than_wanted(now.end, chosen, risen, self._cell)
        put = [each for each in places.in_tray if each not in self._in_tray]
        end = other_than_counted(end, len(put), now.released, self._cell)
        end = other_than_cleared(end, places, self._cell)
        if self._cell.settings.tray is None:
            places = ObjectPlaces(off_table=off)
        return LabReport(
            end, tuple(self._events), now.tries, target.solid, name, work.held.found, error, risen.get(chosen, 0.0),
            chosen, moved, now.released, places.in_tray, places.on_table, places.off_table,
            None if end is now.end else now.end, objects_in_hand(self._cell),
        )  # fmt: skip

    def _middles(self) -> dict[str, float]:
        """How high every object's middle of mass really is, m: what tips over turns about that."""
        world = self._cell.robot.world
        names = [each.name for each in self._cell.settings.objects]
        return {name: float(world.data.subtree_com[world.model.body(name).id][2]) for name in names}

    def _places(self) -> dict[str, Array]:
        """Where every object really is, (3,), m."""
        return {each.name: self._cell.robot.object_pose(each.name).position for each in self._cell.settings.objects}


def other_than_wanted(end: CellOutcome, object_name: str, risen: Mapping[str, float], cell: Cell) -> CellOutcome:
    """The end, which is a miss where another thing is held than the one that was asked for. `risen`: by how much each
    thing is higher than it was, m, as a simulation knows it: of a real camera's pictures nobody does."""
    wanted, settings = cell.wanted, cell.settings
    known = settings.camera.source.kind == "simulated" and settings.tray is None
    if (
        end.kind != "held"
        or wanted is None
        or object_name == wanted.name
        or risen.get(wanted.name, 0.0) > _LIFTED
        or not known
    ):
        return end
    said = (
        f"held {object_name}, not {wanted.name}: of what was seen it was most like it, or had most points in the "
        "picture"
    )
    way = f"move {object_name} away, or {wanted.name} to where the camera sees it alone and whole"
    return CellOutcome("missed", "another object", f"{said}; {way}")


def other_than_counted(end: CellOutcome, count: int, counted: int, cell: Cell) -> CellOutcome:
    """The end with the number of objects that were put away, `count`, where the cell has `counted` less: what it takes
    at once is one to it, and what it takes for lost none. A simulation knows it: of a real camera's pictures nobody
    does."""
    if count <= counted or cell.settings.camera.source.kind != "simulated":
        return end
    why = ": what it took at once is one to it" if counted else ""
    said = f"{put_away(count)} (the cell counts {counted}{why})"
    return replace(end, sentence=end.sentence.replace(put_away(counted), said, 1))


def other_than_cleared(end: CellOutcome, places: ObjectPlaces, cell: Cell) -> CellOutcome:
    """The end, which is a miss where the cell takes the table for cleared and not all is in the tray. `places`: as a
    simulation knows them: of a real camera's pictures nobody does."""
    left = (*places.on_table, *places.off_table)
    if end.kind != "cleared" or not left or cell.settings.camera.source.kind != "simulated":
        return end
    where = [f"{', '.join(names)} {said}" for names, said in (
        (places.on_table, f"still on the table, where the cell sees no object: {_UNSEEN}"),
        (places.off_table, "neither in the tray nor on the table"),
    ) if names]  # fmt: skip
    return CellOutcome(
        "missed", "left", f"{end.sentence}, so the cell takes it for cleared; in truth {'; '.join(where)}"
    )


def arm_controller(cell: Cell, guide: ArmGuide) -> GuidedImpedance:
    """The arm's controller. Raises ConfigError for a spring that friction holds."""
    arm = cell.settings.arm
    stiffness = Stiffness(arm.stiffness, arm.angular_stiffness)
    stuck(cell.robot.model, cell.posture, stiffness, _SLACK, force_sensor=True)
    smoothing = Smoothing(arm.speed, arm.turning)
    return GuidedImpedance(cell.robot.model, guide, stiffness.diagonal(), smoothing, cell.robot.compensation)


def run_through_reflexes(
    arm: HandBackend, law: Controller[M], on_reflex: Callable[[ArmReflex, HandState], None]
) -> Iterator[Sample]:
    """An arm's samples. Where it stops by itself it is recovered, and goes on after `on_reflex` has said where to."""
    state = arm.reset()
    while True:
        try:
            yield from resume(arm, law, state)
        except ArmReflex as error:
            state = recover(arm)
            on_reflex(error, state)


def _noted(device: str, samples: Iterator[Sample], failed: list[str]) -> Iterator[Sample]:
    """A stage that adds the device's name to `failed` when its samples end in an error."""
    try:
        yield from samples
    except HandError:
        failed.append(device)
        raise


def _who(error: Exception, failed: Sequence[str]) -> str:
    return f"{failed[0] if failed else 'cell'} {'silent' if isinstance(error, LinkError) else 'stopped'}"


def _hold(cell: Cell, work: CellActions, last: Sample | None, left: tuple[Iterator[Sample], Iterator[Sample]]) -> None:
    """Let whoever is still there go on for a moment: the arm stands still, or the hand keeps what it has."""
    if last is None:
        return
    work.motion.stand_still(last.state)
    for samples, device in zip(left, (cell.arm, cell.hand), strict=True):
        for _ in islice(_left(samples), round(WATCHED / device.period)):  # Counted: a clock may stand still.
            pass


def _left(samples: Iterator[Sample]) -> Iterator[Sample]:
    try:
        yield from samples
    except (HandFault, LinkError):
        return  # The one whose fault is told already.
