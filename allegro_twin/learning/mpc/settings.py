"""Settings of model predictive control by sampling: the search, its cost terms, and the planner's physics."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import Positive, Seed, Settings, load_settings

Share = Annotated[float, Field(gt=0, le=1)]
Part = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(ge=0)]


class CostSettings(Settings):
    """Costs of a plan besides the task's own reward, 1/s each: a weight of 1 and a term of 1 cost 1 in a second.

    All terms are without a unit, and none has a number of a hand (docs/explanation/model_predictive_control.md#costs).
    """

    ends: Weight = 0.0
    """Joints near an end of their range: of each joint (1 - d / margin)², for d < margin, d its distance from the
    nearer end in parts of its range; summed."""
    margin: Annotated[float, Field(gt=0, le=0.5)] = 0.1
    """Margin of the term `ends`, as a share of a joint's range."""
    posture: Weight = 0.0
    """Distance from the joints' positions at the beginning, in parts of their ranges, squared; summed."""
    effort: Weight = 0.0
    """Torque over its limit, squared; mean over the joints."""
    place: Weight = 0.0
    """Distance of the object from where it began, over `far`, squared: it falls long before it is lost."""
    far: Positive = 0.02
    """Distance of the term `place`, m."""
    lean: Weight = 0.0
    """1 - cosine of the angle between the vertical and that axis of the object which was vertical at the beginning."""
    grip: Weight = 0.0
    """Share of the fingers whose tip does not touch the object, squared: one may step, two at a time are dear."""


class MpcSettings(Settings):
    """Settings of the search for actions."""

    method: Literal["cem", "mppi", "predictive"] = "cem"
    samples: Annotated[int, Field(ge=2, le=100_000)] = 48
    """Simulations side by side. With 100,000 one search takes minutes on two cores."""
    horizon: Annotated[float, Field(gt=0, le=60)] = 0.6
    """Horizon of a plan, s."""
    hold: Annotated[float, Field(ge=0, le=60)] = 0.36
    """Time after the horizon without any action, in which a plan that ends in a bad hold shows it, s."""
    knots: Annotated[int, Field(ge=2)] = 4
    """Knots of the spline over the horizon; between them it is linear."""
    every: Annotated[int, Field(ge=1)] = 1
    """Decisions from one plan to the next, in lockstep; those between follow the plan."""
    iterations: Annotated[int, Field(ge=1)] = 2
    """Iterations of the search in each decision."""
    spread: Positive = 0.4
    """Largest standard deviation of samples, in parts of an action's range."""
    narrowest: Positive = 0.05
    """Least standard deviation. With `cem`, which begins every decision with twice that of the last, of all samples;
    else each sample has its own, drawn between this and `spread` by its logarithm: steps of a gait are wide, what saves
    a bad hold is fine."""
    elite: Share = 0.15
    """Best share of the samples, with `cem`."""
    temperature: Positive = 0.2
    """Temperature λ of `mppi`."""
    fingers: Part = 0.0
    """Share of the drawn samples in which one finger alone differs from the plan, a finger drawn for each: steps of a
    gait are found so."""
    afresh: Part = 0.0
    """Share of the drawn samples around no action at all, instead of around the plan."""
    back: bool = False
    """Whether plans that bring one finger back to where its set-points were at the beginning are among the samples, one
    a finger, and are what half of the samples `afresh` are drawn around: a gait has such steps."""
    keep: Annotated[int, Field(ge=0)] = 0
    """Best samples of the last decision that are tried again, moved on."""
    discount: Share = 1.0
    """What a reward or cost is worth a second later, in parts of what it is worth now: below 1 a plan does not put off
    what it can do."""
    reward: Weight = 1.0
    """Weight of the task's reward."""
    count: Weight = 0.0
    """Weight of what the task counts, such as rad turned: dense where the reward pays for new angles only."""
    terms: dict[str, float] = Field(default_factory=dict)
    """Costs of the terms that the task's steps report in `info`, by name, a second: such as the `angle` to a goal where
    the reward hardly tells of goals that are far."""
    costs: CostSettings = CostSettings()
    stride: Annotated[int, Field(ge=0)] = 1
    """Control periods in one step of the planner's physics, as nearly as a decision has whole steps: 2 costs half as
    much as 1, and is not for tasks with a script; 0: the physics of the episode."""
    coarse: bool = False
    """Whether the planner's contacts are `coarse` (docs/reference/environments.md), whatever those of the episode."""
    seed: Seed = 0


class PoseCamera(Settings):
    """Camera beside a simulated hand that observes the true pose of the object."""

    period: Positive = 0.03
    """Time between two pictures, s."""
    delay: Weight = 0.0
    """Delay of a picture, s; the pose is carried on by as much."""
    noise: Weight = 0.0
    """Standard deviation of the position along each axis, m."""
    turn: Weight = 0.0
    """Standard deviation of the orientation about each axis, rad."""
    window: Positive = 0.06
    """Time over which the object's velocity is a straight line through its poses, s."""
    seed: Seed = 0


def planner_settings(task: str, *, real_time: bool = False) -> MpcSettings:
    """The settings of a task in conf/mpc, by its name; the defaults where it has none. `real_time`: those with which
    two cores make a plan in nearly every decision, where the task has such. Raises ConfigError."""
    folder, name = data_root() / "conf" / "mpc", task.rpartition(":")[2].lower()
    files = [folder / f"{name}{ending}.yaml" for ending in (("_real", "") if real_time else ("",))]
    path = next((file for file in files if file.is_file()), None)
    return MpcSettings() if path is None else load_settings(MpcSettings, path)
