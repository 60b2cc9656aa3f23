"""Rotate task: turn an object in the upturned hand about the vertical, continuously."""

from __future__ import annotations

import warnings
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.settings import EnvSettings, ResetOptions
from allegro_twin.learning.policy.interface import Observation
from allegro_twin.learning.tasks.base import StepOutcome, Ticks
from allegro_twin.learning.tasks.in_hand import DROPPED, InHandTask
from allegro_twin.learning.tasks.vectors import length, tilt, twist
from allegro_twin.sim.batch.core import Rows
from allegro_twin.types import Array

FASTEST = 0.6  # rad/s. Faster turning earns no more.
UPRIGHT, ENOUGH_UPRIGHT = np.radians(25.0), np.radians(30.0)  # Largest tilts for reward and for success.
TOPPLED = np.radians(50.0)  # Beyond this a box falls on its side.
ENOUGH = 2.0 * np.pi  # rad in an episode, net.
# Weights of the costs of a step, after hora (Qi et al. 2022): its ratios, with our units.
_SLIDE, _POSTURE, _TORQUE, _WORK = 0.3, 0.02, 0.01, 0.005


class RotateTask(InHandTask):
    """Counter-clockwise seen from above for the right hand; clockwise for the left. An episode is a success while the
    hand touches the object."""

    name = "Rotate"
    purpose = "rotate an object in the hand about the vertical, continuously"
    seconds = 30.0
    count_term, count_unit = "turned", "rad"
    reward_terms: ClassVar[dict[str, float]] = {
        "speed": 1.0, "slide": 1.0, "posture": 1.0, "torque": 1.0, "work": 1.0, "dropped": 1.0, "back": 0.0,
    }  # fmt: skip

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        _check_tilt(settings.randomise.wrist_tilt)
        super().__init__(settings, n, threads)
        self._sign = 1.0 if settings.side == "right" else -1.0
        xp = self.worlds.xp
        self._before = xp.zeros(n)
        self._limit = xp.asarray(self.spec.actuation.torque_limit)
        self.turned = xp.zeros(n)
        """Net since the reset, rad."""
        self._farthest = xp.zeros(n)

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions) -> None:
        super().begin(rows, variant, draws, values, options)
        assert self.object_body is not None
        self._before[rows] = twist(self.object_body.pose[rows, 3:])
        self.turned[rows] = self._farthest[rows] = 0.0

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        own = {"before": self._before, "turned": self.turned, "farthest": self._farthest}
        return super().live_arrays() | own

    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> StepOutcome:
        assert self.object_body is not None
        xp, now = self.worlds.xp, self.object_body.pose[:, 3:]
        # The heading, not the angular velocity about z: a rocking object has one without turning.
        heading = twist(now)
        turn = self._sign * ((heading - self._before + np.pi) % (2.0 * np.pi) - np.pi)
        leaning = tilt(now)
        self._before, self.turned = heading, self.turned + turn
        lost = self.lost() | (leaning > TOPPLED)
        # Only new angles are paid, otherwise rocking would pay: forward while upright and slow, and back while leaning,
        # or fast. What is gained while leaning is not paid later either.
        farthest = xp.maximum(self._farthest, self.turned)
        gained = xp.minimum((farthest - self._farthest) / self.interface.seconds / FASTEST, 1.0)
        self._farthest = farthest
        speed = xp.where(leaning < UPRIGHT, gained, 0.0)
        # With `back` every turn is paid, back in full: nothing for rocking either, and a stroke back costs at once.
        every_turn = xp.minimum(turn / self.interface.seconds / FASTEST, 1.0)
        away = self.worlds.position - self.start
        told = self.worlds.applied_torque if self.worlds.closes_loop else self.worlds.control
        torque = xp.minimum(xp.maximum(told, -self._limit), self._limit)
        terms = {
            "speed": speed,
            "slide": -_SLIDE * xp.minimum(length(self.object_body.velocity), 1.0),
            "posture": -_POSTURE * (away * away).sum(axis=-1),
            "torque": -_TORQUE * (torque * torque).sum(axis=-1),
            "work": -_WORK * xp.minimum(xp.abs(torque * self.worlds.velocity).sum(axis=-1), 10.0),
            "dropped": xp.where(lost, DROPPED, 0.0),
        }
        reward = xp.stack(list(terms.values())).sum(axis=0)
        terms["back"] = xp.where(leaning < UPRIGHT, every_turn, xp.minimum(every_turn, 0.0)) - speed
        # What is given out stays, although a reset and a restored state write into what is counted.
        values = {"turned": xp.copy(self.turned), "rate": self.turned / xp.maximum(tick * self.settings.period, 1e-9)}
        success = (self.turned >= ENOUGH) & (leaning < ENOUGH_UPRIGHT) & self.contacts.in_contact() & ~lost
        return StepOutcome(reward, lost, success, terms | values | self.palm_terms(tick))


def _check_tilt(drawn: tuple[float, float] | None) -> None:
    """Raise ConfigError for tilts of the palm about each of its axes, rad, that are a loss by themselves, or with which
    no episode begins where anything is paid; warn where some begin so."""
    if drawn is None:
        return
    # About both horizontal axes at once: the same tilt about the diagonal between them.
    least, largest = _lean(drawn[0], drawn[1]), np.sqrt(2.0) * drawn[1]
    paid = f"Rotate pays nothing while an object leans by {np.degrees(UPRIGHT):.0f}° or more"
    if largest > TOPPLED:
        raise ConfigError(
            f"randomise.wrist_tilt up to {drawn[1]:g} rad about each axis leans the palm by up to "
            f"{np.degrees(largest):.0f}°, and Rotate loses an object that leans by {np.degrees(TOPPLED):.0f}°: "
            f"at most {_each(TOPPLED):g} rad"
        )
    if least > UPRIGHT:
        raise ConfigError(
            f"randomise.wrist_tilt from {drawn[0]:g} rad on about each axis leans the palm by {np.degrees(least):.0f}° "
            f"or more, and {paid}: begin the range at {_each(UPRIGHT):g} rad or less"
        )
    if largest > UPRIGHT:
        warnings.warn(
            f"randomise.wrist_tilt up to {drawn[1]:g} rad about each axis leans the palm by up to "
            f"{np.degrees(largest):.0f}°; {paid}, which is {_each(UPRIGHT):g} rad, and success asks for less than "
            f"{np.degrees(ENOUGH_UPRIGHT):.0f}°",
            stacklevel=2,
        )


def _lean(each: float, about: float) -> float:
    """Angle from the vertical, rad, after turns by `each` about both horizontal axes and `about` the vertical one."""
    square = 2.0 * each**2
    turn = np.sqrt(square + about**2)
    return float(np.arccos(np.cos(turn) + (1.0 - np.cos(turn)) * about**2 / turn**2)) if turn > 0.0 else 0.0


def _each(lean: float) -> float:
    """Largest tilt about both axes with which a palm leans by no more, rad, rounded down."""
    return float(np.floor(100.0 * lean / np.sqrt(2.0)) / 100.0)
