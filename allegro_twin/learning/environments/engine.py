"""Episode engine: `n` hands at one task, simulated side by side, with one decision for all at a time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import array_namespace, fetch
from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.files.assets import find_file
from allegro_twin.files.schema import parse_settings
from allegro_twin.learning.environments.observation_model import ExternalTorque, PrivilegedState, SignalModel
from allegro_twin.learning.environments.posterior import RandomDrive
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.randomise import PhysicsRandomiser, check_without_object, draw_values
from allegro_twin.learning.environments.settings import (
    VARIATIONS,
    EnvSettings,
    ResetOptions,
    env_keywords,
    read_options,
    read_settings,
)
from allegro_twin.learning.environments.spaces import observation_space
from allegro_twin.learning.policy.card import PolicyCard, check_card, read_card
from allegro_twin.learning.policy.interface import BOUND, Floats, InterfaceMemory, Observation
from allegro_twin.learning.policy.loading import PARTS, check_inputs, policy_file
from allegro_twin.learning.tasks import make_task, task_type
from allegro_twin.learning.tasks.base import Flags, StepOutcome, task_id
from allegro_twin.learning.tasks.task_memory import HasLiveArrays
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.shared_model import SharedModelBatch
from allegro_twin.sim.engine.backend import substeps
from allegro_twin.sim.model.joints import JointChange, moving_dofs
from allegro_twin.types import Array
from allegro_twin.viewing.batch import PictureSensor

_IN_CARD = {"control": "mode", "step": "step", "reach": "reach"}
"""Settings whose values a card has in full, where its environment has the task's own."""


def read_keywords(task: str, keywords: dict[str, Any]) -> EnvSettings:
    """Settings of a task's environments. `policy`, a path or a name, stands for the environments in which it was
    trained, on processors and without what only its critic saw. Raises ConfigError with the nearest keyword, and for
    one that contradicts the policy."""
    name = keywords.get("policy")
    given = read_settings({key: value for key, value in keywords.items() if key != "policy"})
    if name is None:
        return given
    if not isinstance(name, str | Path) or not str(name):
        raise ConfigError(f"policy is the path of a policy's file, or the name of one that ships, not {name!r}")
    card = read_card(policy_file(name))
    if card.environment is None:
        raise ConfigError(
            f"policy {name} does not say in which environments it was trained: give their keywords, and load it with "
            "load_policy"
        )
    if card.task != (own := task_id(task_type(task))):
        raise ConfigError(f"policy {name} is for {card.task}, not for {own}: make that id, or take another policy")
    if "of_side" in keywords and given.side != card.side:
        raise ConfigError(
            f"policy {name} is for the {card.side} hand, and this id the {given.side} hand's: take the id without "
            "a side"
        )
    for key, its, value in contradictions(card, given, given.model_fields_set):
        raise ConfigError(
            f"policy {name} was trained with {key} {its}, not {value}: leave out {key}, or leave out policy and load "
            "it with load_policy"
        )
    trained = _trained_in(card)
    own_keywords = {key: value for key, value in env_keywords(trained).items() if key not in ("device", "state")}
    return EnvSettings(**own_keywords | env_keywords(given))


def make_engine(task: str, keywords: dict[str, Any], n: int, threads: int = 0) -> EpisodeEngine:
    """The engine of environments with these keywords. Raises ConfigError; also for a `policy` whose card or network is
    not one of the environments that it stands for."""
    engine = EpisodeEngine(task, read_keywords(task, keywords), n, threads)
    if (name := keywords.get("policy")) is not None:
        file, who = policy_file(name), f"policy {name}"
        check_card(read_card(file), engine.task.card(), "its card and its environment differ: train it anew", who)
        space: Any = observation_space(engine.task, engine.n_state, engine.pictures)
        check_inputs(file, getattr(space, "spaces", PARTS[:1]), who)
    return engine


def _picture_sensor(settings: EnvSettings, worlds: SharedModelBatch) -> PictureSensor:
    width, height = (int(edge) for edge in settings.resolution.split("x"))
    return PictureSensor(worlds, width, height, views=settings.cameras, kinds=settings.observe)


