"""Retargeting by dex-retargeting: from where fingertips should be to joint positions."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.teleop.targets import TargetVectors
from allegro_twin.types import Array, Vector

_SMOOTH = 0.5  # The library's low pass: a new frame's share. Of 30 frames/s this lags by one.


@dataclass(frozen=True, slots=True)
class Retargeting:
    """Data with which a process retargets for one hand."""

    spec: HandSpec
    vectors: TargetVectors

    def open(self) -> Callable[[Array], Vector]:
        """From targets (k, 3), m, to the posture that comes nearest to all, (n,), rad. Raises ConfigError."""
        try:
            from dex_retargeting.retargeting_config import RetargetingConfig
        except ImportError as error:
            why = str(error).splitlines()[0]  # Without PyTorch it has a paragraph to say.
            raise ConfigError(
                f"teleop needs dex-retargeting, on Python 3.11 or 3.12: pip install 'allegro-twin[teleop]' ({why})"
            ) from error
        spec = self.spec
        path = data_root() / "models" / "urdf" / f"{spec.name}.urdf"
        tips, root = {finger.name: finger.tip for finger in spec.fingers}, _root(path.read_text())
        settings = {
            "type": "vector",
            "urdf_path": str(path),
            "target_origin_link_names": [root if name is None else tips[name] for name in self.vectors.origins],
            "target_task_link_names": [tips[name] for name in self.vectors.tips],
            # Asked for by the library, which does not read it: targets come as vectors already.
            "target_link_human_indices": np.zeros((2, len(self.vectors.tips)), int).tolist(),
            "scaling_factor": 1.0,
            "low_pass_alpha": _SMOOTH,
        }
        solver = RetargetingConfig.from_dict(settings).build()
        order = [solver.joint_names.index(name) for name in spec.joints]

        def retarget(targets: Array) -> Vector:
            with contextlib.redirect_stdout(io.StringIO()):  # It prints where its optimizer gives up a last digit.
                found: Vector = np.asarray(solver.retarget(targets), dtype=np.float64)[order]
            return found

        return retarget


def _root(urdf: str) -> str:
    tree = ElementTree.fromstring(urdf)
    children = {child.get("link") for child in tree.iter("child")}
    return next(str(link.get("name")) for link in tree.iter("link") if link.get("name") not in children)
