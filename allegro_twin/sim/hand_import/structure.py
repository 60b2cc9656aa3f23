"""The structure of a hand in a MuJoCo model, by ancestry: palm, wrist, fingers, and which motor moves which of them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.sim.hand_import.adapt import WORLD
from allegro_twin.types import Array

WRIST = 3
"""Most joints between the root and the palm; an arm has more."""
_SINGLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_WORDS = {
    "thumb": ("thumb", "th"), "index": ("index", "ff", "if"), "middle": ("middle", "mf"), "ring": ("ring", "rf"),
    "little": ("little", "pinky", "pinkie", "lf", "pf"),
}  # fmt: skip
"""Fingers, and what they are called in names of bodies and joints."""
_PARTS = re.compile(r"(j?\d+|tip|dist|prox|mid|knuck|base|meta|hub|mcp|pip|dip|rot|axl).*")
"""What may follow a finger's initials in a word."""
TipSource = Literal["site", "frame", "shape", "nothing"]
"""A site that is called after the finger, an empty body at its end, the shape of its last link, or nothing of these."""


@dataclass(frozen=True, slots=True)
class FingerStructure:
    """One chain from the palm to a link without moving descendants; links that a loop closes belong to one chain."""

    name: str
    joints: tuple[int, ...]
    """All its joints, from the palm outward, by id; also those that follow or swing."""
    body: int
    """The body that ends it."""
    centre: Array
    """The fingertip's centre in that body's frame, (3,), m."""
    tip_by: TipSource
    """What says where the fingertip is."""
    guessed: bool
    """Whether its name is a guess."""


@dataclass(frozen=True, slots=True)
class HandStructure:
    """Palm, wrist and fingers of a hand."""

    root: str
    """The body that stands still; `world` for fingers that hang on the world."""
    palm: int
    """The last body before the chains branch."""
    wrist: tuple[int, ...]
    """Joints between the root and the palm, by id."""
    fingers: tuple[FingerStructure, ...]


def find_structure(
    model: mujoco.MjModel,
    path: Path,
    root: str | None = None,
    palm: str | None = None,
    fingers: Mapping[str, str] | None = None,
) -> HandStructure:
    """Palm, wrist and fingers of the hand in a model.

    `root`: the body that stands still; None: the only one under the world on which something moves. `palm`: the body
    where the fingers begin; None: the last before the chains branch. `fingers`: for each name the body that ends the
    finger; what it does not name is guessed: every link without moving descendants ends one. Raises ConfigError for an
    arm, and for what needs to be said by `root`.
    """
    links = _Links(model)
    top = _root(model, links, path, root)
    start = top if palm is None else _body(model, path, "palm", palm)
    if palm is None:
        while len(below := links.children(links.of(start))) == 1:
            start = below[0]
    wrist = links.joints_between(top, start)
    found = links.children(links.of(start))
    if palm is None and not found:  # One chain that never branches.
        chain = wrist
        if len(chain) > WRIST + 1:
            raise ConfigError(
                f"{path}: {len(chain)} joints in one chain and no fingers: an arm, not a hand; --palm BODY says "
                "where fingers begin"
            )
        start, wrist, found = top, (), links.children(links.of(top))
    if len(wrist) > WRIST:
        raise ConfigError(
            f"{path}: {len(wrist)} joints before the palm ({model.body(start).name}): an arm with a hand; cut the hand "
            "out into a file of its own, or say with --root and --palm which bodies are the hand's"
        )
    ends = _ends(model, links, links.of(start), path, fingers)
    return HandStructure(model.body(top).name if top else WORLD, start, wrist, _named(model, links, start, ends))


