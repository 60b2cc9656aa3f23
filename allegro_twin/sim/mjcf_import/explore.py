"""What an MJCF says of the hand in it, and what it does when it is moved: enough for its card."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.sim.drivetrain import lugre_friction
from allegro_twin.sim.mjcf_import.adapt import read_mjcf
from allegro_twin.types import Array


class ImportedMotor:
    """One actuator, read. Raises ConfigError for one that nobody could command as a hand."""

    def __init__(self, model: mujoco.MjModel, number: int, path: Path) -> None:
        self.number, self.actuator = number, model.actuator(number).name
        if not self.actuator:
            raise ConfigError(f"{path}: actuator {number} has no name: give it one")
        where, kind = f"{path}: actuator {self.actuator}", int(model.actuator_trntype[number])
        target = int(model.actuator_trnid[number, 0])
        on_tendon = kind == mujoco.mjtTrn.mjTRN_TENDON
        if kind != mujoco.mjtTrn.mjTRN_JOINT and not on_tendon:
            raise ConfigError(f"{where} acts on neither a joint nor a tendon")
        if model.actuator_dyntype[number] != mujoco.mjtDyn.mjDYN_NONE:
            raise ConfigError(f"{where} has dynamics of its own, which no command can stand for")
        self.joint = None if on_tendon else target
        """That it turns; None: it pulls a tendon."""
        self.name = self.actuator if on_tendon else model.joint(target).name
        gain, bias = float(model.actuator_gainprm[number, 0]), model.actuator_biasprm[number]
        self.torque = not bias[:3].any()
        if self.torque and on_tendon:
            raise ConfigError(f"{where} pulls a tendon with a given force, and nobody would know where its joints are")
        if not self.torque and bias[1] >= 0.0:
            raise ConfigError(f"{where} is no position servo: a velocity, say, is no place to go to")
        span = _span(model, number, target, on_tendon, where)
        self.lower, self.upper = span
        if not self.torque and model.actuator_ctrllimited[number]:
            ends = -(bias[0] + gain * model.actuator_ctrlrange[number]) / bias[1]
            self.lower, self.upper = float(ends.min()), float(ends.max())
        self.effort = _effort(model, number, gain, bias, self.upper - self.lower)
        self._gain, self._bias = gain, bias

    def told(self, position: float) -> float:
        """What a position servo is told to go to a position."""
        return float(-(self._bias[0] + self._bias[1] * position) / self._gain)

    def row(self) -> dict[str, Any]:
        numbers = {"lower": round(self.lower, 6), "upper": round(self.upper, 6), "effort": round(self.effort, 6)}
        loop = {} if self.torque else {"stiffness": round(-float(self._bias[1]), 6)}
        return {"name": self.name, "actuator": self.actuator} | numbers | loop


def _span(model: mujoco.MjModel, number: int, target: int, on_tendon: bool, where: str) -> tuple[float, float]:
    limited, span = (
        (model.tendon_limited[target], model.tendon_range[target])
        if on_tendon
        else (model.jnt_limited[target], model.jnt_range[target])
    )
    if not limited and not model.actuator_ctrllimited[number]:
        raise ConfigError(f"{where}: neither it nor what it moves has a range: where may it go?")
    return float(span[0]), float(span[1])


def _effort(model: mujoco.MjModel, number: int, gain: float, bias: Array, span: float) -> float:
    """The most that it can give by the file: its force range, or what its range of control comes to."""
    if model.actuator_forcelimited[number]:
        return float(np.abs(model.actuator_forcerange[number]).max())
    if bias[1]:
        return float(-bias[1] * span)
    ends = np.abs(gain * model.actuator_ctrlrange[number])
    return float(ends.max()) or 1.0


_POINTS, _LOOKS, _LONGEST = 11, 0.1, 20.0  # Positions of a driven joint that are tried; s until a look whether all has
_STILL = 1e-4  # come to rest, and s that it is given at most; rad/s or m/s of a joint at rest.
_MOVES = 2e-3  # rad or m. A joint that moves less does not follow.
_JOINTS = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


class ExploredHand(NamedTuple):
    """The content of a card, and what a person should look at."""

    card: dict[str, Any]
    notes: list[str]


def explore_mjcf(path: Path, root: str | None = None) -> ExploredHand:
    """Read a hand, and move each of its motors alone through its range, without gravity and contacts. `root`: the body
    that is the palm; None: the one under the world that carries all motors. Raises ConfigError for a file without a
    hand that can be driven."""
    spec = read_mjcf(path)
    for element in spec.keys:
        spec.delete(element)
    try:
        model = spec.compile()
    except ValueError as error:
        raise ConfigError(f"{path}: {str(error).strip().splitlines()[0]}") from error
    given = [
        k
        for k in range(model.nu)
        if not lugre_friction.is_friction_only(model.actuator_gaintype[k], model.actuator_gainprm[k])
    ]
    if not given:
        raise ConfigError(f"{path} has no actuators: nothing in it can be driven")
    palm = _palm(model, path, root)
    motors = [ImportedMotor(model, k, path) for k in given]
    commands = {"torque" if motor.torque else "limited_position" for motor in motors}
    if len(commands) > 1:
        raise ConfigError(f"{path}: some actuators take torques and some positions; a hand takes one of them")
    moves = _moved(model, motors)
    tips = _tips(model, palm)
    notes = [] if tips else ["no finger was found: nothing that moves hangs on the palm"]
    ways = [_positions(model, moves, k, palm, tips) for k in range(len(motors))]
    fingers = {name: {"joints": [m.name for m, way in zip(motors, ways, strict=True) if _reaches(way, at)],
                      "tip": [model.body(body).name, centre.round(4).tolist()]}
               for at, (name, (body, centre)) in enumerate(tips.items())}  # fmt: skip
    followers, free = _followers(model, motors, moves)
    notes += [f"{name}: nobody drives this joint, and it follows none; it swings freely" for name in free]
    card = {
        "mjcf": str(path),
        "root": model.body(palm).name,
        "side": "right",
        "commands": ["torque"] if commands == {"torque"} else ["position", "limited_position"],
        "driven": [motor.row() for motor in motors],
        "fingers": fingers,
        "palm": _axes(model, palm, ways),
    }
    return ExploredHand(card | ({"followers": followers} if followers else {}), notes)


def _palm(model: mujoco.MjModel, path: Path, root: str | None) -> int:
    tops = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    moving = [b for b in tops if any(model.body_rootid[model.jnt_bodyid[j]] == b for j in range(model.njnt))]
    if root is not None:
        names = [model.body(b).name for b in tops]
        if root not in names:
            raise ConfigError(f"{path}: {unknown('body under the world', root, names)}")
        return int(model.body(root).id)
    if len(moving) != 1:
        names = [model.body(b).name or "(unnamed)" for b in moving]
        raise ConfigError(f"{path} has {len(moving)} things that move ({', '.join(names)}): say which with --root")
    if not model.body(moving[0]).name:
        raise ConfigError(f"{path}: the hand's first body has no name: give it one")
    return moving[0]


def _moved(model: mujoco.MjModel, motors: list[ImportedMotor]) -> Array:
    """All joint positions, at rest, for each motor alone at places through its range: (motors, places, nq)."""
    model.opt.gravity[:] = 0.0
    # Light links on stiff tendons: a file that says nothing of steps means them as our scenes take them.
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 0.001
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    found = np.empty((len(motors), _POINTS, model.nq))
    for k, motor in enumerate(motors):
        data = mujoco.MjData(model)
        for place, position in enumerate(np.linspace(motor.lower, motor.upper, _POINTS)):
            if motor.torque:
                data.qpos[model.jnt_qposadr[motor.joint]] = position
            else:
                _rest(model, data, motors)
                data.ctrl[k] = motor.told(position)
                _settle(model, data)
            found[k, place] = data.qpos
    return found


def _settle(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    end = data.time + _LONGEST
    while data.time < end:
        mujoco.mj_step(model, data, round(_LOOKS / model.opt.timestep))
        if np.abs(data.qvel).max() < _STILL:
            return


def _rest(model: mujoco.MjModel, data: mujoco.MjData, motors: list[ImportedMotor]) -> None:
    """Every servo is told to stay as near to zero as it can be."""
    for each in motors:
        data.ctrl[each.number] = each.told(min(max(0.0, each.lower), each.upper))


def _tips(model: mujoco.MjModel, palm: int) -> dict[str, tuple[int, Array]]:
    """Of everything that moves on the palm: its first body's name, its furthest body, and the middle of what that
    touches with, m."""
    parents = model.body_parentid
    depth = {palm: 0}
    branch: dict[int, int] = {}
    for body in range(palm + 1, model.nbody):
        parent = int(parents[body])
        if parent in depth:
            depth[body] = depth[parent] + 1
            if parent in branch:
                branch[body] = branch[parent]
            elif model.body_jntnum[body]:
                branch[body] = body
    found: dict[str, tuple[int, Array]] = {}
    for first in dict.fromkeys(branch.values()):
        mine = [body for body in branch if branch[body] == first]
        last = max(mine, key=lambda body: (depth[body], body))
        found[model.body(first).name or f"finger_{len(found)}"] = (last, _end(model, last))
    return found


def _end(model: mujoco.MjModel, body: int) -> Array:
    """The middle of that shape of a body which is furthest from its joint."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    if not count:
        return np.zeros(3)
    places = model.geom_pos[first : first + count]
    return np.array(places[int(np.argmax(np.linalg.norm(places, axis=1)))])


