"""The Allegro Hand as a robot of LeRobot, on any backend of allegro_twin."""

from lerobot_robot_allegro.allegro import Allegro
from lerobot_robot_allegro.config_allegro import AllegroConfig

__all__ = ["Allegro", "AllegroConfig"]
