"""The centroid grasp: fingertips press through the centroid of their contacts, and hold it where it was found.

After Bae et al., "A Grasp Strategy with the Geometric Centroid of a Groped Object Shape Derived from Contact Spots",
ICRA 2012: what is groped is its contact spots, so no size needs to be told. Arrays broadcast over leading batch
dimensions; of k fingertips the last opposes the others: the thumb.
"""

from __future__ import annotations

import numpy as np

from allegro_twin.types import Array


def pressing(tips: Array, force: Array | float, spread: float = 0.25) -> Array:
    """Forces by which the fingertips press the object and cancel, shape (..., k, 3), N.

    With c the centroid of the m = k - 1 fingers and u the direction from it to the thumb: f_thumb = -F u and
    f_i = F/m u + β (c - p_i). Their sum is zero, and so is their moment about any point, whatever F and β are: they
    load the object and do not move it. β makes the part toward the centroid at most `spread` of F/m, since a finger
    that pulls sideways more than friction allows slides off. For two fingertips it is the line between them.
    `tips`: positions (..., k, 3), m; `force` F on the thumb, N.
    """
    fingers, thumb = tips[..., :-1, :], tips[..., -1:, :]
    centroid = fingers.mean(axis=-2, keepdims=True)
    axis = thumb - centroid
    axis = axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-6)
    share = np.asarray(force)[..., None, None] / fingers.shape[-2]
    inward = centroid - fingers
    widest = np.linalg.norm(inward, axis=-1, keepdims=True).max(axis=-2, keepdims=True)
    inward = inward * (spread / np.maximum(widest, 1e-6)) * (widest > 1e-6)
    return np.concatenate([share * (axis + inward), -share * fingers.shape[-2] * axis], axis=-2)


def holding(tips: Array, spots: Array, stiffness: float) -> Array:
    """Forces that bring the object back to where it was gripped, shape (..., k, 3), N, without adding to the pressing.

    With e_i = spot_i - p_i, mean ē and u_i the direction to the centroid: f_i = K (ē + (1 - u_i u_iᵀ)(e_i - ē)). The
    first term resists a shift of the whole grasp, the second its rotation; what would only open or close it is left
    to `pressing`. `stiffness` K in N/m.
    """
    away = spots - tips
    shift = away.mean(axis=-2, keepdims=True)
    towards = tips.mean(axis=-2, keepdims=True) - tips
    unit = towards / np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-6)
    turned = away - shift
    turned = turned - unit * (unit * turned).sum(axis=-1, keepdims=True)
    forces: Array = stiffness * (shift + turned)
    return forces


def joint_torques(jacobians: Array, forces: Array) -> Array:
    """τ = Σ J_iᵀ f_i, shape (..., n), N·m. `jacobians`: translational, (..., k, 3, n), m/rad."""
    torque: Array = np.einsum("...kcn,...kc->...n", jacobians, forces)
    return torque


def resting(jacobians: Array, torque: Array, damping: float = 1e-6) -> Array:
    """The part of a joint torque that no fingertip feels, shape (..., n): τ less Jᵀ (J Jᵀ + λ 1)⁻¹ J τ of each finger.

    A finger of four joints that holds a point has one motion left; posture torques act on that alone. `damping` λ in
    m²/rad² keeps a straight finger's inverse finite.
    """
    tip = np.einsum("...kcn,...n->...kc", jacobians, torque)
    square = np.einsum("...kcn,...kdn->...kcd", jacobians, jacobians)
    felt = np.linalg.solve(square + damping * np.eye(3), tip[..., None])[..., 0]
    return torque - joint_torques(jacobians, felt)
