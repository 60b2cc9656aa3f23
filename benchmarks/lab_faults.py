"""Faults injected into the cell, hand by hand and state by state: does it ever say `held` of what is not?

`python -m benchmarks.lab_faults [--hands allegro,leap] [--kinds power,weak] [--objects 1] [--most N] [--seed 0]
[--rows FILE]`
prints the table of docs/results/cell.md. Objects, places, yaws and joints are drawn, with `--most` N cases of each
kind. Kinds:

- `power`: the motors of the whole hand, or of one finger, give nothing from a state on, for every state;
- `weak`: the motors give 20 % from a state on;
- `encoder`: one joint reads 1° or 3° too much or too little, with the object, and taken away before the approach;
- `dead`: one joint's reading stays as it is when the fingers begin to close, with and without the object;
- `stuck`: one joint does not turn from then on, with and without the object;
- `taken`: the object is taken away when a state begins, for every state;
- `camera`: the camera repeats its last picture from the approach on, with the object and with it taken away;
- `force`: the force sensor stays as it is, or shows 3 N downwards, from the lift on, with and without the object;
- `glued`: the object is fixed to the table;
- `healthy`: nothing is wrong.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from allegro_twin.backend import HandBackend, PassThroughBackend
from allegro_twin.cell.arm.faults import DisturbedBackend
from allegro_twin.cell.assembly import Cell, make_cell, with_objects
from allegro_twin.cell.camera.camera import DepthCamera
from allegro_twin.cell.planning.stored_grasps import stored_grasps
from allegro_twin.cell.run import LabReport, perform
from allegro_twin.cell.settings import LabSettings, TableObjectSettings
from allegro_twin.cell.states import MachineState, StateName
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, PositionCommand, Vector, frozen

HANDS = ("allegro", "leap", "model_o", "qb_softhand", "sih")
_SELDOM = ("ToReleasePose", "PutBack", "OpeningHand", "Retreat")
"""States that a run without a tray, a miss or a reflex never comes to: nothing would be injected."""
STATES: tuple[StateName, ...] = tuple(state for state in get_args(StateName) if state not in _SELDOM)
KINDS = ("healthy", "power", "weak", "encoder", "dead", "stuck", "taken", "camera", "force", "glued")
_AWAY = (2.0, 2.0, 1.0)  # m: off the table.
Row = dict[str, Any]


class Misread(PassThroughBackend):
    """A hand in front of a hand: one joint's encoder is off by `by`, rad; or `dead`: it stays at what it reads. A loop
    in the firmware goes by the same encoder."""

    def __init__(self, inner: HandBackend, joint: int, by: float) -> None:
        super().__init__(inner)
        self._joint, self._by = joint, by
        self._last: float | None = None
        self.dead = False

    def reset(self) -> HandState:
        return self._read(self._inner.reset())

    def write(self, command: Command) -> None:
        if isinstance(command, PositionCommand):
            position = command.position.copy()
            position[self._joint] -= self._by
            command = replace(command, position=position)
        self._inner.write(command)

    def read(self) -> HandState:
        return self._read(self._inner.read())

    def _read(self, state: HandState) -> HandState:
        position, velocity = state.position.copy(), state.velocity.copy()
        if self.dead and self._last is not None:
            self._by, velocity[self._joint] = self._last - float(position[self._joint]), 0.0
        position[self._joint] += self._by
        self._last = float(position[self._joint])
        return replace(state, position=frozen(position), velocity=frozen(velocity))


class Frozen(DisturbedBackend):
    """A force sensor that stays at its last value once it is `stuck`."""

    stuck = False
    _kept: Vector | None = None

    def _seen(self, state: HandState) -> HandState:
        found = super()._seen(state)
        if self.stuck and self._kept is not None:
            return replace(found, wrench=self._kept)
        self._kept = found.wrench
        return found


@dataclass(frozen=True)
class Case:
    """One fault: what is done to the room before the run, and when a state begins."""

    kind: str
    what: str
    state: str
    empty: bool = False
    """The object is taken away before the approach."""
    share: float = 1.0
    motors: tuple[int, ...] = ()
    joint: int = 0
    by: float = 0.0


def cases(kind: str, spec: HandSpec, draws: np.random.Generator) -> Iterator[Case]:
    """All of one kind for a hand; which joints are drawn."""
    every, n = tuple(range(spec.n_joints)), spec.n_joints
    joints = draws.choice(n, min(n, 3), replace=False).tolist()
    match kind:
        case "power":
            parts = {"hand": every, **{finger.name: finger.joints for finger in spec.fingers}}
            kept: dict[tuple[int, ...], str] = {}
            for name, motors in parts.items():
                kept.setdefault(tuple(sorted(motors)), name)
            for motors, name in kept.items():
                yield from (Case(kind, name, state, share=0.0, motors=motors) for state in STATES)
        case "weak":
            yield from (Case(kind, "hand at 20 %", state, share=0.2, motors=every) for state in STATES)
        case "encoder":
            for joint in joints:
                for degrees in (-3.0, -1.0, 1.0, 3.0):
                    for empty in (False, True):
                        what = f"{spec.joint_labels[joint]} by {degrees:+.0f}°"
                        yield Case(kind, what, "always", empty, joint=joint, by=float(np.radians(degrees)))
        case "dead" | "stuck":
            for joint in joints:
                yield from (Case(kind, spec.joint_labels[joint], "ClosingHand", empty, joint=joint)
                            for empty in (False, True))  # fmt: skip
        case "taken":
            yield from (Case(kind, "object", state) for state in STATES)
        case "camera":
            yield from (Case(kind, "frozen", "Approach", empty) for empty in (False, True))
        case "force":
            for what in ("stuck", "3 N down"):
                yield from (Case(kind, what, "ToLiftedPose", empty) for empty in (False, True))
        case "glued":
            yield Case(kind, "object", "Approach")
        case "healthy":
            yield Case(kind, "nothing", "")


def tried(settings: LabSettings, case: Case) -> Row:
    """One run, as a row."""
    cell = make_cell(settings)
    name = settings.objects[0].name
    entered, cell = _injected(cell, case, name)
    try:
        return _row(perform(cell, on_state=entered), case, settings)
    finally:
        cell.close()


def _injected(cell: Cell, case: Case, name: str) -> tuple[Callable[[MachineState], None], Cell]:
    model, data, spec = cell.robot.world.model, cell.robot.world.data, cell.hand.spec
    hand, sensor, done = Misread(cell.hand, case.joint, case.by), Frozen(cell.arm, np.zeros(6)), False

    def entered(now: MachineState) -> None:
        nonlocal done
        if case.empty and now.state == "Approach":
            data.joint(name).qpos[:3] = _AWAY
        if now.state != case.state or done:
            return
        done = True
        match case.kind:
            case "power" | "weak":
                motors = [model.actuator(spec.joints[motor]).id for motor in case.motors]
                model.actuator_gainprm[motors] *= case.share
                model.actuator_biasprm[motors] *= case.share
            case "dead":
                hand.dead = True
            case "stuck":
                joint = [k for k in range(model.njnt) if model.joint(k).name == spec.joints[case.joint]]
                model.dof_frictionloss[[int(model.jnt_dofadr[k]) for k in joint]] = 5.0
            case "taken":
                data.joint(name).qpos[:3] = _AWAY
            case "camera":
                assert isinstance(cell.camera, DepthCamera)
                cell.camera.freeze()
            case "force":
                sensor.stuck = case.what == "stuck"
                arm = cell.robot.base.rotation @ cell.robot.model.pose(data.qpos[:7]).rotation
                if not sensor.stuck:
                    sensor._bias[:3] = arm.T @ [0.0, 0.0, -3.0]
            case "glued":
                first = int(model.joint(name).dofadr[0])
                model.dof_damping[first : first + 6] = 1e4  # N·s/m and N·m·s: it hardly moves.

    if case.kind in ("encoder", "dead"):
        cell = replace(cell, hand=hand)
    return entered, replace(cell, arm=sensor) if case.kind == "force" else cell


def _row(report: LabReport, case: Case, settings: LabSettings) -> Row:
    check = report.checked
    return {
        "hand": settings.hand.model, "object": settings.objects[0].name, "kind": case.kind, "what": case.what,
        "state": case.state, "empty": case.empty, "end": str(report.end), "sentence": report.end.sentence,
        "truly": bool(report.is_lifted), "tries": report.tries, "states": [state for _, state in report.events],
        "check": None if check is None else [check.weight, check.torque, check.between, check.by_camera],
    }  # fmt: skip


def table(rows: Sequence[Row]) -> list[str]:
    """A line a kind: runs, how they ended, and what was said of what."""
    lines = [
        "| fault | runs | held, said held | held, not said | not held, **said held** | not held, not said | ends |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in KINDS:
        mine = [row for row in rows if row["kind"] == kind]
        if not mine:
            continue
        counts = Counter((row["truly"], row["end"] == "held") for row in mine)
        ends = Counter(row["end"] for row in mine if row["end"] != "held").most_common()
        said = ", ".join(f"{end} {count}" for end, count in ends)
        lines.append(f"| {kind} | {len(mine)} | {counts[True, True]} | {counts[True, False]} | "
                     f"{counts[False, True]} | {counts[False, False]} | {said} |")  # fmt: skip
    wrong = [row for row in rows if row["end"] == "held" and not row["truly"]]
    return lines + [f"false: {json.dumps(row)}" for row in wrong]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hands", default=",".join(HANDS))
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--objects", type=int, default=1)
    parser.add_argument("--most", type=int, help="cases of one kind and object, drawn; all without it")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rows", type=Path)
    asked = parser.parse_args()
    rows: list[Row] = []
    for number, hand in enumerate(asked.hands.split(",")):
        settings = load_settings(LabSettings, data_root() / "conf" / f"lab_{hand}.yaml")
        settings = settings.model_copy(update={"decide": settings.decide.model_copy(update={"retries": 0})})
        names, draws = sorted(card.name for card in stored_grasps(hand)), np.random.default_rng((asked.seed, number))
        left = asked.objects
        for name in draws.permutation(names):
            at, yaw = draws.uniform(-0.08, 0.08, 2), float(draws.uniform(-180.0, 180.0))
            thing = TableObjectSettings(name=str(name), at=(float(at[0]), float(at[1])), yaw=yaw)
            here = with_objects(settings, [thing], asked.seed)
            if left == 0:
                break
            if tried(here, Case("healthy", "nothing", ""))["end"].startswith("refused"):
                continue  # Nothing moves: nothing can go wrong.
            left -= 1
            for kind in asked.kinds.split(","):
                every = list(cases(kind, load_spec(hand), draws))
                for each in draws.permutation(len(every))[: asked.most]:
                    case = every[each]
                    rows.append(tried(here, case))
                    if asked.rows is not None:
                        with asked.rows.open("a") as file:
                            file.write(json.dumps(rows[-1]) + "\n")
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
