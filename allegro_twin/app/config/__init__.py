"""The run config: one block a part, and `kind` picks the implementation."""

from allegro_twin.app.config.backends import (
    VIRTUAL,
    CanSettings,
    FaultSettings,
    FirmwareSettings,
    ReplaySettings,
    SceneSettings,
    SimSettings,
)
from allegro_twin.app.config.controllers import (
    CartesianSettings,
    FollowSettings,
    GravitySettings,
    LimpSettings,
    PolicySettings,
    PositionSettings,
    TorqueSettings,
)
from allegro_twin.app.config.dynamixel import VIRTUAL_PORT, DynamixelSettings
from allegro_twin.app.config.polled import PolledSettings, QbSettings, SchunkSettings
from allegro_twin.app.config.run import HandSettings, RunConfig, load_config
from allegro_twin.app.config.task import TaskSettings
from allegro_twin.files.schema import PerJoint

__all__ = [
    "VIRTUAL",
    "VIRTUAL_PORT",
    "CanSettings",
    "CartesianSettings",
    "DynamixelSettings",
    "FaultSettings",
    "FirmwareSettings",
    "FollowSettings",
    "GravitySettings",
    "HandSettings",
    "LimpSettings",
    "PerJoint",
    "PolicySettings",
    "PolledSettings",
    "PositionSettings",
    "QbSettings",
    "ReplaySettings",
    "RunConfig",
    "SceneSettings",
    "SchunkSettings",
    "SimSettings",
    "TaskSettings",
    "TorqueSettings",
    "load_config",
]