def _positions(model: mujoco.MjModel, moves: Array, motor: int, palm: int, tips: dict[str, tuple[int, Array]]) -> Array:
    """Where the tips are as one motor goes through its range, in the palm's frame: (places, tips, 3), m."""
    data, found = mujoco.MjData(model), []
    for qpos in moves[motor]:
        data.qpos = qpos
        mujoco.mj_kinematics(model, data)
        frame, origin = data.xmat[palm].reshape(3, 3), data.xpos[palm]
        rows = [data.xpos[body] + data.xmat[body].reshape(3, 3) @ centre - origin for body, centre in tips.values()]
        found.append(np.array(rows).reshape(-1, 3) @ frame)
    return np.array(found)


def _reaches(way: Array, tip: int) -> bool:
    return bool(np.ptp(way[:, tip], axis=0).max() > 1e-4)


def _followers(
    model: mujoco.MjModel, motors: list[ImportedMotor], moves: Array
) -> tuple[list[dict[str, Any]], list[str]]:
    """Joints without a motor: after which they go, and how far; and those that go after none."""
    own = {motor.joint for motor in motors}
    followers, free = [], []
    for joint in range(model.njnt):
        if joint in own or int(model.jnt_type[joint]) not in _JOINTS:
            continue
        rows = moves[:, :, model.jnt_qposadr[joint]]
        motor = int(np.argmax(np.ptp(rows, axis=1)))
        name = model.joint(joint).name
        if np.ptp(rows[motor]) < _MOVES:
            free.append(name)
            continue
        followers.append({"name": name, "follows": motors[motor].name, "positions": rows[motor].round(5).tolist()})
    return followers, free


def _axes(model: mujoco.MjModel, palm: int, ways: list[Array]) -> dict[str, list[float]]:
    """Guessed: fingers point from the palm to the tips, and the palm looks where the tips go when all motors close;
    along the fingers where they close on each other, as a gripper's do."""
    tips = np.concatenate([way[:1] for way in ways]).reshape(-1, 3)
    if not len(tips):
        return {"facing": [1.0, 0.0, 0.0], "fingers": [0.0, 0.0, 1.0]}
    along = _nearest_axis(tips.mean(axis=0))
    closing = np.sum([(way[-1] - way[0]).mean(axis=0) for way in ways], axis=0)
    closing = closing - along * (closing @ along)
    if np.linalg.norm(closing) < 1e-3:
        return {"facing": along.tolist(), "fingers": np.roll(along, 1).tolist()}
    return {"facing": _nearest_axis(closing).tolist(), "fingers": along.tolist()}


def _nearest_axis(vector: Array) -> Array:
    axis = np.zeros(3)
    largest = int(np.argmax(np.abs(vector)))
    axis[largest] = np.sign(vector[largest]) or 1.0
    return axis
