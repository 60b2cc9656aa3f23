"""In which order a file gives the joints: by their names, or, where it has none, by what the numbers can be."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import HAND
from allegro_twin.spec import Finger, HandSpec
from allegro_twin.types import Array

TOLERANCE = 0.05
"""rad that a closed posture may lie outside the limits: an optimiser's rest, or another version of the hand."""
_HANDS = {22: "a Shadow Hand's, as in DexGraspNet and BODex", 12: "a Barrett or Inspire hand's, say"}
"""By their number of joints."""


def joint_orders(spec: HandSpec) -> dict[str, tuple[int, ...]]:
    """The orders in which others list this hand's joints, as indices of the spec's."""
    fingers = list(spec.fingers)
    in_tree = sorted(fingers, key=lambda finger: spec.joints[finger.joints[0]])
    longest = max(len(finger.joints) for finger in fingers)
    layers = [f.joints[place] for place in range(longest) for f in fingers if place < len(f.joints)]
    by_id = sorted((identifier, joint) for joint, identifier in enumerate(_servo_ids(spec)))
    return (
        {
            "fingers": _joined(fingers),  # Menagerie, DexGraspBench, BODex, the manufacturer.
            "tree": _joined(in_tree),  # Isaac Gym, Pinocchio: the fingers by their names in the URDF.
            "breadth": tuple(dict.fromkeys(layers)),  # Isaac Lab, SAPIEN: all first joints, then all second ones.
            "thumb_first": _joined([*fingers[-1:], *fingers[:-1]]),
            "mirrored": _joined([*fingers[-2::-1], *fingers[-1:]]),  # Menagerie's left hand: from ring to index.
        }
        | ({"servos": tuple(joint for _, joint in by_id)} if by_id else {})
    )  # A LEAP Hand's own program.


def _servo_ids(spec: HandSpec) -> tuple[int, ...]:
    """Servo ids in the spec's order, for a hand whose joints have a servo each; else empty."""
    path = data_root() / "conf" / "hands" / f"{spec.model}.yaml"
    servos = read_yaml(path).get("servos") if path.is_file() else None
    ids = servos.get("ids", ()) if isinstance(servos, Mapping) else ()
    return tuple(ids) if len(ids) == spec.n_joints and not spec.followers else ()


def menagerie_order(spec: HandSpec) -> str:
    """The order of MuJoCo's joint positions with Menagerie's file of that side."""
    return "fingers" if spec.side == "right" else "mirrored"


def order_by_name(
    names: Sequence[str], spec: HandSpec, where: str, known: Mapping[str, int] | None = None
) -> tuple[int, ...]:
    """Where in the spec's order each of a file's joints is. Raises ConfigError for names of another hand, and joints
    that are missing, come twice or follow others. `known`: `joint_names` of the spec, for whoever asks often."""
    known = joint_names(spec) if known is None else known
    found, coupled = [], {each.name for each in spec.followers}
    for name in names:
        bare = name.rsplit("/", 1)[-1].rsplit(":", 1)[-1]
        if bare in coupled:
            raise ConfigError(f"{where}: {name!r} follows another joint of {spec.name}: {_leave_out(spec)}")
        if bare not in known:
            raise ConfigError(f"{where}: {name!r} is no joint of {spec.name}: is it another hand's grasp (--hand)?")
        found.append(known[bare])
    if sorted(found) != list(range(spec.n_joints)):
        missing = [spec.joint_labels[j] for j in range(spec.n_joints) if found.count(j) != 1]
        raise ConfigError(f"{where}: each joint of {spec.name} once; missing or twice: {', '.join(missing)}")
    return tuple(found)


def reorder_joints(joints: Array, spec: HandSpec, where: str, order: str | tuple[int, ...] | None = None) -> Array:
    """Joint positions (k, s, m) in the spec's order, (k, s, n), rad.

    `order`: the name of one of `joint_orders`, or the spec's index of each. Without one they are taken to be in the
    spec's order as long as the closed postures fit its limits. Raises ConfigError for another number of joints, an
    order that is none, and joints out of range: which, by how much, and which order would fit.
    """
    width = joints.shape[-1]
    if width != spec.n_joints:
        if spec.followers and width == len(spec.all_joints):
            raise ConfigError(
                f"{where}: {width} joints, of which {spec.name} drives {spec.n_joints}: {_leave_out(spec)}"
            )
        whose = _HANDS.get(width, "another hand's")
        raise ConfigError(f"{where}: {width} joints; {spec.name} has {spec.n_joints}: they are {whose} (--hand)")
    if isinstance(order, str) and order not in joint_orders(spec):
        raise ConfigError(f"{where}: {unknown('order of joints', order, joint_orders(spec))}")
    given = joint_orders(spec)[order] if isinstance(order, str) else order
    if given is not None and sorted(given) != list(range(width)):
        raise ConfigError(f"{where}: an order has each number from 0 to {width - 1} once, not {list(given)}")
    found = permute_joints(joints, given) if given is not None else joints
    _in_range(found, joints, spec, where)
    return found


