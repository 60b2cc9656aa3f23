"""How to deal with a hand on a bus."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Terms:
    """How to deal with a hand on a bus."""

    period: float = 0.003
    """s between two reports; the hand is told."""
    timeout: float = 0.05
    """Without a whole state for so long the hand has fallen silent, s."""
    deadman: float | None = 0.1
    """Cut the hand off when its program does not call for so long, s; None: never."""
    velocity_cutoff: float = 30.0
    """Of the filter behind joint velocities, Hz."""
    identify: bool = True
    """Ask the hand who it is, where its version answers, and refuse the wrong one."""
    gravity: tuple[float, float, float] | None = None
    """In the palm frame, m/s², in place of the hand's IMU."""
    temperature_period: float = 0.5
    """s between two reports of temperatures, where the version has them. R2 v4_sdk.cpp:241 asks for 500 ms."""
    imu_period: float = 0.0
    """s between two reports of the IMU; 0: never, for no source confirms its layout."""
    status_period: float = 1.0
    """s between two questions for the status. R2 v4_sdk.cpp:421."""
