"""Functions by name, `package.module:function`, so that another process or computer can find them."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from allegro_twin.errors import ConfigError, unknown


def function(name: str) -> Callable[..., Any]:
    """The function of that name. Raises ConfigError where there is none."""
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise ConfigError(f"function {name!r}: must be package.module:name")
    try:
        home = import_module(module)
    except ModuleNotFoundError as error:
        raise ConfigError(f"function {name!r}: {error}") from error
    found: Callable[..., Any] | None = getattr(home, attribute, None)
    if not callable(found):
        known = [each for each, value in vars(home).items() if callable(value) and not each.startswith("_")]
        raise ConfigError(unknown(f"function of {module}", attribute, known))
    return found
