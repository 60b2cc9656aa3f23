"""Settings of perception (conf/perception/*.yaml)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from allegro_twin.files.schema import Positive, Settings, Vector3

NotNegative = Annotated[float, Field(ge=0)]
Part = Annotated[float, Field(gt=0, lt=1)]


class BoxRegion(Settings):
    """A box along the world's axes."""

    lower: Vector3
    """m."""
    upper: Vector3

    @model_validator(mode="after")
    def _not_empty(self) -> BoxRegion:
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"a region from {self.lower} to {self.upper} is empty: every upper bound is the greater")
        return self


class TableSettings(Settings):
    """What counts as a table."""

    near: Positive = 0.01
    """Points this near to a plane are on it, m."""
    tilt: Annotated[float, Field(gt=0, lt=1.57)] = 0.26
    """It leans less than this, rad."""
    part: Part = 0.2
    """Least share of the points in the region that must be on the table."""
    off: Positive | None = 0.005
    """In the workspace it may be so much higher or lower than the world's z = 0, m: arm and hand keep so far from it.
    None: wherever it is."""


class DetectionSettings(Settings):
    """What counts as a thing on it."""

    above: Positive = 0.006
    """Height from which points are of things, m; more where depth scatters more."""
    gap: Positive = 0.008
    """Edge of the cells in which points are gathered, m: things nearer than this touch."""
    least: Annotated[int, Field(ge=10)] = 30
    """A thing has at least so many of the thinned points."""
    error: Positive = 1.8
    """What fits no solid better than this is unclear: times the camera's own scatter there."""
    best: Positive = 0.0015
    """Or than this, m, where depth scatters less."""
    loose: Positive | None = None
    """What is no solid, nor two or three, is taken for the best one if that is off by less than this, m: a bottle for a
    cylinder. None: it is refused."""


class TargetSettings(Settings):
    """Where the hand goes, docs/reference/perception.md#target."""

    offset: NotNegative = 0.05
    """From the thing's surface to the hand's frame, m."""
    fallback: Vector3 = (0.0, 1.0, 0.0)
    """Takes the vertical's part where the main axis is upright; world axes."""
    upright: Part = 0.9
    """The main axis is, when the cosine of its angle to the vertical is greater."""
    clearance: NotNegative = 0.02
    """The hand's frame stays this far above the table, m."""


class SteadySettings(Settings):
    """When a target stands still enough to move for."""

    smooth: NotNegative = 0.1
    """Time constant of the low-pass, s."""
    jump: Positive = 0.05
    """A target further than this from the last, m, is left out,"""
    turn: Positive = 0.6
    """or turned by more than this, rad,"""
    patience: Annotated[int, Field(ge=1)] = 5
    """until so many in a row are: then the thing was moved."""
    window: Positive = 0.3
    """Time over which it must be still, s,"""
    count: Annotated[int, Field(ge=2)] = 4
    """with at least so many targets,"""
    still: Positive = 0.006
    """all within this, m,"""
    straight: Positive = 0.15
    """and this, rad, of the smoothed one."""


class PerceptionSettings(Settings):
    """The whole pipeline."""

    region: BoxRegion
    """What is looked at: everything else, the arm and the room, is cut off."""
    workspace: BoxRegion
    """Where the middle of a thing must be for the arm to go there."""
    disparity: NotNegative = 0.08
    """The camera's scatter, pixels: what errors are measured by. As `noise.disparity` of the camera."""
    baseline: Positive = 0.05
    """The camera's, m."""
    stride: Annotated[int, Field(ge=1, le=8)] = 3
    """Stride through rows and columns, until the place of the object is known."""
    oldest: Positive = 0.3
    """A picture older than this is not acted on, s."""
    table: TableSettings = TableSettings()
    object: DetectionSettings = DetectionSettings()
    target: TargetSettings = TargetSettings()
    steady: SteadySettings | None = None
    """The cell looks until the target stands still; None: the first picture counts."""
