"""SciPy, which comes with an extra."""

from __future__ import annotations

from types import ModuleType

from allegro_twin.errors import ConfigError


def scipy_part(name: str) -> ModuleType:
    """One part of SciPy: `optimize`, `spatial`. Raises ConfigError where the extra is not installed."""
    try:
        import scipy.optimize  # type: ignore[import-untyped]  # Its types are a package of their own.
        import scipy.spatial  # type: ignore[import-untyped]
    except ImportError as error:
        raise ConfigError("metrics of contacts need SciPy: pip install 'allegro-twin[objects]'") from error
    found: ModuleType = getattr(scipy, name)
    return found
