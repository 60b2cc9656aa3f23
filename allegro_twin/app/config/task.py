"""The task block: what is to be done, whichever hand does it."""

from __future__ import annotations

from allegro_twin.files.schema import PerJoint, Settings


class TaskSettings(Settings):
    """A scenario, or a grasp in the open, or a posture; without any a position controller goes `home`."""

    scenario: str | None = None
    """Name or path: what lies where, how the wrist moves, which grasp. A simulated or virtual hand stands in its scene;
    any other follows its timeline with the fingers."""
    grasp: str | None = None
    """With a scenario: another grasp than the one it names. Without: close this one where the hand is. For a policy
    that has several scripts: which."""
    object: str | None = None
    """With a scenario: another object in place of its first: of the catalogue, or a mesh (.obj, .stl)."""
    posture: str | PerJoint | None = None
    """Where to go, by name or in rad. For a policy that reaches goals: the goal, whose fingertips it is to reach."""
