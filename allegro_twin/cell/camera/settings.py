"""Settings of a camera (conf/cameras/*.yaml)."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import AfterValidator, Field, model_validator

from allegro_twin.cell.camera.intrinsics import D435I_BASELINE, D435I_DEPTH, Intrinsics
from allegro_twin.cell.camera.mount import CameraMount
from allegro_twin.drivers.realsense import RealSenseSource
from allegro_twin.files.schema import Settings, at_most

NotNegative = Annotated[float, Field(ge=0)]
Part = Annotated[float, Field(ge=0, le=1)]

_NEAREST = 0.08  # m. f·B/126 of the smallest picture: a D435i knows nothing nearer (realsense-ros #2367).


def _beyond_the_nearest(furthest: float) -> float:
    if furthest < _NEAREST:
        raise ValueError(f"it is in m, and nothing nearer than {_NEAREST:g} is known: here at least that")
    return furthest


class DepthNoise(Settings):
    """Errors of a stereo camera's depth. Everything at zero, and `shadow` off: exact depth."""

    disparity: NotNegative = 0.08
    """Standard deviation of the disparity, pixels: typical of D400 cameras (librealsense #3904; the best is 0.032)."""
    patch: Annotated[int, Field(ge=1, le=16)] = 4
    """Edge of the squares over which it is smeared, pixels: neighbours share their matching windows (estimated)."""
    subpixel: Annotated[int, Field(ge=0)] = 32
    """Steps of a pixel in which disparity is given; 0: any. (D400: 1/32.)"""
    unit: Annotated[NotNegative, at_most(0.1, "m")] = 0.001
    """Step in which depth is given, m; 0: any. (D400's default depth unit.)"""
    shadow: bool = True
    """Whether places that the right imager does not see are unknown: beside objects, and in a band at the picture's
    left."""
    edge: Part = 0.5
    """Share of the pixels beside a jump in depth that is lost (estimated)."""
    grazing: tuple[float, float] = (75.0, 85.0)
    """Angles between the ray and the surface's normal, degrees: fewer and fewer pixels from the first, none beyond the
    second (estimated)."""

    @model_validator(mode="after")
    def _ordered(self) -> DepthNoise:
        first, last = self.grazing
        if not 0.0 <= first <= last <= 90.0:
            raise ValueError(
                f"grazing [{first:g}, {last:g}]: give two angles from 0 to 90 degrees, the greater one not first"
            )
        return self


class SimulatedSource(Settings):
    """Pictures are rendered, with the errors of a D435i."""

    kind: Literal["simulated"] = "simulated"


class RecordingSource(Settings):
    """Pictures come from a ROS bag, at its own pace from the first look on."""

    kind: Literal["recording"] = "recording"
    file: str
    """An .mcap, .db3 or .bag file, or a folder of rosbag2; from the folder in which the program runs."""
    topic: str | None = None
    """Depth pictures (Image 16UC1 or 32FC1, with CameraInfo) or clouds (PointCloud2). None: the bag's only ones."""
    pose: Literal["config", "bag"] = "config"
    """Where the camera was: by `mount`, or by the bag's transforms."""
    world: str = "world"
    """With `pose: bag`: the frame of the bag that is the cell's world."""


Source: TypeAlias = SimulatedSource | RealSenseSource | RecordingSource


class DepthCameraSettings(Settings):
    """A D435i: where it stands, what it tells and how late."""

    kind: Literal["d435i"] = "d435i"
    resolution: Literal["640x480", "848x480", "640x360", "480x270", "424x240"] = "640x480"
    mount: CameraMount
    rate: Literal[6, 15, 30, 60, 90] = 30
    """Pictures a second."""
    latency: Annotated[NotNegative, at_most(10, "s")] = 0.065
    """Time from a picture's exposure until the program has it, s (librealsense #1242: 60 to 70 ms for depth)."""
    colour: bool = False
    """Take a colour picture with each."""
    furthest: Annotated[float, AfterValidator(_beyond_the_nearest), at_most(100, "m")] = 10.0
    """Largest known depth, m (datasheet: about 10 m)."""
    noise: DepthNoise = DepthNoise()
    source: Annotated[Source, Field(discriminator="kind")] = SimulatedSource()
    """Where pictures come from; with another than `simulated` the keys above but `mount` do not count."""

    @property
    def intrinsics(self) -> Intrinsics:
        """Intrinsics of the depth picture."""
        return D435I_DEPTH[self.resolution]

    @property
    def baseline(self) -> float:
        """m."""
        return D435I_BASELINE
