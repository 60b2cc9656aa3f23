"""What a cell's config refuses when it is loaded, before anything moves."""

from __future__ import annotations

from typing import Any

import pytest

from allegro_twin.cell.settings import LabSettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.files.schema import load_settings, parse_settings

CONFIGS = sorted((data_root() / "conf").glob("lab_*.yaml"))


def parsed(key: str, value: Any) -> LabSettings:
    """Settings of the shipped cell with another value at a dotted key."""
    config = read_yaml(data_root() / "conf" / "lab_allegro.yaml")
    *above, last = key.split(".")
    part = config
    for name in above:
        part = part.setdefault(name, {})
    part[last] = value
    return parse_settings(LabSettings, config, "lab.yaml")


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_cell_that_ships_loads(path: Any) -> None:
    assert load_settings(LabSettings, path).objects


@pytest.mark.parametrize(("key", "value", "unit"), [
    ("lift", 150, "m"), ("decide.near", 6, "m"), ("decide.turned", 4, "rad"), ("arm.turning", 90, "rad/s"),
    ("arm.joint_speed", 90, "rad/s"), ("arm.speed", 400, "m/s"), ("arm.approach", 1200, "s"), ("arm.lift", 1000, "s"),
    ("arm.stiffness", 1e6, "N/m"), ("arm.angular_stiffness", 5e4, "N·m/rad"), ("arm.period", 3, "s"),
    ("perception.table.near", 10, "m"), ("perception.table.off", 5, "m"), ("perception.object.above", 6, "m"),
    ("perception.object.gap", 8, "m"), ("perception.object.best", 1.5, "m"), ("perception.object.loose", 6, "m"),
    ("perception.target.clearance", 20, "m"), ("perception.target.offset", 50, "m"), ("perception.baseline", 50, "m"),
    ("perception.oldest", 300, "s"), ("camera.noise.unit", 1, "m"), ("camera.furthest", 10_000, "m"),
    ("camera.furthest", 0.001, "m"), ("camera.latency", 65, "s"), ("validation.torque", 100, "N·m"),
    ("validation.most", 1700, "kg"), ("timeouts.look", 1000, "s"), ("timeouts.open", 4000, "s"),
    ("follow.clearance", 15, "m"),
])  # fmt: skip
def test_a_value_that_has_another_unit_is_refused_with_its_key_and_the_unit(key: str, value: float, unit: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parsed(key, value)
    assert str(refused.value).startswith(f"lab.yaml: {key}: it is in {unit}, ")
    assert str(refused.value).endswith(f", not {value}")


@pytest.mark.parametrize("angles", [[85, 75], [75, 100], [-5, 80]])
def test_grazing_angles_that_are_no_range_are_refused(angles: list[float]) -> None:
    with pytest.raises(ConfigError, match=r"camera\.noise: grazing \[.*give two angles from 0 to 90 degrees"):
        parsed("camera.noise.grazing", angles)
    assert parsed("camera.noise.grazing", [0, 90]).camera.noise.grazing == (0.0, 90.0)


@pytest.mark.parametrize(("key", "value", "limit", "by"), [
    ("validation.samples", 4000, "target", "validation.samples x arm.period 12 s"),
    ("timeouts.check", 0.1, "check", "validation.samples x arm.period 0.3 s"),
    ("validation.tare", 4000, "target", "validation.tare x arm.period, of light objects, 12 s"),
    ("validation.long", 2100, "check", "validation.long x arm.period, of light objects, 6.3 s"),
    ("camera.latency", 1.2, "look", "camera.latency 1.2 s"),
    ("arm.approach", 5.0, "approach", "arm.approach 5 s"), ("timeouts.lift", 0.8, "lift", "arm.lift 1 s"),
])  # fmt: skip
def test_a_time_limit_that_always_runs_out_is_refused_with_both_keys(
    key: str, value: float, limit: str, by: str
) -> None:
    with pytest.raises(ConfigError, match=rf"timeouts\.{limit} .* s is less than {by}, so it always runs out"):
        parsed(key, value)


@pytest.mark.parametrize(
    ("key", "value"), [("timeouts.approach", 1.1), ("timeouts.lift", 0.95), ("timeouts.look", 0.07)]
)
def test_a_time_limit_that_a_motion_meets_before_the_next_decision_is_taken(key: str, value: float) -> None:
    assert float(getattr(parsed(key, value).timeouts, key.split(".")[1])) == value
