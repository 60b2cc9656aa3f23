"""The protocol of the study, and the hash by which its results are known."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from allegro_twin import ConfigError
from allegro_twin.errors import unknown
from allegro_twin.files import Positive, Settings, parse_settings, read_yaml
from allegro_twin.grasping import PhysicsSettings, Shake
from allegro_twin.sim.model import Cone

NotNegative = Annotated[float, Field(ge=0)]
Part = Annotated[float, Field(ge=0, le=1)]
Set = Literal["train", "test"]


class Strata(Settings):
    """The cells that trials are spread over."""

    position: Annotated[tuple[NotNegative, ...], Field(min_length=1)]
    """Standard deviations of the object's place along x and y, m."""
    yaw: Annotated[tuple[NotNegative, ...], Field(min_length=1)]
    """Of its turn about the vertical, degrees."""
    friction: Annotated[tuple[Positive, ...], Field(min_length=1)]
    """Sliding, of every contact."""
    approach: Annotated[tuple[Positive, ...], Field(min_length=1)]
    """How long the arm is on its way, s."""


class ContactStrata(Strata):
    """And how contacts are modelled."""

    contacts: Annotated[Mapping[str, PhysicsSettings], Field(min_length=1)]
    """By name, what differs from the study's physics."""


class Pairs(Settings):
    """Trials of a hand under each policy."""

    train: Annotated[int, Field(ge=1)]
    test: Annotated[int, Field(ge=1)]


class Motion(Settings):
    """What is done, and how long it takes, s."""

    close: Positive
    squeeze: Positive
    lift: Positive
    """m."""
    lifting: Positive
    hold: Positive
    shake: Shake
    shaking: Positive


class Rest(Settings):
    """When an arm that has been led to its goal counts as being there."""

    distance: Positive
    """m."""
    speed: Positive
    """m/s."""
    patience: Positive
    """After so long it counts anyway, s."""


class SpringArm(Settings):
    """The spring on which the palm is carried."""

    stiffness: Positive
    """N/m."""
    rotation: Positive
    """N·m/rad."""
    inertia: Positive
    """kg."""
    turning: Positive
    """kg·m²."""
    rest: Rest


class LabArm(Settings):
    """The arm of each hand's cell, with its impedance and its collision thresholds."""

    rest: Rest


class Check(Settings):
    """When a thing counts as held, and what the arm's force sensor says."""

    rise: Positive
    """m, at least, from where it stood."""
    noise: NotNegative
    """Of a sample of the force, N."""
    samples: Annotated[int, Field(ge=1)]
    least: Positive
    """kg."""


class Policy(Settings):
    """When the hand begins to close."""

    name: str
    begins: Literal["arrival", "overlap", "distance", "contact"]
    rate: Positive | None = None
    """How often it is asked, Hz; None: in every period of control."""
    overlap: Part = 0.0
    """The part of the closing time that is over when the arm arrives."""
    margin: NotNegative = 0.0
    """m."""
    per_width: NotNegative = 0.0
    """m of distance for each m of the object's width."""
    per_speed: NotNegative = 0.0
    """m for each m/s of the palm: s."""
    per_sigma: NotNegative = 0.0
    """m for each m of the standard deviation of its place."""
    force: NotNegative = 0.0
    """N."""


class TimedPolicy(Policy):
    """When the hand begins to close, and how fast it does."""

    close: Positive
    """s."""


class LearnedPolicy(Settings):
    """Chooses one of the other policies for each trial by what is known before it: a logistic model of each one's
    success, fitted on train; the one with the most successes a second whose success is predicted to be at most
    `allowance` below the baseline's."""

    name: str
    options: Annotated[tuple[str, ...], Field(min_length=1)]
    ridge: Positive
    """Of the fit."""
    allowance: Part


class StudyObject(Settings):
    """A solid that was never measured."""

    shape: Literal["sphere", "cylinder", "box", "ellipsoid"]
    size: tuple[Positive, ...]
    """m. Sphere: diameter. Cylinder: diameter, height. Box: edges. Ellipsoid: short, long diameter."""
    mass: Positive
    """kg."""
    up: Literal["x", "z"] = "z"
    """Which of its own axes points at the sky; a cylinder's is z, an ellipsoid's long one x."""

    @property
    def extents(self) -> tuple[float, float, float]:
        """As it stands or lies along the world's axes, m."""
        size = self.size
        match self.shape:
            case "box":
                own = (size[0], size[1], size[2])
            case "sphere":
                own = (size[0], size[0], size[0])
            case "cylinder":
                own = (size[0], size[0], size[1])
            case _:
                own = (size[1], size[0], size[0])
        return own if self.up == "z" else (own[1], own[2], own[0])


class Analysis(Settings):
    """How outcomes become an answer."""

    baseline: str
    report: str
    candidates: Annotated[tuple[str, ...], Field(min_length=1)]
    allowance: Part
    margin: Part
    alpha: Annotated[float, Field(gt=0, lt=1)]
    resamples: Annotated[int, Field(ge=100)]


