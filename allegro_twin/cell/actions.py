"""What the states do: the thin shell around the state machine, which moves targets and takes pictures."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from allegro_twin.cell.arm.limits import at_limit
from allegro_twin.cell.assembly import Room
from allegro_twin.cell.camera.frame import Frame
from allegro_twin.cell.checks.camera_check import Sight, sighted
from allegro_twin.cell.checks.force_sensor_check import doubted, drifted, with_doubt
from allegro_twin.cell.checks.grasp_check import (
    Checked,
    between,
    checked,
    detectable,
    pressing,
    stopped,
    surely,
    tare,
    verdict,
    weighed,
)
from allegro_twin.cell.checks.motor_check import MotorCheck
from allegro_twin.cell.motion.arm_motion import Guide
from allegro_twin.cell.motion.clutter import beside
from allegro_twin.cell.motion.empty_grasp import around_nothing, meeting, misread, squeezing
from allegro_twin.cell.motion.finger_paths import OPENING
from allegro_twin.cell.motion.grasp_selection import Way
from allegro_twin.cell.perception.errors import Refused, stale
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.perception.pipeline import Found
from allegro_twin.cell.reachability import best_way, way_of
from allegro_twin.cell.states import End, Now, Seen
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.arm import rotation_between
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Array, HandState, Vector

_STILL = 0.02  # rad/s, of the fastest joint of an arm that rests.
_REST = 0.2  # s. After a motion, until what hangs on the flange has come to rest.
WATCHED = 0.5
"""s. How long arm and hand are watched after the end, and what is held is then looked at again."""
_LOOSE = 3.0  # Times the tolerance after the lift: the load pulls the spring down.


class Work:
    """One run's memory of what was seen, felt and sent."""

    def __init__(self, room: Room) -> None:
        self.room, self.guide = room, Guide(room.posture, room.cell.model)
        self.fingers = SmoothSetpoint(room.open)
        self.way: Way | None = None
        self._through: tuple[Vector, ...] = ()
        self._left: list[Vector] = []  # Of these postures, those still to come.
        self.solid: Solid | None = None
        self.seen_at = 0.0
        """When the picture was taken, s."""
        self.checked: Checked | None = None
        self.looked: Callable[[Frame, Found | Refused], None] = lambda frame, seen: None
        """Hears what perception says of every picture."""
        self._last = room.camera.capture(room.cell.world.data)  # The camera is there; the next must be a new one.
        self._asked: tuple[Frame, Vector] | None = None  # A picture, and where the arm was when it was taken.
        self._refused: End | None = None
        self._blocked: End | None = None
        self._grasp: Grasp | None = None
        self._there = 0.0  # When the fingers will be.
        self._squeezed = False
        self._hand: HandState | None = None
        self._motors = MotorCheck(room.hand.spec, room.stiffness, room.forces, room.hand.period)
        self._found: Found | None = None
        self.others: tuple[Array, ...] = ()
        """Points of each other object on the table, at the last look, (k, 3), world, m."""
        self._grasped = room.security  # The palm, before the lift.
        self._sight: Sight | None = None
        samples = room.settings.validation.samples
        self._idle: deque[Vector] = deque(maxlen=samples)
        self._before: deque[Vector] = deque()
        self._after: deque[Vector] = deque(maxlen=room.settings.validation.long)
        self._tare = samples
        self._enough = samples
        """So many samples of the force before the approach, and after the lift."""

    def enter(self, now: Now, state: HandState) -> None:
        """Begin what a state is for; `state` is the arm's."""
        t = now.since
        match now.state:
            case "ToSecurityPose":
                self._head_for(t, self.room.open, OPENING)
                self._back(t, state)
            case "Look":
                self._asked, self._refused, self.way = None, None, None
                self._idle.clear()
            case "ToTargetPose":
                assert self.way is not None
                self._grasp = self.room.library.grasp(self.way.card.grasp, self.room.hand.spec)
                self._before.clear()
                if self.solid is not None:
                    self._tare = tare(np.asarray(self.solid.size), self.room.settings.validation)
                self._head_for(t, self._grasp.preshape, OPENING)
                self._left = list(self._through)
                self._far(t, state, self._left.pop(0))
            case "Approach":
                assert self.way is not None
                self._go(t, self.way.palm, self.room.settings.arm.approach)
            case "ClosingHand":
                assert self._grasp is not None
                self._squeezed = False
                if self._hand is not None:
                    self._motors.begin(self._hand, self._grasp.squeeze)
                self._head_for(t, self._grasp.close, self._grasp.speed)
            case "ToLiftedPose":
                assert self.way is not None
                self._after.clear()
                self._enough = self.room.settings.validation.samples
                self._grasped = self.room.cell.palm(state)
                up = np.array([0.0, 0.0, self.room.settings.lift])
                self._go(t, Pose(self.way.palm.position + up, self.way.palm.rotation), self.room.settings.arm.lift)
            case "Validate":
                self._look_again(state)
            case "Done":
                self.stand_still(state)
                self._after.clear()
                self._sight, self._asked = None, None

    def stand_still(self, state: HandState) -> None:
        """The arm stays where it is."""
        self.guide.target.move(self.room.cell.model.pose(state.position))
        self.guide.let_go()

    def felt(self, now: Now, state: HandState) -> None:
        """Every state of the arm: what the flange feels is gathered while it is needed and the arm rests."""
        kept = None
        if now.state == "Look" and float(np.abs(state.velocity).max()) < _STILL:
            kept = self._idle
        elif now.state == "ToTargetPose" and not self._left and state.t >= self._there + _REST:
            kept = self._before
        elif now.state == "Done" or (now.state == "Validate" and state.t >= now.since + _REST):
            kept = self._after
        if kept is not None:
            flange = self.room.cell.model.pose(state.position).rotation
            kept.append(self.room.cell.bridge.felt(state.wrench, flange, state.gravity))

    def hand_is(self, state: HandState) -> None:
        """Every state of the hand."""
        self._hand = state
        gravity = self.room.model.gravity_torque(state.position, state.gravity)
        self._motors.see(state, self.fingers(state.t), gravity)

    def know(self, now: Now, state: HandState) -> Seen:
        """What the state machine has to know of this moment; pictures are taken here."""
        full = at_limit(state, self.room.cell.spec, self.room.cell.limits)
        if full is not None:
            return Seen(state.t, fault=End("fault", "arm at a limit", full))
        if self._blocked is not None:
            return Seen(state.t, fault=self._blocked)
        weak = self._powerless()
        if weak is not None:
            return Seen(state.t, fault=weak)
        match now.state:
            case "Look":
                self._look(state)
                return Seen(state.t, done=self.way is not None, refused=self._refused)
            case "ClosingHand":
                return Seen(state.t, done=self._closed(state.t))
            case "Validate":
                return self._check(state)
        if now.state == "ToTargetPose" and self._left and state.t >= self._there:
            self._far(state.t, state, self._left.pop(0))
            return Seen(state.t)
        if now.state == "ToTargetPose" and len(self._before) < self._tare:
            return Seen(state.t)  # The tare.
        loose = _LOOSE if now.state == "ToLiftedPose" else 1.0
        return Seen(state.t, done=self._arrived(state, loose) and state.t >= self._there)

    def keeps(self, now: Now, state: HandState) -> Seen:
        """Whether what was said to be held after the lift still is, once there are as many samples and a picture again;
        that the run is not over until then."""
        weak = self._powerless()
        if weak is not None:
            return Seen(state.t, fault=weak)
        if state.t < now.since + WATCHED:
            return Seen(state.t)
        if self._sight is None and self._asked is None:
            self._look_again(state)
        told = self.checked
        found = self._check(state)
        if found.held:
            self.checked = told  # What the verdict went by.
        return found

    def _powerless(self) -> End | None:
        hand = self._hand
        return None if hand is None else self._motors.fault(hand, self.fingers(hand.t))

    def _look_again(self, state: HandState) -> None:
        """Take a picture of what is in the hand."""
        self._sight, self._asked = None, (self.room.camera.capture(self.room.cell.world.data), state.position)

    def _sighted(self, state: HandState, hand: HandState) -> Sight | None:
        """What the picture says that was taken after the lift; None while it is not there yet."""
        if self._sight is not None or self._asked is None:
            return self._sight
        frame, posture = self._asked
        if state.t < frame.ready - 1e-9:
            return None
        self._asked, room = None, self.room
        if frame.number == self._last.number or self._found is None:
            self._sight = Sight(fresh=False)
            return self._sight
        self._last = frame
        cloud, moved = room.itself.cut_out(frame.cloud, posture, hand.position), (self._grasped, room.cell.palm(state))
        self._sight = sighted(
            frame,
            cloud,
            self._found,
            np.concatenate([np.empty((0, 3)), *self.others]),
            moved,
            room.settings.lift,
            room.settings.perception,
        )
        return self._sight

    def _go(self, t: float, palm: Pose, seconds: float) -> None:
        self._there = max(self._there, self.guide.straight(t, self.room.cell.flange_for(palm), seconds))

    def _far(self, t: float, state: HandState, posture: Vector) -> None:
        speed = self.room.settings.arm.joint_speed
        self._there = max(self._there, self.guide.through_joints(t, state.position, posture, speed))

    def _back(self, t: float, state: HandState) -> None:
        """To where the arm waits, unless the table is in the way; where the thing is by now nobody knows."""
        room = self.room
        arm, times = way_of(state.position, room.posture, room.settings.arm.joint_speed)
        room.apart.nothing()
        met = room.apart.on_way(arm, np.stack([self.fingers(t + each).position for each in times]))
        if met is None:
            self._far(t, state, room.posture)
            return
        said = f"{met} on the way back to where it waits: the arm stands still; lead it out by hand"
        self._blocked = End("fault", "in the way", said)
        self.stand_still(state)

    def _head_for(self, t: float, posture: Vector, speed: float) -> None:
        # The fingers' clock is the controller's, which began with the run at 0.
        self._there = self.fingers.head_for(t, posture, speed)

    def _arrived(self, state: HandState, loose: float) -> bool:
        decide, pose, goal = (
            self.room.settings.decide,
            self.room.cell.model.pose(state.position),
            self.guide.target.pose,
        )
        off = np.linalg.norm(pose.position - goal.position)
        return bool(
            off < loose * decide.near
            and np.linalg.norm(rotation_between(pose.rotation, goal.rotation)) < loose * decide.turned
        )

    def _closed(self, t: float) -> bool:
        if t < self._there:
            return False
        if not self._squeezed:
            assert self._grasp is not None
            self._squeezed = True
            self._head_for(t, self._grasp.squeeze, squeezing(self._grasp))
            return False
        return True

    def _look(self, state: HandState) -> None:
        room = self.room
        if self._asked is None:
            self._asked = room.camera.capture(room.cell.world.data), state.position
        frame, posture = self._asked
        if state.t < frame.ready - 1e-9:
            return
        self._asked = None
        if frame.number == self._last.number:
            old = stale(frame.time, state.t, room.settings.perception.oldest)
            self._refused = None if old is None else End("fault", "camera", old.sentence)
            return
        self._last = frame
        alone = room.itself.cut_out(frame.cloud, posture, room.open if self._hand is None else self._hand.position)
        cloud = alone if room.settings.at_the_wrist else frame.cloud
        seen = room.pipeline.look(cloud, frame.pose.position, frame.pose.rotation)
        self.looked(frame, seen)
        if not isinstance(seen, Found):
            self._refused = End("refused", seen.reason, seen.sentence)
            return
        try:
            self.others = beside(frame, alone, seen, room.settings.perception)
            best = best_way(seen.solid, room, self.others)
            self.way, self._through = best.way, best.through
        except ConfigError as error:
            self._refused = End("refused", "no_grasp", str(error))
            return
        self.solid, self.seen_at, self._found = seen.solid, frame.time, seen

    def _check(self, state: HandState) -> Seen:
        room, settings = self.room, self.room.settings.validation
        if len(self._after) < self._enough or self._hand is None or self.way is None or self._grasp is None:
            return Seen(state.t)
        hand, spec, friction = self._hand, room.hand.spec, room.hand.spec.actuation.frictionloss
        dead, sight = self._motors.dead(hand), self._sighted(state, hand)
        if dead is not None or sight is None:
            return Seen(state.t, fault=dead)
        axes = room.cell.base.rotation @ room.cell.model.pose(state.position).rotation
        gravity = room.model.gravity_torque(hand.position, hand.gravity)
        torque = self._motors.given(hand, self.fingers(hand.t), gravity)
        nothing = around_nothing(room.settings.hand, self._grasp.name, self.way.palm.rotation)
        press = pressing(hand.position, torque - gravity, nothing, room.stiffness, friction)
        squeeze = between(press, nothing, meeting(room.settings.hand, hand.position))
        stop, weight = stopped(torque, gravity, friction), weighed(self._before, self._after, axes)
        told = detectable(len(self._before), len(self._after), settings)
        found = checked(weight, told, stop, squeeze, sight, settings)
        why = drifted(self._idle, self._before, settings, len(self.others))
        why = why or doubted(found, self._before, self._after, axes, settings)
        self.checked = with_doubt(found, why, settings)

        def sure() -> bool:
            ways = misread(hand.position)
            off = pressing(ways, torque - gravity, nothing, room.stiffness, friction)
            meet = meeting(room.settings.hand, ways)
            return surely(off, nothing, meet, [finger.joints for finger in spec.fingers], settings.torque)

        seen = verdict(state.t, self.checked, sight, sure, settings)
        if seen.fault is not None and seen.fault.reason == "not confirmed" and len(self._after) < settings.long:
            self._enough = settings.long  # It may be light: weigh it for longer.
            return Seen(state.t)
        return seen
