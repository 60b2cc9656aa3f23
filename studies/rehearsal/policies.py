"""Shipped policies on a hidden hand, over the bus, and what simulations say of them before: the nominal hand's, and
those of hands drawn from the posterior in the identified hand's file.

Not of the hidden hand in these episodes: its leaning mount, and its contacts but for their friction.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy.stats import betabinom  # type: ignore[import-untyped]  # Its types are a package of its own.

from allegro_twin import HandBackend, HandError, HandSpec, HandState, run
from allegro_twin.app import assemble
from allegro_twin.files import find_file
from allegro_twin.gym import EnvSettings
from allegro_twin.learning import evaluate, load_policy, load_recipe, policy_controller
from allegro_twin.learning.environments import EpisodeBackend
from studies.rehearsal.hidden_hand import STEP, HiddenHand
from studies.rehearsal.motor_laws import MotorLaws
from studies.rehearsal.sessions import hidden_config

POLICY_SEED = 3_100_000_000
"""Of the episodes of policies: none that a training or a choice about one has seen."""
SIMULATED = 0.001
"""s, of the physics in which a policy is tried before."""
SURE = (0.025, 0.975)


class PolicyTrial(NamedTuple):
    """A policy that ships, the recipe of its task, and how many episodes are played."""

    policy: str
    recipe: str
    episodes: int
    """On the hidden hand, with each host."""
    simulated: int


POLICIES = (
    PolicyTrial("grasp_right", "grasp_easy", 12, 96),
    PolicyTrial("lift_right", "lift", 12, 96),
    PolicyTrial("rotate_hand_right", "rotate_on_palm_hand", 6, 48),
)
"""All are of right hands."""


class HiddenEpisode(EpisodeBackend):
    """An episode of a task whose hand has hidden motors and gears, and encoders that are off."""

    def __init__(self, hand: HiddenHand, task: str, settings: EnvSettings, seed: int) -> None:
        super().__init__(task, settings, seed)
        self._hand, self._laws = hand, MotorLaws(hand.physics, STEP)
        self._rng = np.random.default_rng((hand.number, seed))
        self._substeps = round(settings.period / settings.timestep)
        self.model = self.engine.worlds.model
        self.data = mujoco.MjData(self.model)
        """Of no contact: what a v5 hand says of pressure, no policy reads."""

    def reset(self) -> HandState:
        state, worlds, own = super().reset(), self.engine.worlds, self._hand.physics
        at = (0, worlds.dofs)
        worlds.expand("dof_frictionloss")[at] = worlds.expand("dof_damping")[at] = 0.0
        worlds.expand("dof_solimp")[0, worlds.dofs, :2] = 0.9999  # Dry friction holds, and does not creep.
        worlds.expand("dof_armature")[at] = 2e-5 if own.spring else own.armature
        worlds.expand("geom_friction")[0, :, 0] *= self._hand.friction
        joints = [int(worlds.model.joint(name).bodyid[0]) for name in self.spec.joints]
        worlds.expand("body_mass")[0, joints] *= own.mass
        worlds.expand("body_inertia")[0, joints] *= own.mass[:, None]
        worlds.derive(np.zeros(1, np.int64))
        self._laws.reset(np.array(worlds.position[0]))
        self._coming: list[tuple[int, Any]] = []
        self._duty, self._steps = np.zeros(self.spec.n_joints), 0
        return self._reported(state)

    def read(self) -> HandState:
        return self._reported(super().read())

    def simulate(self, k: int) -> None:
        worlds, own, limit = self.engine.worlds, self._hand.physics, self.spec.actuation.torque_limit
        self._coming.append((self._steps + round(own.delay / STEP), np.clip(self.command, -limit, limit)))
        self.engine.task.move_surroundings(k)
        dry = worlds.expand("dof_frictionloss")
        for _ in range(self._substeps):
            while self._coming and self._coming[0][0] <= self._steps:
                self._duty = self._coming.pop(0)[1]
            torque, slides = self._laws.step(self._duty, worlds.position[0], worlds.velocity[0], self._steps * STEP)
            worlds.joint_force[0, worlds.dofs] = torque
            if self._laws.link_friction:
                dry[0, worlds.dofs] = slides
            worlds.control[...] = 0.0
            worlds.step(None, 1)
            self._steps += 1

    def _reported(self, state: HandState) -> HandState:
        own = self._hand.physics
        heard = state.position + own.offset + own.noise * self._rng.standard_normal(len(state.position))
        given = self._duty.copy()
        for array in (heard, given):
            array.setflags(write=False)
        return replace(state, position=heard, torque=given)


def try_policies(hand: HiddenHand, file: Path, seed: int, trials: tuple[PolicyTrial, ...] = POLICIES) -> list[Any]:
    """Rows of the policies of a hand's side: successes on the hidden hand with each host, and of simulations."""
    mine = [trial for trial in trials if hand.side == "right"]
    return [_try_policy(trial, hand, file, seed) for trial in mine]