class Control(Settings):
    """Trials whose outcome is known beforehand, if the study is sound."""

    every: Annotated[int, Field(ge=1)]
    policies: tuple[str, ...]
    stream: Annotated[int, Field(ge=0)] = 0
    """Of random numbers; 0 is that of the study itself."""
    frozen: bool = False
    """The hand never closes."""
    certain: bool = False
    """No error, and the most friction."""
    gravity: NotNegative | None = None
    """m/s²."""
    timestep: Positive | None = None
    """s."""
    cone: Cone | None = None


class Study(Settings):
    """The whole of it, but what carries the hand."""

    version: int
    seed: Annotated[int, Field(ge=0)]
    hands: Mapping[str, str]
    """For each model of hand the name of an object's scenario, with `{object}` in it; or of its cell."""
    train: Annotated[tuple[str, ...], Field(min_length=1)]
    test: Annotated[tuple[str, ...], Field(min_length=1)]
    pairs: Pairs
    strata: Strata
    motion: Motion
    check: Check
    physics: PhysicsSettings
    period: Positive
    policies: Annotated[tuple[Policy, ...], Field(min_length=1)]
    analysis: Analysis
    controls: Mapping[str, Control] = {}

    @property
    def trained(self) -> tuple[str, ...]:
        """The policies that are tried on train."""
        return (self.analysis.baseline, *self.analysis.candidates)

    @property
    def compared(self) -> tuple[tuple[str, str], ...]:
        """Pairs of policies that are compared, beside all against the baseline."""
        return ()

    @model_validator(mode="after")
    def _names(self) -> Study:
        known = [policy.name for policy in self.policies]
        if len(set(known)) < len(known):
            raise ValueError(f"policies must have different names: {', '.join(known)}")
        asked = [self.analysis.baseline, self.analysis.report, *self.analysis.candidates]
        for name in asked + [each for control in self.controls.values() for each in control.policies]:
            if name not in known:
                raise ValueError(unknown("policy", name, known))
        both = sorted(set(self.train) & set(self.test))
        if both:
            raise ValueError(f"{', '.join(both)}: on train and on test; an object is on one of them")
        return self

    @property
    def digest(self) -> str:
        """Of everything that it says, however it is written down: the first 16 digits of a SHA-256."""
        plain = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(plain.encode()).hexdigest()[:16]

    def policy(self, name: str) -> Policy:
        """By its name."""
        return next(policy for policy in self.policies if policy.name == name)

    def of(self, hands: tuple[str, ...]) -> tuple[str, ...]:
        """Those hands, or all where none is named. Raises ConfigError for one that is not studied."""
        for hand in hands:
            if hand not in self.hands:
                raise ConfigError(unknown("hand of the study", hand, self.hands))
        return hands or tuple(self.hands)


class SpringStudy(Study):
    """A palm on a spring."""

    arm: SpringArm


class ArmStudy(Study):
    """The lab's arm in the loop, with objects that nobody measured."""

    objects: Mapping[str, StudyObject]
    arm: LabArm
    strata: ContactStrata
    policies: Annotated[tuple[TimedPolicy, ...], Field(min_length=1)]
    learned: LearnedPolicy
    versus: tuple[tuple[str, str], ...] = ()
    """Compared, too: the first against the second."""

    @property
    def trained(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((self.analysis.baseline, *self.analysis.candidates, *self.learned.options)))

    @property
    def compared(self) -> tuple[tuple[str, str], ...]:
        return self.versus

    @model_validator(mode="after")
    def _known(self) -> ArmStudy:
        known = [policy.name for policy in self.policies]
        both = (*known, self.learned.name)
        if self.learned.name in known:
            raise ValueError(f"policies must have different names: {', '.join(both)}")
        for name in (*self.learned.options, *(name for pair in self.versus for name in pair)):
            if name not in (known if name in self.learned.options else both):
                raise ValueError(unknown("policy", name, known))
        for name in (*self.train, *self.test):
            if name not in self.objects:
                raise ValueError(unknown("object", name, self.objects))
        return self


def study_of(content: Mapping[str, Any], where: str) -> Study:
    """A protocol of either kind: with `objects` the arm is in the loop. Raises ConfigError."""
    kind: type[Study] = ArmStudy if "objects" in content else SpringStudy
    return parse_settings(kind, dict(content), where)


def named(name: str) -> Path:
    """A protocol's file: by path, or by its name beside this module. Raises ConfigError."""
    given = Path(name)
    if given.is_file():
        return given
    shipped = {path.stem: path for path in Path(__file__).parent.glob("*.yaml")}
    if given.parts[1:] or given.suffix or given.name not in shipped:
        raise ConfigError(unknown("study", name, shipped))
    return shipped[given.name]


def load_study(name: str) -> Study:
    """A protocol by path or name."""
    path = named(name)
    return study_of(read_yaml(path), str(path))
