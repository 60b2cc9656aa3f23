"""What the verdicts depend on: `python -m benchmarks.physics [FILE]` makes the tables of docs/results/physics.md.

The demo's trials, right hand, under one changed setting at a time; and whether contacts obey the laws that they stand
for: force balance, friction cones, energy, the same bits again.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from allegro_twin.files.assets import data_root
from allegro_twin.grasping.batch.batched_trials import Verdict
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner
from allegro_twin.grasping.scenario import Phase, PhysicsSettings, TrialProtocol, load_protocol, load_scenario
from allegro_twin.grasping.uncertainty import Perturbation
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.sim.engine.backend import ENGINE

DEMO = sorted(path.stem for path in (data_root() / "scenarios" / "demo").glob("*.yaml"))
PROTOCOL = load_protocol("table_pick")
PHYSICS: Mapping[str, Mapping[str, Any]] = {
    "as shipped": {},
    "contacts of 20 ms, impratio 10 (version 1)": {"softness": 0.02, "impratio": 10.0},
    "contacts of 10 ms": {"softness": 0.01},
    "timestep halved": {"timestep": 0.0005},
    "impratio 10": {"impratio": 10.0},
    "noslip 0": {"noslip": 0},
    "noslip 10": {"noslip": 10},
    "pyramidal cone": {"cone": "pyramidal"},
    "CG solver": {"solver": "CG"},
    "Euler": {"integrator": "Euler"},
    "implicit": {"integrator": "implicit"},
}
DRAWS = {
    "friction 0.6": Perturbation(friction=0.6),
    "friction 0.5": Perturbation(friction=0.5),
    "torque × 0.7": Perturbation(torque=0.7),
    "torque × 1.3": Perturbation(torque=1.3),
}
GAINS = ("v4",)


@dataclass(frozen=True, slots=True)
class Row:
    """The demo under one setting."""

    name: str
    verdicts: Sequence[Verdict]
    turned: Sequence[float]
    """How far each object has moved in the hand during the turn, m."""
    seconds: float
    """CPU s a trial."""

    def cells(self) -> list[str]:
        reports = [verdict.report for verdict in self.verdicts if verdict.report is not None]
        lost = [name for name, verdict in zip(DEMO, self.verdicts, strict=True) if not verdict.held]
        held = f"{len(DEMO) - len(lost)}" + (f" (not {', '.join(lost)})" if lost else "")
        deepest = max(report.penetration for report in reports)
        drift = np.median([max(p.drift for p in report.phases if p.check) for report in reports])
        turned, worst = np.nanmedian(self.turned), np.nanmax(self.turned)
        far = f"{1e3 * turned:.2f}, {1e3 * worst:.2f}"
        return [self.name, held, f"{1e3 * deepest:.2f}", f"{1e3 * drift:.2f}", far, f"{self.seconds:.2f}"]


def rows() -> Iterator[Row]:
    """Each setting, one after the other."""
    spec = load_spec()
    bench = TrialRunner(spec)
    for name, settings in PHYSICS.items():
        yield _row(bench, name, PROTOCOL.model_copy(update={"physics": PhysicsSettings(**settings)}))
    for name, draw in DRAWS.items():
        yield _row(bench, name, PROTOCOL, draw)
    for gains in GAINS:
        yield _row(TrialRunner(spec, gains), f"gains {gains}", PROTOCOL)


def _row(bench: TrialRunner, name: str, protocol: TrialProtocol, draw: Perturbation | None = None) -> Row:
    began = time.process_time()
    cases = [replace(case, protocol=protocol, draw=draw) for case in _cases(bench)]
    verdicts = list(bench.verdicts(cases))
    seconds = (time.process_time() - began) / len(verdicts)
    turning = _since(protocol, "hold", "turn")
    turned = [_moved(v, "turn") for v in bench.verdicts([replace(case, protocol=turning) for case in cases])]
    return Row(name, verdicts, turned, seconds)


def _cases(bench: TrialRunner) -> list[TrialCase]:
    found = []
    for name in DEMO:
        scenario, path = load_scenario(name)
        found.append(TrialCase(scenario, load_grasp(scenario.grasp, bench.spec), folder=path.parent))
    return found


def _since(protocol: TrialProtocol, phase: str, last: str) -> TrialProtocol:
    """The protocol up to a phase, with motion counted from the end of another one."""
    names = [each.name for each in protocol.phases]
    return protocol.model_copy(update={"reference": phase, "phases": protocol.phases[: names.index(last) + 1]})


def _moved(verdict: Verdict, phase: str) -> float:
    """How far the object was by the end of a phase from where it counts, m; NaN where the trial could not go on."""
    phases = () if verdict.report is None else verdict.report.phases
    return next((each.drift for each in phases if each.name == phase), float("nan"))


def creeping() -> Iterator[list[str]]:
    """How fast each object moves in the hand when it has been held for 10 s, µm/s."""
    bench = TrialRunner(load_spec())
    phases: list[Phase] = []
    for phase in PROTOCOL.phases:
        if phase.name == "hold":
            longer = (("hold", 10.0), ("on", 2.0))
            phases += [phase.model_copy(update={"name": name, "seconds": s}) for name, s in longer]
            break
        phases.append(phase)
    long = _since(PROTOCOL.model_copy(update={"phases": tuple(phases)}), "hold", "on")
    cases = [replace(case, protocol=long) for case in _cases(bench)]
    for name, verdict in zip(DEMO, bench.verdicts(cases), strict=True):
        yield [name, f"{1e6 * _moved(verdict, 'on') / 2.0:.2f}"]


def laws() -> Iterator[list[str]]:
    """What contacts must obey, over the demo's trials, in steps of 30 ms from the lift on."""
    bench = TrialRunner(load_spec())
    imbalance: list[float] = []
    cone: list[float] = []
    count = 0
    for case in _cases(bench):
        trial = bench.trial(case)
        model, data = trial.backend.model, trial.backend.data
        body = model.body(case.scenario.objects[0].name).id
        mass = float(model.body_mass[body])
        for wrench, contacts in _watched(bench, trial, body):
            count += len(contacts)
            # MuJoCo's cacc begins with -g at the world, so that it is a - g.
            imbalance.append(float(np.linalg.norm(wrench - mass * data.cacc[body, 3:])) / (9.81 * mass))
            cone += contacts
    first = [verdict.report for verdict in bench.verdicts(_cases(bench)[:3])]
    again = first == [verdict.report for verdict in bench.verdicts(_cases(bench)[:3])]
    yield ["contacts looked at", f"{count}"]
    off = f"{np.median(imbalance):.1e}, {max(imbalance):.1e}"
    yield ["Σ contact forces less m (a - g), as a share of the weight: median, worst", off]
    yield ["friction over its cone, worst", f"{max(cone):.4f}"]
    yield ["three trials again", "the same bits" if again else "DIFFERENT"]


