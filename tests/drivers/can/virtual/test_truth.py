"""A virtual hand that is not what its host believes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.dynamixel.config import DynamixelSettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse_settings
from allegro_twin.types import Array, TorqueCommand
from tests.conftest import on_a_bus

TORQUE = 240 / 1200 * np.tile([0.25, 1.0, 0.75, 0.5], 4)  # Whole counts, and half of them, too.


def swung(share: float, **scene: Any) -> Array:
    """Where the joints are in each of 60 periods under a share of a torque."""
    return played(on_a_bus("v4", scene={"kind": "sim", **scene}), share)


def played(backend: CanBackend, share: float) -> Array:
    found = [backend.reset().position]
    for _ in range(60):
        backend.write(TorqueCommand(share * TORQUE))
        found.append(backend.read().position)
    backend.close()
    return np.array(found)


def test_the_same_counts_are_half_the_torque_of_a_hand_with_half_the_constant() -> None:
    np.testing.assert_array_equal(swung(1.0, truth={"wire": {"torque_constant": 0.5}}), swung(0.5))


def test_an_empty_truth_is_the_hand_that_its_host_believes() -> None:
    np.testing.assert_array_equal(swung(1.0, truth={}), swung(1.0))


def test_truth_in_a_file_is_the_truth_in_the_config(tmp_path: Path) -> None:
    file = tmp_path / "hidden.yaml"
    file.write_text("actuation: {damping: 0.2}\ndrive: {delay: 0.004}\nlimits: {}\n")
    hidden = swung(1.0, truth=str(file))
    np.testing.assert_array_equal(hidden, swung(1.0, truth={"actuation": {"damping": 0.2}, "drive": {"delay": 0.004}}))
    assert np.abs(hidden - swung(1.0)).max() > 0.01


def test_a_hidden_offset_is_what_the_host_reads_too_much() -> None:
    off = swung(0.0, truth={"drive": {"encoder_offset": 0.02}})[0] - swung(0.0)[0]
    np.testing.assert_allclose(off, 0.02, atol=np.radians(333.3 / 65536))


def test_a_truth_that_nobody_would_read_is_refused() -> None:
    with pytest.raises(ValueError, match="no block named 'wires'; did you mean 'wire'"):
        swung(1.0, truth={"wires": {}})
    with pytest.raises(ConfigError, match="truth: drive: no key named 'dely'"):
        swung(1.0, truth={"drive": {"dely": 1}})
    with pytest.raises(ConfigError, match="truth: wire: no key named 'torque_constants'"):
        swung(1.0, truth={"wire": {"torque_constants": 1}})


def suffered(*script: dict[str, Any], share: float = 1.0, **chance: float) -> Array:
    return played(on_a_bus("v4", scene={"kind": "sim"}, faults={"script": list(script), **chance}), share)


def test_what_goes_wrong_with_a_joint_shows_from_that_moment_on() -> None:
    well = suffered()
    for what, amount, least in (
        ("weak", 0.2, 0.02), ("stuck", 1.0, 0.05), ("friction", 0.1, 0.02), ("encoder_step", 0.05, 0.04),
        ("encoder_drift", 0.5, 0.02), ("payload", 0.1, 2e-3),
    ):  # fmt: skip
        ill = suffered({"at": 0.12, "what": what, "which": 5, "amount": amount})
        np.testing.assert_array_equal(ill[:25], well[:25])
        assert np.abs(ill - well)[:, 5].max() > least, what
        np.testing.assert_array_equal(ill[:, 8:12], well[:, 8:12])


def test_a_stuck_joint_stays_where_it_is() -> None:
    ill = suffered({"at": 0.0, "what": "stuck", "which": 5})
    assert np.ptp(ill[:, 5]) < 1e-3


def test_a_motor_of_which_nothing_is_left_is_dead() -> None:
    dead = suffered({"at": 0.0, "what": "weak", "which": 5, "amount": 0})
    limp = suffered({"at": 0.0, "what": "weak", "which": 5, "amount": 1e-12})
    np.testing.assert_allclose(dead, limp, atol=np.radians(333.3 / 65536))
    np.testing.assert_array_equal(suffered({"at": 0.0, "what": "payload", "which": 5, "amount": 0}), suffered())


@pytest.mark.parametrize(
    ("what", "amount", "bounds"),
    [("weak", -5, "0 … 1"), ("weak", 1.5, "0 … 1"), ("payload", -0.5, "from 0"), ("friction", -0.1, "from 0"),
     ("stuck", -1, "from 0"), ("loose", -0.01, "from 0"), ("slippery", 2, "0 … 1")],
)  # fmt: skip
def test_an_amount_that_no_fault_has_is_refused_with_its_range(what: str, amount: float, bounds: str) -> None:
    faults = {"script": [{"at": 0.1, "what": what, "which": 2, "amount": amount}]}
    with pytest.raises(ConfigError, match=f"faults.script.0: amount: of {what} it is {bounds}, not {amount:g}$"):
        parse_settings(CanSettings, {"kind": "can", "faults": faults}, "config")


@pytest.mark.parametrize(
    ("what", "amount", "said"),
    [("other_id", 300, "of other_id it is 0 … 252, not 300"), ("other_id", 1.5, "an id is a whole number, not 1.5"),
     ("overheat", -10, "of overheat it is 0 … 255, not -10")],
)  # fmt: skip
def test_an_amount_that_no_servo_has_is_refused_with_its_range(what: str, amount: float, said: str) -> None:
    faults = {"script": [{"at": 0.1, "what": what, "amount": amount}]}
    with pytest.raises(ConfigError, match=f"faults.script.0: amount: {said}$"):
        parse_settings(DynamixelSettings, {"kind": "dynamixel", "faults": faults}, "config")


def test_what_goes_wrong_by_chance_is_the_same_for_the_same_seed() -> None:
    first, again, well = suffered(failures=2000.0), suffered(failures=2000.0), suffered()
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - well).max() > 1e-3
