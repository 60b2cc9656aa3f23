"""One trial: a scenario made ready for the loop, watched, and judged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.control.trajectory import Moves
from allegro_twin.errors import ConfigError, HandError
from allegro_twin.grasping.grasp_type import GraspObservation, ObjectShape, SurfaceLoad, classify_grasp
from allegro_twin.grasping.scenario import (
    Scenario,
    TrialProtocol,
    load_protocol,
    load_scenario_for,
    scenario_protocol,
    skew_warning,
)
from allegro_twin.grasping.timeline import first_posture, make_stage, make_timeline, with_push_phases
from allegro_twin.grasping.uncertainty import Perturbation
from allegro_twin.grasping.verdict import FULL, Observations, PhaseWindow, Rule, TrialReport, judge
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.taxonomy import ObservedType
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.sim.contact.contact_surfaces import SURFACES, BodyPlaces, SurfaceForces, SurfaceProbe, box_edges
from allegro_twin.sim.contact.initial_overlap import check_objects_apart
from allegro_twin.sim.contact.probe import ObjectProbe
from allegro_twin.sim.engine.backend import Push, SimBackend
from allegro_twin.sim.model.appearance import scene_appearance
from allegro_twin.sim.model.compiled_scenes import CompiledScenes
from allegro_twin.sim.model.wrist import STIFF_WRIST, wrist_load, wrist_set_points
from allegro_twin.sim.objects.catalogue import PlacedObject
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, HandState, Sample, Vector

PRESSED, PRESSED_WEIGHTS = 20.0, 3.0
"""N, and weights of the object, from which on a hand that presses on object and table is told so: those of the package
press with up to 17 N."""


class Trial:
    """A simulated hand at a scenario, and what is seen of it.

    `start` are the joint positions at reset, (n,), rad; by default those in which the hand acts first. `protocol` takes
    the place of the scenario's; `draw` is what the hand is not told. `scenes`: where trials of one scene share the work
    of compiling it. `typed`: whether the type that its contacts show is asked for, which costs a tenth of `fc`.
    """

    def __init__(
        self,
        scenario: Scenario,
        spec: HandSpec,
        grasp: Grasp,
        *,
        folder: Path = Path(),
        period: float = 0.003,
        start: Vector | None = None,
        protocol: TrialProtocol | None = None,
        draw: Perturbation | None = None,
        scenes: CompiledScenes | None = None,
        typed: bool = True,
    ) -> None:
        self.scenario, self.grasp, self.draw = scenario, grasp, draw
        self.protocol = with_push_phases(protocol or load_protocol(scenario.protocol), scenario)
        scene = make_stage(scenario, self.protocol, spec.side, folder)
        scene = replace(scene, physics=scene.physics.for_hand(spec, period))
        if draw is not None:
            scene = draw.on(scene, self.protocol.physics.friction)
        self.objects: tuple[PlacedObject, ...] = tuple(scene.objects)
        posture = first_posture(self.protocol, grasp, spec) if start is None else start
        timeline = make_timeline(self.protocol, grasp, scenario, posture, spec, period)
        self.windows: tuple[PhaseWindow, ...] = timeline.windows
        self.reference: Moves = timeline.reference
        self.seconds = timeline.seconds
        before = zip(timeline.segments, self.windows, strict=True)
        self._told = sum(float(segment.move[2]) for segment, window in before if window.end <= self.begin + 1e-9)
        model = (scenes or CompiledScenes(spec)).model(scene)
        if draw is None and len(scene.objects) > 1:
            check_objects_apart(model, [each.grasp_object.name for each in scene.objects])
        if draw is not None:
            motors = [model.actuator(joint).id for joint in spec.joints]
            if "torque" in spec.commands:
                model.actuator_gear[motors, 0] *= draw.torque
            else:
                model.actuator_forcerange[motors] *= draw.torque
        physics, name = scene.physics, scenario.objects[0].name
        drive = wrist_set_points(timeline.segments, physics.timestep, wrist_load(model), -physics.gravity[2])
        push = Push(name, timeline.push * float(model.body_mass[model.body(name).id]))
        self.backend = SimBackend(spec, model, period=period, posture=posture, drive=drive, pushing=push)
        self._probe = ObjectProbe(model, self.backend.data, spec, name)
        self._surfaces, self._borne = SurfaceProbe(model, spec, name), list[SurfaceForces]()
        self._stood: BodyPlaces | None = None
        self._holding = next((window for window in self.windows if window.check), None) if typed else None
        limits = self.protocol.success
        lift = sum(max(phase.move[2], 0.0) for phase in self.protocol.after_reference)
        self.rule = Rule(self.protocol.reference, limits.drift, limits.rotation, float(lift), limits.throughout)
        self._weight, self._push = self.mass * float(np.linalg.norm(physics.gravity)), float(np.abs(push.force).max())
        self._rows: list[tuple[float, Vector, Mapping[str, Array]]] = []
        self.pressing = float("nan")
        """With how much the hand presses on object and table when the reference ends, N; NaN before the verdict, and
        without a table."""

    @property
    def mass(self) -> float:
        """Mass of the object to grasp, kg."""
        return self.backend.mass_of(self.scenario.objects[0].name)

    def warnings(self) -> list[str]:
        """What speaks against a success, with its numbers."""
        friction = self.scenario.friction * self.protocol.physics.friction
        said = weight_warning(self._weight, self.grasp, self.backend.spec, friction)
        return [line for line in (said, skew_warning(self.scenario.wrist)) if line is not None]

    def remarks(self) -> list[str]:
        """What the verdict does not weigh and a person should know; empty before the verdict. Part of the reason of
        what is not held."""
        if not (self.pressing > PRESSED and self.pressing > PRESSED_WEIGHTS * self._weight):
            return []
        return [
            f"at the end of {self.protocol.reference} the hand presses on object and table with {self.pressing:.0f} N "
            f"(the object weighs {self._weight:.1f} N): raise wrist.position"
        ]

    @property
    def typed(self) -> bool:
        """Whether the type that its contacts show is asked for."""
        return self._holding is not None

    @property
    def begin(self) -> float:
        """From when on motion in the hand counts, s."""
        return next(window.end for window in self.windows if window.name == self.protocol.reference)

    def begin_of(self, stage: str) -> float:
        """When the hand begins to `close` or to `squeeze`, s. Raises ConfigError when the protocol never does."""
        for phase, window in zip(self.protocol.phases, self.windows, strict=True):
            if phase.hand == stage:
                return window.begin
        raise ConfigError(f"protocol {self.scenario.protocol}: no phase lets the hand {stage}")

    def latest(self) -> Mapping[str, Array]:
        """What the probe saw with the last sample that was watched."""
        return self._rows[-1][2]

    def watched(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """A stage that keeps what the verdict needs."""
        for sample in samples:
            self.see(sample.state)
            yield sample

    def see(self, state: HandState) -> None:
        """Keep what the verdict needs of one moment; a session's first state begins anew."""
        if state.tick == 0:
            self._rows.clear()
            self._borne.clear()
        self.feel(state.t, self.backend.data)
        self._rows.append((state.t, state.torque, self._probe()))

    def feel(self, t: float, data: Any) -> None:
        """Keep what carries, in the first phase that checks; `data`: MuJoCo's of this trial at `t` s."""
        if self._holding is not None and self._holding.begin < t <= self._holding.end + 1e-9:
            self._borne.append(self._surfaces(data))
            self._stood = BodyPlaces.of(data)

    def observed_type(self) -> ObservedType | None:
        """The type of grasp that its contacts showed on average over that phase; None before it."""
        if not self._borne or self._stood is None or not self.backend.spec.fingers:
            return None
        force, normal, _ = (np.mean([each[k] for each in self._borne], axis=0) for k in range(3))
        stance = self._surfaces.stance(self._stood)
        names = [finger.name for finger in self.backend.spec.fingers]
        thumb = next((name for name in names if "thumb" in name.lower() or name.lower() == "th"), None)
        up = (
            0.0
            if thumb is None
            else float(np.degrees(np.arcsin(np.clip(stance.direction[names.index(thumb), 0], -1, 1))))
        )
        bearings = [
            SurfaceLoad(part, surface, float(force[p, k]), tuple((normal[p, k] / force[p, k]).tolist()))
            for p, part in enumerate(self._surfaces.parts)
            for k, surface in enumerate(SURFACES)
            if force[p, k] > 0.0
        ]
        fingers = tuple(name for name in names if name != thumb)
        reach = max((float(stance.length[k]) for k, name in enumerate(names) if name != thumb), default=1.0)
        straight = dict(zip(names, stance.straight.tolist(), strict=True))
        return classify_grasp(
            GraspObservation(bearings, fingers, self._shape(), thumb, 90.0 if thumb is None else up, straight, reach)
        )

    def _shape(self) -> ObjectShape:
        grasp_object = self.objects[0].grasp_object
        box = (
            box_edges(self.backend.model, grasp_object.name)
            if grasp_object.shape == "mjcf"
            else 2.0 * grasp_object.half_extents()
        )
        short, middle, long = sorted(box.tolist())
        fill = {"sphere": np.pi / 6, "ellipsoid": np.pi / 6, "cylinder": np.pi / 4}.get(grasp_object.shape, 1.0)
        if grasp_object.shape == "mesh":
            fill = grasp_object.mesh().volume / float(np.prod(box))
        return ObjectShape(short, middle, long, float(fill))

    def report(self) -> TrialReport:
        """The verdict. Raises HandError when the trial was not run to its end."""
        if not self._rows or self._rows[-1][0] < self.seconds - 1e-9:
            raise HandError(f"the trial ended before its {self.seconds:.1f} s: there is no verdict")
        t, torque, observations = zip(*self._rows, strict=True)
        columns = {key: np.array([row[key] for row in observations]) for key in observations[0]}
        return self.judged(
            Observations(
                np.array(t),
                columns["palm"],
                columns["object"],
                columns["contact_force"],
                columns["on_table"][:, 0],
                columns["contacts"][:, 0],
                columns["penetration"][:, 0],
                np.array(torque),
            )
        )

    def judged(self, observations: Observations) -> TrialReport:
        """The verdict on what was observed of this trial."""
        spec = self.backend.spec
        report = judge(
            observations, self.windows, self.rule,
            parts=self._probe.parts, joints=spec.joint_labels, torque_limit=spec.actuation.torque_limit,
        )  # fmt: skip
        report = replace(report, observed=self.observed_type())
        self.pressing = self._pressing(observations)
        return report if report.held else replace(report, reason="; ".join([report.reason, *self._loads(observations)]))

    def _pressing(self, observations: Observations) -> float:
        """By how much the palm is above where the wrist is told to be, times the wrist's stiffness, N."""
        if self.protocol.floating:
            return float("nan")
        start, end = (int(np.searchsorted(observations.t, t + 1e-9, side="right")) - 1 for t in (0.0, self.begin))
        up = float(observations.palm[end, 2] - observations.palm[start, 2])
        return float(STIFF_WRIST.stiffness[2]) * (up - self._told)

    def _loads(self, observations: Observations) -> list[str]:
        """What the hand had to carry, and which joints had no more to give up to the first check."""
        limit = self.backend.spec.actuation.torque_limit
        begin = self.begin
        end = next((w.end for w in self.windows if w.check), self.seconds)
        share = (np.abs(observations.torque[(observations.t > begin) & (observations.t <= end)]) >= FULL * limit).mean(
            axis=0
        )
        full = [name for name, part in zip(self.backend.spec.joint_labels, share, strict=True) if part > 0.5]
        loads = [("it weighs", self._weight), ("it is pushed with", self._push)]
        said = [f"{what} {newtons:.1f} N" for what, newtons in loads if newtons > 0.0]
        said += self.remarks()
        return [*said, f"{', '.join(full)} at their torque limit"] if full else said

    def meta(self) -> dict[str, object]:
        """What a recording should say of the scene."""
        objects = [
            {"name": each.name, "shape": each.shape, "size": list(each.size), "mass": each.mass}
            for each in (placed.grasp_object for placed in self.objects)
        ]
        return {
            "protocol": f"{self.scenario.protocol} {self.protocol.version}",
            "grasp": self.grasp.name,
            "objects": objects,
            "phases": [[w.name, w.begin, w.end] for w in self.windows],
            "judged": {"windows": [[w.name, w.begin, w.end, w.check] for w in self.windows]} | asdict(self.rule),
            "look": scene_appearance(
                self.backend.model, self.backend.spec, tuple(placed.grasp_object.name for placed in self.objects)
            ),
        }


