"""The run config: one block a part, and `kind` picks the implementation."""

from allegro_twin.config.backends import (
    VIRTUAL,
    CanSettings,
    FaultSettings,
    FirmwareSettings,
    ReplaySettings,
    SceneSettings,
    SimSettings,
)
from allegro_twin.config.controllers import (
    CartesianSettings,
    FollowSettings,
    GravitySettings,
    LimpSettings,
    PolicySettings,
    PositionSettings,
    TorqueSettings,
)
from allegro_twin.config.dynamixel import VIRTUAL_PORT, DynamixelSettings
from allegro_twin.config.polled import PolledSettings, QbSettings, SchunkSettings
from allegro_twin.config.run import HandSettings, LimitSettings, RunConfig, load_config
from allegro_twin.config.task import TaskSettings
from allegro_twin.config.values import PerJoint

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
    "LimitSettings",
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
