"""Settings of perception (conf/perception/*.yaml)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from allegro_twin.files.schema import Positive, Settings, Vector3, at_most

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
    """Settings of the search for the table's plane."""

    near: Annotated[Positive, at_most(0.2, "m")] = 0.01
    """Distance from a plane within which points lie on it, m."""
    tilt: Annotated[float, Field(gt=0, lt=1.57)] = 0.26
    """Largest tilt of the table, rad."""
    part: Part = 0.2
    """Least share of the points in the region that must be on the table."""
    off: Annotated[Positive, at_most(1, "m")] | None = 0.005
    """Largest height difference to the world's z = 0 in the workspace, m: arm and hand keep so far from the table.
    None: any."""


class DetectionSettings(Settings):
    """Settings of the detection of objects on the table."""

    above: Annotated[Positive, at_most(1, "m")] = 0.006
    """Height above the table from which points belong to objects, m; more where depth scatters more."""
    gap: Annotated[Positive, at_most(1, "m")] = 0.008
    """Edge of the cells in which points are gathered, m: objects nearer than this touch."""
    least: Annotated[int, Field(ge=10)] = 30
    """Least number of thinned points of an object."""
    error: Positive = 1.8
    """Largest error of a fit as a multiple of the camera's own scatter there; otherwise the object is `unclear`."""
    best: Annotated[Positive, at_most(0.1, "m")] = 0.0015
    """Largest error of a fit, m, where depth scatters less."""
    loose: Annotated[Positive, at_most(1, "m")] | None = None
    """Error up to which a body that is no solid, nor two or three, is taken for the best one, m: a bottle for a
    cylinder. None: it is refused."""


class TargetSettings(Settings):
    """Settings of the hand's target frame, docs/reference/perception.md#target."""

    offset: Annotated[NotNegative, at_most(2, "m")] = 0.05
    """Distance from the object's surface to the hand's frame, m."""
    fallback: Vector3 = (0.0, 1.0, 0.0)
    """World axis that takes the vertical's part where the main axis is upright."""
    upright: Part = 0.9
    """Cosine of the angle to the vertical above which the main axis is upright."""
    clearance: Annotated[NotNegative, at_most(2, "m")] = 0.02
    """Height of the hand's frame above the table, at least, m."""


class SteadySettings(Settings):
    """Settings of the check that a target stands still enough to move for."""

    smooth: Annotated[NotNegative, at_most(60, "s")] = 0.1
    """Time constant of the low-pass, s."""
    jump: Annotated[Positive, at_most(2, "m")] = 0.05
    """Distance from the last target beyond which a target is left out, m."""
    turn: Positive = 0.6
    """Rotation from the last target beyond which a target is left out, rad."""
    patience: Annotated[int, Field(ge=1)] = 5
    """Number of targets left out in a row after which the object counts as moved."""
    window: Annotated[Positive, at_most(60, "s")] = 0.3
    """Time over which the target must be still, s."""
    count: Annotated[int, Field(ge=2)] = 4
    """Least number of targets within `window`."""
    still: Annotated[Positive, at_most(2, "m")] = 0.006
    """Largest distance of these targets from the smoothed one, m."""
    straight: Positive = 0.15
    """Largest rotation of these targets from the smoothed one, rad."""


class PerceptionSettings(Settings):
    """The whole pipeline."""

    region: BoxRegion
    """Box of the world in which points are used; everything else, the arm and the room, is cut off."""
    workspace: BoxRegion
    """Box of the world in which the middle of an object must be for the arm to go there."""
    disparity: NotNegative = 0.08
    """Scatter of the camera's disparity, pixels, in units of which errors are measured; as `noise.disparity` of the
    camera."""
    baseline: Annotated[Positive, at_most(2, "m")] = 0.05
    """Baseline of the camera, m."""
    stride: Annotated[int, Field(ge=1, le=8)] = 3
    """Stride through rows and columns, until the place of the object is known."""
    oldest: Annotated[Positive, at_most(60, "s")] = 0.3
    """Largest age of a picture that is acted on, s."""
    table: TableSettings = TableSettings()
    object: DetectionSettings = DetectionSettings()
    target: TargetSettings = TargetSettings()
    steady: SteadySettings | None = None
    """The cell looks until the target stands still; None: the first picture counts."""
