"""What a search begins with: the pre-shapes of the library, and which way their fingers close."""

from __future__ import annotations

from allegro_twin.errors import ConfigError
from allegro_twin.library.grasps import Grasp
from allegro_twin.library.library import Library
from allegro_twin.plan.poses import closing_of
from allegro_twin.spec import HandSpec

FEWEST = 3
"""Joints that a template closes; all, of a hand with fewer."""


def templates(spec: HandSpec, taxonomy: int | str | None = None) -> list[Grasp]:
    """All of the library that close on something, or those of a type of the taxonomy. Raises ConfigError where there is
    none."""
    library = Library()
    listed = library.list(kind="grasp", taxonomy=taxonomy, hand=spec)
    found = [library.grasp(each.name, spec) for each in listed]
    fewest = min(FEWEST, spec.n_joints)
    closing = [grasp for grasp in found if grasp.grip is None and (closing_of(grasp) != 0.0).sum() >= fewest]
    if not closing:
        raise ConfigError(f"the library has no grasp of type {taxonomy!r} that closes the fingers of {spec.name}")
    return closing