def policy_file(trial: PolicyTrial) -> Path:
    """The policy as it ships."""
    return find_file(trial.policy, "policy", "conf/policies", ".onnx")


def _try_policy(trial: PolicyTrial, hand: HiddenHand, file: Path, seed: int) -> dict[str, Any]:
    recipe = load_recipe(trial.recipe)
    usual = recipe.environment.model_copy(update={"device": "cpu", "timestep": SIMULATED, "state": False})
    row: dict[str, Any] = {"policy": trial.policy, "episodes": trial.episodes}
    for twin, serial in (("nominal", ""), ("identified", str(file))):
        won = [_episode(trial, recipe.task, usual, hand, serial, seed + k) for k in range(trial.episodes)]
        row[twin] = {"successes": sum(each["success"] for each in won), "episodes": won}
    policy = load_policy(policy_file(trial))
    of_object = {name: getattr(usual.randomise, name) for name in ("mass", "size", "friction")}
    own = type(usual.randomise)(twin=str(file), **of_object)
    for name, settings in (("simulated", usual), ("posterior", usual.model_copy(update={"randomise": own}))):
        try:
            found = evaluate(policy.policy, recipe.task, settings, trial.simulated, seed=seed)
        except HandError as error:
            row[name] = {"error": str(error)}
            continue
        row[name] = {"successes": int(found.success.sum()), "of": trial.simulated}
        low, high = predicted(int(found.success.sum()), trial.simulated, trial.episodes)
        row[name] |= {"low": low, "high": high, "covers": low <= row["identified"]["successes"] <= high}
    return row


def predicted(successes: int, simulated: int, episodes: int) -> tuple[int, int]:
    """Between how many of some episodes 95 % lie that are as likely to succeed as those that were simulated."""
    low, high = betabinom.ppf(SURE, episodes, successes + 0.5, simulated - successes + 0.5)
    return int(low), int(high)


def _episode(
    trial: PolicyTrial, task: str, settings: EnvSettings, hand: HiddenHand, serial: str, seed: int
) -> dict[str, Any]:
    """One episode on the bus."""
    episode = HiddenEpisode(hand, task, settings.model_copy(update={"timestep": STEP}), seed)

    def physics(spec: HandSpec, step: float) -> tuple[HandBackend, None]:
        return episode, None

    config = hidden_config(hand).changed(hand={"serial": serial}, backend={"gravity": [0.0, 0.0, -9.81]})
    rig = assemble(config, physics)
    with closing(rig.backend):
        episode.reset()
        controller = replace(
            policy_controller(policy_file(trial), rig.spec, goal=episode.goal), script=episode.script,
            target=episode.target, complete=episode.complete_observation, interface=episode.engine.task.interface,
        )  # fmt: skip
        try:
            for _ in run(rig.backend, controller):
                if episode.over:
                    break
        except HandError as error:  # The guard's: too fast, say. The episode is lost.
            return {"success": False, "error": str(error), "count": episode.count}
    return {"success": bool(episode.success), "count": episode.count}
