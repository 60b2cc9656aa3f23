"""The GRASP taxonomy: its 33 types in their 17 cells, what a grasp claims to be, and what was observed of it.

Source: Feix, Romero, Schmiedmayer, Dollar and Kragic, "The GRASP Taxonomy of Human Grasp Types", IEEE Trans.
Human-Machine Systems 46(1), 2016, figure 4: its columns (power, intermediate or precision; opposition of palm, pad or
side; fingers of virtual finger 2), and its rows (thumb abducted or adducted). Types that share a cell differ by the
shape and size of the object only, which is why the paper counts 17 grasps without the object.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple, TypeAlias

from pydantic import Field, model_validator

from allegro_twin.files.schema import Settings

Control: TypeAlias = Literal["power", "intermediate", "precision"]
Opposition: TypeAlias = Literal["palm", "pad", "side"]
Thumb: TypeAlias = Literal["abducted", "adducted"]
NONE = "none of the 33"
"""The name of what no type of the taxonomy describes."""


class GraspType(NamedTuple):
    """A type's place in figure 4."""

    number: int
    name: str
    type: Control
    opposition: Opposition
    fingers: str
    """Fingers of virtual finger 2, counted from the thumb: 2 is the index, 5 the little finger."""
    thumb: Thumb


GRASP_TYPES: dict[int, GraspType] = {
    kind.number: kind
    for kind in (
        GraspType(1, "Large Diameter", "power", "palm", "2-5", "abducted"),
        GraspType(2, "Small Diameter", "power", "palm", "2-5", "abducted"),
        GraspType(3, "Medium Wrap", "power", "palm", "2-5", "abducted"),
        GraspType(4, "Adducted Thumb", "power", "palm", "2-5", "adducted"),
        GraspType(5, "Light Tool", "power", "palm", "2-5", "adducted"),
        GraspType(6, "Prismatic 4 Finger", "precision", "pad", "2-5", "abducted"),
        GraspType(7, "Prismatic 3 Finger", "precision", "pad", "2-4", "abducted"),
        GraspType(8, "Prismatic 2 Finger", "precision", "pad", "2-3", "abducted"),
        GraspType(9, "Palmar Pinch", "precision", "pad", "2", "abducted"),
        GraspType(10, "Power Disk", "power", "palm", "2-5", "abducted"),
        GraspType(11, "Power Sphere", "power", "palm", "2-5", "abducted"),
        GraspType(12, "Precision Disk", "precision", "pad", "2-5", "abducted"),
        GraspType(13, "Precision Sphere", "precision", "pad", "2-5", "abducted"),
        GraspType(14, "Tripod", "precision", "pad", "2-3", "abducted"),
        GraspType(15, "Fixed Hook", "power", "palm", "2-5", "adducted"),
        GraspType(16, "Lateral", "intermediate", "side", "2", "adducted"),
        GraspType(17, "Index Finger Extension", "power", "palm", "3-5", "adducted"),
        GraspType(18, "Extension Type", "power", "pad", "2-4", "abducted"),
        GraspType(19, "Distal Type", "power", "pad", "2-5", "abducted"),
        GraspType(20, "Writing Tripod", "precision", "side", "3", "abducted"),
        GraspType(21, "Tripod Variation", "intermediate", "side", "3-4", "abducted"),
        GraspType(22, "Parallel Extension", "precision", "pad", "2-5", "adducted"),
        GraspType(23, "Adduction Grip", "intermediate", "side", "2", "abducted"),
        GraspType(24, "Tip Pinch", "precision", "pad", "2", "abducted"),
        GraspType(25, "Lateral Tripod", "intermediate", "side", "3", "adducted"),
        GraspType(26, "Sphere 4 Finger", "power", "pad", "2-4", "abducted"),
        GraspType(27, "Quadpod", "precision", "pad", "2-4", "abducted"),
        GraspType(28, "Sphere 3 Finger", "power", "pad", "2-3", "abducted"),
        GraspType(29, "Stick", "intermediate", "side", "2", "adducted"),
        GraspType(30, "Palmar", "power", "palm", "2-5", "adducted"),
        GraspType(31, "Ring", "power", "pad", "2", "abducted"),
        GraspType(32, "Ventral", "intermediate", "side", "2", "adducted"),
        GraspType(33, "Inferior Pincer", "precision", "pad", "2", "abducted"),
    )
}


class ClaimedType(Settings):
    """The type that a grasp claims to be; `number` is None for one that claims to be none of the 33."""

    number: Annotated[int, Field(ge=1, le=33)] | None
    name: str = NONE
    type: Control | None = None
    opposition: Opposition | None = None
    virtual_fingers: str = ""
    """The surfaces that oppose each other."""

    @model_validator(mode="after")
    def _as_in_the_paper(self) -> ClaimedType:
        kind = GRASP_TYPES.get(self.number or 0)
        if kind is None and self.name != NONE:
            raise ValueError(f"a grasp without a number is {NONE!r}, not {self.name!r}")
        for key in ("name", "type", "opposition") if kind is not None else ():
            if getattr(self, key) != getattr(kind, key):
                raise ValueError(f"type {self.number} has the {key} {getattr(kind, key)!r}, not {getattr(self, key)!r}")
        return self

    def __str__(self) -> str:
        return self.name if self.number is None else f"{self.number} {self.name}"


class ObservedType(Settings):
    """The type that the contacts of a trial show: those that carry while the object is held up."""

    number: Annotated[int, Field(ge=1, le=33)] | None = None
    """None: none of the 33."""
    name: str = NONE
    type: Control | None = None
    opposition: Opposition | None = None
    """None where nothing acts against anything else, as with a single digit."""
    virtual_fingers: str = ""
    """The surfaces that oppose each other."""
    carries: str = ""
    """Each surface that carries, with its share of the hand's normal force."""
    why: str = ""
    """Why it is none of the 33 types."""

    def __str__(self) -> str:
        return self.name if self.number is None else f"{self.number} {self.name}"


def claim_type(number: int | None, virtual_fingers: str = "") -> ClaimedType:
    """The claim to be a type, by its number. Raises KeyError for one that the taxonomy does not have."""
    if number is None:
        return ClaimedType(number=None, virtual_fingers=virtual_fingers)
    kind = GRASP_TYPES[number]
    return ClaimedType(
        number=number, name=kind.name, type=kind.type, opposition=kind.opposition, virtual_fingers=virtual_fingers
    )


def claim_observed(observed: ObservedType) -> ClaimedType:
    """The claim that is true of what was observed."""
    return ClaimedType(**{key: getattr(observed, key) for key in ClaimedType.model_fields})
