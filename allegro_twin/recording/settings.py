"""Settings of the replay backend."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from allegro_twin.plugins import BackendSettings


class ReplaySettings(BackendSettings):
    """A recording in place of a hand."""

    kind: Literal["replay"]
    file: Path
    """A .arrow recording, or a bag: .mcap, .bag, or a folder of rosbag2."""
    partial: bool = False
    """Use the readable rows of a recording that was cut short."""
    track: str | None = None
    """Track of a recording of a whole cell: `hand` or `arm`."""
    topic: str | None = None
    """Topic of a bag with the joints' positions (JointState). None: its only one that is called joint_states."""

    @property
    def place(self) -> str:
        return f"recording {self.file}"
