"""Exploration of an MJCF or a URDF: its contents, and its behaviour when moved; enough for the hand's card."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.sim.hand_import.adapt import PID_PLUGIN, WORLD, compile_model, read_mjcf, take_out_gears
from allegro_twin.sim.hand_import.couplings import couplings
from allegro_twin.sim.hand_import.gains import BANDWIDTH, MotorJoint, motor_gains
from allegro_twin.sim.hand_import.imported_motor import ImportedMotor, read_motors
from allegro_twin.sim.hand_import.structure import FingerStructure, HandStructure, find_structure
from allegro_twin.sim.hand_import.urdf import is_urdf, read_urdf, touching_note, touching_pairs
from allegro_twin.spec import Side
from allegro_twin.types import Array

_POINTS, _LOOKS, _LONGEST = 11, 0.1, 20.0  # Positions of a driven joint that are tried; s until a look whether all has
_STILL = 1e-4  # come to rest, and s that it is given at most; rad/s or m/s of a joint at rest.
_LAST = 10  # Looks in which each step is looked at, for how far a joint moves that has not come to rest.
_DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
_SMALLEST, _LARGEST = 0.02, 1.0  # m. From the palm to the end of a finger, of any hand.
_IMMOVABLE = 1e3  # kg·m² or kg, of a joint that is held.
_UNITS = (
    'Lengths are in metres: a mesh takes scale="0.001 0.001 0.001" for mm, and all other lengths of the file are to be '
    "written in metres"
)
_NARROW = np.radians(2 * np.pi)  # rad. A joint's range in radians that is read as degrees is narrower.
_STEP = 0.01  # rad or m, by which a joint is moved to measure its servo.
_MOVES = 2e-3  # rad or m. A joint that moves less does not follow.
_SHARED = 0.05  # Of the way by its first motor. A joint that a second one moves further follows both.
_TOGETHER = 0.65  # Of the ways of all tips: what is left over where fingers close to one side; less: on each other.
_JOINTS = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_TIPS = {
    "shape": "guesses, the middle of the pad at the far end of the last link's shape",
    "nothing": "unknown, for the last link has no shape, and are put where it begins",
    "site": "where the file has sites called FINGER_tip",
}
"""What says where fingertips are, in words; an empty body at a finger's end needs none."""


class ExploredHand(NamedTuple):
    """The content of a card, and what a person should look at."""

    card: dict[str, Any]
    notes: list[str]
    """What was guessed, repaired and assumed."""
    spec: mujoco.MjSpec
    """The model; of a URDF, with servos: to be written beside the card."""
    structure: HandStructure
    file: Path
    """File that it was read from."""


def explore_hand(
    path: Path, root: str | None = None, palm: str | None = None, fingers: Mapping[str, str] | None = None,
    side: Side = "right",
) -> ExploredHand:  # fmt: skip
    """Read a hand, and move each of its motors alone through its range, without gravity and contacts.

    `root`: the body that stands still; None: the one under the world that carries all motors. `palm`, `fingers`: what
    `find_structure` takes. `side`: which hand its card is to be, for a note where the file's name says the
    other. Raises ConfigError for a file without a hand that can be driven.
    """
    spec, notes = _read(path)
    model = _compiled(spec, path)
    motors, more = read_motors(model, path)
    notes += more
    structure = find_structure(model, path, root, palm, fingers)
    _check_names(model, structure, path)
    moves, more = _moved(model, motors, path)
    notes += more
    drives = [_driven_joints(model, motor) for motor in motors]
    ways = [_tip_paths(model, moves, k, structure) for k in range(len(motors))]
    followers, free, more = _followers(model, motors, moves, path)
    notes += more
    notes += _notes(model, structure, motors, free, path, side)
    touching = _touching(model, structure)
    if touching:
        notes.append(touching_note(touching))
    torque = motors[0].torque
    card: dict[str, Any] = {
        "mjcf": str(path),
        "root": structure.root,
        "side": "right",
        "commands": ["torque"] if torque else ["position", "limited_position"],
        "driven": [motor.row() for motor in motors],
        "fingers": {finger.name: _finger_row(model, finger, motors, drives) for finger in structure.fingers},
        "palm": _axes(model, structure, motors, ways, drives),
    }
    if torque:
        joints = [MotorJoint(motor.joint, motor.effort) for motor in motors if motor.joint is not None]
        card["gains"] = {"default": motor_gains(model, joints)}
        notes.append(
            f"gains are chosen: by each joint's inertia, critically damped at {BANDWIDTH:g} rad/s or less, full effort "
            "not before 0.1 rad (5 mm); `gains` in the card has them"
        )
    if structure.wrist:
        names = [motor.name for motor, own in zip(motors, drives, strict=True) if own & set(structure.wrist)]
        card["wrist"] = {"joints": names, "palm": model.body(structure.palm).name}
    card |= {"followers": followers} if followers else {}
    card |= {"touching": [list(pair) for pair in touching]} if touching else {}
    return ExploredHand(card, notes, spec, structure, path)