class _Links:
    """The tree of links: bodies that joints connect; what is fixed to a body is of its link."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._of = [int(each) for each in model.body_weldid]
        self.bodies: dict[int, list[int]] = {}
        for body, link in enumerate(self._of):
            self.bodies.setdefault(link, []).append(body)
        self.parent = {link: self._of[int(model.body_parentid[link])] for link in self.bodies if link}
        self.depth = {0: 0}
        for link in sorted(self.parent):
            self.depth[link] = self.depth[self.parent[link]] + 1

    def of(self, body: int) -> int:
        """The link that a body is fixed to: its first body."""
        return self._of[body]

    def children(self, link: int) -> list[int]:
        """Links that hang on it by joints of one degree of freedom."""
        return [each for each, parent in self.parent.items() if parent == link and not self.free(each)]

    def free(self, link: int) -> bool:
        """Whether it floats: an object, not a part of a hand."""
        return any(int(self.model.jnt_type[joint]) not in _SINGLE for joint in self.joints(link))

    def joints(self, link: int) -> range:
        first, count = int(self.model.body_jntadr[link]), int(self.model.body_jntnum[link])
        return range(first, first + count) if count else range(0)

    def path(self, top: int, link: int) -> list[int]:
        """Links after `top` down to `link`."""
        found = []
        while link not in (top, 0):
            found.append(link)
            link = self.parent[link]
        return found[::-1]

    def joints_between(self, top: int, body: int) -> tuple[int, ...]:
        return tuple(joint for link in self.path(self.of(top), self.of(body)) for joint in self.joints(link))

    def leaves(self, link: int) -> list[int]:
        """Links below without links on them."""
        below = self.children(link)
        return [leaf for each in below for leaf in (self.leaves(each) or [each])]


def _root(model: mujoco.MjModel, links: _Links, path: Path, root: str | None) -> int:
    tops = [body for body in range(1, model.nbody) if model.body_parentid[body] == 0]
    if root is not None:
        if root == WORLD:
            return 0
        found = _body(model, path, "root", root)
        if found not in tops:
            outer = model.body(int(model.body_rootid[found])).name
            raise ConfigError(f"{path}: --root {root} hangs on other bodies; take {outer}, and say --palm {root}")
        _check_held(model, links, found, path)
        return found
    if len(tops) == 1:
        _check_free(model, links, tops[0], path)
    moving = [top for top in tops if any(int(model.body_rootid[model.jnt_bodyid[j]]) == top for j in range(model.njnt))]
    bodies = [top for top in moving if not links.free(links.of(top))]
    if len(moving) == 1 and bodies:
        if not model.body(moving[0]).name:
            raise ConfigError(f"{path}: the hand's first body has no name: give it one")
        return moving[0] if not links.joints(moving[0]) else 0
    chains = all(len(_branches(links, top, model)) < 2 for top in bodies)
    if len(bodies) > 1 and len(bodies) == len(moving) and chains:
        return 0  # Fingers that hang on the world.
    names = [model.body(b).name or "(unnamed)" for b in moving]
    raise ConfigError(f"{path} has {len(moving)} things that move ({', '.join(names)}): say which with --root")


def _check_free(model: mujoco.MjModel, links: _Links, body: int, path: Path) -> None:
    """Raises ConfigError for a palm that floats."""
    if links.free(links.of(body)):
        name = model.body(body).name or "the first body"
        raise ConfigError(f"{path}: {name} floats, and a palm is held: remove the freejoint of {name}")


def _check_held(model: mujoco.MjModel, links: _Links, root: int, path: Path) -> None:
    """Raises ConfigError for a root that moves."""
    _check_free(model, links, root, path)
    if joints := links.joints(links.of(root)):
        name = model.body(root).name
        raise ConfigError(
            f"{path}: --root {name} moves by its joint {model.joint(joints[0]).name}, and a root is held: leave --root "
            "out, or say --root world"
        )


def _branches(links: _Links, top: int, model: mujoco.MjModel) -> list[int]:
    """Leaves below a body under the world."""
    firsts = [link for link, parent in links.parent.items()
              if parent == 0 and int(model.body_rootid[link]) == top and not links.free(link)]  # fmt: skip
    return [leaf for first in firsts for leaf in (links.leaves(first) or [first])]


def _body(model: mujoco.MjModel, path: Path, what: str, name: str) -> int:
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if number < 0:
        names = [model.body(k).name for k in range(1, model.nbody)]
        raise ConfigError(f"{path}: --{what}: {unknown('body', name, [each for each in names if each])}")
    return int(number)


def _ends(
    model: mujoco.MjModel, links: _Links, palm: int, path: Path, fingers: Mapping[str, str] | None
) -> list[tuple[str, list[int]]]:
    """The leaves that end each finger, and its given name; leaves that a loop joins are one finger's."""
    leaves = links.leaves(palm)
    groups = {leaf: {leaf} for leaf in leaves}
    for first, second in _loops(model):
        one, other = (_leaf(links, leaves, links.of(body)) for body in (first, second))
        if one is None or other is None or groups[one] is groups[other]:
            continue
        groups[one] |= groups[other]
        for leaf in groups[other]:
            groups[leaf] = groups[one]
    found = [sorted(group) for group in {id(group): group for group in groups.values()}.values()]
    named: dict[tuple[int, ...], str] = {}
    for name, body in (fingers or {}).items():
        end = _leaf(links, leaves, links.of(_body(model, path, f"finger {name}", body)))
        if end is None:
            ends = ", ".join(model.body(links.bodies[leaf][-1]).name for leaf in leaves)
            raise ConfigError(
                f"{path}: --finger {name}={body}: {body} is no part of one finger on the palm; their ends are {ends}"
            )
        group = tuple(sorted(groups[end]))
        if group in named:
            raise ConfigError(f"{path}: --finger {name}={body} is the finger that is {named[group]} already")
        named[group] = name
    return [(named.get(tuple(group), ""), group) for group in sorted(found)]


