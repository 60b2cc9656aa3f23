"""Trial timeline: the scene, the wrist's motion and the grasp's phases that a scenario asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.control.trajectory import Moves, Waypoint, travel_time
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.scenario import (
    Phase,
    Scenario,
    ScenarioObject,
    TrialProtocol,
    as_written,
    check_object_names,
)
from allegro_twin.grasping.verdict import PhaseWindow
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.orientation import matrix_facing, quaternion_from_matrix
from allegro_twin.sim.model.scene import TABLE_END, Stage
from allegro_twin.sim.model.wrist import WristSegment, wrist_angles
from allegro_twin.sim.objects.catalogue import (
    GraspObject,
    PlacedObject,
    load_object,
    standing_orientation,
)
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Array, Vector

DENSITY = 500.0  # kg/m³ of a mesh whose mass nobody says: between a hollow thing of plastic and a solid one. Assumed.
_DENSEST = 25_000.0  # kg/m³; osmium has 22,590.
_LIGHTEST = 5.0  # kg/m³; melamine foam, of the lightest that are sold, has 8 to 11 (BASF Basotect).
_PART_OF_BOX = {"sphere": np.pi / 6, "cylinder": np.pi / 4, "ellipsoid": np.pi / 6, "box": 1.0}
_MIRROR = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
"""What the mirror in the world's x-z plane does to the wrist's six coordinates: slides along x, y, z, and turns, which
are pseudovectors, about the palm's x, y, z."""
PUSHED = "push"
"""The window at whose end the object is over the table's edge."""
BACK, BESIDE = 0.02, 0.10
"""m: by which fingers leave what they have pushed, and from where the approach begins that the palm comes down."""
SWIFT, TURNED, SHORTEST = 0.25, 0.15, 0.2
"""m/s of the palm on average where it pushes nothing; the radius, m, with which a turn counts as a way; s."""


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
    protocol: TrialProtocol, grasp: Grasp, scenario: Scenario, start: Vector, spec: HandSpec, period: float
) -> TrialTimeline:
    """Time every phase in whole control periods, beginning with the hand at `start` (n,), rad."""
    windows, waypoints, segments, pushes = [], [], [], []
    posture, t = start, 0.0
    for phase in protocol.phases:
        waypoint = Waypoint(posture, seconds=phase.seconds)
        if phase.hand is not None:
            waypoint = grasp.waypoint(phase.hand, phase.seconds)
        elif phase.posture is not None:
            waypoint = Waypoint(_posture(phase.posture, spec), seconds=phase.seconds)
        seconds = max(round(travel_time(posture, waypoint) / period), 1) * period
        posture = waypoint.posture
        waypoints.append(replace(waypoint, seconds=seconds, profile=grasp.profile))
        segments.append(_segment(phase, seconds, scenario, spec.side))
        windows.append(PhaseWindow(phase.name, t, t + seconds, phase.check))
        pushes.append(np.tile(as_written(spec.side) * phase.push, (round(seconds / period), 1)))
        t += seconds
    return TrialTimeline(tuple(windows), Moves(waypoints), segments, np.concatenate(pushes))


def first_posture(protocol: TrialProtocol, grasp: Grasp, spec: HandSpec) -> Vector:
    """In which the hand acts first, (n,), rad: that of the first phase with one of its own, or open for the grasp."""
    acts = next((phase for phase in protocol.phases if phase.hand is not None or phase.posture is not None), None)
    return grasp.preshape if acts is None or acts.posture is None else _posture(acts.posture, spec)


def _posture(joints: Sequence[float], spec: HandSpec) -> Vector:
    """Posture of the right hand's joints on the spec's side, (n,), rad. Raises ConfigError for another number of
    them."""
    posture = np.array(joints)
    if posture.shape != (spec.n_joints,):
        raise ConfigError(f"posture: {len(posture)} joints; {spec.name} has {spec.n_joints}")
    return posture if spec.side == "right" else spec.mirror_posture(posture)


