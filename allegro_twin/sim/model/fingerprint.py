"""Fingerprints of a hand's description and of a compiled scene: what physics depends on, and none of how it looks."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from allegro_twin.files.assets import data_root
from allegro_twin.files.fingerprints import fingerprint
from allegro_twin.sim.hand_import.adapt import find_mjcf
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

if TYPE_CHECKING:
    import mujoco

_LOOKS = ("mat_", "tex_", "light_", "skin_", "cam_", "name_", "names_")
"""Arrays of the compiled model that only pictures depend on, by how their names begin."""
_LOOK = ("_rgba", "_matid", "castshadow", "_pathadr", "texcoord", "texcoordadr", "texcoordnum")
"""And by how they end; paths are where files were, not what was in them."""


def model_fingerprint(model: mujoco.MjModel) -> str:
    """Fingerprint of a compiled model: all arrays, options and names but colours, materials, lights and paths. What is
    left out is listed, so that what a later MuJoCo adds counts. Floats count to single precision: compilers of two
    computers differ in the last bits of a double."""
    found: dict[str, object] = {}
    for name in dir(model):
        value = getattr(model, name)
        if name.startswith(("_", *_LOOKS)) or name.endswith(_LOOK):
            continue
        if isinstance(value, np.ndarray):
            found[name] = _single(value)
    options = {name: getattr(model.opt, name) for name in dir(model.opt) if not name.startswith("_")}
    found |= {name: _single(np.asarray(value)) for name, value in options.items() if not callable(value)}
    found |= {"meaninertia": _single(np.asarray(model.stat.meaninertia)), "names": _named(model)}
    return fingerprint(found)


def _single(array: Array) -> object:
    return array.astype(np.float32) + np.float32(0.0) if array.dtype == np.float64 else array  # -0 is 0.


def _named(model: mujoco.MjModel) -> list[str]:
    """What bodies, joints, geoms, sites, actuators and tendons are called."""
    kinds = ((model.body, model.nbody), (model.joint, model.njnt), (model.geom, model.ngeom), (model.site, model.nsite),
             (model.actuator, model.nu), (model.tendon, model.ntendon))  # fmt: skip
    return [kind(number).name for kind, count in kinds for number in range(count)]


def hand_fingerprint(spec: HandSpec) -> str:
    """Fingerprint of a hand: its spec but for the heating of its motors, on which no simulation depends, its MJCF, and
    the URDF that its own weight is carried by. The place of these files does not count. Raises ConfigError."""
    models = data_root() / "models"
    files = [models / "mjcf" / f"{spec.name}.xml", models / "urdf" / f"{spec.name}.urdf"]
    if spec.foreign is not None:
        files = [find_mjcf(spec)]
    foreign = None if spec.foreign is None else replace(spec.foreign, mjcf="")
    return fingerprint(replace(spec, card="", foreign=foreign, thermal=None), files)
