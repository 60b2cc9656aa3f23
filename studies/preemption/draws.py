"""Which trial number i is: a function of the protocol and of i alone, so that every policy, and every hand, has the
same (common random numbers)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studies.preemption.protocol import ContactStrata, Control, Set, Study

_SETS: dict[Set, int] = {"train": 0, "test": 1}


@dataclass(frozen=True, slots=True)
class Case:
    """What a trial is drawn as; the hand knows none of it but the strata's standard deviation and the arm's time."""

    object: str
    sigma: float
    """Standard deviation of its place along x and y, m."""
    sigma_yaw: float
    """Of its turn, degrees."""
    friction: float
    approach: float
    """s."""
    x: float
    """Where it is less where it is taken to be, m."""
    y: float
    yaw: float
    """rad."""
    phase: float
    """Where in its cycle a state machine is when the arm sets off, as a part of it."""
    felt: float
    """The error of the force check, in its standard deviations."""
    contact: str = ""
    """How contacts are modelled, by name; empty where the study has one way."""


def block(study: Study, set_: Set) -> int:
    """So many trials in a row have each object with each pair of errors once, and each friction and each time of
    approach as often as can be."""
    return len(getattr(study, set_)) * len(study.strata.position) * len(study.strata.yaw)


def object_of(study: Study, set_: Set, number: int) -> str:
    """What trial `number` of a set is made with."""
    objects: tuple[str, ...] = getattr(study, set_)
    return objects[number % len(objects)]


def case(study: Study, set_: Set, number: int, control: Control | None = None) -> Case:
    """Trial `number` of a set, from 0."""
    objects, strata = getattr(study, set_), study.strata
    row = number // len(objects)
    turn, cell = divmod(row, len(strata.position) * len(strata.yaw))
    place, yaw = cell % len(strata.position), cell // len(strata.position)
    frictions, times = strata.friction, strata.approach
    slot = turn + cell
    friction = frictions[slot % len(frictions)]
    approach = times[(slot + slot // len(frictions) + cell // len(times)) % len(times)]
    stream = 0 if control is None else control.stream
    random = np.random.default_rng([study.seed, stream, _SETS[set_], number])
    x, y, angle, felt = random.standard_normal(4).tolist()
    phase = float(random.uniform())
    contacts = tuple(strata.contacts) if isinstance(strata, ContactStrata) else ("",)
    contact = contacts[int(random.integers(len(contacts)))]
    sigma, sigma_yaw = strata.position[place], strata.yaw[yaw]
    if control is not None and control.certain:
        sigma, sigma_yaw, friction = 0.0, 0.0, max(frictions)
    return Case(
        object_of(study, set_, number), sigma, sigma_yaw, friction, approach, sigma * x, sigma * y,
        float(np.radians(sigma_yaw)) * angle, phase, felt, contact,
    )  # fmt: skip