def _watched(bench: TrialRunner, trial: Any, body: int) -> Iterator[tuple[Any, list[float]]]:
    """From the lift on: the sum of contact forces on the object, N, and how far each friction is up its cone."""
    from allegro_twin.loop import run, until

    model, data = trial.backend.model, trial.backend.data
    begin = next(window.begin for window in trial.windows if window.name == "lift")
    for sample in until(trial.seconds, run(trial.backend, bench.controller(trial))):
        if sample.state.t < begin or sample.state.tick % 10:
            continue
        mujoco.mj_forward(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        total, cones, local = np.zeros(3), [], np.zeros(6)
        for index, contact in enumerate(data.contact):
            bodies = model.geom_bodyid[contact.geom]
            if body not in bodies or contact.efc_address < 0:
                continue
            mujoco.mj_contactForce(model, data, index, local)
            force = contact.frame.reshape(3, 3).T @ local[:3]
            total += force if bodies[1] == body else -force
            if local[0] > 1e-6:
                cones.append(float(np.hypot(local[1], local[2]) / (contact.friction[0] * local[0])))
        yield total, cones


def table(head: Sequence[str], body: Iterator[list[str]]) -> Iterator[str]:
    """Markdown, a line at a time."""
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for cells in body:
        yield "| " + " | ".join(cells) + " |"


def page() -> Iterator[str]:
    """The tables, each under its heading."""
    yield f"### The demo under one changed setting ({ENGINE}, right hand, 12 trials each)\n"
    head = ("setting", "held of 12", "deepest, mm", "drift, median mm", "turn, median, worst mm", "CPU s a trial")
    yield from table(head, (row.cells() for row in rows()))
    yield "\n### Creep between 10 and 12 s of hold\n"
    yield from table(("object", "µm/s"), creeping())
    yield "\n### Laws\n"
    yield from table(("law", "measured"), laws())


def main() -> None:
    lines = []
    for line in page():
        print(line, flush=True)
        lines.append(line)
    if len(sys.argv) > 1:
        path = Path(sys.argv[1])
        text = path.read_text()
        head = text.split("<!-- tables -->")[0]
        path.write_text(f"{head}<!-- tables -->\n\n" + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
