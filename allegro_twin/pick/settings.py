"""Settings of `ArmPick`: those of the environment when it is made, and those of an episode at its reset."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from allegro_twin.files.schema import Positive, Settings
from allegro_twin.spec import Side

NotNegative = Annotated[float, Field(ge=0)]
OBJECTS = ("apple", "tomato_soup_can", "sugar_box", "tennis_ball", "mug", "pudding_box", "softball", "foam_brick")


class PickSettings(Settings):
    """The keyword arguments of `gymnasium.make`."""

    arm: str | None = None
    """None: that of conf/lab_allegro.yaml."""
    hand: str = "allegro"
    side: Side = "right"
    control: Literal["joints", "grasp"] = "joints"
    """What moves the fingers: every joint, or one number that closes the library's grasp."""
    perception: bool = False
    """The thing is where one picture of the camera at the episode's beginning says, and stays there in observations;
    else it is known at every decision, as exactly and as late as the three `camera_…` say."""
    objects: Annotated[tuple[str, ...], Field(min_length=1)] = OBJECTS
    """Objects of the catalogue; each episode draws one. One that the hand cannot take is refused where it is named, and
    left out of the default."""
    place: Annotated[float, Field(ge=0, le=0.12)] = 0.08
    """A thing stands within so much of the table's middle along x and y, m, turned by any angle."""
    off: Annotated[float, Field(ge=0, le=0.05)] = 0.03
    """The palm begins within so much along each axis of where the approach of its grasp begins, m."""
    friction: Annotated[float, Field(gt=0, le=1)] = 0.8
    camera_shift: NotNegative = 0.0
    """m an axis, anew in each picture."""
    camera_turn: NotNegative = 0.0
    """rad an axis."""
    camera_delay: Annotated[int, Field(ge=0, le=20)] = 0
    """Decisions."""
    step: Positive = 0.02
    """Largest translation of the palm in an action, along each axis, m."""
    turn: Positive = 0.1
    """Largest rotation of the palm in an action, about each axis, and of the finger joints, rad."""
    close: Positive = 0.1
    """Largest change of the grasp in an action: it is open at 0, closed at 1, squeezed at 2."""
    stiffness: Positive = 1000.0
    """Translational stiffness of the spring between palm and set-point, N/m."""
    angular_stiffness: Positive = 50.0
    """Rotational stiffness of the spring between palm and set-point, N·m/rad."""
    gains: str = "default"
    period: Positive = 0.003
    """Control period, s."""
    decimation: Annotated[int, Field(ge=1)] = 13
    """Control periods between two actions."""
    seconds: Positive = 7.0
    """Duration of an episode, s."""

    def keywords(self) -> dict[str, Any]:
        """The keywords that were given, as plain data."""
        return self.model_dump(mode="json", exclude_unset=True)

    @model_validator(mode="after")
    def _camera_used(self) -> Self:
        for name in ("camera_shift", "camera_turn", "camera_delay"):
            if self.perception and getattr(self, name):
                raise ValueError(f"perception=True looks once, so {name} does nothing: leave one of them out")
        return self


class PickOptions(Settings):
    """The `options` of a reset: what this episode does not draw."""

    object: str | None = None
    at: tuple[float, float] | None = None
    """World, m."""
    yaw: float | None = None
    """Degrees."""