def _leaf(links: _Links, leaves: Sequence[int], link: int) -> int | None:
    """The only leaf at or below a link."""
    below = [leaf for leaf in leaves if leaf == link or link in links.path(0, leaf)]
    return below[0] if len(below) == 1 else None


def _loops(model: mujoco.MjModel) -> Iterable[tuple[int, int]]:
    """Pairs of bodies that `connect` or `weld` holds together, where it is not switched off."""
    kinds = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
    for k in range(model.neq):
        if int(model.eq_type[k]) in kinds and model.eq_active0[k]:
            if int(model.eq_objtype[k]) == int(mujoco.mjtObj.mjOBJ_SITE):
                yield int(model.site_bodyid[model.eq_obj1id[k]]), int(model.site_bodyid[model.eq_obj2id[k]])
            else:
                yield int(model.eq_obj1id[k]), int(model.eq_obj2id[k])


def _named(
    model: mujoco.MjModel, links: _Links, palm: int, ends: Sequence[tuple[str, list[int]]]
) -> tuple[FingerStructure, ...]:
    found: list[tuple[str, tuple[int, ...], int, bool]] = []
    for given, leaves in ends:
        joints = sorted({joint for leaf in leaves for joint in links.joints_between(palm, leaf)},
                        key=lambda joint: (links.depth[links.of(int(model.jnt_bodyid[joint]))], joint))  # fmt: skip
        last = max(leaves, key=lambda leaf: (_tip_rank(model, links, leaf), leaf))
        found.append((given or _word(model, links, palm, leaves), tuple(joints), last, not given))
    names = _unique([each[0] for each in found])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return tuple(
        FingerStructure(names[k], found[k][1], *_tip(model, data, links, found[k][2], names[k]), found[k][3])
        for k in sorted(range(len(found)), key=lambda k: (_rank(names[k]), k))
    )


def _tip_rank(model: mujoco.MjModel, links: _Links, leaf: int) -> tuple[int, float]:
    """How likely a leaf of a loop ends the finger: the deepest, then the furthest from where the chain begins."""
    return links.depth[leaf], float(np.linalg.norm(model.body_pos[leaf]))


def _tip(
    model: mujoco.MjModel, data: mujoco.MjData, links: _Links, link: int, finger: str
) -> tuple[int, Array, TipSource]:
    """The body that ends a link, the middle of what it touches with in that body's frame, and what says so."""
    bodies = links.bodies[link]
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"{finger}_tip")
    if site >= 0 and int(model.site_bodyid[site]) in bodies:
        return int(model.site_bodyid[site]), np.array(model.site_pos[site]), "site"
    deepest = bodies[-1]
    if deepest != link and not model.body_geomnum[deepest]:
        return deepest, np.zeros(3), "frame"
    shapes = [geom for body in bodies for geom in _shapes(model, body)]
    if not shapes:
        return deepest, np.zeros(3), "nothing"
    joints = links.joints(link)
    start = data.xanchor[joints[-1]] if joints else data.xpos[link]
    furthest = max(shapes, key=lambda geom: float(np.linalg.norm(data.geom_xpos[geom] - start)))
    body, along = int(model.geom_bodyid[furthest]), data.geom_xpos[furthest] - start
    if joints and model.jnt_type[joints[-1]] == mujoco.mjtJoint.mjJNT_HINGE:
        across = along - data.xaxis[joints[-1]] * (along @ data.xaxis[joints[-1]])
        along = across if np.linalg.norm(across) > 0.5 * np.linalg.norm(along) else along
    last = max(_shapes(model, body), key=lambda geom: _support(model, data, geom, along))
    place = data.geom_xpos[last] + data.geom_xmat[last].reshape(3, 3) @ _pad(model, data, last, along)
    return body, data.xmat[body].reshape(3, 3).T @ (place - data.xpos[body]), "shape"


