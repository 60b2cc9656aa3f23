"""Errors say what they said where they were raised, in another process too."""

from __future__ import annotations

import ast
import importlib
import pickle

import numpy as np
import pytest

from allegro_twin.errors import ArmReflex, HandError, unknown
from allegro_twin.types import Sample, TorqueCommand
from tests.test_architecture import MODULES, PACKAGE, parsed
from tests.test_safety import state

ARGUMENTS = {"ArmReflex": ("cartesian_reflex: 41 N", "cartesian_reflex", (0.0, 0.0, 41.0, 0.0, 0.0, 0.0))}


def error_classes() -> list[tuple[str, str]]:
    """Module and name of every class of an error in the package."""
    return [
        (".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts), each.name)
        for path in MODULES
        for each in ast.walk(parsed(path))
        if isinstance(each, ast.ClassDef)
        and any(ast.unparse(base).endswith(("Error", "Exception", "Fault")) for base in each.bases)
    ]


@pytest.mark.parametrize(("module", "name"), error_classes())
def test_every_error_crosses_the_border_of_a_process_with_all_that_it_says(module: str, name: str) -> None:
    kind = getattr(importlib.import_module(module), name)
    assert issubclass(kind, BaseException)
    error = kind(*ARGUMENTS.get(name, ("no report from ring",)))
    error.add_note("the hand may not be limp")
    if isinstance(error, HandError):
        error.history = (Sample(state(3), TorqueCommand(np.ones(16))),)
    found = pickle.loads(pickle.dumps(error))
    assert type(found) is kind
    assert str(found) == str(error)
    assert found.__notes__ == ["the hand may not be limp"]
    if isinstance(error, HandError):
        assert isinstance(found, HandError)
        np.testing.assert_array_equal(found.history[0].command.torque, np.ones(16))
    if isinstance(error, ArmReflex):
        assert isinstance(found, ArmReflex)
        assert (found.name, found.wrench) == (error.name, error.wrench)


def test_an_unknown_name_among_many_is_answered_with_those_that_are_least_unlike_it() -> None:
    many = [f"grasp_{k}" for k in range(99)] + ["zebra"]
    said = unknown("grasp", "zzzbzz", many)
    assert said.startswith("no grasp named 'zzzbzz'; there are 100, among them zebra, ")
    assert said.count(",") == 8
    assert unknown("hand", "shadow", ["leap", "sih"]) == "no hand named 'shadow'; there are: leap, sih"
