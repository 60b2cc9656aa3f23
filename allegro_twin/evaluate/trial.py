"""One trial: a scenario made ready for the loop, watched, and judged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from allegro_twin.control.trajectory import Moves
from allegro_twin.errors import ConfigError, HandError
from allegro_twin.evaluate.held import FULL, Observations, Report, Rule, Window, judge
from allegro_twin.evaluate.scenario import Protocol, Scenario, load_protocol
from allegro_twin.evaluate.timeline import plan, stage
from allegro_twin.evaluate.uncertainty import Draw
from allegro_twin.library.grasps import Grasp
from allegro_twin.sim.contact.probe import Probe
from allegro_twin.sim.engine.backend import Push, SimBackend
from allegro_twin.sim.model import wrist
from allegro_twin.sim.model.appearance import scene_look
from allegro_twin.sim.model.scene import compile_scene
from allegro_twin.sim.model.statics import hand_model
from allegro_twin.sim.things.objects import Placement
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, HandState, Sample, Vector


class Trial:
    """A simulated hand at a scenario, and what is seen of it.

    `start` are the joint positions at reset, (n,), rad; by default the grasp's pre-shape. `protocol` takes the place of
    the scenario's; `draw` is what the hand is not told.
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
        protocol: Protocol | None = None,
        draw: Draw | None = None,
    ) -> None:
        self.scenario, self.grasp, self.draw = scenario, grasp, draw
        self.protocol = load_protocol(scenario.protocol) if protocol is None else protocol
        scene = stage(scenario, self.protocol, spec.side, folder)
        if draw is not None:
            scene = draw.on(scene, self.protocol.physics.friction)
        self.things: tuple[Placement, ...] = tuple(scene.things)
        posture = grasp.preshape if start is None else start
        timeline = plan(self.protocol, grasp, scenario, posture, spec.side, period)
        self.windows: tuple[Window, ...] = timeline.windows
        self.reference: Moves = timeline.reference
        self.seconds = timeline.seconds
        model = compile_scene(spec, scene)
        if draw is not None:
            motors = [model.actuator(joint).id for joint in spec.joints]
            if "torque" in spec.commands:
                model.actuator_gear[motors, 0] *= draw.torque
            else:
                model.actuator_forcerange[motors] *= draw.torque
        physics, name = scene.physics, scenario.objects[0].name
        drive = wrist.commands(timeline.segments, physics.timestep, wrist.load(model), -physics.gravity[2])
        push = Push(name, timeline.push * float(model.body_mass[model.body(name).id]))
        self.backend = SimBackend(spec, model, period=period, posture=posture, drive=drive, pushing=push)
        self._probe = Probe(model, self.backend.data, spec, name)
        limits, lift = self.protocol.success, sum(max(phase.move[2], 0.0) for phase in self.protocol.phases)
        self.rule = Rule(self.protocol.reference, limits.drift, limits.rotation, float(lift), limits.throughout)
        self._weight, self._push = self.mass * float(np.linalg.norm(physics.gravity)), float(np.abs(push.force).max())
        self._too_heavy = too_heavy(self._weight, grasp, spec, scenario.friction * self.protocol.physics.friction)
        self._rows: list[tuple[float, Vector, Mapping[str, Array]]] = []

    @property
    def mass(self) -> float:
        """Of the object to grasp, kg."""
        return self.backend.mass_of(self.scenario.objects[0].name)

    def warnings(self) -> list[str]:
        """What speaks against a success, with its numbers."""
        return [] if self._too_heavy is None else [self._too_heavy]

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
        self._rows.append((state.t, state.torque, self._probe()))

    def report(self) -> Report:
        """The verdict. Raises HandError when the trial was not run to its end."""
        if not self._rows or self._rows[-1][0] < self.seconds - 1e-9:
            raise HandError(f"the trial ended before its {self.seconds:.1f} s: there is no verdict")
        t, torque, seen = zip(*self._rows, strict=True)
        columns = {key: np.array([row[key] for row in seen]) for key in seen[0]}
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

    def judged(self, seen: Observations) -> Report:
        """The verdict on what was observed of this trial."""
        spec = self.backend.spec
        report = judge(
            seen, self.windows, self.rule,
            parts=self._probe.parts, joints=spec.readable, torque_limit=spec.actuation.torque_limit,
        )  # fmt: skip
        return report if report.held else replace(report, reason="; ".join([report.reason, *self._loads(seen)]))

    def _loads(self, seen: Observations) -> list[str]:
        """What the hand had to carry, and which joints had no more to give up to the first check."""
        limit = self.backend.spec.actuation.torque_limit
        begin = self.begin
        end = next((w.end for w in self.windows if w.check), self.seconds)
        share = (np.abs(seen.torque[(seen.t > begin) & (seen.t <= end)]) >= FULL * limit).mean(axis=0)
        full = [name for name, part in zip(self.backend.spec.readable, share, strict=True) if part > 0.5]
        loads = [("it weighs", self._weight), ("it is pushed with", self._push)]
        said = [f"{what} {newtons:.1f} N" for what, newtons in loads if newtons > 0.0]
        return [*said, f"{', '.join(full)} at their torque limit"] if full else said

    def meta(self) -> dict[str, object]:
        """What a recording should say of the scene."""
        things = [
            {"name": p.thing.name, "shape": p.thing.shape, "size": list(p.thing.size), "mass": p.thing.mass}
            for p in self.things
        ]
        return {
            "protocol": f"{self.scenario.protocol} {self.protocol.version}",
            "grasp": self.grasp.name,
            "objects": things,
            "phases": [[w.name, w.begin, w.end] for w in self.windows],
            "judged": {"windows": [[w.name, w.begin, w.end, w.check] for w in self.windows]} | asdict(self.rule),
            "look": scene_look(self.backend.model, self.backend.spec, tuple(p.thing.name for p in self.things)),
        }


def too_heavy(weight: float, grasp: Grasp, spec: HandSpec, friction: float) -> str | None:
    """A warning for an object whose weight, N, friction cannot carry: every finger presses it against the palm or
    another finger, so that at most 2 µ Σ F holds it up, with F what each fingertip can press at the closed posture."""
    forces = hand_model(spec).fingertip_force(grasp.close, spec.actuation.torque_limit)
    bound = 2.0 * friction * sum(forces.values())
    if weight <= bound:
        return None
    return (
        f"the object weighs {weight:.1f} N; friction {friction:g} and the torque limits hold at most "
        f"{bound:.1f} N with {grasp.name} (fingertips press {', '.join(f'{n} {f:.1f} N' for n, f in forces.items())})"
    )
