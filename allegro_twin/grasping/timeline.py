"""From a scenario to what the simulator needs: the scene, the wrist's motion, the grasp's timeline."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from allegro_twin.control.trajectory import Moves, Waypoint, travel_time
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.scenario import Phase, Scenario, ScenarioObject, TrialProtocol
from allegro_twin.grasping.verdict import PhaseWindow
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.orientation import matrix_facing, mirror_quaternion, quaternion_from_matrix
from allegro_twin.sim.model.scene import Stage
from allegro_twin.sim.model.wrist import WristSegment
from allegro_twin.sim.objects.catalogue import (
    SIZES_OF_KIND,
    GraspObject,
    PlacedObject,
    load_object,
    standing_orientation,
)
from allegro_twin.spec import Side
from allegro_twin.types import Array, Vector

# What the mirror in the world's x-z plane does to the wrist's six coordinates: slides along x, y, z, and turns, which
# are pseudovectors, about the palm's x, y, z.
DENSITY = 500.0  # kg/m³ of a mesh whose mass nobody says: between a hollow thing of plastic and a solid one. Assumed.
_MIRROR = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class TrialTimeline:
    """One trial on the clock: hand and wrist act by the same timeline."""

    windows: tuple[PhaseWindow, ...]
    reference: Moves
    """What the fingers follow."""
    segments: list[WristSegment]
    """What the wrist does."""
    push: Array
    """What accelerates the object from outside in every control period, (periods, 3), m/s², world."""

    @property
    def seconds(self) -> float:
        return self.windows[-1].end


def make_timeline(
    protocol: TrialProtocol, grasp: Grasp, scenario: Scenario, start: Vector, side: Side, period: float
) -> TrialTimeline:
    """Time every phase in whole control periods, beginning with the hand at `start` (n,), rad."""
    windows, waypoints, segments, pushes = [], [], [], []
    posture, t = start, 0.0
    for phase in protocol.phases:
        waypoint = Waypoint(posture, seconds=phase.seconds)
        if phase.hand is not None:
            waypoint = grasp.waypoint(phase.hand, phase.seconds)
        seconds = max(round(travel_time(posture, waypoint) / period), 1) * period
        posture = waypoint.posture
        waypoints.append(replace(waypoint, seconds=seconds, profile=grasp.profile))
        segments.append(_segment(phase, seconds, scenario, side))
        windows.append(PhaseWindow(phase.name, t, t + seconds, phase.check))
        pushes.append(np.tile(_on_side(phase.push, side), (round(seconds / period), 1)))
        t += seconds
    return TrialTimeline(tuple(windows), Moves(waypoints), segments, np.concatenate(pushes))


def make_stage(scenario: Scenario, protocol: TrialProtocol, side: Side, folder: Path) -> Stage:
    """The table, the objects on it, and the hand where its approach begins."""
    things = [place_object(settings, folder) for settings in scenario.objects]
    offset = np.array(scenario.wrist.position)
    if scenario.wrist.over is not None:
        half = _half_height(scenario.objects[0], things[0].thing)
        offset[2] = max(scenario.wrist.over.table, 2 * half + scenario.wrist.over.top) - half
    stand = None
    if scenario.stand is not None:
        x, y, z = things[0].position
        things[0] = replace(things[0], position=(x, y, z + scenario.stand.height))
        stand = (x, y, *scenario.stand.size, scenario.stand.height)
    position = np.add(things[0].position, offset)
    if any(phase.wrist == "approach" for phase in protocol.phases):
        position = position + scenario.wrist.retreat
    rotation = matrix_facing(scenario.wrist.facing, scenario.wrist.fingers)
    if side == "left":
        things = [_mirrored(thing) for thing in things]
        mirror = np.diag([1.0, -1.0, 1.0])
        stand = stand and (stand[0], -stand[1], *stand[2:])
        position, rotation = mirror @ position, mirror @ rotation @ mirror
    if protocol.mass is not None:
        things[0] = replace(things[0], thing=replace(things[0].thing, mass=protocol.mass))
    friction = (protocol.friction or scenario.friction) * protocol.physics.friction
    return Stage(
        position, quaternion_from_matrix(rotation), things, friction, table=not protocol.floating, wrist=True,
        stand=None if protocol.floating else stand, physics=protocol.physics.physics(),
    )  # fmt: skip


def _on_side(vector: tuple[float, float, float], side: Side) -> Vector:
    """A vector of the world, seen in the mirror for a left hand."""
    return np.array(vector) * (_MIRROR[:3] if side == "left" else 1.0)


def _segment(phase: Phase, seconds: float, scenario: Scenario, side: Side) -> WristSegment:
    move = np.concatenate([phase.move, np.radians(phase.turn)])
    if phase.wrist == "approach":
        move[:3] -= scenario.wrist.retreat
    if side == "left":
        move = move * _MIRROR
    shake = np.zeros(6)
    if phase.shake is None:
        return WristSegment(seconds, move, shake)
    shake[:3] = phase.shake.acceleration
    return WristSegment(seconds, move, shake, phase.shake.frequency)


def place_object(settings: ScenarioObject, folder: Path = Path()) -> PlacedObject:
    """An object where its settings put it, on the table unless they say a height. `folder`: where its own file is
    looked for. Raises ConfigError for what its shape needs and does not have."""
    if settings.shape is None:
        thing = load_object(settings.name)
    else:
        thing = _own(settings, folder)
    turned = standing_orientation(settings.up, float(np.radians(settings.yaw)))
    if len(settings.at) == 3:
        position = settings.at
    else:
        # 0.1 mm of air, so that the object settles instead of being pushed out of the table.
        height = _half_height(settings, thing) + 1e-4
        position = (*settings.at, height)
    return PlacedObject(thing, position, tuple(turned))


def _half_height(settings: ScenarioObject, thing: GraspObject) -> float:
    """From the table to the middle of an object as it stands, m."""
    return float(thing.half_extents()["xyz".index(settings.up)])


def _own(settings: ScenarioObject, folder: Path) -> GraspObject:
    """An object described in the scenario itself. Raises ConfigError for what its shape needs and does not have."""
    name, shape = settings.name, settings.shape
    assert shape is not None
    if shape in ("mesh", "mjcf"):
        if settings.file is None:
            raise ConfigError(f"object {name}: a {shape} needs `file`")
        file = settings.file if settings.file.is_absolute() else folder / settings.file
        if not file.is_file():
            raise ConfigError(f"object {name}: no file at {file}")
        if len(settings.at) != 3 and shape == "mjcf":
            raise ConfigError(f"object {name}: a {shape} needs a third value in `at`: the height of its origin, m")
    else:
        file = None
        if settings.size is None or len(settings.size) != SIZES_OF_KIND[shape]:
            raise ConfigError(f"object {name}: a {shape} needs `size` with {SIZES_OF_KIND[shape]} values, m")
    if settings.mass is None and shape not in ("mjcf", "mesh"):
        raise ConfigError(f"object {name}: a {shape} needs `mass`, kg")
    mass = settings.mass or float("nan")
    thing = GraspObject(name, shape, settings.size or (), mass, file, settings.scale, settings.collision)
    if shape == "mesh" and settings.mass is None:
        thing = replace(thing, mass=DENSITY * thing.mesh().volume)
    return thing


def _mirrored(placement: PlacedObject) -> PlacedObject:
    x, y, z = placement.position
    w, i, j, k = mirror_quaternion(placement.quaternion).tolist()
    return PlacedObject(placement.thing, (x, -y, z), (w, i, j, k))