def training_differences(policy: str, settings: EnvSettings) -> Iterator[str]:
    """Sentences on what a policy, by name or path, was trained with otherwise: palm and goals, which change its task.
    Raises ConfigError."""
    card = read_card(find_file(policy, "policy", "conf/policies", ".onnx"))
    for key, its, value in contradictions(card, settings, ("palm", "goals")):
        yield f"{policy} was trained with {key} {its}; these episodes have {value}"


def contradictions(card: PolicyCard, settings: EnvSettings, keys: Iterable[str]) -> list[tuple[str, object, object]]:
    """Which of these settings are not those of a policy's training and change what it is asked for, with its value and
    the other. None where its card does not say."""
    if card.environment is None:
        return []
    trained, found = _trained_in(card), []
    for key in sorted({*keys} - {*VARIATIONS}):
        value, its = getattr(settings, key), getattr(card, _IN_CARD.get(key, ""), getattr(trained, key))
        if value != its:
            found.append((key, its, value))
    return found


def _trained_in(card: PolicyCard) -> EnvSettings:
    return parse_settings(EnvSettings, card.environment or {}, f"a policy of {card.task}: environment")


class EpisodeEngine:
    """Runs the episodes of all environments. A single environment is an engine with n = 1, so both compute the same
    lines."""

    def __init__(self, task: str, settings: EnvSettings, n: int, threads: int = 0) -> None:
        if not isinstance(threads, int | np.integer) or isinstance(threads, bool) or threads < 0:
            raise ConfigError(f"threads is a whole number, 0 for one per processor, not {threads!r}")
        self.settings, self.n = settings, n
        self._substeps = substeps(settings.period, settings.timestep)
        self.task = make_task(task, settings, n, threads)
        self.worlds = self.task.worlds
        if self.task.object_body is None:
            check_without_object(settings.randomise, self.task.name)
        self._physics = PhysicsRandomiser(self.worlds, self.task.object_body)
        known = self.task.posterior
        self._drive = None if known is None else RandomDrive(known, self.worlds, settings.period)
        self._sensing = SignalModel(settings.randomise, self.worlds, self._drive)
        self._drawn: dict[str, Array] = {}
        self._touch = ExternalTorque(settings.randomise, self.worlds) if settings.touch else None
        self._state = PrivilegedState(self.worlds, self.task.object_body) if settings.state else None
        self.n_state = 0 if self._state is None else self._state.size
        """Numbers of the privileged state; 0 without."""
        self.pictures = _picture_sensor(settings, self.worlds) if settings.observe else None
        """Cameras whose pictures are part of an observation."""
        xp = self.worlds.xp
        self.memory: InterfaceMemory = self.task.interface.start(xp.zeros((n, self.task.spec.n_joints)))
        self.limit = max(round(self.task.seconds / self.task.interface.seconds), 1)
        """Actions per episode."""
        gains = self.task.interface.gains
        self._gains = xp.asarray(np.stack([gains.kp, gains.kd])[:, None])
        self.begun = False
        """Whether there was a reset."""
        self._seen = xp.zeros((n, self.task.interface.frame), np.float32)
        self.count = xp.zeros(n, np.int64)
        """Actions taken since the reset, (n,)."""

    def reset(
        self, rows: Rows, generators: list[np.random.Generator], options: dict[str, Any] | None = None
    ) -> dict[str, Any]:
        """Begin new episodes of some simulations. Returns what was drawn, one value for each of them."""
        mine, xp = [generators[row] for row in rows], self.worlds.xp
        rows = xp.asarray(rows)
        values = self.begin(rows, Draws.from_generators(mine, xp), options)
        drawn = self.fetch(values | ({"twin": self._drawn} if self._drawn else {}))
        return {"randomised": drawn, **self.task.reset_info(rows)}

    def begin(self, rows: Rows, draws: Draws, options: dict[str, Any] | None = None) -> dict[str, Array]:
        """Begin new episodes of some simulations from random numbers. Returns the randomised values."""
        if not self.begun and len(rows) < self.n:
            raise ConfigError(
                f"the first reset is of all {self.n} simulations, not of {len(rows)}: leave out reset_mask"
            )
        self.begun = True
        task = self.task
        chosen = read_options(options, task.options, task.name)
        values = draw_values(self.settings.randomise, draws)
        for name in ("size", "friction"):
            if (value := getattr(chosen, name)) is not None:
                values[name] = self.worlds.xp.full(len(rows), value)
        variant = task.variant(rows, draws, chosen)
        task.draw_variation(rows, variant, draws, values, chosen)
        if "size" in values:
            values["size"] = self._possible_sizes(variant, values["size"], chosen)
        self.worlds.choose(rows, variant)
        self._physics.apply(rows, values)
        if self._drive is not None:
            self._drawn = self._drive.begin(rows, draws)
        task.begin(rows, variant, draws, values, chosen)
        self._sensing.begin(rows, values, draws)
        if self._touch is not None:
            self._touch.begin(rows, values, draws)
        if self._state is not None:
            self._state.begin(rows, values)
        self._remember(rows)
        self.count[rows] = 0
        return values

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """All arrays that decide how the episodes go on, by their paths, live; a task of a user may keep more
        (`Task.save_memory`)."""
        parts: dict[str, HasLiveArrays | None] = {
            "worlds": self.worlds, "signals": self._sensing, "drive": self._drive, "touch": self._touch,
            "privileged_state": self._state, "task": self.task,
        }  # fmt: skip
        memory = {f"memory/{name}": part for name, part in self.memory._asdict().items()}
        known = [(name, part.live_arrays()) for name, part in parts.items() if part is not None]
        told = {f"{name}/{key}": array for name, arrays in known for key, array in arrays.items()}
        return {"count": self.count, "seen": self._seen} | memory | told

    def release(self) -> None:
        """Have arrays of one's own in place of those that the last step has given out: they stay as they were given."""
        copy = self.worlds.xp.copy
        self.memory = InterfaceMemory(*map(copy, self.memory))
        self._seen = copy(self._seen)

    def clip_actions(self, action: NDArray[np.floating[Any]]) -> Any:
        """Actions (n, joints) clipped to [-1, 1], on the simulations' device. Raises CommandError for an action with
        NaN."""
        self._check(action)
        xp = self.worlds.xp
        return xp.minimum(xp.maximum(xp.asarray(action, np.float64), -1.0), 1.0)

    def fetch(self, tree: Any) -> Any:
        """Arrays as NumPy arrays, as `array_api.fetch`."""
        return tree if self.worlds.xp is np else fetch(tree)

    def step(self, action: NDArray[np.floating[Any]], rows: Rows | None = None) -> None:
        """Let all simulations, or some, take an action each, (n, joints), from `clip_actions`."""
        interface = self.task.interface
        rows = None if rows is None else self.worlds.xp.asarray(rows)
        memory = interface.act(action, self.memory, self._seen)
        set_points = interface.set_points(memory)
        self.task.plan_surroundings(memory.tick)
        worlds, sensing, move, substeps = self.worlds, self._sensing, self.task.move_surroundings, self._substeps
        gains, pd_torque_into, torque, step = (
            sensing.gains(self._gains),
            interface.pd_torque_into,
            worlds.control,
            worlds.step,
        )
        live = worlds.live if sensing.ideal else None
        for k in range(interface.decimation):
            if live is not None:
                pd_torque_into(*live, set_points, k, gains, torque)
            else:
                tick = memory.tick + k
                sensing.send(interface.command(*sensing.measure(tick), set_points, k, (gains[0], gains[1])), tick)
            move(k)
            step(rows, substeps)
        worlds.check()
        self.memory = interface.advance(memory)
        self.count += 1

    def step_period(self, command: Array, tick: NDArray[np.int64], k: int, rows: Rows | None = None) -> None:
        """Simulate one control period, the k-th since `plan_surroundings`. `command`: torques, N·m, or for hands that
        close their own loop positions, rad, (n, joints)."""
        self._sensing.send(command, tick)
        self.task.move_surroundings(k)
        self.worlds.step(rows, self._substeps)

    def become(self, change: JointChange, friction: float | None = None) -> None:
        """Go on with other hands, and where `friction` is given with that sliding friction of every contact. What the
        next episodes draw is drawn again; the rest stays."""
        worlds = self.worlds
        dofs = moving_dofs(self.task.spec, worlds.model)
        for name, value in (("dof_damping", change.damping), ("dof_frictionloss", change.frictionloss)):
            if value is not None:
                worlds.expand(name)[:, dofs] = value
        if self._drive is not None and change.frictionloss is not None:
            self._drive.rub(change.frictionloss)
        if change.strength != 1.0:
            motors = np.arange(worlds.model.nu)[worlds.motors]
            worlds.expand("actuator_gainprm")[:, motors, 0] *= change.strength
            worlds.expand("actuator_forcerange")[:, motors] *= change.strength
        if friction is not None:
            worlds.expand("geom_friction")[:, :, 0] = friction

    def measure(self, tick: NDArray[np.int64]) -> tuple[Array, Array]:
        """Joint positions and speeds as the hands report them at their periods `tick` (n,), each (n, joints)."""
        return self._sensing.measure(tick)

    def observe(self) -> Observation:
        """Observations of all simulations, as new arrays. A simulation that has diverged shows zeros."""
        position, velocity = self._sensing.measure(self.memory.tick)
        xp = self.worlds.xp
        if not _finite(position):
            position, velocity = (xp.nan_to_num(x, nan=0.0, posinf=0.0, neginf=0.0) for x in (position, velocity))
        goal = self.task.goal() if self.task.interface.goal != "none" else None
        joints = self.task.interface.observe(position, velocity, self.memory, goal)
        self._seen = joints["observation"] if isinstance(joints, dict) else joints
        return self.complete_observation(joints)

    def complete_observation(self, joints: Observation) -> Observation:
        """Add to an observation of joints what no hand reports: object, external torque, goal, privileged state."""
        xp, tick = self.worlds.xp, self.memory.tick
        self.task.look(tick)
        achieved, goal = self.task.achieved(tick), self.task.goal()
        parts = dict(joints) if isinstance(joints, dict) else {"observation": joints}
        more = [self.task.privileged_observation(tick), None if self._touch is None else self._touch.observe(tick)]
        if extra := [each for each in more if each is not None]:
            parts["observation"] = _append_numbers(parts["observation"], extra)
        if achieved is not None and goal is not None:
            parts |= {"achieved_goal": xp.asarray(achieved, np.float32), "desired_goal": xp.copy(goal)}
        if self._state is not None:
            parts["state"] = self._state(tick)
        if self.pictures is not None:
            parts |= self.pictures.take()
        return parts if len(parts) > 1 else parts["observation"]

    def outcome(self, action: Array, observation: Observation) -> tuple[StepOutcome, Flags]:
        """Outcome of the last step, for actions from `clip_actions`; and which simulations have diverged: those have
        failed, whatever they show. Raises ConfigError for a task whose outcome is none."""
        xp, object_body = self.worlds.xp, self.task.object_body
        outcome = self.task.outcome(self.memory.tick, action, observation)
        _check_outcome(outcome, self.task.name, self.n)
        for term, factor in self.task.settings.reward.items():
            if term not in outcome.terms:
                raise ConfigError(f"{self.task.name} reports no {term} to weigh: name its own terms in reward_terms")
            more = factor - self.task.reward_terms[term]
            outcome = outcome._replace(reward=outcome.reward + more * outcome.terms[term])
        moving = [self.worlds.position] if object_body is None else [self.worlds.position, object_body.pose]
        if all(map(_finite, moving)):
            diverged = xp.zeros(self.n, bool)
        else:
            diverged = ~xp.stack([xp.isfinite(each).all(axis=-1) for each in moving]).all(axis=0)
            outcome = outcome._replace(
                reward=xp.where(diverged, 0.0, outcome.reward),
                failed=outcome.failed | diverged,
                success=outcome.success & ~diverged,
            )
        # On a device this check would wait.
        if isinstance(outcome.reward, np.ndarray) and not _finite(outcome.reward):
            self._check_reward(outcome.reward)
        return outcome, diverged

    def _check_reward(self, reward: Array) -> None:
        """Raise ConfigError for a reward that is not finite."""
        for row in np.flatnonzero(~np.isfinite(reward))[:1]:
            where = f" of simulation {row}" if self.n > 1 else ""
            raise ConfigError(
                f"{self.task.name}: the reward{where} at step {self.count[row]} is {reward[row]}, and its simulation "
                "has not diverged: have the task's outcome give finite rewards"
            )

    def _possible_sizes(self, variant: Rows, drawn: Array, chosen: ResetOptions) -> Array:
        sizes = self._physics.sizes(variant, drawn)
        if chosen.size is not None and bool((sizes != drawn).any()):
            raise ConfigError(
                "a mesh keeps its size in an episode: leave out the option size, or give it another scale"
            )
        return sizes

    def _remember(self, rows: Rows) -> None:
        self.memory.tick[rows] = 0
        position, _ = self._sensing.measure(self.memory.tick)
        targets = self.task.initial_targets(rows)
        fresh = self.task.interface.start(position[rows], self.task.scripts(rows), targets)
        for name in InterfaceMemory._fields:
            getattr(self.memory, name)[rows] = getattr(fresh, name)

    def _check(self, action: NDArray[np.floating[Any]]) -> None:
        if not self.begun:
            raise CommandError("a step before the first reset: call reset() first")
        wanted = (self.n, self.task.spec.n_joints)
        if tuple(action.shape) != wanted:
            raise CommandError(f"actions must have shape {wanted}, not {tuple(action.shape)}")
        # On a device this check would wait; there such a simulation diverges and reports it.
        if not isinstance(action, np.ndarray):
            return
        if action.dtype.kind not in "fiub":
            raise CommandError(f"actions are numbers, not {action.dtype}")
        if not np.isfinite(action).all():
            row, joint = (int(index) for index in np.argwhere(~np.isfinite(action))[0])
            where = f" of simulation {row}" if self.n > 1 else ""
            raise CommandError(f"the action{where} for {self.task.spec.joints[joint]} at step {self.count[row]} is "
                               f"{action[row, joint]}; every value must be finite")  # fmt: skip


