"""Small scenes for cameras, in which every ray is known."""

from __future__ import annotations

import allegro_twin.cell.camera  # noqa: F401  # isort: skip  # It chooses how MuJoCo renders, which must come before MuJoCo.
import mujoco
import pytest

from allegro_twin.cell.camera.camera import DepthCamera
from allegro_twin.cell.camera.mount import CameraMount
from allegro_twin.cell.camera.settings import DepthCameraSettings, DepthNoise
from allegro_twin.errors import ConfigError

EXACT = DepthNoise(disparity=0.0, subpixel=0, unit=0.0, shadow=False, edge=0.0, grazing=(89.999, 90.0))
SMALL = "424x240"
_HEAD = """<mujoco><statistic extent="1"/>
<visual><map znear="0.01" zfar="20"/><quality numslices="100" numstacks="100"/>
</visual><worldbody>{}</worldbody></mujoco>"""
PLANE = '<geom type="plane" size="5 5 .1"/>'
BALL = '<geom type="sphere" size=".1" pos=".1 .05 .1"/>'
WRIST = """<body name="wrist" pos="0 0 .5"><joint name="turn" axis="0 0 1"/><geom size=".01"/>
<site name="eye" pos="0 0 -.02"/></body>"""


def scene(inside: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(_HEAD.format(inside))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def camera(model: mujoco.MjModel, mount: CameraMount, noise: DepthNoise = EXACT, **more: object) -> DepthCamera:
    """A small one, or a skipped test where nothing can be rendered."""
    given = {"mount": mount, "noise": noise, "resolution": SMALL} | more
    try:
        return DepthCamera(model, DepthCameraSettings.model_validate(given))
    except ConfigError as error:
        if "cannot render" in str(error):
            pytest.skip(str(error))
        raise
