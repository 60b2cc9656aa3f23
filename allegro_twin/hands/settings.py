"""Settings of a hand, its task and its limits: blocks of a config."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator

from allegro_twin.control.trajectory import FASTEST
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find_file, read_yaml
from allegro_twin.files.schema import PerJoint, Settings
from allegro_twin.hands.description.specs import card_side, hand_side
from allegro_twin.spec import SIDES, Side


def _rad_per_second(limit: PerJoint) -> PerJoint:
    for value in limit if isinstance(limit, list) else [limit]:
        if not 0.0 < value <= FASTEST:
            raise ValueError(f"{value:g} rad/s limits no joint: it must be above 0 and at most {FASTEST:g}")
    return limit


def with_card_side(values: Any, key: str) -> Any:
    """Settings before they are read, with the side of the card that the key names, or of the hand's own file, `serial`,
    where they give none: each is of one side."""
    if not isinstance(values, Mapping) or "side" in values:
        return values
    side = card_side(values[key]) if isinstance(values.get(key), str) else None
    serial = values.get("serial")
    if side is None and isinstance(serial, str) and serial:
        with suppress(ConfigError):  # `load_spec` says what is wrong with it.
            side = hand_side(serial)
    return values if side is None else {**values, "side": side}


def scenario_side(scenarios: Iterable[Any]) -> Side | None:
    """The side that scenarios, by name or path, say themselves; None: it is left to the hand. Raises ValueError for
    scenarios of both."""
    said: dict[Side, str] = {}
    for name in scenarios:
        if not isinstance(name, str | Path):
            continue
        with suppress(ConfigError):  # Whoever reads the whole scenario says what is wrong with it.
            side = read_yaml(find_file(name, "scenario", "scenarios", below=True)).get("side")
            said |= {each: str(name) for each in SIDES if each == side}
    if len(said) > 1:
        raise ValueError(f"{said['right']} is for the right hand, {said['left']} for the left one: take those of one")
    return next(iter(said), None)


def scenario_files(objects: Any) -> tuple[str, ...]:
    """The scenarios among the objects of an environment."""
    given = objects if isinstance(objects, list | tuple) else ()
    return tuple(each for each in given if isinstance(each, str) and Path(each).suffix in (".yaml", ".yml"))


class HandSettings(Settings):
    model: str = "allegro"
    """Model of hand, or of arm."""
    side: Side = "right"
    """Default: that of the hand's card or own file, else of the task's scenario; where none says one, right."""
    serial: str = ""
    """File in conf/hands with what was measured on this very hand."""

    @model_validator(mode="before")
    @classmethod
    def _of_card(cls, values: Any) -> Any:
        return with_card_side(values, "model")


class EpisodeSettings(Settings):
    """An episode of one of the environments (docs/reference/environments.md)."""

    task: str
    """Such as Rotate, Reorient or Reach."""
    environment: dict[str, Any] = Field(default_factory=dict)
    """Keywords of the environment but hand, side and period, which the config has."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the reset: object, size, start and goals."""


class TaskSettings(Settings):
    """A scenario, or a grasp in the open, or a posture; without any a position controller goes `home`."""

    scenario: str | None = None
    """Name or path: what lies where, how the wrist moves, which grasp, and, where `hand` leaves it open, of which side
    the hand is. A simulated or virtual hand stands in its scene;
    any other follows its timeline with the fingers."""
    grasp: str | None = None
    """With a scenario: another grasp than the one it names. Without: close this one where the hand is. For a policy
    that has several scripts: which."""
    object: str | None = None
    """With a scenario: another object in place of its first: of the catalogue, or a mesh (.obj, .stl)."""
    posture: str | PerJoint | None = None
    """Where to go, by name or in rad. For a policy that reaches goals: the goal, whose fingertips it is to reach."""
    episode: EpisodeSettings | None = None
    """A simulated or virtual hand is in this episode, its object included; the controller `mpc` plans for it."""


class LimitSettings(Settings):
    """Limits of the guard; docs/explanation/safety.md."""

    torque: PerJoint | None = None
    """N·m; default: the hand's own clip, which is also the highest possible."""
    velocity: Annotated[PerJoint, AfterValidator(_rad_per_second)] = 12.0
    """rad/s; of an arm, at most what its maker allows."""
    margin: Annotated[float, Field(ge=-0.6)] = 0.0
    """Soft stops this far inside the joint limits, rad; negative: outside, to look for the real ones."""