def _leave_out(spec: HandSpec) -> str:
    """What to do about joints that follow others."""
    return f"leave out those that follow; it has {', '.join(spec.joints)}"


def permute_joints(joints: Array, order: Sequence[int]) -> Array:
    """From a file's order to the spec's: column i of the file is the spec's joint order[i]."""
    return joints[..., np.argsort(np.asarray(order))]


def limit_excess(joints: Array, spec: HandSpec) -> Array:
    """How far outside its limits each joint is, rad; 0 inside."""
    over: Array = np.maximum(np.maximum(spec.lower - joints, joints - spec.upper), 0.0)
    return over


def check_limits(joints: Array, spec: HandSpec, where: str) -> None:
    """Raises ConfigError for joints (k, s, n), rad, of which a closed posture is more than `TOLERANCE` outside the
    limits, or any posture so far that its numbers are no radians."""
    _in_range(joints, None, spec, where)


def _in_range(found: Array, given: Array | None, spec: HandSpec, where: str) -> None:
    """`given`: the same in the file's order; None: the file has them by name."""
    allowed = np.empty(found.shape[1:])
    allowed[:] = np.maximum(np.pi, 2.0 * (spec.upper - spec.lower))
    allowed[-2] = TOLERANCE
    over = limit_excess(found, spec)
    beyond = over - allowed
    if beyond.size == 0 or not beyond.max() > 0.0:  # NaN is somebody else's to report.
        return
    grasp, stage, joint = np.unravel_index(int(beyond.argmax()), beyond.shape)
    fitting = [] if given is None else _fitting_orders(given, spec)
    way_out = (
        f"its numbers fit the order {' or '.join(repr(name) for name in fitting)}: say order={fitting[0]!r}"
        if fitting
        else f"no known order of {spec.name}'s joints fits: is it another hand's (--hand), or in degrees?"
        if given is not None
        else "is it in degrees?"
    )
    stages = found.shape[1]
    named = {stages - 3: " preshape:", stages - 1: " squeeze:"}.get(int(stage), "")
    raise ConfigError(
        f"{where}: grasp {grasp}:{named} {spec.joint_labels[joint]} = {found[grasp, stage, joint]:.4g} rad is "
        f"{over[grasp, stage, joint]:.4g} rad outside its limits [{spec.lower[joint]:.3f}, {spec.upper[joint]:.3f}]; "
        f"{way_out}"
    )


def _fitting_orders(given: Array, spec: HandSpec) -> list[str]:
    """Names of the orders in which the closed postures fit the limits."""
    orders = joint_orders(spec).items()
    return [n for n, o in orders if limit_excess(permute_joints(given, o)[:, -2], spec).max() <= TOLERANCE]


def _joined(fingers: Iterable[Finger]) -> tuple[int, ...]:
    """One after the other; a joint of several fingers once."""
    return tuple(dict.fromkeys(joint for finger in fingers for joint in finger.joints))


def joint_names(spec: HandSpec) -> dict[str, int]:
    """Every name of a joint that is known: ours, the URDF's, Menagerie's, NVIDIA's (`index_joint_0`), and, of a hand of
    servos, their ids, by which the URDF of a LEAP Hand calls its joints (`1`, `joint_1`)."""
    foreign = spec.foreign
    if spec.model == HAND:
        foreign = load_spec(spec.model, spec.side, f"menagerie_{spec.side}").foreign
    theirs = foreign.joints if foreign is not None else ()
    found = {name: j for names in (spec.joints, spec.aliases, theirs) for j, name in enumerate(names)}
    for finger in spec.fingers:
        for place, joint in enumerate(finger.joints):
            found.setdefault(f"{finger.name}_joint_{place}", joint)
    for joint, identifier in enumerate(_servo_ids(spec)):
        found.setdefault(str(identifier), joint)
        found.setdefault(f"joint_{identifier}", joint)
    return found
