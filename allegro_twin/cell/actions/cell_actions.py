"""Actions of the cell's states, and their answers to the state machine."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from allegro_twin.cell.actions.cell_motion import LOOSE, ArmGoal, CellMotion
from allegro_twin.cell.actions.cell_pictures import LiftedLook, OnDetection, Pictures, TableLook, Target
from allegro_twin.cell.actions.force_samples import ForceSamples
from allegro_twin.cell.actions.hand_monitor import HandMonitor
from allegro_twin.cell.actions.held_check import HeldCheck
from allegro_twin.cell.arm.contact_reflex import retreat_offset
from allegro_twin.cell.arm.limits import at_limit
from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.motion.arm_motion import ArmGuide
from allegro_twin.cell.motion.empty_grasp import squeeze_speed
from allegro_twin.cell.motion.finger_paths import OPENING
from allegro_twin.cell.planning.object_selection import ObjectSelector
from allegro_twin.cell.planning.release import ReleasePath, release_path
from allegro_twin.cell.states import CellOutcome, MachineState, Observation
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.errors import ArmReflex, ConfigError
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import HandState

_RETREATS = 0.8  # s. Away from what the arm met.
WATCHED = 0.5
"""s. How long arm and hand are watched after the end, and what is held is then looked at again."""
_FAR = ("ToSecurityPose", "ToTargetPose", "ToReleasePose", "PutBack")  # States with several goals of the arm.
_ASIDE = 0.03  # m. So far from above where it grasped the palm does not go straight down.


class CellActions:
    """Acts for the states of one run; the decisions are the state machine's."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.motion = CellMotion(cell)
        self.target = Target()
        """The object that the cell goes for."""
        self.on_detection: OnDetection = lambda frame, seen: None
        """Hears what perception says of every picture."""
        self.on_planning: Callable[[str], None] = lambda said: None
        """Hears how far a search for a grasp is, while simulated time stands still."""
        self.selector = ObjectSelector(cell, lambda said: self.on_planning(said))
        """Which object is next."""
        pictures = Pictures(cell)
        self.table = TableLook(cell, pictures, self.selector, lambda frame, seen: self.on_detection(frame, seen))
        """The look at the table."""
        self._lifted = LiftedLook(cell, pictures, self.target)
        self.hand = HandMonitor(cell, self.motion.fingers)
        """The hand as it was heard last."""
        self.forces = ForceSamples(cell)
        """Samples of the force on the flange."""
        self.held = HeldCheck(cell, self.hand, self.forces, self._lifted)
        """The check of what is in the hand."""
        self._grasp: Grasp | None = None
        self._grasped = cell.security  # The palm, before the lift.
        self._above: Pose | None = None  # The palm above where something is to be let go, and
        self._over: Pose | None = None  # where something has been.
        self._squeezed = False
        self._blocked: CellOutcome | None = None  # On the way back to where the arm waits.
        self._no_way: CellOutcome | None = None  # To the tray.
        self._reflex: CellOutcome | None = None
        self._away = np.zeros(3)  # From what the arm met, world, m.

    @property
    def guide(self) -> ArmGuide:
        """Set-points of the arm."""
        return self.motion.guide

    @property
    def fingers(self) -> SmoothSetpoint:
        """Set-points of the fingers, rad."""
        return self.motion.fingers

    def enter(self, now: MachineState, state: HandState) -> None:
        """Begin what a state is for; `state` is the arm's."""
        t, motion, target, settings = now.since, self.motion, self.target, self.cell.settings
        match now.state:
            case "ToSecurityPose":
                self._remember(now)
                over, self._over = self._over, None
                if over is not None:
                    motion.follow(t, state, over, self.cell.posture)  # The fingers open once they are out of the tray.
                else:
                    self._return(t, state)
            case "Look":
                target.candidate = None
                self.table.begin()
                self.forces.idle.clear()
            case "ToTargetPose":
                assert target.candidate is not None
                self._grasp = target.candidate.card.grasp
                self.forces.begin_tare(target.solid)
                motion.move_fingers(t, self._grasp.preshape, OPENING)
                motion.follow(t, state, *target.through)
            case "Approach":
                assert target.candidate is not None
                motion.straight(t, target.candidate.palm, settings.arm.approach)
            case "ClosingHand":
                assert self._grasp is not None
                self._squeezed = False
                self.hand.begin_closing(self._grasp.squeeze)
                motion.move_fingers(t, self._grasp.close, self._grasp.speed)
            case "ToLiftedPose":
                assert target.candidate is not None
                self.forces.begin_weighing()
                self._grasped = self.cell.robot.palm(state)
                up = np.array([0.0, 0.0, settings.lift])
                motion.straight(
                    t, Pose(target.candidate.palm.position + up, target.candidate.palm.rotation), settings.arm.lift
                )
            case "Validate":
                self._lifted.begin(state)
            case "ToReleasePose":
                path = self._release_path(now, state)
                if path is not None:
                    motion.set_touchdown(path.palm)
                    self._above = path.over
                    motion.follow(t, state, path.up, path.across, path.palm)
            case "PutBack":
                motion.set_touchdown(self._grasped)
                self._above, goals = self._way_back(state)
                motion.follow(t, state, *goals)
            case "OpeningHand":
                assert self._grasp is not None
                self._over = self._above
                motion.move_fingers(t, self._grasp.preshape, OPENING)
            case "Retreat":
                palm = self.cell.robot.palm(state)
                motion.straight(t, Pose(palm.position + self._away, palm.rotation), _RETREATS)
            case "Done":
                motion.stand_still(state)
                self.forces.after.clear()
                self._lifted.forget()

    def on_reflex(self, error: ArmReflex, state: HandState) -> None:
        """The arm has stopped by itself and is recovered: it stays where it is until a state leads it away."""
        self._away = retreat_offset(error, self.cell.robot.base.rotation)
        self._reflex = CellOutcome("fault", error.name, str(error))
        self.motion.stand_still(state)

    def collect_force(self, now: MachineState, state: HandState) -> None:
        """Every state of the arm."""
        self.forces.add(now, state, self.motion)

    def observe(self, now: MachineState, state: HandState) -> Observation:
        """What the state machine has to know of this moment; pictures are taken here."""
        reflex, self._reflex = self._reflex, None
        if reflex is not None:
            return self._met(now, state, reflex)
        fault = self._fault(state)
        if fault is not None:
            return Observation(state.t, fault=fault)
        motion = self.motion
        match now.state:
            case "Look":
                return self._look(state)
            case "ClosingHand":
                return Observation(state.t, done=self._closed(state.t))
            case "Validate":
                return self._check(state)
        if now.state == "ToReleasePose" and self._no_way is not None:
            refused, self._no_way = self._no_way, None
            return Observation(state.t, refused=refused)
        if now.state in _FAR and motion.ahead and motion.is_over(state.t):
            if now.state == "ToSecurityPose":
                self._return(state.t, state)
            else:
                motion.next(state.t, state)
            return Observation(state.t)
        match now.state:
            case "ToTargetPose" if not self.forces.is_tared:
                return Observation(state.t)
            case "PutBack":
                return Observation(state.t, done=motion.has_come_down(state))
            case "ToReleasePose":
                there = motion.has_come_down(state)
                lost = there and self._grasp is not None and not self.hand.holds_something(self._grasp, state)
                if lost:
                    self.table.lose_over_tray()
                return Observation(state.t, done=there and not lost, held=False if lost else None)
            case "OpeningHand":
                return Observation(state.t, done=motion.is_over(state.t))
        loose = LOOSE if now.state == "ToLiftedPose" else 1.0
        return Observation(state.t, done=motion.arrived(state, loose) and motion.is_over(state.t))

    def recheck(self, now: MachineState, state: HandState) -> Observation:
        """Whether what was said to be held after the lift still is, once there are as many samples and a picture again;
        that the run is not over until then."""
        weak = self._reflex or self.hand.fault()
        if weak is not None:
            return Observation(state.t, fault=weak)
        if state.t < now.since + WATCHED:
            return Observation(state.t)
        if self._lifted.is_idle:
            self._lifted.begin(state)
        return self._check(state, again=True)

    def _fault(self, state: HandState) -> CellOutcome | None:
        """Why arm or hand cannot go on."""
        full = at_limit(state, self.cell.robot.spec, self.cell.robot.limits)
        if full is not None:
            return CellOutcome("fault", "arm at a limit", full)
        return self._blocked or self.hand.fault()

    def _met(self, now: MachineState, state: HandState, reflex: CellOutcome) -> Observation:
        """The arm has met something. What comes down where it is to be let go has arrived, and a hand that opens there
        goes on to open."""
        if now.state == "OpeningHand":
            return Observation(state.t, done=self.motion.is_over(state.t))
        comes_down = now.state in ("ToReleasePose", "PutBack") and not self.motion.ahead
        if comes_down and self.motion.is_over_touchdown(state):
            return Observation(state.t, done=True)
        return Observation(state.t, reflex=reflex)

    def _look(self, state: HandState) -> Observation:
        chosen = self.table.look(state, self.hand.state)
        if chosen is not None:
            self.target.select(chosen)
            self.held.found = None  # That was of another try.
        table, done = self.table, self.target.candidate is not None
        return Observation(
            state.t, done=done, landed=table.landed, refused=table.refused, warning=self.selector.warning
        )

    def _check(self, state: HandState, *, again: bool = False) -> Observation:
        if self._grasp is None:
            return Observation(state.t)
        return self.held.check(state, self.target, self._grasp, self._grasped, again=again)

    def _closed(self, t: float) -> bool:
        """Whether the fingers have closed and squeezed."""
        if not self.motion.is_over(t):
            return False
        if not self._squeezed:
            assert self._grasp is not None
            self._squeezed = True
            self.motion.move_fingers(t, self._grasp.squeeze, squeeze_speed(self._grasp))
            return False
        return True

    def _remember(self, now: MachineState) -> None:
        """Tell the selector what came of the last try."""
        if now.released > self.selector.released:
            self.selector.put_away()
        elif self.target.candidate is not None and self.target.solid is not None:
            self.selector.missed(self.target.candidate.card, self.target.solid, leave=now.tries == 1)

    def _return(self, t: float, state: HandState) -> None:
        """Open the fingers, and move the arm to where it waits."""
        self.motion.move_fingers(t, self.cell.open, OPENING)
        met = self.motion.return_to_wait(t, state)
        if met is not None:
            said = f"{met} on the way back to where it waits: the arm stands still; lead it out by hand"
            self._blocked = CellOutcome("fault", "in the way", said)

    def _release_path(self, now: MachineState, state: HandState) -> ReleasePath | None:
        """The way to where the object is let go; where there is none, the next observation says so."""
        tray, way, solid = self.cell.settings.tray, self.target.candidate, self.target.solid
        assert tray is not None
        assert way is not None
        assert solid is not None
        try:
            return release_path(
                tray, way, self._grasped, solid, self.target.others, state.position, self.cell, now.released,
                self.table.points_in_tray,
            )  # fmt: skip
        except ConfigError as error:
            self._no_way = CellOutcome("refused", "in the way", str(error))
            return None

    def _way_back(self, state: HandState) -> tuple[Pose, list[ArmGoal]]:
        """The palm above where it grasped, and straight ways there: up, across, turned back, and down."""
        here, there = self.cell.robot.palm(state), self._grasped
        high = max(here.position[2], there.position[2] + self.cell.settings.lift)
        above = Pose(np.array([*there.position[:2], high]), there.rotation)
        aside = float(np.linalg.norm((here.position - there.position)[:2])) > _ASIDE
        up = Pose(np.array([*here.position[:2], high]), here.rotation)
        return above, [up, above, there] if aside else [there]