def with_push_phases(protocol: TrialProtocol, scenario: Scenario) -> TrialProtocol:
    """The protocol with the scenario's push before its approach: down behind the object, along, back and up, over to
    the grasp, and beside where its approach begins. Itself, where there is no push or no approach."""
    push, names = scenario.push, [phase.wrist for phase in protocol.phases]
    if push is None or not _approaches(protocol):
        return protocol
    begin, first = np.array(push.wrist.position), matrix_facing(push.wrist.facing, push.wrist.fingers)
    turn = wrist_angles(first.T @ matrix_facing(scenario.wrist.facing, scenario.wrist.fingers))
    retreat = np.array(scenario.wrist.retreat)
    goal = np.array(scenario.wrist.position) + retreat
    beside = goal + BESIDE * retreat / max(float(np.linalg.norm(retreat)), 1e-9)
    pushed = np.add(begin, (push.distance, 0.0, 0.0))
    back = pushed - (BACK, 0.0, 0.0)
    up = back + push.wrist.retreat
    over = np.array([*beside[:2], max(beside[2], up[2])])

    def moved(name: str, here: Array, there: Array, speed: float = SWIFT, **more: Any) -> Phase:
        far = max(float(np.linalg.norm(there - here)), TURNED * float(np.abs(np.radians(more.get("turn", 0.0))).max()))
        return Phase(name=name, seconds=max(far / speed, SHORTEST), move=tuple((there - here).tolist()), **more)

    phases = (
        moved("push_down", begin + push.wrist.retreat, begin, posture=push.posture),
        moved(PUSHED, begin, pushed, push.speed),
        moved("push_back", pushed, back),
        moved("push_up", back, up),
        moved("push_over", up, over, hand="preshape", turn=tuple(np.degrees(turn).tolist())),
        moved("push_beside", over, beside),
        moved("push_ready", beside, goal),
    )
    at = names.index("approach")
    return protocol.model_copy(update={"phases": (*protocol.phases[:at], *phases, *protocol.phases[at:])})


def pushed_until(windows: Sequence[PhaseWindow]) -> float:
    """When the object lies where it was pushed to, s."""
    return next(window.end for window in windows if window.name == "push_up")


def _approaches(protocol: TrialProtocol) -> bool:
    return not protocol.floating and any(phase.wrist == "approach" for phase in protocol.phases)


def make_stage(scenario: Scenario, protocol: TrialProtocol, side: Side, folder: Path) -> Stage:
    """The table, the objects on it, and the hand where its approach begins."""
    check_object_names(scenario.objects)  # Another object may have been put in the place of the first.
    objects = [place_object(settings, folder) for settings in scenario.objects]
    offset = np.array(scenario.wrist.position)
    if scenario.wrist.over is not None:
        half = _half_height(scenario.objects[0], objects[0].grasp_object)
        offset[2] = max(scenario.wrist.over.table, 2 * half + scenario.wrist.over.top) - half
    stand = None
    if scenario.stand is not None:
        x, y, z = objects[0].position
        objects[0] = replace(objects[0], position=(x, y, z + scenario.stand.height))
        stand = (x, y, *scenario.stand.size, scenario.stand.height)
    wrist, edge = scenario.wrist, TABLE_END
    if scenario.push is not None and _approaches(protocol):
        wrist, offset = scenario.push.wrist, np.array(scenario.push.wrist.position)
    if scenario.edge is not None:
        edge = objects[0].position[0] + scenario.edge
    position = np.add(objects[0].position, offset)
    if any(phase.wrist == "approach" for phase in protocol.phases):
        position = position + wrist.retreat
    rotation = matrix_facing(wrist.facing, wrist.fingers)
    if side == "left":
        objects = [_mirrored(placed, own) for placed, own in zip(objects, scenario.objects, strict=True)]
        mirror = np.diag(as_written(side))
        stand = stand and (stand[0], -stand[1], *stand[2:])
        position, rotation = mirror @ position, mirror @ rotation @ mirror
    if protocol.mass is not None:
        if objects[0].grasp_object.shape == "mjcf":
            raise ConfigError(
                f"object {objects[0].grasp_object.name}: an MJCF brings its own mass, and the protocol asks for "
                f"{protocol.mass:g} kg: give the file that mass and take a protocol without `mass`"
            )
        objects[0] = replace(objects[0], grasp_object=replace(objects[0].grasp_object, mass=protocol.mass))
    friction = (protocol.friction or scenario.friction) * protocol.physics.friction
    physics = protocol.physics.physics()
    x, y, z = (as_written(side) * physics.gravity + 0.0).tolist()  # No zero becomes -0.
    return Stage(
        position, quaternion_from_matrix(rotation), objects, friction, not protocol.floating, edge, wrist=True,
        stand=None if protocol.floating else stand, physics=replace(physics, gravity=(x, y, z)),
    )  # fmt: skip


