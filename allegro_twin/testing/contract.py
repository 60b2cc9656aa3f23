"""The backend contract as a pytest class: subclass it, say how a backend is made, and inherit every test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from allegro_twin.backend import HandBackend
from allegro_twin.testing import rules


class BackendContract:
    """One test for each rule of the backend contract.

    ```python
    class TestMyHand(BackendContract):
        def make(self) -> HandBackend:
            return MyHand("/dev/ttyUSB7")
    ```
    """

    def make(self) -> HandBackend:
        """Open a backend anew. The tests close it."""
        raise NotImplementedError(f"{type(self).__name__} has no method `make` that opens a backend")

    def does_not_apply(self, reason: str) -> None:
        """Skip the test of a rule that has nothing to say of this backend."""
        pytest.skip(f"contract: {reason}")


def _test(rule: rules.Rule) -> Callable[[Any], None]:
    def test(self: BackendContract) -> None:
        try:
            rule(self.make)
        except rules.DoesNotApply as reason:
            self.does_not_apply(str(reason))

    test.__doc__ = rule.__doc__
    return test


for _rule in rules.RULES:
    setattr(BackendContract, f"test_{_rule.__name__}", _test(_rule))
