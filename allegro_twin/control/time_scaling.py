"""Time scaling of a straight line in joint space: which part of it is travelled when."""

from __future__ import annotations

from typing import Any, Literal, Protocol, TypeAlias, get_args

from allegro_twin.errors import ConfigError, unknown

Profile: TypeAlias = Literal["linear", "minimum_jerk", "time_optimal"]
# Peak over mean speed: 1 for a straight line, 15/8 for the minimum-jerk polynomial.
_PEAK: dict[str, float] = {"linear": 1.0, "minimum_jerk": 15.0 / 8.0}


class TimeScaling(Protocol):
    """A profile on the unit interval."""

    def __call__(self, s: float) -> tuple[float, float]:
        """The part of the line that is travelled at the part `s` of the time, and its derivative by `s`."""
        ...


def linear(s: float) -> tuple[float, float]:
    """Constant speed."""
    return s, 1.0


def minimum_jerk(s: float) -> tuple[float, float]:
    """The polynomial of fifth degree with rest at both ends."""
    return s**3 * (10.0 + s * (6.0 * s - 15.0)), 30.0 * s**2 * (1.0 - s) ** 2


def minimum_jerk_curvature(s: float) -> float:
    """The second derivative of that polynomial by `s`."""
    return 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)


def leg_timing(profile: Profile, distance: float, speed: float, acceleration: float) -> tuple[float, TimeScaling]:
    """Seconds that a joint takes for a distance (rad), and its time scaling: with `speed` (rad/s) as its peak and,
    where the profile is `time_optimal`, at most `acceleration` (rad/s²). Raises ConfigError without its library, and
    for a profile that there is not."""
    if profile not in get_args(Profile):
        raise ConfigError(unknown("profile", str(profile), get_args(Profile)))
    if profile == "time_optimal":
        return _time_optimal(distance, speed, acceleration)
    return distance * _PEAK[profile] / speed, linear if profile == "linear" else minimum_jerk


def _time_optimal(distance: float, speed: float, acceleration: float) -> tuple[float, TimeScaling]:
    """The shortest time from rest to rest. All joints have the same limits, so the one that travels furthest needs
    longest; the others do the same part of their way at any time, and stay within the limits with room to spare."""
    try:
        import ruckig
    except ImportError as error:
        raise ConfigError("the profile time_optimal needs ruckig: pip install 'allegro-twin[trajectory]'") from error
    if distance < 1e-9:
        return 0.0, minimum_jerk  # Nowhere to go.
    wish: Any = ruckig.InputParameter(1)
    wish.current_position, wish.target_position = [0.0], [distance]
    wish.max_velocity, wish.max_acceleration = [speed], [acceleration]
    path: Any = ruckig.Trajectory(1)
    try:
        ruckig.Ruckig(1).calculate(wish, path)
    except ruckig.RuckigError as error:
        raise ConfigError(f"no motion of {distance:g} rad at {speed:g} rad/s and {acceleration:g} rad/s²") from error
    seconds = float(path.duration)

    def shape(s: float) -> tuple[float, float]:
        position, velocity, _ = path.at_time(s * seconds)
        return position[0] / distance, velocity[0] * seconds / distance

    return seconds, shape
