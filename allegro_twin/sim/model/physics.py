"""Physics settings of contacts, on which a verdict depends, with the defaults of every scene."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import mujoco
import numpy as np

from allegro_twin.spec import HandSpec

Cone: TypeAlias = Literal["elliptic", "pyramidal"]
Integrator: TypeAlias = Literal["implicitfast", "implicit", "Euler", "RK4"]
Solver: TypeAlias = Literal["Newton", "CG", "PGS"]
_CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}


@dataclass(frozen=True, slots=True)
class Physics:
    """Physics of contacts. The measurements behind each default are in docs/results/physics.md."""

    timestep: float = 0.001
    """s. Divides the hand's 3 ms."""
    softness: float = 0.005
    """Time constant of contacts, s (MuJoCo's solref): how soon two bodies that are in each other are apart."""
    impratio: float = 100.0
    """How much stiffer friction is than the normal direction."""
    noslip: int = 2
    """Iterations that take the remaining slip away."""
    torsional: float = 0.01
    """m. Soft rubber on plastic; DexGraspBench takes 0.02."""
    rolling: float = 0.0005
    """m."""
    cone: Cone = "elliptic"
    integrator: Integrator = "implicitfast"
    solver: Solver = "Newton"
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """World, m/s²."""

    def for_hand(self, spec: HandSpec, period: float) -> Physics:
        """With steps in which a hand is simulated truly and of which a whole number is a control period, s."""
        return self if self.timestep <= spec.coarsest_step else replace(self, timestep=spec.longest_step(period))

    def options(self, scene: mujoco.MjSpec) -> None:
        """Set a scene's options."""
        option = scene.option
        option.timestep, option.impratio, option.noslip_iterations = self.timestep, self.impratio, self.noslip
        option.cone = _CONES[self.cone]
        option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{self.integrator.upper()}")
        option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{self.solver.upper()}")
        option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        option.gravity = np.asarray(self.gravity)
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # A diverged state must be seen, not hidden.
        scene.compiler.degree = False

    def contacts(self, scene: mujoco.MjSpec) -> None:
        """Set what every geom that touches has."""
        for geom in scene.geoms:
            if geom.contype or geom.conaffinity:
                geom.solref = [self.softness, 1.0]

    def friction(self, sliding: float) -> tuple[float, float, float]:
        """Sliding, torsional (m) and rolling (m), as a geom has them."""
        return sliding, self.torsional, self.rolling
