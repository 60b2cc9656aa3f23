"""HoldDisturbed task: keep a grasped object in the hand while it is pushed again and again."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import to_numpy
from allegro_twin.control import laws
from allegro_twin.control.controllers import Gains
from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.entries import HAND
from allegro_twin.learning.environments.objects import ObjectChoice, object_name
from allegro_twin.learning.environments.random_streams import Draws, jitter
from allegro_twin.learning.environments.settings import EnvSettings, Level, ResetOptions
from allegro_twin.learning.policy.card import GraspScript
from allegro_twin.learning.policy.interface import Observation
from allegro_twin.learning.policy.script import (
    SampledScript,
    closing_moves,
    holding_script,
    sample_script,
    script_table,
)
from allegro_twin.learning.tasks.base import StepOutcome, Ticks
from allegro_twin.learning.tasks.grasp import HELD, LOST, WIDTH, GraspTask
from allegro_twin.learning.tasks.scenes import (
    OBJECT,
    TaskScene,
    known_scenarios,
    palm_turn,
    require_objects,
    turn_with_palm,
)
from allegro_twin.learning.tasks.scripted_closing import ObjectVariation
from allegro_twin.learning.tasks.vectors import effort_cost, length, rotate_vectors
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.cpu import CpuBatch
from allegro_twin.sim.batch.shared_model import SharedModelBatch
from allegro_twin.sim.engine.backend import substeps
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

if TYPE_CHECKING:
    import mujoco


EVERY, LASTS = 0.5, 0.3  # s between pushes, and their duration.
STRONGEST = 2.5  # Weights of the object. Along each axis a push is drawn from [-this, this].
SETTLE = 0.3  # s after the presenter's release, before the episode begins.
# Objects that the scripted grasp holds without a push (docs/reference/environments.md#tasks); for other hands all are
# tried.
_OBJECTS = ("tennis_ball", "rubiks_cube", "apple", "foam_brick", "lemon", "gelatin_box", "mug")

# A presented mug is held through all pushes by a grasp of the whole hand around it, on both sides. The grasp of its
# scenario, made to pick it off a table, holds it in 1 of 20 episodes.
_GRASPS = {"mug": "power_sphere"}


class HoldDisturbedTask(GraspTask):
    """Actions are added to the grasp's squeeze; episodes begin in the state that the scripted grasp reaches."""

    name = "HoldDisturbed"
    purpose = "keep a grasped object in the hand while it is pushed at random"
    seconds = 4.0
    options: ClassVar[tuple[str, ...]] = ("object", "friction", "grasp")
    own_settings = ("level", "reach")
    levels: ClassVar[dict[Level, ObjectVariation]] = {
        "easy": ObjectVariation(noise=0.0),
        "default": ObjectVariation(noise=0.0, friction=(0.4, 1.0), mass=(0.5, 2.0), push=1.5),
    }

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        self._weight = self.worlds.xp.zeros(n)
        self._force: Array = self.worlds.xp.zeros((n, 3))
        self._key = self.worlds.xp.zeros(n, np.uint64)
        self._push: Ticks = self.worlds.xp.zeros(n, np.int64) - 1
        """Number of the push whose force is known; -1 where it is not."""
        self._caught = 0
        self._holds_by_itself: list[int] = []
        self._prepare_starts()
        if not self._holds_by_itself:
            names = ", ".join(map(object_name, self.object_choices()))
            raise ConfigError(f"{self.name}: {self.spec.model} keeps none of {names} even when nothing pushes: choose "
                              "other objects")  # fmt: skip

    def object_choices(self) -> tuple[ObjectChoice, ...]:
        if self.settings.objects is not None:
            return self.settings.objects
        if self.spec.model == HAND:
            return _OBJECTS
        return require_objects(tuple(known_scenarios(self.spec.model)), self.spec, self.name)

    def make_scene(self, choice: ObjectChoice, grasp: str | None) -> TaskScene:
        own = _GRASPS.get(object_name(choice)) if self.spec.model == HAND else None
        return super().make_scene(choice, grasp or own)

    def variant(self, rows: Rows, draws: Draws, options: ResetOptions) -> Rows:
        if self.settings.objects is not None or options.object is not None or options.grasp is not None:
            found = super().variant(rows, draws, options)
        else:
            found = self._kept[draws.integers(len(self._kept))]
        for number in sorted({*found.tolist()} - {*self._kept.tolist()}):
            scene = self.scenes[number]
            raise ConfigError(f"{self.name}: the grasp {scene.grasp.name} does not keep {scene.object_name} even when "
                              "nothing pushes: choose another object or grasp")  # fmt: skip
        return found

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions) -> None:
        assert self.object_body is not None
        self.script[rows] = variant
        self.contacts.begin(rows)
        if "wrist_tilt" in values:
            palm = self.worlds.model.body("palm_link").id
            before = np.stack([model.body_quat[palm] for model in self.worlds.models])
            turn = palm_turn(self.worlds, rows, self.worlds.xp.asarray(before)[variant])
            self.object_body.pose[rows] = turn_with_palm(self.worlds, variant, turn, self.object_body.pose[rows])
            self.object_body.velocity[rows] = rotate_vectors(turn, self.object_body.velocity[rows])
        mass = self.worlds.expand("body_mass")[rows, self.object_body.id]
        self._weight[rows] = mass * -self.worlds.model.opt.gravity[2]
        self._key[rows], self._push[rows] = draws.keys(), -1
        self.place[rows] = self.object_body.pose[rows, :3]

    def plan_surroundings(self, tick: Ticks) -> None:
        assert self.object_body is not None
        self.contacts.begin_decision()
        period = self.settings.period
        ticks = tick + self._periods
        into = ticks * period % EVERY
        number = self.worlds.xp.asarray(ticks[-1] * period // EVERY, np.int64)
        known = self.worlds.xp is np  # On a device a check costs more than doing it all.
        if not known or (number != self._push).any():
            force = jitter(self._key, number, 7, 3) * (STRONGEST * self.variation.push * self._weight)[:, None]
            self._force, self._push = force, number
        pushing = into >= EVERY - LASTS
        self._path = self._forces = None
        if not known or pushing.any():
            self._forces = self.worlds.xp.where(pushing[..., None], self._force, 0.0)
        else:
            self.object_body.force[:] = 0.0

    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> StepOutcome:
        assert self.object_body is not None
        drift = length(self.object_body.pose[:, :3] - self.place)
        hold, effort = self.worlds.xp.exp(-((drift / WIDTH) ** 2)), effort_cost(action)
        over = tick * self.settings.period >= self.seconds - self.interface.seconds
        kept = over & (drift < HELD) & self.held()
        return StepOutcome(hold + effort, drift > LOST, kept, {"hold": hold, "effort": effort})

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        own = {"weight": self._weight, "force": self._force, "key": self._key, "number_of_push": self._push}
        return super().live_arrays() | own

    def verdict_time(self, scene: TaskScene) -> float:
        return 0.0  # The hand is closed when an episode begins.

    def grasp_scripts(self) -> tuple[GraspScript, ...]:
        return tuple(closed.model_copy(update={"holds": True}) for closed in super().grasp_scripts())

    def _variant_number(self, choice: ObjectChoice, grasp: str | None) -> int:
        number = super()._variant_number(choice, grasp)
        self._prepare_starts()
        return number

    def _prepare_starts(self) -> None:
        """Play the scripted grasp for new scenes, keep the state as their start, and make its squeeze the base of the
        actions."""
        for number in range(self._caught, len(self.scenes)):
            if self._prepare_start(number):
                self._holds_by_itself.append(number)
            self._scripts[number] = holding_script(self.scenes[number].grasp, self.periods)
        self._caught = len(self.scenes)
        self.interface = self._interface(scripts=script_table(self._scripts), reach=self.settings.reach)
        self._kept = self.worlds.xp.asarray(np.array(self._holds_by_itself, np.int64))

    def _prepare_start(self, number: int) -> bool:
        """Play the scripted grasp for a variant and keep the state as its start. Returns whether the object is still in
        the hand."""
        scene, period = self.scenes[number], self.settings.period
        release = int(self._release[number])
        last = release + round(SETTLE / period)
        path = scene.pose[:3] - to_numpy(self._left)[:, None] * scene.retreat
        positions: list[Array] = []

        def around(worlds: SharedModelBatch, k: int) -> None:
            hand, _, holds = worlds.presenter()
            if k == 0:
                worlds.free_body(OBJECT).pose[0, :3] = path[0]
            hand[0], holds[0] = path[min(k, len(path) - 1)], k < release
            if k in (release, last - 1):
                positions.append(np.array(worlds.free_body(OBJECT).pose[0, :3]))

        script = sample_script(closing_moves(scene.grasp, self.wait, self.squeeze), scene.grasp.preshape, last, period)
        self.worlds.keep_start(number, play_script(self.spec, scene.model, self.gains, script, self.settings, around))
        return bool(np.linalg.norm(positions[-1] - positions[0]) < HELD)


def play_script(
    spec: HandSpec,
    model: mujoco.MjModel,
    gains: Gains,
    script: SampledScript,
    settings: EnvSettings,
    before_period: Callable[[SharedModelBatch, int], None],
) -> Array:
    """State after the hand has followed a script; `before_period` acts on the one simulation before every period."""
    worlds = CpuBatch(spec, model, 1, 1)
    worlds.choose(np.zeros(1, np.int64), np.zeros(1, np.int64))
    worlds.place(np.zeros(1, np.int64), script.position[:1])
    for k, (position, velocity) in enumerate(zip(script.position, script.velocity, strict=True)):
        before_period(worlds, k)
        error, rate = position - worlds.position[0], velocity - worlds.velocity[0]
        worlds.command(position[None] if worlds.closes_loop else laws.pd(error, rate, gains.kp, gains.kd)[None])
        worlds.step(None, substeps(settings.period, settings.timestep))
    return worlds.state(0)