def _shapes(model: mujoco.MjModel, body: int) -> list[int]:
    """A body's shapes that touch; where none does, all."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    geoms = list(range(first, first + count))
    return [geom for geom in geoms if model.geom_contype[geom] or model.geom_conaffinity[geom]] or geoms


def _support(model: mujoco.MjModel, data: mujoco.MjData, geom: int, along: Array) -> float:
    """How far a shape goes along a direction, of any length, in the world's frame."""
    local, size = np.abs(data.geom_xmat[geom].reshape(3, 3).T @ along), model.geom_size[geom]
    match int(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_MESH:
            own = float((_vertices(model, geom) @ (data.geom_xmat[geom].reshape(3, 3).T @ along)).max())
        case mujoco.mjtGeom.mjGEOM_BOX:
            own = float(size @ local)
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            own = float(np.linalg.norm(size * local))
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            own = float(size[1] * local[2] + size[0] * np.hypot(local[0], local[1]))
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            own = float(size[1] * local[2] + size[0] * np.linalg.norm(along))
        case _:
            own = float(size[0] * np.linalg.norm(along))
    return own + float(data.geom_xpos[geom] @ along)


def _pad(model: mujoco.MjModel, data: mujoco.MjData, geom: int, along: Array) -> Array:
    """The middle of a shape's last part along a direction, in the shape's frame, (3,), m: before its end by half of its
    thickness, as a sphere's middle is."""
    local, size = data.geom_xmat[geom].reshape(3, 3).T @ along, np.array(model.geom_size[geom])
    place, axis = np.zeros(3), int(np.argmax(np.abs(local)))
    match int(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_MESH:
            return _mesh_pad(_vertices(model, geom), local) if local.any() else place
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            place[2] = np.sign(local[2]) * size[1]
        case mujoco.mjtGeom.mjGEOM_BOX | mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            place[axis] = np.sign(local[axis]) * (size[axis] - size.min())
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            size = size[[0, 0, 1]]
            place[axis] = np.sign(local[axis]) * (size[axis] - size.min())
    return place


def _mesh_pad(vertices: Array, along: Array) -> Array:
    """That of a mesh: the part that counts is about as long as half of its own thickness."""
    along = along / np.linalg.norm(along)
    first = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    first /= np.linalg.norm(first)
    second, turns = np.cross(along, first), np.linspace(0.0, np.pi, 36, endpoint=False)
    across = np.outer(np.cos(turns), first) + np.outer(np.sin(turns), second)  # (36, 3)
    places = vertices @ along
    half = 0.5 * float(np.ptp(places))
    for _ in range(2):
        last = vertices[places >= places.max() - half]
        half = min(half, 0.5 * float(np.ptp(last @ across.T, axis=0).min()))
    middle = [0.5 * float((last @ each).min() + (last @ each).max()) for each in (first, second)]
    return np.asarray((places.max() - half) * along + middle[0] * first + middle[1] * second)


def _vertices(model: mujoco.MjModel, geom: int) -> Array:
    mesh = int(model.geom_dataid[geom])
    first = int(model.mesh_vertadr[mesh])
    return np.asarray(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], float)


def _word(model: mujoco.MjModel, links: _Links, palm: int, leaves: Sequence[int]) -> str:
    """A finger's name by the names of its bodies and joints: the anatomical one where they tell, else what they have in
    common, else its first body's."""
    path = [link for leaf in leaves for link in links.path(links.of(palm), leaf)]
    bodies = [model.body(body).name for link in path for body in links.bodies[link] if model.body(body).name]
    names = bodies + [model.joint(joint).name for link in path for joint in links.joints(link)]
    votes = [finger for name in names for word in _words(name) if (finger := _anatomical(word))]
    if votes.count("middle") == 1 and not any({"middle", "tip"} <= {*_words(name)} for name in names):
        votes.remove("middle")  # It is a phalanx, too.
    if votes:
        return max(dict.fromkeys(votes), key=votes.count)
    alike = [len(set(words)) == 1 for words in zip(*map(_words, bodies), strict=False)]
    common = _words(bodies[0])[: [*alike, False].index(False)] if bodies else []
    while common and len(set(bodies)) > 1 and common[-1] in ("finger", "link"):
        common.pop()
    return "_".join(common or _words(bodies[0])) if bodies else "finger"


def _words(name: str) -> list[str]:
    """The words of a name, in lower case, of any alphabet."""
    return re.findall(r"[^\W_]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower())


def _anatomical(word: str) -> str:
    for finger, names in _WORDS.items():
        for name in names:
            rest = word.removeprefix(name)
            if rest != word and (not rest or len(name) > 2 or _PARTS.fullmatch(rest)):
                return finger
    return ""


def _unique(names: Sequence[str]) -> list[str]:
    """Each name once: equal ones are numbered."""
    return [f"{name}_{names[:k].count(name) + 1}" if names.count(name) > 1 else name for k, name in enumerate(names)]


def _rank(name: str) -> int:
    """Fingers from the index on, the thumb last; others as they come."""
    order = ["index", "middle", "ring", "little", "thumb"]
    return order.index(name) if name in order else -1