def _read(path: Path) -> tuple[mujoco.MjSpec, list[str]]:
    """The hand's model, without keyframes and gears, and notes on how it was read."""
    notes: list[str] = []
    if is_urdf(path):
        hand = read_urdf(path)
        spec, notes = hand.spec, list(hand.notes)
    else:
        spec = read_mjcf(path)
        if PID_PLUGIN in path.read_text():
            notes.append("the PID plugin is read as position servos of its kp and kd: no integral, no slew")
    for element in spec.keys:
        spec.delete(element)
    take_out_gears(spec)
    return spec, notes


def _compiled(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    try:
        return compile_model(spec)
    except ValueError as error:
        text = str(error).strip().splitlines()[0].removeprefix("Error: ")
        way = "; names are relative to the model file and its `meshdir`" if "opening file" in text else ""
        raise ConfigError(f"{path}: {text}{way}") from error


def _check_names(model: mujoco.MjModel, structure: HandStructure, path: Path) -> None:
    """Raises ConfigError for a joint of the hand without a name."""
    for joint in range(model.njnt):
        body = model.body(int(model.jnt_bodyid[joint]))
        mine = structure.root in (WORLD, model.body(int(body.rootid[0])).name)
        if mine and not model.joint(joint).name and int(model.jnt_type[joint]) in _JOINTS:
            raise ConfigError(f"{path}: a joint of body {body.name or '(unnamed)'} has no name: give it one")


def measured_stiffness(hand: ExploredHand) -> dict[str, float]:
    """Stiffness of each joint with a position servo, by joint name, N·m/rad or N/m: the loss of torque per small motion
    of that joint alone, in the model as its file has it."""
    path, found = hand.file, {}
    model = compile_model(read_urdf(path).spec if is_urdf(path) else read_mjcf(path))
    model.actuator_forcelimited[:] = model.jnt_actfrclimited[:] = 0
    data = mujoco.MjData(model)
    for row in hand.card["driven"]:
        actuator = model.actuator(row["actuator"])
        if "stiffness" not in row or int(actuator.trntype[0]) != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        joint, torques = model.joint(int(actuator.trnid[0])), []
        for place in (0.0, _STEP):
            mujoco.mj_resetData(model, data)
            data.qpos[joint.qposadr[0]] += place
            mujoco.mj_forward(model, data)
            torques.append(float(data.qfrc_actuator[joint.dofadr[0]]))
        value = (torques[0] - torques[1]) / _STEP
        found[row["name"]] = row["stiffness"] if np.isclose(value, row["stiffness"], rtol=1e-5) else round(value, 6)
    return found


def _driven_joints(model: mujoco.MjModel, motor: ImportedMotor) -> set[int]:
    """Joints that a motor moves by what connects them: its own, its tendon's, and those coupled to one of these."""
    if motor.joint is not None:
        found = {motor.joint}
    else:
        assert motor.tendon is not None
        found = _wrapped(model, motor.tendon)
    links = [(int(model.eq_obj1id[k]), int(model.eq_obj2id[k])) for k in couplings(model)]
    while more := {a for pair in links for a, b in (pair, pair[::-1]) if b in found} - found:
        found |= more
    return found


def _wrapped(model: mujoco.MjModel, tendon: int) -> set[int]:
    """Joints that change a tendon's length: those of a fixed one; of a spatial one, those between its sites."""
    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    kinds, objects = model.wrap_type[first : first + count], model.wrap_objid[first : first + count]
    if (kinds == mujoco.mjtWrap.mjWRAP_JOINT).any():
        return {int(each) for each in objects}
    ways = []
    for kind, each in zip(kinds, objects, strict=True):
        if kind == mujoco.mjtWrap.mjWRAP_SITE:
            ways.append(_ancestors(model, int(model.site_bodyid[each])))
        elif kind in (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER):
            ways.append(_ancestors(model, int(model.geom_bodyid[each])))
    shared = set.intersection(*ways) if ways else set()
    return set().union(*ways) - shared


def _ancestors(model: mujoco.MjModel, body: int) -> set[int]:
    """Joints between the world and a body."""
    found: set[int] = set()
    while body:
        first = int(model.body_jntadr[body])
        found |= set(range(first, first + int(model.body_jntnum[body]))) if first >= 0 else set()
        body = int(model.body_parentid[body])
    return found


def _finger_row(
    model: mujoco.MjModel, finger: FingerStructure, motors: Sequence[ImportedMotor], drives: Sequence[set[int]]
) -> dict[str, Any]:
    """A finger of the card: the motors that move a joint of its chain, from the palm outward."""
    order = {joint: place for place, joint in enumerate(finger.joints)}
    mine = [(min(order[joint] for joint in own & set(order)), motor.name)
            for motor, own in zip(motors, drives, strict=True) if own & set(order)]  # fmt: skip
    return {"joints": [name for _, name in sorted(mine, key=lambda each: each[0])],
            "tip": [model.body(finger.body).name, finger.centre.round(4).tolist()]}  # fmt: skip


def _notes(
    model: mujoco.MjModel, structure: HandStructure, motors: Sequence[ImportedMotor], free: Sequence[str], path: Path,
    side: Side,
) -> list[str]:  # fmt: skip
    """Raises ConfigError for a hand of more than a metre."""
    if not structure.fingers:
        return ["no finger was found: nothing that moves hangs on the palm"]
    guessed = ", ".join(finger.name for finger in structure.fingers if finger.guessed)
    notes = []
    if guessed:
        palm = model.body(structure.palm).name
        notes.append(
            f"fingers and their names are guesses, by what hangs on {palm}: {guessed}; --finger NAME=BODY says another"
        )
    for source, words in _TIPS.items():
        if tips := [finger.name for finger in structure.fingers if finger.tip_by == source]:
            notes.append(f"fingertips are {words}: {', '.join(tips)}; `tip` in the card says another place")
    if structure.root == WORLD:
        notes.append("the fingers hang on the world itself: it is taken for the palm")
    reach = _reach(model, structure)
    size = f"it reaches {reach:.3g} m from the palm to the end of a finger"
    if reach > _LARGEST:
        raise ConfigError(f"{path}: {size}: is it in mm, or in inches? {_UNITS}")
    if reach < _SMALLEST:
        notes.append(f"{size}: is it in another unit? {_UNITS}")
    hinges = [motor for motor in motors
              if motor.joint is not None and model.jnt_type[motor.joint] == mujoco.mjtJoint.mjJNT_HINGE]  # fmt: skip
    turning = [f"{motor.name} {motor.lower:g} … {motor.upper:g}" for motor in hinges
               if motor.upper - motor.lower > 2 * np.pi + 1e-3]  # fmt: skip
    if turning:
        notes.append(f"ranges of more than a whole turn, rad: {', '.join(turning)}: are they in degrees?")
    narrow = [motor for motor in hinges if motor.upper - motor.lower < _NARROW]
    if 2 * len(narrow) > len(hinges) and not is_urdf(path):
        ranges = ", ".join(
            f"{each.name} {np.degrees(each.lower):.3g} … {np.degrees(each.upper):.3g}" for each in narrow
        )
        notes.append(
            f"most joints hardly move, ranges in degrees: {ranges}: are they in radians? Without "
            '<compiler angle="radian"/> an MJCF has degrees'
        )
    called = re.split(r"[^a-z]+", path.stem.lower())
    other: Side = "left" if side == "right" else "right"
    if other in called and side not in called:
        notes.append(f"the file's name says {other}, and the card is a {side} hand's: say `--side {other}`")
    if structure.wrist:
        names = ", ".join(model.joint(joint).name for joint in structure.wrist)
        notes.append(f"a wrist: {names}, between {structure.root} and {model.body(structure.palm).name}")
    unknown = [motor.name for motor in motors if motor.effort is None]
    if unknown:
        which = "all motors" if len(unknown) == len(motors) else ", ".join(unknown)
        notes.append(f"effort unknown of {which}: the file limits no force, so in simulation none is limited, and no "
                     "share of a limit can be said; write the maker's into the card")  # fmt: skip
    notes += [f"{name}: nobody drives this joint, and it follows none; it swings freely" for name in free]
    return notes


def _touching(model: mujoco.MjModel, structure: HandStructure) -> list[tuple[str, str]]:
    """Pairs of named bodies of the hand whose shapes are inside each other at rest. MuJoCo lets a link and the next one
    through each other, but not the links on a palm that stands still."""
    root = 0 if structure.root == WORLD else model.body(structure.root).id
    return [pair for pair in touching_pairs(model) if all(pair)
            and all(not root or int(model.body_rootid[model.body(name).id]) == root for name in pair)]  # fmt: skip


def _reach(model: mujoco.MjModel, structure: HandStructure) -> float:
    """From the palm's origin to the far side of the furthest shape that ends a finger, at rest, m."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ends = [float(np.linalg.norm(data.xpos[f.body] + data.xmat[f.body].reshape(3, 3) @ f.centre
                                 - data.xpos[structure.palm])) for f in structure.fingers]  # fmt: skip
    for finger in structure.fingers:
        first = int(model.body_geomadr[finger.body])
        for geom in range(first, first + int(model.body_geomnum[finger.body])):
            far = data.geom_xpos[geom] - data.xpos[structure.palm]
            ends.append(float(np.linalg.norm(far) + model.geom_rbound[geom]))
    return max(ends)


def _moved(model: mujoco.MjModel, motors: list[ImportedMotor], path: Path) -> tuple[Array, list[str]]:
    """All joint positions, at rest, for each motor alone at places through its range, (motors, places, nq), and a note
    where a driven joint does not come to rest. Raises ConfigError where another joint does not.

    A position servo goes there. A joint with a torque motor is put there, and stands as if nothing could move it."""
    model = copy.copy(model)
    model.opt.gravity[:] = 0.0
    # Light links on stiff tendons: a file that says nothing of steps means them as our scenes take them.
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 0.001
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    held = [int(model.jnt_dofadr[motor.joint]) for motor in motors if motor.torque]
    model.dof_armature[held] = _IMMOVABLE
    model.dof_frictionloss[:] *= not held  # It would keep followers short of their places.
    own = {motor.joint for motor in motors}
    others = [int(model.jnt_qposadr[joint]) for joint in range(model.njnt) if joint not in own
              and int(model.jnt_type[joint]) in _JOINTS]  # fmt: skip
    found, worst, note = np.empty((len(motors), _POINTS, model.nq)), _MOVES, ""
    for k, motor in enumerate(motors):
        data = mujoco.MjData(model)
        for place, position in enumerate(np.linspace(motor.lower, motor.upper, _POINTS)):
            _rest(model, data, motors)
            if motor.torque:
                data.qpos[model.jnt_qposadr[motor.joint]] = position
            else:
                data.ctrl[k] = motor.command_for(position)
            if len(held) < model.nv:
                swing = _settle(model, data, held)
                words = _unrest(model, motor, position, swing, others)
                if swing[others].max(initial=0.0) >= _MOVES or np.isinf(swing).any():
                    raise ConfigError(
                        f"{path}: {words}, so nobody can say where the joints that follow are: give it more "
                        "damping or armature"
                    )
                if swing.max() >= worst:
                    worst, note = float(swing.max()), words
            found[k, place] = data.qpos
    return found, [note] if note else []


def _settle(model: mujoco.MjModel, data: mujoco.MjData, held: list[int]) -> Array:
    """Until nothing moves; how far each position still goes to and fro in the last second, (nq,): zeros at rest,
    infinite where the simulation diverges. `held`: degrees of freedom that stand where they are."""
    places, seen = model.jnt_qposadr[model.dof_jntid[held]], []
    there, looks, steps = data.qpos[places], round(_LONGEST / _LOOKS), round(_LOOKS / model.opt.timestep)
    for look in range(looks):
        each = looks - look <= _LAST  # Looks alone do not see what swings in time with them.
        for _ in range(steps if each else 1):
            mujoco.mj_step(model, data, 1 if each else steps)
            if each:
                seen.append(data.qpos.copy())
        data.qpos[places], data.qvel[held] = there, 0.0
        if any(data.warning[kind].number for kind in _DIVERGED):
            return np.full(model.nq, np.inf)
        if np.abs(data.qvel).max() < _STILL:
            return np.zeros(model.nq)
    swing: Array = np.ptp(seen, axis=0)
    swing[places] = 0.0  # Put back at each look.
    return swing


def _unrest(model: mujoco.MjModel, motor: ImportedMotor, position: float, swing: Array, others: list[int]) -> str:
    """In words: the joint that still moves furthest, one without a motor before the others, and by how much."""
    among = others if swing[others].max(initial=0.0) >= _MOVES else range(model.nq)
    place = max(among, key=lambda each: float(swing[each]))
    joint = int(np.flatnonzero(model.jnt_qposadr <= place)[-1])
    if np.isinf(swing[place]):
        return f"its simulation diverges with {motor.name} at {position:.4g}"
    return (f"{model.joint(joint).name} does not come to rest with {motor.name} at {position:.4g}: after "
            f"{_LONGEST:g} s it still moves to and fro by {swing[place]:.3g} {_unit(model, joint)}")  # fmt: skip


def _unit(model: mujoco.MjModel, joint: int) -> str:
    return "m" if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE else "rad"


def _rest(model: mujoco.MjModel, data: mujoco.MjData, motors: list[ImportedMotor]) -> None:
    """Every servo is told to stay as near to zero as it can be, and every joint with a torque motor stands there."""
    for each in motors:
        place = min(max(0.0, each.lower), each.upper)
        if each.torque:
            data.qpos[model.jnt_qposadr[each.joint]] = place
        else:
            data.ctrl[each.number] = each.command_for(place)


def _tip_paths(model: mujoco.MjModel, moves: Array, motor: int, structure: HandStructure) -> Array:
    """Where the tips are as one motor goes through its range, in the palm's frame: (places, tips, 3), m."""
    data, found = mujoco.MjData(model), []
    for qpos in moves[motor]:
        data.qpos = qpos
        mujoco.mj_kinematics(model, data)
        frame, origin = data.xmat[structure.palm].reshape(3, 3), data.xpos[structure.palm]
        rows = [data.xpos[each.body] + data.xmat[each.body].reshape(3, 3) @ each.centre - origin
                for each in structure.fingers]  # fmt: skip
        found.append(np.array(rows).reshape(-1, 3) @ frame)
    return np.array(found)


def _followers(
    model: mujoco.MjModel, motors: list[ImportedMotor], moves: Array, path: Path
) -> tuple[list[dict[str, Any]], list[str], list[str]]:
    """Joints without a motor: after which they go, and how far; those that go after none and that nothing fixes; and
    notes on what a second motor moves by a little. Raises ConfigError for a joint that follows two motors."""
    own = {motor.joint for motor in motors}
    alone = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_obj2id < 0) & model.eq_active0.astype(bool)
    fixed = {int(model.eq_obj1id[k]): float(model.eq_data[k, 0]) for k in np.flatnonzero(alone)}
    followers, free, notes = list[dict[str, Any]](), list[str](), list[str]()
    for joint in range(model.njnt):
        if joint in own or int(model.jnt_type[joint]) not in _JOINTS:
            continue
        rows = moves[:, :, model.jnt_qposadr[joint]]
        far, name, unit = np.ptp(rows, axis=1), model.joint(joint).name, _unit(model, joint)
        motor, second = int(np.argmax(far)), int(np.argsort(-far, kind="stable")[1]) if len(motors) > 1 else 0
        if far[motor] < _MOVES:
            free += [] if joint in fixed else [name]
            if abs(away := fixed.get(joint, 0.0)) > _MOVES:
                notes.append(
                    f"{name}: an equality fixes it {away:.3g} {unit} from where the file draws it; kinematics has it "
                    "as drawn, so fingertips beyond it are off: draw its body there, and delete joint and equality"
                )
            continue
        if second != motor and far[second] >= _MOVES:
            ways = [f"{motors[k].name} (by {far[k]:.3g} {unit})" for k in (motor, second)]
            if far[second] >= _SHARED * far[motor]:
                raise ConfigError(
                    f"{path}: joint {name} follows two motors, {' and '.join(ways)}, and a hand's joint follows one: "
                    "couple it to one of them, give it a motor of its own, or fix it"
                )
            notes.append(f"{name} follows {ways[0]}; that it also moves with {ways[1]} is left out")
        followers.append({"name": name, "follows": motors[motor].name, "positions": rows[motor].round(5).tolist()})
    return followers, free, notes


