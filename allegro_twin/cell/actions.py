"""Actions of the cell's states: the shell around the state machine, which moves targets and takes pictures."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from allegro_twin.cell.arm.contact_reflex import retreat_offset
from allegro_twin.cell.arm.limits import at_limit
from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.camera.camera import CameraFrame
from allegro_twin.cell.camera.intrinsics import Cloud
from allegro_twin.cell.camera.sources import RecordedCamera
from allegro_twin.cell.checks.camera_check import CameraCheck, check_camera, lifted_part
from allegro_twin.cell.checks.grasp_check import (
    NOTHING,
    GraspCheck,
    check_grasp,
    detectable_weight,
    grasp_verdict,
    may_weigh_more,
    presses_surely,
    pressing_torque,
    stopping_torque,
    tare_samples,
    torque_between_fingers,
    weigh,
)
from allegro_twin.cell.checks.motor_check import MotorCheck
from allegro_twin.cell.checks.sensor_zero_check import check_drift, check_plausibility, with_uncertainty
from allegro_twin.cell.motion.arm_motion import ArmGuide
from allegro_twin.cell.motion.empty_grasp import (
    EmptyGrasp,
    empty_grasp,
    misread_positions,
    squeeze_speed,
    touching_joints,
)
from allegro_twin.cell.motion.finger_paths import OPENING
from allegro_twin.cell.motion.other_objects import on_tray, points_in_tray, tray_filled
from allegro_twin.cell.perception.cloud import finite
from allegro_twin.cell.perception.errors import PerceptionRefusal, check_age
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.steady import TargetTrack, check_steadiness, track_target
from allegro_twin.cell.perception.target import grasp_target
from allegro_twin.cell.planning.object_selection import ObjectSelector, SelectedObject, refusal_outcome
from allegro_twin.cell.planning.reachability import far_path
from allegro_twin.cell.planning.release import ReleasePath, release_path
from allegro_twin.cell.planning.stored_grasps import GraspCandidate
from allegro_twin.cell.planning.wanted_object import wanted_first
from allegro_twin.cell.states import CellOutcome, MachineState, Observation
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.errors import ArmReflex, ConfigError
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.arm import rotation_between
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Array, HandState, Vector

_STILL = 0.02  # rad/s, of the fastest joint of an arm that rests.
_REST = 0.2  # s. After a motion, until what hangs on the flange has come to rest.
_RETREATS = 0.8  # s. Away from what the arm met.
WATCHED = 0.5
"""s. How long arm and hand are watched after the end, and what is held is then looked at again."""
_FAR = ("ToSecurityPose", "ToTargetPose", "ToReleasePose", "PutBack")  # States that may have several far ways.
_SLOWLY = 0.15  # m/s, on average, on a straight way.
_ASIDE = 0.03  # m. So far from above where it grasped the palm does not go straight down.
_LOOSE = 3.0  # Times the tolerance after the lift: the load pulls the spring down.


class CellActions:
    """One run's memory of what was seen, felt and sent."""

    def __init__(self, cell: Cell) -> None:
        self.cell, self.guide = cell, ArmGuide(cell.posture, cell.robot.model)
        self.fingers = SmoothSetpoint(cell.open)
        self.way: GraspCandidate | None = None
        self._through: tuple[Vector, ...] = ()
        self._left: list[Vector | Pose] = []  # Postures, and poses of the palm, still to come in this state.
        self.solid: Solid | None = None
        self.checked: GraspCheck | None = None
        self.on_detection: Callable[[CameraFrame, Detection | PerceptionRefusal], None] = lambda frame, seen: None
        """Hears what perception says of every picture."""
        self.on_planning: Callable[[str], None] = lambda said: None
        """Hears how far a search for a grasp is, while simulated time stands still."""
        self._selector = ObjectSelector(cell, lambda said: self.on_planning(said))
        # A live camera is there, and its next picture must be a new one. A recording plays from the first look on.
        self._recorded = isinstance(cell.camera, RecordedCamera)
        self._last = None if self._recorded else cell.camera.capture(cell.robot.world.data)
        self._asked: tuple[CameraFrame, Vector] | None = None  # A picture, and where the arm was when it was taken.
        self._refused: CellOutcome | None = None
        self._in_tray = np.zeros((0, 3))  # Points of what is in the tray, and of itself, world, m.
        self._lost = False  # Over the tray, since the last look.
        self._down = self.guide.target.pose  # The flange where something is to be let go, base's frame.
        self._above: Pose | None = None  # The palm above where something is to be let go, and
        self._over: Pose | None = None  # where something has been.
        self._no_way: CellOutcome | None = None  # To the tray.
        self._track: TargetTrack | None = None
        self._blocked: CellOutcome | None = None
        self._reflex: CellOutcome | None = None
        self._away = np.zeros(3)  # From what the arm met, world, m.
        self._grasp: Grasp | None = None
        self._there = 0.0  # When the fingers will be.
        self._squeezed = False
        self._hand: HandState | None = None
        self._motors = MotorCheck(cell.hand.spec, cell.stiffness, cell.forces, cell.hand.period)
        self._found: Detection | None = None
        self.others: tuple[Array, ...] = ()
        """Points of each other object on the table, at the last look, (k, 3), world, m."""
        self._grasped = cell.security  # The palm, before the lift.
        self._sight: CameraCheck | None = None
        samples = cell.settings.validation.samples
        self._idle: deque[Vector] = deque(maxlen=samples)
        self._before: deque[Vector] = deque()
        self._after: deque[Vector] = deque(maxlen=cell.settings.validation.long)
        self._tare = samples
        self._enough = samples
        """So many samples of the force before the approach, and after the lift."""

    def enter(self, now: MachineState, state: HandState) -> None:
        """Begin what a state is for; `state` is the arm's."""
        t = now.since
        match now.state:
            case "ToSecurityPose":
                self._remember(now)
                over, self._over = self._over, None
                if over is not None:
                    self._left = [over, self.cell.posture]
                    self._step(t, state)  # The fingers open wide once they are out of the tray.
                else:
                    self._head_for(t, self.cell.open, OPENING)
                    self._back(t, state)
            case "Look":
                self._asked, self._refused, self.way, self._track = None, None, None, None
                self._idle.clear()
            case "ToTargetPose":
                assert self.way is not None
                self._grasp = self.way.card.grasp
                self._before.clear()
                if self.solid is not None:
                    self._tare = tare_samples(np.asarray(self.solid.size), self.cell.settings.validation)
                self._head_for(t, self._grasp.preshape, OPENING)
                self._left = list(self._through)
                self._step(t, state)
            case "Approach":
                assert self.way is not None
                self._go(t, self.way.palm, self.cell.settings.arm.approach)
            case "ClosingHand":
                assert self._grasp is not None
                self._squeezed = False
                if self._hand is not None:
                    self._motors.begin(self._hand, self._grasp.squeeze)
                self._head_for(t, self._grasp.close, self._grasp.speed)
            case "ToLiftedPose":
                assert self.way is not None
                self._after.clear()
                self._enough = self.cell.settings.validation.samples
                self._grasped = self.cell.robot.palm(state)
                up = np.array([0.0, 0.0, self.cell.settings.lift])
                self._go(t, Pose(self.way.palm.position + up, self.way.palm.rotation), self.cell.settings.arm.lift)
            case "Validate":
                self._look_again(state)
            case "ToReleasePose":
                path = self._release_path(now, state)
                if path is not None:
                    self._down = self.cell.robot.flange_for(path.palm)
                    self._above, self._left = path.over, [path.up, path.across, path.palm]
                    self._step(t, state)
            case "PutBack":
                self._down = self.cell.robot.flange_for(self._grasped)
                self._above, self._left = self._way_back(state)
                self._step(t, state)
            case "OpeningHand":
                assert self._grasp is not None
                self._over = self._above
                self._head_for(t, self._grasp.preshape, OPENING)
            case "Retreat":
                palm = self.cell.robot.palm(state)
                self._go(t, Pose(palm.position + self._away, palm.rotation), _RETREATS)
            case "Done":
                self.stand_still(state)
                self._after.clear()
                self._sight, self._asked = None, None

    def on_reflex(self, error: ArmReflex, state: HandState) -> None:
        """The arm has stopped by itself and is recovered: it stays where it is until a state leads it away."""
        self._away = retreat_offset(error, self.cell.robot.base.rotation)
        self._reflex = CellOutcome("fault", error.name, str(error))
        self.stand_still(state)

    def stand_still(self, state: HandState) -> None:
        """The arm stays where it is."""
        self.guide.target.move(self.cell.robot.model.pose(state.position))
        self.guide.let_go()

    def collect_force(self, now: MachineState, state: HandState) -> None:
        """Every state of the arm: what the flange feels is gathered while it is needed and the arm rests."""
        kept = None
        if now.state == "Look" and float(np.abs(state.velocity).max()) < _STILL:
            kept = self._idle
        elif now.state == "ToTargetPose" and not self._left and state.t >= self._there + _REST:
            kept = self._before
        elif now.state == "Done" or (now.state == "Validate" and state.t >= now.since + _REST):
            kept = self._after
        if kept is not None:
            flange = self.cell.robot.model.pose(state.position).rotation
            kept.append(self.cell.robot.compensation.flange_wrench(state.wrench, flange, state.gravity))

    def update_hand(self, state: HandState) -> None:
        """Every state of the hand."""
        self._hand = state
        gravity = self.cell.model.gravity_torque(state.position, state.gravity)
        self._motors.update(state, self.fingers(state.t), gravity)

    def observe(self, now: MachineState, state: HandState) -> Observation:
        """What the state machine has to know of this moment; pictures are taken here."""
        reflex, self._reflex = self._reflex, None
        if reflex is not None:
            return self._met(now, state, reflex)
        full = at_limit(state, self.cell.robot.spec, self.cell.robot.limits)
        if full is not None:
            return Observation(state.t, fault=CellOutcome("fault", "arm at a limit", full))
        if self._blocked is not None:
            return Observation(state.t, fault=self._blocked)
        weak = self._powerless()
        if weak is not None:
            return Observation(state.t, fault=weak)
        match now.state:
            case "Look":
                self._look(state)
                return Observation(
                    state.t, done=self.way is not None, refused=self._refused, doubt=self._selector.doubt
                )
            case "ClosingHand":
                return Observation(state.t, done=self._closed(state.t))
            case "Validate":
                return self._check(state)
        if now.state == "ToReleasePose" and self._no_way is not None:
            refused, self._no_way = self._no_way, None
            return Observation(state.t, refused=refused)
        if now.state in _FAR and self._left and state.t >= self._there:
            if now.state == "ToSecurityPose":
                self._head_for(state.t, self.cell.open, OPENING)
                self._back(state.t, state)
            else:
                self._step(state.t, state)
            return Observation(state.t)
        if now.state == "ToTargetPose" and len(self._before) < self._tare:
            return Observation(state.t)  # The tare.
        match now.state:
            case "PutBack":
                there = state.t >= self._there and (self._arrived(state, _LOOSE) or self._rests_on_something(state))
                return Observation(state.t, done=there)
            case "ToReleasePose":
                there = state.t >= self._there and (self._arrived(state, _LOOSE) or self._rests_on_something(state))
                lost = there and not self._between(state)
                self._lost = self._lost or lost
                return Observation(state.t, done=there and not lost, held=False if lost else None)
            case "OpeningHand":
                return Observation(state.t, done=state.t >= self._there)
        loose = _LOOSE if now.state == "ToLiftedPose" else 1.0
        return Observation(state.t, done=self._arrived(state, loose) and state.t >= self._there)

    def _met(self, now: MachineState, state: HandState, reflex: CellOutcome) -> Observation:
        """The arm has met something. What comes down where it is to be let go has arrived, and a hand that opens there
        goes on to open."""
        if now.state == "OpeningHand":
            return Observation(state.t, done=state.t >= self._there)
        down = now.state in ("ToReleasePose", "PutBack") and not self._left and self._comes_down(state)
        return Observation(state.t, done=True) if down else Observation(state.t, reflex=reflex)

    def _remember(self, now: MachineState) -> None:
        """What came of the last try."""
        if now.released > self._selector.released:
            self._selector.put_away()
        elif self.way is not None and self.solid is not None:
            self._selector.missed(self.way.card, self.solid, leave=now.tries == 1)

    def _release_path(self, now: MachineState, state: HandState) -> ReleasePath | None:
        """The way to where the object is let go; where there is none, the next observation says so."""
        tray, way = self.cell.settings.tray, self.way
        assert tray is not None
        assert way is not None
        assert self.solid is not None
        try:
            return release_path(
                tray, way, self._grasped, self.solid, self.others, state.position, self.cell, now.released,
                self._in_tray,
            )  # fmt: skip
        except ConfigError as error:
            self._no_way = CellOutcome("refused", "in the way", str(error))
            return None

    def _way_back(self, state: HandState) -> tuple[Pose, list[Vector | Pose]]:
        """The palm above where it grasped, and straight ways there: up, across, turned back, and down."""
        here, there = self.cell.robot.palm(state), self._grasped
        high = max(here.position[2], there.position[2] + self.cell.settings.lift)
        above = Pose(np.array([*there.position[:2], high]), there.rotation)
        aside = float(np.linalg.norm((here.position - there.position)[:2])) > _ASIDE
        up = Pose(np.array([*here.position[:2], high]), here.rotation)
        return above, [up, above, there] if aside else [there]

    def _between(self, state: HandState) -> bool:
        """Whether the fingers still press on something that is not there around nothing."""
        if self._hand is None or self._grasp is None:
            return True
        nothing = empty_grasp(self.cell.settings.hand, self._grasp, self.cell.robot.palm(state).rotation)
        _, _, between = self._torques(self._hand, nothing)
        return between > NOTHING * self.cell.settings.validation.torque

    def _torques(self, hand: HandState, nothing: EmptyGrasp) -> tuple[Vector, Vector, float]:
        """What the motors give and what gravity takes, (n,) each, and what is between the fingers, N·m."""
        cell = self.cell
        gravity = cell.model.gravity_torque(hand.position, hand.gravity)
        torque = self._motors.given(hand, self.fingers(hand.t), gravity)
        friction = cell.hand.spec.actuation.frictionloss
        press = pressing_torque(hand.position, torque - gravity, nothing, cell.stiffness, friction)
        touching = touching_joints(cell.settings.hand, hand.position)
        return torque, gravity, torque_between_fingers(press, nothing, touching)

    def recheck(self, now: MachineState, state: HandState) -> Observation:
        """Whether what was said to be held after the lift still is, once there are as many samples and a picture again;
        that the run is not over until then."""
        weak = self._reflex or self._powerless()
        if weak is not None:
            return Observation(state.t, fault=weak)
        if state.t < now.since + WATCHED:
            return Observation(state.t)
        if self._sight is None and self._asked is None:
            self._look_again(state)
        told = self.checked
        found = self._check(state, again=True)
        if found.held:
            self.checked = told  # What the verdict went by.
        return found

    def _powerless(self) -> CellOutcome | None:
        hand = self._hand
        return None if hand is None else self._motors.fault(hand, self.fingers(hand.t))

    def _look_again(self, state: HandState) -> None:
        """Take a picture of what is in the hand."""
        self._sight, self._asked = None, (self.cell.camera.capture(self.cell.robot.world.data), state.position)

    def _sighted(self, state: HandState, hand: HandState) -> CameraCheck | None:
        """What the picture says that was taken after the lift; None while it is not there yet."""
        if self._sight is not None or self._asked is None:
            return self._sight
        frame, posture = self._asked
        if state.t < frame.ready - 1e-9:
            return None
        self._asked, cell = None, self.cell
        if self._is_old(frame) or self._found is None:
            self._sight = CameraCheck(fresh=False)
            return self._sight
        self._last = frame
        cloud = cell.self_filter.remove_robot(frame.cloud, posture, hand.position)
        cloud = self._without_tray(cloud, frame)
        moved, lift, settings = (self._grasped, cell.robot.palm(state)), cell.settings.lift, cell.settings.perception
        others = np.concatenate([np.empty((0, 3)), *self.others])
        self._sight = check_camera(frame, cloud, self._found, others, moved, lift, settings)
        part = lifted_part(frame, cloud, self._found, others, moved, lift, settings) if self._sight.left else None
        if part is not None:  # What looked like one body was several.
            self.others += tuple(one.points for one in self._found.instead if one is not part.found)
            self._found, self._sight, self.solid = part.found, part.sight, part.found.solid
        return self._sight

    def _go(self, t: float, palm: Pose, seconds: float) -> None:
        """Straight there, in so much time at least, s, and not too fast."""
        flange = self.cell.robot.flange_for(palm)
        seconds = max(seconds, float(np.linalg.norm(flange.position - self.guide.target.pose.position)) / _SLOWLY)
        self._there = max(self._there, self.guide.straight(t, flange, seconds))

    def _step(self, t: float, state: HandState) -> None:
        """Head for the next of what is left: a posture through the joints, a pose of the palm straight."""
        goal = self._left.pop(0)
        if isinstance(goal, Pose):
            self._go(t, goal, self.cell.settings.arm.approach)
        else:
            self._far(t, state, goal)

    def _far(self, t: float, state: HandState, posture: Vector) -> None:
        speed = self.cell.settings.arm.joint_speed
        self._there = max(self._there, self.guide.through_joints(t, state.position, posture, speed))

    def _back(self, t: float, state: HandState) -> None:
        """To where the arm waits, unless the table is in the way; where the thing is by now nobody knows."""
        cell = self.cell
        arm, times = far_path(state.position, cell.posture, cell.settings.arm.joint_speed)
        cell.clearance.nothing()
        met = cell.clearance.on_way(arm, np.stack([self.fingers(t + each).position for each in times]))
        self._left = []
        if met is None:
            self._far(t, state, cell.posture)
            return
        said = f"{met} on the way back to where it waits: the arm stands still; lead it out by hand"
        self._blocked = CellOutcome("fault", "in the way", said)
        self.stand_still(state)

    def _head_for(self, t: float, posture: Vector, speed: float) -> None:
        # The fingers' clock is the controller's, which began with the run at 0.
        self._there = self.fingers.head_for(t, posture, speed)

    def _arrived(self, state: HandState, loose: float) -> bool:
        decide, pose, goal = (
            self.cell.settings.decide,
            self.cell.robot.model.pose(state.position),
            self.guide.target.pose,
        )
        off = np.linalg.norm(pose.position - goal.position)
        return bool(
            off < loose * decide.near
            and np.linalg.norm(rotation_between(pose.rotation, goal.rotation)) < loose * decide.turned
        )

    def _rests_on_something(self, state: HandState) -> bool:
        """Whether it is still where it came down: a full tray is higher than an empty one."""
        return self._comes_down(state) and float(np.abs(state.velocity).max()) < _STILL

    def _comes_down(self, state: HandState) -> bool:
        """Whether it is above where it is to come down."""
        base, pose, goal = self.cell.robot.base, self.cell.robot.model.pose(state.position), self._down
        off = base.rotation @ (pose.position - goal.position)
        most = _LOOSE * self.cell.settings.decide.near
        return float(np.hypot(off[0], off[1])) < most and off[2] > -most

    def _closed(self, t: float) -> bool:
        if t < self._there:
            return False
        if not self._squeezed:
            assert self._grasp is not None
            self._squeezed = True
            self._head_for(t, self._grasp.squeeze, squeeze_speed(self._grasp))
            return False
        return True

    def _look(self, state: HandState) -> None:
        cell = self.cell
        if self._asked is None:
            self._asked = cell.camera.capture(cell.robot.world.data), state.position
        frame, posture = self._asked
        if state.t < frame.ready - 1e-9:
            return
        self._asked = None
        if self._is_old(frame):
            old = check_age(frame.time, state.t, cell.settings.perception.oldest, self._recorded)
            self._refused = None if old is None else CellOutcome("fault", "camera", old.sentence)
            return
        self._last = frame
        alone = cell.self_filter.remove_robot(
            frame.cloud, posture, cell.open if self._hand is None else self._hand.position
        )
        cloud = self._without_tray(alone if cell.settings.at_the_wrist else frame.cloud, frame)
        if cell.settings.tray is not None:
            before, self._in_tray = (
                self._in_tray,
                points_in_tray(frame.pose.world(alone.astype(np.float64)), cell.settings.tray),
            )
            if self._lost and tray_filled(before, self._in_tray, cell.settings.perception.object.gap):
                self._selector.fell_into_tray()
            self._lost = False
            every = cell.pipeline.detect_all(cloud, frame.pose.position, frame.pose.rotation)
            chosen = self._selector.first(every, frame, alone)
            self._take(chosen)
            self.on_detection(frame, chosen.found if isinstance(chosen, SelectedObject) else every[0])
            return
        if cell.wanted is None:
            seen = cell.pipeline.detect(cloud, frame.pose.position, frame.pose.rotation)
        else:
            seen = wanted_first(cell.pipeline.detect_all(cloud, frame.pose.position, frame.pose.rotation), cell.wanted)[
                0
            ]
        self.on_detection(frame, seen)
        seen = self._steady(seen, frame.time)
        if isinstance(seen, PerceptionRefusal):
            self._refused = refusal_outcome(seen)
            return
        self._take(self._selector.first([seen], frame, alone))

    def _is_old(self, frame: CameraFrame) -> bool:
        """Whether it is the picture that was looked at last."""
        return self._last is not None and frame.number == self._last.number

    def _take(self, chosen: SelectedObject | CellOutcome) -> None:
        """Go for it, or remember why that cannot be."""
        if isinstance(chosen, CellOutcome):
            self._refused = chosen
            return
        self._refused, self.others, self._found = None, chosen.others, chosen.found
        self.way, self._through, self.solid = chosen.plan.way, chosen.plan.through, chosen.found.solid

    def _without_tray(self, cloud: Cloud, frame: CameraFrame) -> Cloud:
        """A cloud in which the tray and what is in it are unknown."""
        tray = self.cell.settings.tray
        if tray is None:
            return cloud
        known, there = finite(cloud), np.zeros(cloud.shape[:2], np.bool_)
        world = frame.pose.world(cloud[known].astype(np.float64))
        there[known] = on_tray(world, world[:, 2], tray, self.cell.settings.perception.object.gap)
        return np.where(there[..., None], np.float32(np.nan), cloud)

    def _steady(self, seen: Detection | PerceptionRefusal, time: float) -> Detection | PerceptionRefusal:
        """The detection, once its target stands still where the settings ask for that; until then why it does not."""
        settings = self.cell.settings.perception
        if settings.steady is None or isinstance(seen, PerceptionRefusal):
            return seen
        target = grasp_target(seen, settings.target)
        if isinstance(target, PerceptionRefusal):
            return target
        self._track = track_target(self._track, target, time, settings.steady)
        return check_steadiness(self._track, settings.steady) or seen

    def _check(self, state: HandState, *, again: bool = False) -> Observation:
        """What the state machine hears of the checks; `again`: it was held by those before."""
        cell, settings = self.cell, self.cell.settings.validation
        if len(self._after) < self._enough or self._hand is None or self.way is None or self._grasp is None:
            return Observation(state.t)
        hand, spec, friction = self._hand, cell.hand.spec, cell.hand.spec.actuation.frictionloss
        dead, sight = self._motors.dead(hand), self._sighted(state, hand)
        if dead is not None or sight is None:
            return Observation(state.t, fault=dead)
        axes = cell.robot.base.rotation @ cell.robot.model.pose(state.position).rotation
        nothing = empty_grasp(cell.settings.hand, self._grasp, self.way.palm.rotation)
        torque, gravity, squeeze = self._torques(hand, nothing)
        stop, weight = stopping_torque(torque, gravity, friction), weigh(self._before, self._after, axes)
        told = detectable_weight(len(self._before), len(self._after), settings)
        found = check_grasp(weight, told, stop, squeeze, sight, settings)
        why = check_drift(self._idle, self._before, settings, len(self.others))
        why = why or check_plausibility(found, self._before, self._after, axes, settings)
        self.checked = with_uncertainty(found, why, settings)

        def sure() -> bool:
            ways = misread_positions(hand.position)
            off = pressing_torque(ways, torque - gravity, nothing, cell.stiffness, friction)
            meet = touching_joints(cell.settings.hand, ways)
            return presses_surely(off, nothing, meet, [finger.joints for finger in spec.fingers], settings.torque)

        seen = grasp_verdict(state.t, self.checked, sight, sure, settings, again=again)
        unsure = seen.fault is not None and seen.fault.reason == "not confirmed"
        unsure = unsure or (not seen.held and may_weigh_more(self.checked, sight))
        if unsure and len(self._after) < settings.long:
            self._enough = settings.long  # It may be light: weigh it for longer.
            return Observation(state.t)
        return seen
