"""Templates of a search: the pre-shapes of the library and the closing directions of their fingers."""

from __future__ import annotations

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.plan.candidate import check_stiffness
from allegro_twin.grasping.plan.proposals.opposition import opposing_grasps
from allegro_twin.grasping.plan.proposals.poses import closing_directions
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import Library
from allegro_twin.spec import HandSpec

FEWEST = 3
"""Joints that a template closes; all, of a hand with fewer."""


def grasp_templates(spec: HandSpec, taxonomy: int | str | None = None) -> list[Grasp]:
    """All of the library that close on something, or those of a type of the taxonomy where there are any: only the
    contacts tell of which type is what comes of them. For a hand of which the library has none at all, those in which
    its fingertips oppose each other. Raises ConfigError for what is no type, for a hand that cannot plan, and where
    nothing closes."""
    check_stiffness(spec)
    library = Library()
    listed = library.list(kind="grasp", taxonomy=taxonomy, hand=spec)
    if taxonomy is not None:
        of_type = [library.grasp(each.name, spec) for each in listed]
        return [grasp for grasp in of_type if _closes(grasp, spec)] or grasp_templates(spec)
    found = [library.grasp(each.name, spec) for each in listed]
    closing = [grasp for grasp in found if _closes(grasp, spec)]
    if not closing and not found:
        return list(opposing_grasps(spec))
    if not closing:
        raise ConfigError(f"the library has no grasp that closes the fingers of {spec.name}")
    return closing


def _closes(grasp: Grasp, spec: HandSpec) -> bool:
    """Whether it closes joints by position, and enough of them."""
    return grasp.grip is None and int((closing_directions(grasp, spec) != 0.0).sum()) >= min(FEWEST, spec.n_joints)