def _axes(
    model: mujoco.MjModel,
    structure: HandStructure,
    motors: Sequence[ImportedMotor],
    ways: Sequence[Array],
    drives: Sequence[set[int]],
) -> dict[str, list[float]]:
    """Guessed: fingers point from the palm to the tips, and the palm looks where the tips go when all motors close;
    along the fingers where these close on each other, as a gripper's do. In the root's frame."""
    wrist = set(structure.wrist)
    closing_of = [_closing(motor, way) for motor, way, own in zip(motors, ways, drives, strict=True) if not own & wrist]
    tips = np.concatenate([way[0][None] for way in ways]).reshape(-1, 3) if ways else np.empty((0, 3))
    if not len(tips):
        return {"facing": [1.0, 0.0, 0.0], "fingers": [0.0, 0.0, 1.0]}
    turn = _palm_in_root(model, structure)
    along = _nearest_axis(turn @ tips.mean(axis=0))
    across = np.array(closing_of).reshape(-1, 3) @ turn.T
    across -= np.outer(across @ along, along)
    closing = across.sum(axis=0)
    most = float(np.linalg.norm(across, axis=1).sum())
    if np.linalg.norm(closing) > max(_TOGETHER * most, 1e-3):
        return {"facing": _nearest_axis(closing).tolist(), "fingers": along.tolist()}
    side = _nearest_axis(closing) if np.linalg.norm(closing) > 1e-3 else np.roll(along, 1)
    return {"facing": along.tolist(), "fingers": side.tolist()}


def _closing(motor: ImportedMotor, way: Array) -> Array:
    """How the tips move, in the mean, as a motor goes from its place nearest zero toward its end furthest from it, m:
    by four tenths of the way, for a tip that curls on comes back to where it was."""
    places = np.linspace(motor.lower, motor.upper, len(way))
    start, end = int(np.argmin(np.abs(places))), int(np.argmax(np.abs(places)))
    if motor.lower * motor.upper < 0.0 and min(-motor.lower, motor.upper) > 0.5 * max(-motor.lower, motor.upper):
        return np.zeros(3)  # To either side alike: it spreads, it does not close.
    return np.asarray((way[start + round(0.4 * (end - start))] - way[start]).mean(axis=0))


def _palm_in_root(model: mujoco.MjModel, structure: HandStructure) -> Array:
    """The rotation from the palm's frame to the root's, at rest."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = 0 if structure.root == WORLD else model.body(structure.root).id
    return np.asarray(data.xmat[root].reshape(3, 3).T @ data.xmat[structure.palm].reshape(3, 3))


def _nearest_axis(vector: Array) -> Array:
    axis = np.zeros(3)
    largest = int(np.argmax(np.abs(vector)))
    axis[largest] = np.sign(vector[largest]) or 1.0
    return axis
