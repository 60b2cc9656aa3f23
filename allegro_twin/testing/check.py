"""The backend contract as a check without pytest: what a backend keeps of it, rule by rule."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from allegro_twin.errors import HandError
from allegro_twin.testing.rules import RULES, ContractViolation, DoesNotApply, Make


@dataclass(frozen=True, slots=True)
class Result:
    """Result of one rule."""

    rule: str
    """Its name in words."""
    outcome: Literal["kept", "broken", "does not apply"]
    text: str
    """What the rule asks, or what is wrong, or why it does not apply."""


def check_backend(make: Make) -> Iterator[Result]:
    """Try every rule of the contract, one after the other, on backends that `make` opens anew.

    A hand moves a little: 0.05 N·m, or a tenth of each joint's range about its middle. Whatever a backend raises where
    the contract allows nothing is a broken rule; only what stops a program (Ctrl-C) passes through.
    """
    for rule in RULES:
        name = rule.__name__.replace("_", " ")
        asked = " ".join((rule.__doc__ or "").split())
        try:
            rule(make)
        except DoesNotApply as reason:
            yield Result(name, "does not apply", str(reason))
        except ContractViolation as error:
            yield Result(name, "broken", str(error))
        except HandError as error:
            yield Result(name, "broken", f"{type(error).__name__}: {error}")
        except Exception as error:  # noqa: BLE001  # A stranger's code may raise anything; the table says what.
            yield Result(name, "broken", f"{type(error).__name__}, which is no HandError: {error}")
        else:
            yield Result(name, "kept", asked)
