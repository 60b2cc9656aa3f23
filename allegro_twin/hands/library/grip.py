"""How a grasp holds on: by position, by force through the centroid of its contacts, or by wrapping torques."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from allegro_twin.files.schema import Positive, Settings


class CentroidGrip(Settings):
    """Close softly until every finger has met the object, then press through the centroid of the contacts."""

    kind: Literal["centroid"]
    fingers: Annotated[tuple[str, ...], Field(min_length=2, max_length=4)]
    """The last one opposes the others: the thumb."""
    force: Positive = 3.0
    """On the thumb, N."""
    spread: Annotated[float, Field(ge=0, le=1)] = 0.25
    """How much of a finger's force may point toward the others."""
    stiffness: Positive = 1200.0
    """Against a motion of the object, N/m."""
    closing: Annotated[float, Field(gt=0, le=1)] = 0.25
    """The most that a joint pushes before contact, as a fraction of its torque limit."""


class EnvelopGrip(Settings):
    """Wrap every link around the object with constant torques."""

    kind: Literal["envelop"]
    torque: dict[str, list[float]]
    """For each finger that wraps, torques at scale 1, N·m; a zero leaves the joint where the pre-shape has it."""
    scale: Positive = 1.0
    stiffness: Annotated[float, Field(ge=0)] = 4.0
    """Against a motion of the wrapped object, N·m/rad."""
    closing: Annotated[float, Field(gt=0, le=1)] = 0.3
    """Of the torques before the squeeze."""


Grip: TypeAlias = Annotated[CentroidGrip | EnvelopGrip, Field(discriminator="kind")]
