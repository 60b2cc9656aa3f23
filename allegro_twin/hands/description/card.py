"""Cards: a hand by somebody's MJCF and what that file does not say. `allegro-twin hand new` writes one."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import Settings, load_settings
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_facing
from allegro_twin.spec import Actuation, CommandKind, Finger, ForeignModel, HandSpec, Side
from allegro_twin.spec.coupled_joints import CoupledJoint
from allegro_twin.spec.hand import aliases
from allegro_twin.spec.thermal import ThermalData
from allegro_twin.types import frozen

Triple = tuple[float, float, float]
Amount = Annotated[float, Field(ge=0.0)]


class DrivenCard(Settings):
    """Joint or tendon that one motor drives."""

    name: str
    """Its name in commands, states and files."""
    actuator: str
    """Its name in the MJCF."""
    lower: float
    """Lowest position, in the units of the actuator's command."""
    upper: float
    effort: Annotated[float, Field(gt=0.0)] | Literal["unknown"]
    """The most that the motor gives, N·m; N on a slide or a tendon. `unknown`: nothing limits it in simulation, and no
    share of a limit can be said."""
    stiffness: Annotated[float, Field(gt=0.0)] | None = None
    """Stiffness of the loop that it closes, effort per unit of position; None: unknown, or it takes torques."""

    @model_validator(mode="after")
    def _ordered(self) -> DrivenCard:
        if not self.lower < self.upper:
            raise ValueError(f"{self.name}: lower {self.lower} is not below upper {self.upper}")
        return self


class FollowerCard(Settings):
    """A joint that a driven one takes along."""

    name: str
    """In the MJCF."""
    follows: str
    positions: Annotated[tuple[float, ...], Field(min_length=2)]
    """Free, for positions of the driven one evenly from its lowest to its highest, rad or m."""


class FingerCard(Settings):
    joints: tuple[str, ...]
    """Driven joints, from the palm outward; a finger may share one with others."""
    tip: tuple[str, Triple]
    """The body that ends it, and the fingertip's centre in that body's frame, m."""


class ThermalCard(Settings):
    """Heating of the motors: T' = (T_room + rise (effort / most)² − T) / time_constant."""

    rise: Annotated[float, Field(gt=0.0)]
    """K above the room that full effort leads to in the end."""
    time_constant: Annotated[float, Field(gt=0.0)]
    """s."""
    source: Annotated[str, Field(min_length=1)]
    """Where the two are from: a data sheet, a measurement, an assumption. It is printed with what follows from them."""

    def data(self) -> ThermalData:
        return ThermalData(self.rise, self.time_constant, self.source)


class WristCard(Settings):
    """Joints between the root and the palm. They are driven as the others are, and no finger's."""

    joints: tuple[str, ...]
    """Driven joints, from the root outward."""
    palm: str
    """The body on which the fingers are."""


class PalmCard(Settings):
    """Axes in the frame of the root body."""

    facing: Triple = (1.0, 0.0, 0.0)
    """Out of the palm."""
    fingers: Triple = (0.0, 0.0, 1.0)
    """Along stretched fingers."""


class GainsCard(Settings):
    """Gains of the loop that closes round a hand that takes torques, a value for each that is driven."""

    kp: tuple[Amount, ...]
    """N·m/rad; N/m on a slide."""
    kd: tuple[Amount, ...]
    """N·m·s/rad; N·s/m on a slide."""
    ki: tuple[Amount, ...]
    """N·m/(rad·s), N/(m·s) on a slide; only the controller `pid` uses it."""
    clamp: tuple[Amount, ...]
    """The largest integral term, N·m; N on a slide."""


