"""Check of what is in the hand after the lift: by the force on the flange, the fingers and the camera."""

from __future__ import annotations

from allegro_twin.cell.actions.cell_pictures import LiftedLook, Target
from allegro_twin.cell.actions.force_samples import ForceSamples
from allegro_twin.cell.actions.hand_monitor import HandMonitor
from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.checks.grasp_check import (
    GraspCheck,
    check_grasp,
    detectable_weight,
    grasp_verdict,
    may_weigh_more,
    stopping_torque,
    weigh,
)
from allegro_twin.cell.checks.sensor_zero_check import check_drift, check_plausibility, with_uncertainty
from allegro_twin.cell.motion.empty_grasp import empty_grasp
from allegro_twin.cell.states import Observation
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import HandState


class HeldCheck:
    """Checks what is held, once there are enough samples of the force and a picture."""

    def __init__(self, cell: Cell, hand: HandMonitor, forces: ForceSamples, lifted: LiftedLook) -> None:
        self._cell, self._hand, self._forces, self._lifted = cell, hand, forces, lifted
        self.found: GraspCheck | None = None
        """What the verdict goes by; None from when an object is selected until it is checked."""

    def check(
        self, state: HandState, target: Target, grasp: Grasp, grasped: Pose, *, again: bool = False
    ) -> Observation:
        """What the state machine hears. `state`: the arm's; `grasped`: the palm before the lift; `again`: the check
        before found it held, and `found` stays that of it."""
        cell, settings, forces, hand = self._cell, self._cell.settings.validation, self._forces, self._hand.state
        if not forces.is_weighed or hand is None or target.candidate is None:
            return Observation(state.t)
        dead, sight = self._hand.dead(hand), self._lifted.look(state, hand, grasped)
        if dead is not None or sight is None:
            return Observation(state.t, fault=dead)
        axes = cell.robot.base.rotation @ cell.robot.model.pose(state.position).rotation
        empty = empty_grasp(cell.settings.hand, grasp, target.candidate.palm.rotation)
        torque, gravity = self._hand.torques(hand)
        stop = stopping_torque(torque, gravity, cell.hand.spec.actuation.frictionloss)
        weight, told = (
            weigh(forces.before, forces.after, axes),
            detectable_weight(len(forces.before), len(forces.after), settings),
        )
        checked = check_grasp(weight, told, stop, self._hand.squeeze(hand, empty), sight, settings)
        why = check_drift(forces.idle, forces.before, settings, len(target.others))
        why = why or check_plausibility(checked, forces.before, forces.after, axes, settings)
        checked = with_uncertainty(checked, why, settings)
        seen = grasp_verdict(
            state.t, checked, sight, lambda: self._hand.surely_presses(hand, empty), settings, again=again
        )
        unsure = seen.fault is not None and seen.fault.reason == "not confirmed"
        unsure = unsure or (not seen.held and may_weigh_more(checked, sight))
        if not (again and seen.held):
            self.found = checked
        if unsure and forces.weigh_longer():  # It may be light.
            return Observation(state.t)
        return seen
