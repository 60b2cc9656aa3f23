"""Tests that every backend passes, for backends of your own: pytest classes, and a check that prints a table."""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.testing.check import Result, check_backend
    from allegro_twin.testing.contract import BackendContract
    from allegro_twin.testing.rules import ContractViolation, DoesNotApply

__all__ = ["BackendContract", "ContractViolation", "DoesNotApply", "Result", "check_backend"]
__getattr__, __dir__ = exports(
    __name__,
    {
        "check": ("Result", "check_backend"),
        "contract": ("BackendContract",),
        "rules": ("ContractViolation", "DoesNotApply"),
    },
)
