"""Settings of the host's side of a CAN bus."""

from __future__ import annotations

from dataclasses import dataclass

from allegro_twin.errors import ConfigError


@dataclass(frozen=True, slots=True)
class CanHostSettings:
    """Settings of the host's side of a CAN bus. Raises ConfigError for times that no hand can keep."""

    period: float = 0.003
    """s between two reports; the hand is told."""
    timeout: float = 0.05
    """Without a whole state for so long the hand has fallen silent, s."""
    deadman: float | None = 0.3
    """Cut the hand off when its program does not call for so long, s; None: never. docs/explanation/safety.md has why
    0.3."""
    keeper: bool = True
    """Have a process of its own do so, which also does it when the program dies; where the bus can be shared."""
    velocity_cutoff: float = 30.0
    """Cutoff of the filter on joint velocities, Hz."""
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

    def __post_init__(self) -> None:
        ms = 1000.0 * self.period
        if abs(ms - round(ms)) > 1e-6 or not 1 <= round(ms) <= 255:
            raise ConfigError(f"period {self.period:g} s: a hand counts whole milliseconds, from 0.001 to 0.255 s")
        if self.timeout < 2 * self.period:
            raise ConfigError(f"timeout {self.timeout:g} s must be two periods of {self.period:g} s or more")
