"""Things of a household that no grasp was made for, as closed meshes: made by code, of shapes that a lab has.

`write_things(folder)` writes an STL a thing, in m, as it lies or stands on a table. Sizes are of what we have at home,
masses those that such things weigh; they are no catalogue's. `THINGS` are the first ten, `MORE` twelve that were made
later, when planning was as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import trimesh
from trimesh.transformations import rotation_matrix, translation_matrix

Mesh: TypeAlias = Any
"""A `trimesh.Trimesh`; that library has no types."""


class Thing(NamedTuple):
    """A mesh to be, and how heavy it is."""

    mass: float
    """kg."""
    make: Callable[[], Mesh]


def write_things(folder: Path, things: Mapping[str, Thing]) -> dict[str, tuple[Path, float]]:
    """Path and mass, kg, of each by name; its lowest point at 0, its middle over 0."""
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for name, thing in things.items():
        mesh = thing.make()
        low, high = mesh.bounds
        mesh.apply_translation([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])
        assert mesh.is_watertight, name
        path = folder / f"{name}.stl"
        mesh.export(path)
        found[name] = (path, thing.mass)
    return found


def _box(size: tuple[float, float, float], at: tuple[float, float, float], lean: float = 0.0) -> Mesh:
    turned = rotation_matrix(np.radians(lean), [0, 1, 0])
    return trimesh.creation.box(size, transform=translation_matrix(at) @ turned)


def _rod(radius: float, length: float, at: tuple[float, float, float], along: str = "z") -> Mesh:
    turn = {"x": rotation_matrix(np.pi / 2, [0, 1, 0]), "y": rotation_matrix(np.pi / 2, [1, 0, 0]), "z": np.eye(4)}
    return trimesh.creation.cylinder(radius, length, sections=48, transform=translation_matrix(at) @ turn[along])


def _joined(*parts: Mesh) -> Mesh:
    return trimesh.boolean.union(list(parts), engine="manifold")


def _drill() -> Mesh:
    """Stands on its battery."""
    return _joined(
        _box((0.11, 0.075, 0.045), (0.0, 0.0, 0.0225)),
        _box((0.042, 0.034, 0.12), (0.0, 0.0, 0.1), lean=8.0),
        _rod(0.029, 0.15, (0.015, 0.0, 0.18), "x"),
        _rod(0.016, 0.04, (0.105, 0.0, 0.18), "x"),
    )


def _screwdriver() -> Mesh:
    return _joined(_rod(0.015, 0.10, (0.0, 0.0, 0.015), "x"), _rod(0.0035, 0.13, (0.11, 0.0, 0.015), "x"))


def _bowl() -> Mesh:
    angles = np.linspace(0.0, 1.25, 24)
    outer = np.stack([0.079 * np.sin(angles), 0.079 * (1.0 - np.cos(angles))], axis=1)
    inner = np.stack([0.074 * np.sin(angles), 0.079 - 0.074 * np.cos(angles)], axis=1)[::-1]
    return trimesh.creation.revolve(np.vstack([outer, inner]), sections=64)


def _spray_bottle() -> Mesh:
    return _joined(
        _rod(0.036, 0.15, (0.0, 0.0, 0.075)), _rod(0.014, 0.05, (0.0, 0.0, 0.165)),
        _box((0.085, 0.026, 0.032), (0.018, 0.0, 0.2)), _box((0.012, 0.018, 0.05), (0.045, 0.0, 0.172), lean=-15.0),
    )  # fmt: skip


def _stapler() -> Mesh:
    return _joined(
        _box((0.15, 0.038, 0.014), (0.0, 0.0, 0.007)), _box((0.14, 0.03, 0.026), (-0.003, 0.0, 0.034), lean=4.0),
        _box((0.03, 0.03, 0.03), (-0.058, 0.0, 0.022)),
    )  # fmt: skip


def _dumbbell() -> Mesh:
    heads = [_rod(0.033, 0.035, (side * 0.072, 0.0, 0.033), "x") for side in (-1.0, 1.0)]
    return _joined(_rod(0.0145, 0.12, (0.0, 0.0, 0.033), "x"), *heads)


def _hammer() -> Mesh:
    return _joined(_rod(0.014, 0.24, (0.0, 0.0, 0.016), "x"), _box((0.03, 0.10, 0.032), (0.125, 0.0, 0.016)))


def _banana() -> Mesh:
    """A bent rod that lies on its side, thinner at its ends."""
    angles = np.linspace(-0.85, 0.85, 13)
    parts = []
    for angle in angles:
        radius = 0.0175 - 0.008 * (angle / 0.85) ** 4
        ball = trimesh.creation.icosphere(3, radius)
        ball.apply_translation([0.1 * np.sin(angle), 0.1 * np.cos(angle), 0.0175])
        parts.append(ball)
    hulls = [trimesh.util.concatenate(pair).convex_hull for pair in pairwise(parts)]
    return _joined(*hulls)


def _wine_glass() -> Mesh:
    outer = [(0.0, 0.0), (0.034, 0.0), (0.034, 0.003), (0.006, 0.008), (0.0045, 0.07), (0.012, 0.078), (0.031, 0.1),
             (0.036, 0.125), (0.031, 0.165)]  # fmt: skip
    inner = [(0.029, 0.165), (0.034, 0.125), (0.029, 0.102), (0.01, 0.082), (0.0, 0.08)]
    return trimesh.creation.revolve(np.array([*outer, *inner]), sections=48)


def _padlock() -> Mesh:
    """Lies on its back."""
    ring = trimesh.creation.torus(0.0165, 0.0045, transform=translation_matrix((0.0, 0.03, 0.0125)))
    return _joined(_box((0.052, 0.05, 0.025), (0.0, 0.0, 0.0125)), ring)


THINGS = {
    "drill": Thing(0.9, _drill), "screwdriver": Thing(0.12, _screwdriver), "bowl": Thing(0.2, _bowl),
    "spray_bottle": Thing(0.45, _spray_bottle), "stapler": Thing(0.25, _stapler), "dumbbell": Thing(0.8, _dumbbell),
    "hammer": Thing(0.4, _hammer), "banana": Thing(0.15, _banana), "wine_glass": Thing(0.15, _wine_glass),
    "padlock": Thing(0.25, _padlock),
}  # fmt: skip


def _above_table(mesh: Mesh) -> Mesh:
    return trimesh.boolean.intersection([mesh, _box((1.0, 1.0, 0.5), (0.0, 0.0, 0.25))], engine="manifold")


def _ellipsoid(radii: tuple[float, float, float], at: tuple[float, float, float]) -> Mesh:
    mesh = trimesh.creation.icosphere(4, 1.0)
    mesh.apply_scale(radii)
    mesh.apply_translation(at)
    return mesh


def _ring(radius: float, thick: float, at: tuple[float, float, float]) -> Mesh:
    """Upright, its axis along y."""
    turned = translation_matrix(at) @ rotation_matrix(np.pi / 2, [1, 0, 0])
    return trimesh.creation.torus(radius, thick, transform=turned)


def _turned(profile: Sequence[tuple[float, float]]) -> Mesh:
    return trimesh.creation.revolve(np.array(profile), sections=48)


def _teapot() -> Mesh:
    spout = translation_matrix((0.075, 0.0, 0.075)) @ rotation_matrix(0.7, [0, 1, 0])
    return _joined(
        _ellipsoid((0.065, 0.065, 0.055), (0.0, 0.0, 0.055)), _rod(0.04, 0.01, (0.0, 0.0, 0.005)),
        trimesh.creation.cylinder(0.011, 0.07, sections=32, transform=spout),
        _ring(0.03, 0.006, (-0.075, 0.0, 0.06)), _rod(0.012, 0.02, (0.0, 0.0, 0.117)),
    )  # fmt: skip


def _shoe() -> Mesh:
    upper = _above_table(_ellipsoid((0.13, 0.045, 0.04), (0.0, 0.0, 0.03)))
    return _joined(upper, _rod(0.036, 0.06, (-0.075, 0.0, 0.06)), _box((0.25, 0.085, 0.012), (0.0, 0.0, 0.006)))


def _remote() -> Mesh:
    return _box((0.17, 0.045, 0.02), (0.0, 0.0, 0.01))


def _torch() -> Mesh:
    """Lies on its side."""
    return _joined(_rod(0.016, 0.12, (0.0, 0.0, 0.025), "x"), _rod(0.025, 0.045, (0.075, 0.0, 0.025), "x"))


def _shampoo() -> Mesh:
    body = trimesh.creation.cylinder(1.0, 0.16, sections=64)
    body.apply_scale((0.04, 0.024, 1.0))
    body.apply_translation((0.0, 0.0, 0.08))
    return _joined(body, _rod(0.014, 0.03, (0.0, 0.0, 0.172)))


def _bulb() -> Mesh:
    profile = [(0.0, 0.0), (0.012, 0.0), (0.0135, 0.005), (0.0135, 0.03), (0.02, 0.045), (0.03, 0.07), (0.03, 0.085)]
    return _turned([*profile, (0.022, 0.104), (0.008, 0.112), (0.0, 0.113)])


def _mouse() -> Mesh:
    return _above_table(_ellipsoid((0.06, 0.032, 0.036), (0.0, 0.0, 0.0)))


def _jar() -> Mesh:
    return _joined(_rod(0.042, 0.12, (0.0, 0.0, 0.06)), _rod(0.036, 0.03, (0.0, 0.0, 0.13)))


def _toy_car() -> Mesh:
    axles = [_rod(0.018, 0.07, (x, 0.0, 0.018), "y") for x in (-0.045, 0.045)]
    return _joined(_box((0.14, 0.06, 0.03), (0.0, 0.0, 0.03)), _box((0.07, 0.055, 0.03), (-0.01, 0.0, 0.058)), *axles)


def _book() -> Mesh:
    """Stands."""
    return _box((0.05, 0.13, 0.19), (0.0, 0.0, 0.095))


def _kettlebell() -> Mesh:
    ball = _ellipsoid((0.042, 0.042, 0.042), (0.0, 0.0, 0.04))
    return _joined(ball, _rod(0.025, 0.01, (0.0, 0.0, 0.005)), _ring(0.032, 0.010, (0.0, 0.0, 0.1)))


def _saucepan() -> Mesh:
    pot = _turned([(0.0, 0.0), (0.06, 0.0), (0.06, 0.07), (0.056, 0.07), (0.056, 0.004), (0.0, 0.004)])
    return _joined(pot, _box((0.14, 0.022, 0.014), (0.125, 0.0, 0.055)))


MORE = {
    "teapot": Thing(0.35, _teapot), "shoe": Thing(0.3, _shoe), "remote": Thing(0.12, _remote),
    "torch": Thing(0.2, _torch), "shampoo": Thing(0.35, _shampoo), "bulb": Thing(0.06, _bulb),
    "mouse": Thing(0.1, _mouse), "jar": Thing(0.6, _jar), "toy_car": Thing(0.2, _toy_car),
    "book": Thing(0.5, _book), "kettlebell": Thing(0.6, _kettlebell), "saucepan": Thing(0.5, _saucepan),
}  # fmt: skip
