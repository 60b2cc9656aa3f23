"""Named controller gains."""

from __future__ import annotations

from allegro_twin.control.controllers import Gains
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.spec import HandSpec

_KEYS = ("kp", "kd", "ki", "clamp")


def load_gains(name: str, spec: HandSpec) -> Gains:
    """Gains by name from conf/gains/<model>.yaml. Raises ConfigError for an unknown name or a wrong count."""
    path = data_root() / "conf" / "gains" / f"{spec.model}.yaml"
    table = read_yaml(path)
    if name not in table:
        raise ConfigError(unknown("gains", name, table))
    row = table[name]
    wrong = sorted(set(row) ^ set(_KEYS))
    if wrong:
        raise ConfigError(f"{path}: {name} needs exactly {', '.join(_KEYS)}; see {', '.join(wrong)}")
    gains = Gains(*(spec.vector(row[key], f"{path}: {name}.{key}") for key in _KEYS))
    if any((values < 0).any() for values in (gains.kp, gains.kd, gains.ki, gains.clamp)):
        raise ConfigError(f"{path}: {name}: gains must not be negative")
    return gains
