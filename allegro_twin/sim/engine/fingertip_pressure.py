"""Simulated readings of pressure sensors in the fingertips."""

from __future__ import annotations

import math

import numpy as np

from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.contact_forces import contact_forces
from allegro_twin.types import Vector

RADIUS = 0.012  # m, of the fingertip. models/allegro.yaml.
AREA = 2.0 * math.pi * RADIUS**2
"""m², of the half sphere that touches. Nominal: nobody has published how the v5 sensor turns force into pressure."""


class PressureSensors:
    """The sum of normal contact forces on each fingertip's collision geom, over its area."""

    def __init__(self, backend: SimBackend) -> None:
        model = backend.model
        self._model, self._data = model, backend.data
        self._finger = np.full(model.ngeom, -1)
        for number, finger in enumerate(backend.spec.fingers):
            self._finger[model.geom(finger.tip).id] = number
        self._n = len(backend.spec.fingers)

    def __call__(self) -> Vector:
        """Per finger, (n,), Pa."""
        contact = self._data.contact
        active = np.flatnonzero(contact.efc_address >= 0)
        force = contact_forces(self._model, self._data, active)[:, 0]
        total = np.zeros(self._n)
        for side in self._finger[contact.geom[active]].T:
            tips = side >= 0
            total += np.bincount(side[tips], weights=force[tips], minlength=self._n)
        return total / AREA