def _segment(phase: Phase, seconds: float, scenario: Scenario, side: Side) -> WristSegment:
    move = np.concatenate([phase.move, np.radians(phase.turn)])
    if phase.wrist == "approach":
        move[:3] -= scenario.wrist.retreat
    mirror = _MIRROR if side == "left" else np.ones(6)
    move, shake = move * mirror, np.zeros(6)
    if phase.shake is None:
        return WristSegment(seconds, move, shake)
    shake[:3] = phase.shake.acceleration
    return WristSegment(seconds, move, shake * mirror, phase.shake.frequency)


def place_object(settings: ScenarioObject, folder: Path = Path()) -> PlacedObject:
    """An object where its settings put it, on the table unless they say a height. `folder`: where its own file is
    looked for. Raises ConfigError where there is none, and for a mass that no solid has."""
    if settings.shape is None:
        grasp_object = load_object(settings.name)
        if settings.mass is not None:
            grasp_object = replace(grasp_object, mass=settings.mass)
    else:
        grasp_object = _own(settings, folder)
    if settings.mass is not None:
        _check_density(grasp_object)
    turned = standing_orientation(settings.up, float(np.radians(settings.yaw)))
    if len(settings.at) == 3:
        position = settings.at
    else:
        # 0.1 mm of air, so that the object settles instead of being pushed out of the table.
        height = _half_height(settings, grasp_object) + 1e-4
        position = (*settings.at, height)
    return PlacedObject(grasp_object, position, tuple(turned))


def _half_height(settings: ScenarioObject, grasp_object: GraspObject) -> float:
    """From the table to the middle of an object as it stands, m."""
    return float(grasp_object.half_extents()["xyz".index(settings.up)])


def _own(settings: ScenarioObject, folder: Path) -> GraspObject:
    """An object described in the scenario itself. Raises ConfigError where its file is missing."""
    name, shape, file = settings.name, settings.shape, settings.file
    assert shape is not None
    if file is not None:
        file = file if file.is_absolute() else folder / file
        if not file.is_file():
            raise ConfigError(f"object {name}: no file at {file}")
    mass = settings.mass or float("nan")
    grasp_object = GraspObject(name, shape, settings.size or (), mass, file, settings.scale, settings.collision)
    if shape == "mesh" and settings.mass is None:
        grasp_object = replace(grasp_object, mass=DENSITY * grasp_object.mesh().volume)
    return grasp_object


def _check_density(grasp_object: GraspObject) -> None:
    """Raises ConfigError for a mass that no solid of that size has."""
    box = float(np.prod(2.0 * grasp_object.half_extents()))
    mass = grasp_object.mass
    volume = grasp_object.mesh().volume if grasp_object.shape == "mesh" else _PART_OF_BOX[grasp_object.shape] * box
    if mass > _DENSEST * volume:
        raise ConfigError(
            f"object {grasp_object.name}: {mass:g} kg in {1e6 * volume:.3g} cm³ is {mass / volume:,.0f} kg/m³, "
            f"denser than any metal: masses are in kg; if this is in g, say {mass / 1e3:g}"
        )
    if mass < _LIGHTEST * volume:
        raise ConfigError(
            f"object {grasp_object.name}: {mass:g} kg in {1e6 * volume:.3g} cm³ is {mass / volume:.2g} kg/m³, lighter "
            f"than any foam: masses are in kg; if this is in t, say {mass * 1e3:g}"
        )


def _mirrored(placement: PlacedObject, settings: ScenarioObject) -> PlacedObject:
    """Its place and its yaw in the mirror: the same axis points up, and a shape stays what it is."""
    x, y, z = placement.position
    turned = standing_orientation(settings.up, -float(np.radians(settings.yaw)))
    return PlacedObject(placement.grasp_object, (x, -y, z), tuple(turned))