def _check_outcome(outcome: Any, task: str, n: int) -> None:
    """Raise ConfigError for what is no outcome of `n` simulations."""
    if not isinstance(outcome, StepOutcome):
        raise ConfigError(f"{task}: outcome returns a StepOutcome, not {type(outcome).__name__}")
    named = {"reward": outcome.reward, "failed": outcome.failed, "success": outcome.success, **outcome.terms}
    for name, value in named.items():
        if tuple(getattr(value, "shape", ())) != (n,):
            shape = tuple(getattr(value, "shape", ())) or type(value).__name__
            raise ConfigError(f"{task}: outcome's {name} is {shape}, not an array of shape ({n},): one value for each "
                              "simulation")  # fmt: skip
    for name in ("failed", "success"):
        if "bool" not in str(kind := named[name].dtype):
            raise ConfigError(f"{task}: outcome's {name} is of {kind}: give bool, true where it is so")


def _append_numbers(seen: Floats, more: list[Array]) -> Floats:
    """Append numbers, within bounds."""
    xp = array_namespace(seen)
    finite = [each if _finite(each) else xp.nan_to_num(each) for each in more]
    bounded = [xp.asarray(xp.minimum(xp.maximum(each, -BOUND), BOUND), np.float32) for each in finite]
    found: Floats = xp.concatenate([seen, *bounded], axis=-1)
    return found


def _finite(x: NDArray[np.floating[Any]]) -> bool:
    """Whether all numbers are finite for certain: the sum is finite only then. After False each is checked, which is
    cheap on a device, and this check is not."""
    return isinstance(x, np.ndarray) and math.isfinite(np.add.reduce(x, axis=None))
