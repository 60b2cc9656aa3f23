"""Where results that took long are kept for the next time, on this machine."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.errors import ConfigError


def cache_folder(kind: str, what: str) -> Path:
    """The folder of one kind of result in the user's cache. Raises ConfigError, saying that `what` needs the extra,
    where the platform's folders are not known."""
    try:
        from platformdirs import user_cache_path
    except ImportError as error:
        raise ConfigError(f"{what} is kept in a cache: pip install 'allegro-twin[objects]'") from error
    return user_cache_path("allegro_twin", appauthor=False) / kind