class HandCard(Settings):
    """One hand: the file that simulates it, and what is commanded and reported, in the order of every array."""

    mjcf: Path
    """A relative path is the card's own."""
    root: str
    """The body that stands still: the palm, or what carries the wrist; `world` for fingers that hang on the world."""
    wrist: WristCard | None = None
    side: Side = "right"
    commands: Annotated[tuple[CommandKind, ...], Field(min_length=1)]
    driven: Annotated[tuple[DrivenCard, ...], Field(min_length=1)]
    fingers: dict[str, FingerCard] = {}  # noqa: RUF012  # Pydantic copies it.
    followers: tuple[FollowerCard, ...] = ()
    palm: PalmCard = PalmCard()
    postures: dict[str, tuple[float, ...]] = {}  # noqa: RUF012  # Pydantic copies it.
    """Postures by name, a value for each that is driven, in their order; `home`, `open` and `flat` are asked for."""
    gains: dict[str, GainsCard] = {}  # noqa: RUF012  # Pydantic copies it.
    """Gains by name, `default` among them, of a hand that takes torques."""
    apart: tuple[tuple[str, str], ...] = ()
    """Pairs of fingers that could hook into each other: no command may lead them there."""
    touching: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies of the MJCF that touch at rest, and are let through each other in simulation."""
    thermal: ThermalCard | None = None
    """How the motors warm; None: unknown, and nothing is said of temperatures."""
    coarsest_step: Annotated[float, Field(gt=0.0)] | None = None
    """The longest physics step that simulates the hand truly, s; None: trials of a search may take 3 ms."""
    servos: dict[str, Any] | None = None
    """Settings of a hand of servos on a serial line; docs/reference/dynamixel.md."""
    line: dict[str, Any] | None = None
    """Settings of a hand that is polled; docs/reference/serial_protocols.md."""

    @model_validator(mode="after")
    def _known_names(self) -> HandCard:
        names = [each.name for each in self.driven]
        followers = [each.name for each in self.followers]
        for taken in (names, followers, [each.actuator for each in self.driven]):
            if twice := next((name for name in taken if taken.count(name) > 1), None):
                raise ValueError(f"{twice} is named twice")
        asked = [(name, f"fingers.{finger}") for finger, each in self.fingers.items() for name in each.joints]
        asked += [(name, "wrist") for name in (self.wrist.joints if self.wrist is not None else ())]
        asked += [(each.follows, f"followers: {each.name}") for each in self.followers]
        for name, where in asked:
            if name not in names:
                raise ValueError(f"{where}: {name!r} is none of what is driven: {', '.join(names)}")
        for finger in (finger for pair in self.apart for finger in pair):
            if finger not in self.fingers:
                raise ValueError(f"apart: {finger!r} is none of the fingers: {', '.join(self.fingers)}")
        for name, posture in self.postures.items():
            if len(posture) != len(names):
                raise ValueError(f"postures: {name} has {len(posture)} values; {len(names)} are driven")
            for each, value in zip(self.driven, posture, strict=True):
                if not each.lower <= value <= each.upper:
                    raise ValueError(
                        f"postures: {name}: {each.name} is {value:g}, outside {each.lower:g} … {each.upper:g}"
                    )
        for name, gains in self.gains.items():
            for key, row in gains:
                if len(row) != len(names):
                    raise ValueError(f"gains: {name}.{key} has {len(row)} values; {len(names)} are driven")
        if self.gains and "torque" not in self.commands:
            raise ValueError("gains: the hand takes positions, and closes its own loop: leave them out")
        if "torque" in self.commands and len(self.commands) > 1:
            raise ValueError(f"commands: a hand that takes torques takes nothing else, not {', '.join(self.commands)}")
        return self


def spec_from_card(path: Path, model: str, side: Side) -> HandSpec:
    """The spec of the hand that a card describes. Raises ConfigError."""
    card = load_settings(HandCard, path)
    if card.side != side:
        raise ConfigError(f"{path} is a {card.side} hand; hand.side is {side}: a {side} hand has a card of its own, "
                          f"made from its own file (allegro-twin hand new FILE --side {side})")  # fmt: skip
    names = tuple(each.name for each in card.driven)
    mjcf = card.mjcf if card.mjcf.is_absolute() else path.parent / card.mjcf
    taken = _frames(mjcf)
    fingers = tuple(
        Finger(name, tuple(names.index(joint) for joint in each.joints), _tip_name(name, taken))
        for name, each in card.fingers.items()
    )
    return HandSpec(
        model=model,
        side=side,
        joints=names,
        fingers=fingers,
        lower=frozen([each.lower for each in card.driven]),
        upper=frozen([each.upper for each in card.driven]),
        actuation=_actuation(card),
        mirror_flips=(),
        aliases=aliases(fingers, len(names)) if _apart(card) else (),
        foreign=ForeignModel(
            str(mjcf), card.root, tuple(each.actuator for each in card.driven),
            {name: each.tip for name, each in card.fingers.items()}, _turn(card.palm, path), keeps=True,
            touching=card.touching,
        ),
        commands=card.commands,
        apart=card.apart,
        postures={name: frozen(posture) for name, posture in card.postures.items()},
        thermal=None if card.thermal is None else card.thermal.data(),
        coarsest_step=card.coarsest_step or float("inf"),
        followers=tuple(
            CoupledJoint(each.name, names.index(each.follows), frozen(each.positions)) for each in card.followers
        ),
    )  # fmt: skip


def card_gains(path: Path) -> dict[str, dict[str, tuple[float, ...]]]:
    """Gains by name as a card has them, kp, kd, ki and clamp of each that is driven. Raises ConfigError."""
    return {name: dict(gains) for name, gains in load_settings(HandCard, path).gains.items()}


def _tip_name(finger: str, taken: set[str]) -> str:
    """The frame of a fingertip, of a name that no body or site of the file has already."""
    return f"{finger}_tip" if f"{finger}_tip" not in taken else f"{finger}_tip_centre"


def _frames(mjcf: Path, seen: frozenset[Path] = frozenset()) -> set[str]:
    """Names of bodies and sites in an MJCF and in what it includes; none of a file that cannot be read, which the
    simulation says."""
    if mjcf in seen:
        return set()
    try:
        elements = list(ElementTree.parse(mjcf).getroot().iter())
    except (OSError, ElementTree.ParseError):
        return set()
    names = {each.get("name", "") for each in elements if each.tag in ("body", "site")}
    included = [mjcf.parent / each.get("file", "") for each in elements if each.tag == "include"]
    return names.union(*(_frames(each, seen | {mjcf}) for each in included))


def _actuation(card: HandCard) -> Actuation:
    """Friction and inertia stay in the MJCF: nothing reads them from the spec."""
    nothing = frozen(np.zeros(len(card.driven)))
    stiff = [each.stiffness for each in card.driven if each.stiffness is not None]
    effort = frozen([np.inf if each.effort == "unknown" else each.effort for each in card.driven])
    return Actuation(effort, nothing, nothing, nothing, frozen(stiff) if len(stiff) == len(card.driven) else None)


def _apart(card: HandCard) -> bool:
    """Whether every joint is in one finger, so that a finger and a place name it."""
    joints = [joint for finger in card.fingers.values() for joint in finger.joints]
    return sorted(joints) == sorted(each.name for each in card.driven)


def _turn(palm: PalmCard, path: Path) -> Any:
    length = np.linalg.norm(np.cross(palm.facing, palm.fingers))
    if length < 1e-6:
        raise ConfigError(f"{path}: palm: facing {palm.facing} and fingers {palm.fingers} must not be parallel or zero")
    quaternion = quaternion_facing(palm.facing, palm.fingers)
    if np.allclose(matrix_from_quaternion(quaternion), np.eye(3)):
        return None
    return tuple(float(value) for value in quaternion)