def weight_warning(weight: float, grasp: Grasp, spec: HandSpec, friction: float) -> str | None:
    """A warning for an object whose weight, N, friction cannot carry: every finger presses it against the palm or
    another finger, so that at most 2 µ Σ F holds it up, with F what each fingertip can press at the closed posture."""
    forces = hand_kinematics(spec).fingertip_force(grasp.close, spec.actuation.torque_limit)
    bound = 2.0 * friction * sum(forces.values())
    if weight <= bound:
        return None
    return (
        f"the object weighs {weight:.1f} N; friction {friction:g} and the torque limits hold at most "
        f"{bound:.1f} N with {grasp.name} (fingertips press {', '.join(f'{n} {f:.1f} N' for n, f in forces.items())})"
    )


def make_trial(
    scenario: str,
    spec: HandSpec,
    period: float = 0.003,
    start: Vector | None = None,
    *,
    grasp: str | None = None,
    object_name: str | None = None,
) -> Trial:
    """A scenario by name or path, ready to run with this hand; with another grasp, or another object of the catalogue
    in place of its first, if they are named. Raises ConfigError."""
    settings, path, chosen = load_scenario_for(scenario, spec, grasp=grasp, object_name=object_name)
    protocol = scenario_protocol(settings, path)
    return Trial(settings, spec, chosen, folder=path.parent, period=period, start=start, protocol=protocol)
