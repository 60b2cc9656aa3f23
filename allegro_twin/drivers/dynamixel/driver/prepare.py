"""Before a hand moves: whether its servos are there, are the right ones, and are set as they must be."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from allegro_twin.drivers.dynamixel.codec.calibration import Calibration
from allegro_twin.drivers.dynamixel.codec.table import CURRENT_POSITION, MODELS
from allegro_twin.drivers.dynamixel.driver.sdk import Sdk, causes
from allegro_twin.errors import ConfigError, HandFault, LinkError, LinkTimeout
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector

_GAINS = ("position_p_gain", "position_i_gain", "position_d_gain")
FAR = 0.5
"""rad outside its limits at which an actuator cannot be."""
BOOT = 0.5
"""s that a servo takes after a reboot, at most."""


def find(sdk: Sdk, calibration: Calibration) -> None:
    """Everybody answers, as the right model. Raises LinkTimeout that says who does not, and at which baud the servos
    answer if at another; ConfigError for another model."""
    found = {identifier: sdk.ping(identifier) for identifier in calibration.ids}
    missing = [identifier for identifier, number in found.items() if number is None]
    if len(missing) == len(found):
        raise LinkTimeout(
            f"no servo answers on {sdk.port.name} at {sdk.port.baud} baud; {_elsewhere(sdk, calibration)}"
        )
    if missing:
        others = sorted(set(sdk.everybody()) - set(calibration.ids))
        there = f"strangers answer: ids {', '.join(map(str, others))}" if others else "nobody else does"
        ids = ", ".join(map(str, missing))
        raise LinkTimeout(f"no answer from id {ids} on {sdk.port.name}, and {there}; check its plug, power and id")
    for identifier, number in found.items():
        if number != calibration.model.number:
            is_a = next((model.name for model in MODELS.values() if model.number == number), f"model {number}")
            raise ConfigError(f"id {identifier} is a {is_a}; this hand's servos are {calibration.model.name}")


def _elsewhere(sdk: Sdk, calibration: Calibration) -> str:
    """At which speed they answer instead."""
    wanted = sdk.port.baud
    for baud in calibration.model.bauds:
        if baud == wanted:
            continue
        try:
            sdk.port.rebaud(baud)
        except LinkError:
            continue  # This adapter cannot speak so fast.
        if any(sdk.ping(identifier) is not None for identifier in calibration.ids):
            return f"they answer at {baud}: set baud so, or change it in the servos"
    return "nor at any other speed: check power and cable"


def wake(sdk: Sdk, calibration: Calibration, names: dict[int, str]) -> None:
    """Motors off, hardware errors cleared by a reboot. Raises HandFault for one that stays."""
    ids = calibration.ids
    sdk.tell(ids, "torque_enable", [0] * len(ids))
    ill = [identifier for identifier, bits in zip(ids, sdk.ask_item(ids, "hardware_error_status"), strict=True) if bits]
    for identifier in ill:
        sdk.reboot(identifier)
    if not ill:
        return
    sdk.port.wait(sdk.port.now() + BOOT)
    sdk.alerts.clear()
    for identifier in ill:
        if bits := sdk.read(identifier, "hardware_error_status"):
            raise HandFault(f"{names[identifier]} (id {identifier}): {causes(bits)}, also after a reboot; let it cool")


def check_place(spec: HandSpec, position: Vector, calibration: Calibration) -> None:
    """Raises ConfigError for an actuator that cannot be where its servo says: its calibration is another's, or it was a
    turn farther when it last lost its power, which a servo forgets."""
    if len(position) != spec.n_joints:
        return  # The limits are those of joints.
    excess = np.maximum(spec.lower - position, position - spec.upper)
    worst = int(np.argmax(excess))
    if excess[worst] > FAR:
        raise ConfigError(
            f"{spec.joint_labels[worst]} (id {calibration.ids[worst]}) would be at {position[worst]:.2f} rad, far "
            f"outside [{spec.lower[worst]:.2f}, {spec.upper[worst]:.2f}]: its zero or direction is wrong, "
            "or it lost a turn"
        )


def settle(sdk: Sdk, calibration: Calibration, return_delay: int) -> None:
    """Set what must be set, in the servos' EEPROM only where it differs, and read it back. Raises ConfigError where a
    servo keeps another value."""
    wanted = dict(_wanted(calibration, return_delay))
    for identifier in calibration.ids:
        for name, value in wanted[identifier].items():
            if sdk.read(identifier, name) != value:
                sdk.write(identifier, name, value)
            if (kept := sdk.read(identifier, name)) != value:
                raise ConfigError(f"id {identifier} keeps {name} = {kept}; this hand needs {value}")


def _wanted(calibration: Calibration, return_delay: int) -> Iterator[tuple[int, dict[str, int]]]:
    """Registers to write into each servo, in this order: a change of mode resets what follows. The current limit is the
    servo's own, so that no command and no lost packet can ask for more."""
    for servo, most in zip(calibration.servos, calibration.current_counts, strict=True):
        gains = {} if servo.gains is None else dict(zip(_GAINS, servo.gains, strict=True))
        yield (
            servo.id,
            {
                "bus_watchdog": 0,
                "status_return_level": 2,
                "return_delay": return_delay,
                "drive_mode": 0,
                "operating_mode": CURRENT_POSITION,
                "current_limit": most,
                "goal_current": most,
                "profile_velocity": 0,
                "profile_acceleration": 0,
                **gains,
            },
        )
